"""Controllers other than the visual servo: their creation and the checks of a scenario that uses them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from safety_harness.admission.avoiders import BESIDE, avoider_sha256, folder_of, is_a_program
from safety_harness.base.exceptions import AvoiderError, ControllerError, InadmissibleError, Place, TraceError
from safety_harness.base.settings import ImageSource
from safety_harness.cell.avoidance.avoider import Avoider, Proposal, Vector
from safety_harness.cell.controller.predicting import KALMAN_FILTER, KalmanFilter
from safety_harness.cell.robot.robots import urdf_sha256_of
from safety_harness.scenario.faults import AvoiderLate, AvoiderNaN, AvoiderSilent
from safety_harness.scenario.model import NO_AVOIDER, Scenario
from safety_harness.scenario.references import file_and_name, names_onnx
from safety_harness.seams.contract import (
    DECISIONS,
    IMAGE,
    OBJECT,
    SIGHTS,
    WANTED,
    Image,
    UserController,
    reports_of,
    sees_of,
)
from safety_harness.trace.records import TRACKS_PER_HAND
from safety_harness.trace.system import Component, SystemUnderTest, system_of
from safety_harness.trace.trace import Trace

IN_PYTHON = " (an object in Python)"  # added to its name, as a reference without a file


class _Nobody:
    """A placeholder for the avoider, for controllers that never query an avoider."""

    name = NO_AVOIDER

    def propose(
        self, *, hand_position_in_base_m: Vector, tcp_position_in_base_m: Vector, seed: int
    ) -> Proposal:
        """Raise AvoiderError, because a controller without an avoider must not query this placeholder."""
        raise AvoiderError("the controller asks no avoider")


NOBODY: Avoider = _Nobody()


@dataclass(frozen=True, eq=False)
class MadeDriver:
    """A user's controller, together with a function that creates a new instance of it.

    The controller may store data in memory.
    """

    controller: UserController
    make: Callable[[], UserController]
    sha256: str = ""  # of its file; empty for one that ships, or without a file
    tried: set[object] = field(default_factory=set, init=False, repr=False)
    _lanes: list[UserController] = field(default_factory=list, init=False, repr=False)

    @property
    def many(self) -> bool:
        """Whether the controller can drive many episodes side by side, with one object per episode."""
        return getattr(self.controller, "another", None) is not None and DECISIONS not in reports_of(
            self.controller
        )

    def lane(self, number: int) -> UserController:
        """Return the controller of lane ``number``.

        Every call returns the same object.  The first lane uses the controller of single runs.
        """
        another: Any = getattr(self.controller, "another", None)
        while len(self._lanes) <= number:
            self._lanes.append(another() if self._lanes else self.controller)
        return self._lanes[number]

    @property
    def component(self) -> Component:
        """The component that describes the controller in the record of the system under test."""
        return Component(name=self.controller.name, sha256=self.sha256)

    @property
    def sees_object(self) -> bool:
        """Whether the controller needs the object in view."""
        return bool({OBJECT, IMAGE} & {*sees_of(self.controller)})


class Drivers:
    """The controllers of scenarios.

    Each is created only once, so that its memory lasts from one run to the next.
    """

    def __init__(self) -> None:
        self._made: dict[tuple[str, Path | None], MadeDriver] = {}

    def driver_for(self, scenario: Scenario) -> MadeDriver:
        """Return the scenario's controller.

        Raise InadmissibleError at the key ``controller`` if the controller cannot be used.
        """
        key = scenario.controller, folder_of(scenario)
        if key not in self._made:
            made = self._made_of(key, scenario.place("controller"))
            try:
                sees_of(made.controller, SIGHTS)
            except ControllerError as error:
                expected = "a controller, which sees no wanted command"
                raise scenario.inadmissible(expected, str(error), "controller") from error
        return self._made[key]

    def filter_for(self, scenario: Scenario) -> MadeDriver:
        """Return the scenario's safety filter.

        Raise InadmissibleError at the key ``safety filter`` if the filter cannot be used.
        """
        place, folder = scenario.place("safety filter"), folder_of(scenario)
        refuse_unusable_filter(scenario)
        key = scenario.safety_filter, folder
        made = self._made.get(key) or self._made_of(key, place)
        if WANTED not in sees_of(made.controller):
            hint = "a filter that does not see the command can only replace it: that is a controller"
            expected, got = f'a safety filter with "{WANTED}" in its sees', ", ".join(made.controller.sees)
            raise InadmissibleError(place=place, expected=expected, got=got or "nothing", hint=hint)
        return made

    def predictor_for(self, scenario: Scenario) -> MadeDriver:
        """Return the scenario's predictor.

        Raise InadmissibleError at the key ``predictor`` if the predictor cannot be used.
        """
        place, folder = scenario.place("predictor"), folder_of(scenario)
        refuse_unusable_predictor(scenario)
        if scenario.predictor == KALMAN_FILTER:
            return kalman_filter()
        key = scenario.predictor, folder
        made = self._made.get(key) or self._made_of(key, place)
        if {IMAGE, WANTED} & {*sees_of(made.controller)}:
            expected = "a predictor, which sees no image and no wanted command"
            got = ", ".join(made.controller.sees)
            raise InadmissibleError(place=place, expected=expected, got=got)
        return made

    def forget_programs(self) -> None:
        """Forget the controllers and filters that may remember earlier runs."""
        self._made = {key: made for key, made in self._made.items() if names_onnx(key[0])}

    def _made_of(self, key: tuple[str, Path | None], place: Place) -> MadeDriver:
        """Create and return the controller or filter for a reference and a folder."""
        from safety_harness.cell.controller.named import controller_of, controller_sha256

        make = controller_of(*key, place)
        self._made[key] = MadeDriver(make(), make, controller_sha256(*key))
        return self._made[key]


def kalman_filter() -> MadeDriver:
    """Return the predictor that this package ships, a Kalman filter."""
    return MadeDriver(KalmanFilter(), KalmanFilter)


def driver_of(controller: object) -> MadeDriver:
    """Return the driver for a user's own object.

    Raise InadmissibleError if the object does not fulfil the interface of a controller.
    """
    place = Place(field="admit(controller)")
    if isinstance(controller, type):
        hint = f"{controller.__name__}() makes one"
        raise InadmissibleError(place=place, expected="an object", got="a class", hint=hint)
    from safety_harness.cell.controller.python_file import checked_controller

    made = checked_controller(controller, type(controller).__name__, place)
    return MadeDriver(made, lambda: made)


def refuse_unusable_driver(scenario: Scenario) -> None:
    """Raise those errors of ``Drivers`` that can be detected without executing user code."""
    from safety_harness.cell.controller.named import refuse_unusable_controller

    refuse_unusable_controller(scenario.controller, folder_of(scenario), scenario.place("controller"))


def refuse_unusable_filter(scenario: Scenario) -> None:
    """Raise those errors of a safety filter that can be detected without executing user code."""
    reference, place = scenario.safety_filter, scenario.place("safety filter")
    if not reference:
        return
    if scenario.shield is not None:
        expected = "a shield or a safety filter, because each must be the last before the drives"
        raise InadmissibleError(place=place, expected=expected, got="both")
    _refuse_no_program(scenario, reference, "a safety filter: ", place)


def _refuse_no_program(scenario: Scenario, reference: str, forms: str, place: Place) -> None:
    """Refuse a ``reference`` that is no program, or a program that cannot be used.

    ``forms`` states further allowed references, for the error message.
    """
    from safety_harness.cell.controller.named import refuse_unusable_controller

    if not is_a_program(reference):
        expected = f"{forms}FILE.py:NAME, exec:COMMAND, tcp:HOST:PORT or unix:PATH"
        hint = f"name the class in it as well: {reference}:NAME" if reference.endswith(".py") else ""
        raise InadmissibleError(place=place, expected=expected, got=repr(reference), hint=hint)
    refuse_unusable_controller(reference, folder_of(scenario), place)


def refuse_unusable_predictor(scenario: Scenario) -> None:
    """Raise those errors of a predictor that can be detected without executing user code."""
    reference, place = scenario.predictor, scenario.place("predictor")
    if not reference:
        return
    if scenario.driven:
        expected = "no predictor beside a controller, which does its own prediction"
        raise InadmissibleError(place=place, expected=expected, got=f"controller {scenario.controller}")
    if reference == KALMAN_FILTER:
        return
    _refuse_no_program(scenario, reference, f"a predictor: {KALMAN_FILTER}, ", place)


def refuse_other_parts(trace: Trace, scenario: Scenario, file: Path | None = None) -> None:
    """Raise TraceError if the name or file hash of a part in ``BESIDE`` differs from the trace.

    Args:
        trace: The trace, which was loaded from ``file``.
        scenario: The scenario of the trace, with the parts that the user states for the repetition.
        file: The file of the trace, for the error.

    """
    from safety_harness.cell.controller.named import controller_sha256

    for name in BESIDE:
        then, reference = trace.system.parts.get(name), getattr(scenario, name)
        if then is None or not is_a_program(reference):
            continue
        named = {file_and_name(getattr(each, name))[1] for each in (trace.scenario, scenario)}
        sha256 = controller_sha256(reference, folder_of(scenario))
        if len(named) > 1 or then.sha256 not in ("", sha256):
            raise TraceError(
                place=Place(file=file, field=name.replace("_", " ")),
                expected=f"{then}, as then",
                got=f"{reference} (sha256 {sha256[:12]}...)",
            )


def named_system(scenario: Scenario) -> SystemUnderTest:
    """Return the system under test as described by the scenario's references.

    The function creates no avoider and no controller.  A file appears under its name, without its folder.
    """
    from safety_harness.cell.controller.named import controller_sha256

    called = _called(scenario.under_test)
    if scenario.driven:
        sha256 = controller_sha256(scenario.controller, folder_of(scenario))
        own = {"controller": Component(name=called, sha256=sha256)}
    else:
        own = {"avoider": Component(name=called, sha256=avoider_sha256(scenario))}
    if reference := scenario.safety_filter:
        sha256 = controller_sha256(reference, folder_of(scenario))
        own["safety_filter"] = Component(name=_called(reference), sha256=sha256)
    if reference := scenario.predictor:
        sha256 = "" if reference == KALMAN_FILTER else controller_sha256(reference, folder_of(scenario))
        own["predictor"] = Component(name=_called(reference), sha256=sha256)
    return system_of(scenario, robot_sha256=urdf_sha256_of(scenario.robot), **own)


def _called(reference: str) -> str:
    """Return the reference of a part, with the folder removed from its file's path."""
    file, name = file_and_name(reference)
    return f"{Path(file).name}:{name}" if name else Path(file).name or str(reference)


def refuse_no_action(scenario: Scenario, driver: MadeDriver, driven_by: Callable[..., Any]) -> None:
    """Raise InadmissibleError if an ONNX policy fails, or if its fixed axes do not fit the scenario.

    The axes must fit the number of joints, the number of hands and the image size.  The function queries the
    policy once with a black image, through the controller that ``driven_by`` returns.  It does not query a
    program, because the query might change the program's state.
    """
    camera, rows = scenario.settings.camera, scenario.hand_slots * TRACKS_PER_HAND
    key = scenario.robot, rows, camera.height_px, camera.width_px
    if not names_onnx(scenario.controller) or key in driver.tried:
        return
    black = Image(time_s=np.nan, new=False, pixels=np.zeros((*key[2:], 3), np.uint8))
    try:
        controller = driven_by(driver.controller)
        controller.sees_images_of(lambda: black)
        controller.ask()
    except ControllerError as error:
        expected = f"a policy that answers for the arm {scenario.robot.label} and {rows} rows of hands"
        raise scenario.inadmissible(expected, str(error), "controller") from error
    driver.tried.add(key)


def refuse_no_images(scenario: Scenario, driver: MadeDriver) -> None:
    """Raise InadmissibleError if the controller sees images but the camera does not render images."""
    source = scenario.settings.camera.source
    if IMAGE in sees_of(driver.controller) and source is not ImageSource.RENDERED:
        expected = "rendered images, as the controller sees them: camera: {source: rendered}"
        raise scenario.inadmissible(expected, source.value, "camera.source", "controller")


def refuse_faults_of_avoider(scenario: Scenario) -> None:
    """Raise InadmissibleError if the scenario contains a fault of an avoider.

    The caller has checked that the scenario's controller queries no avoider.
    """
    for number, fault in enumerate(scenario.faults):
        if isinstance(fault, AvoiderLate | AvoiderNaN | AvoiderSilent):
            expected = f"faults of cameras, joints and brakes: {scenario.controller} asks no avoider"
            raise scenario.inadmissible(expected, "a fault of the avoider", f"faults[{number}]", "faults")
