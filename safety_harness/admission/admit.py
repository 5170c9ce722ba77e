"""Resolve a scenario's references, and refuse a scenario that cannot run, before any run begins."""

from __future__ import annotations

from collections.abc import Hashable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import lru_cache
from pathlib import Path
from typing import cast

import numpy as np
from numpy.typing import NDArray

from safety_harness.admission.avoiders import Avoiders, folder_of, refuse_unusable
from safety_harness.admission.checks import (
    check_cameras,
    check_decision_time,
    check_faults,
    checked_view,
    refuse_gate,
    refuse_late_drives,
)
from safety_harness.admission.claims import property_of
from safety_harness.admission.driving import (
    IN_PYTHON,
    NOBODY,
    Drivers,
    MadeDriver,
    driver_of,
    refuse_faults_of_avoider,
    refuse_no_action,
    refuse_no_images,
    refuse_unusable_driver,
    refuse_unusable_filter,
    refuse_unusable_predictor,
)
from safety_harness.admission.hands import check_hands
from safety_harness.admission.poses import (
    DESIRED,
    VIEW,
    check_desired,
    check_drives,
    check_obstacles,
    check_posture,
    check_stuck_joints,
    checked_start,
)
from safety_harness.base.exceptions import InadmissibleError, NoAnswerError, SettingsError, refuse_other_type
from safety_harness.base.seeds import Branch, seed
from safety_harness.base.settings import DecisionCost, DecisionTimes, Settings, Vector3
from safety_harness.cell.avoidance.asking import Question, ask
from safety_harness.cell.avoidance.avoider import Avoider, decision_time_of, shown_to
from safety_harness.cell.avoidance.gate import Gate
from safety_harness.cell.controller.around import ControllerWrapper
from safety_harness.cell.controller.controller import AvoidingServo
from safety_harness.cell.controller.decision_times import decision_times_s, recorded_late, recorded_times_s
from safety_harness.cell.controller.driven import DrivenController
from safety_harness.cell.controller.filtered import FilterCalls, FilteredController
from safety_harness.cell.controller.predicting import PredictorCalls
from safety_harness.cell.controller.shield import Guard, guard_of
from safety_harness.cell.robot.description import ArmModel
from safety_harness.cell.robot.robots import (
    arm_capsules,
    arm_model,
    drive_model,
    inverse_kinematics,
    refuse_unfit,
)
from safety_harness.cell.robot.urdf import ArmFileError
from safety_harness.cell.servoing.control import DesiredView
from safety_harness.cell.simulation.truth import cell_capsules
from safety_harness.claims.properties.base import Property
from safety_harness.scenario.fault_table import fault_table
from safety_harness.scenario.model import NO_AVOIDER, Scenario
from safety_harness.scenario.robots import AnyRobot
from safety_harness.seams.contract import UserController
from safety_harness.space.regions import SeenRegions, seen_by
from safety_harness.trace.trace import Trace

FIRST_ANSWER_S = 300.0  # for an avoider's imports, loading and compilation


@dataclass(frozen=True, eq=False, kw_only=True)
class Checked:
    """A scenario that has passed all checks that need no avoider."""

    scenario: Scenario
    arm: ArmModel
    view: DesiredView | None  # None: the controller does not see the object
    joint_position_rad: NDArray[np.float64]  # (n,) where the arm starts
    properties: tuple[Property, ...]  # in the order of the scenario's claims


@dataclass(frozen=True, eq=False, kw_only=True)
class Admitted(Checked):
    """A scenario whose references are resolved, ready to run and to be judged.

    Args:
        scenario: The scenario.
        arm: The kinematic model of the robot arm.
        view: The view of the object at the desired pose, or None if the controller does not see the object.
        joint_position_rad: (n,) The joint angles at the start.
        properties: The property of each claim, in the order of the scenario's claims.
        avoider: The avoider.  If a controller other than the visual servo drives the arm, this is a stand-in
            without answers.
        avoider_sha256: The hash of the avoider's file, or an empty text if the avoider has no file.
        driver: The user's controller.  None means that the visual servo drives the arm.
        safety_filter: The user's filter of commands, if any.
        predictor: The scenario's predictor of hands, if any.

    """

    avoider: Avoider  # NOBODY where another controller than the visual servo drives
    avoider_sha256: str  # of the file that the avoider comes from; empty for one without
    driver: MadeDriver | None = None  # None: the visual servo
    safety_filter: MadeDriver | None = None
    predictor: MadeDriver | None = None

    def controller(
        self, recorded: Trace | None = None
    ) -> AvoidingServo | DrivenController | FilteredController:
        """Return a new controller for one run.

        Args:
            recorded: An earlier run of the scenario, whose decision times the new run repeats.  None means
                that the run measures or draws new times.

        Raises:
            ControllerError: The ``reset`` method of the user's controller raises an exception.

        """
        own = self.servo(recorded) if self.driver is None else self.driven_by(self.driver.controller)
        return own if self.safety_filter is None else self.filtered(own, self.safety_filter.controller)

    def filtered(
        self, pilot: AvoidingServo | ControllerWrapper | DrivenController, safety_filter: UserController
    ) -> FilteredController:
        """Return a controller for one run that passes every command of ``pilot`` through ``safety_filter``.

        Args:
            pilot: The controller.
            safety_filter: The user's filter of commands.

        Raises:
            ControllerError: The ``reset`` method of the filter raises an exception.

        """
        scenario = self.scenario
        calls = FilterCalls(
            safety_filter,
            scenario.settings,
            self.arm,
            self.view,
            self.joint_position_rad,
            seed(scenario.seed, Branch.SAFETY_FILTER),
            scenario.hand_slots,
        )
        return FilteredController(pilot, calls, scenario.ticks + 1)

    def driven_by(self, controller: UserController) -> DrivenController:
        """Return the user's ``controller``, prepared for one run.

        Args:
            controller: The user's controller.

        """
        scenario = self.scenario
        return DrivenController(
            controller,
            scenario.settings,
            self.arm,
            self.view,
            self.joint_position_rad,
            seed(scenario.seed, Branch.CONTROLLER),
            scenario.hand_slots,
            self.guard(),
            decision_times_s(self.cost, 0.0, scenario.seed, scenario.ticks + 1),
        )

    @property
    def answers_later(self) -> bool:
        """Whether the scenario's controller needs simulated time for its answers."""
        costs = isinstance(self.cost, DecisionTimes) and self.cost.most_s > 0.0
        return self.scenario.driven and costs

    @property
    def cost(self) -> DecisionCost | DecisionTimes:
        """The simulated time that an answer takes, according to the settings."""
        return self.scenario.settings.avoidance.decision_time

    def servo(self, recorded: Trace | None = None) -> AvoidingServo:
        """Return a fresh visual servo for one run of a scenario that it drives.

        Args:
            recorded: An earlier run of the scenario, with the same meaning as in ``controller``.

        """
        scenario, settings = self.scenario, self.scenario.settings
        assert self.view is not None
        robot = scenario.robot
        arm = inverse_kinematics(robot), arm_capsules(robot)
        gate = Gate.from_settings(settings, *arm, scenario.obstacles, scenario.gate)
        cost, declared_s = self.cost, decision_time_of(self.avoider)
        if recorded is not None and cost is DecisionCost.WALL_CLOCK:
            times_s = recorded_times_s(recorded)
        else:
            times_s = decision_times_s(cost, declared_s, scenario.seed, scenario.ticks + 1)
        return AvoidingServo(
            settings,
            self.arm,
            self.view,
            self.avoider,
            gate,
            scenario.seed,
            () if recorded is None else recorded_late(recorded),
            fault_table(scenario.faults),
            times_s,
            scenario.hand_slots,
            self.guard(),
            None if self.predictor is None else self._predicting(self.predictor.controller),
        )

    def _predicting(self, predictor: UserController) -> PredictorCalls:
        """Return the object that queries ``predictor`` in one run."""
        scenario = self.scenario
        return PredictorCalls(
            predictor,
            scenario.settings,
            self.arm,
            self.view,
            self.joint_position_rad,
            seed(scenario.seed, Branch.PREDICTOR),
            scenario.hand_slots,
            scenario.ticks + 1,
        )

    def guard(self) -> Guard:
        """Return the guard that enforces the scenario's shield in one run.

        If the scenario has no shield, the guard has no effect.
        """
        scenario = self.scenario
        capsules = cell_capsules(arm_capsules(scenario.robot), scenario.settings)
        ticks = scenario.ticks + 1
        return guard_of(scenario.shield, scenario.settings, self.arm, capsules, ticks, scenario.hand_slots)


class Admitter:
    """An object that admits several scenarios, so that no result depends on an earlier scenario.

    The object creates the avoider of each Python file only once.  If such an avoider stores data in memory,
    the data remain from one run to the next.
    """

    def __init__(self) -> None:
        self._avoiders = Avoiders()
        self._drivers = Drivers()
        # Many scenarios share an avoider, whose first answer may take minutes.
        self._answers = lru_cache(maxsize=16)(answers_at_first)
        self._seen_by = lru_cache(maxsize=16)(seen_by)

    def admit(self, scenario: Scenario) -> Admitted:
        """Resolve a scenario's references and check that it can run.

        Raise InadmissibleError if it cannot run.
        """
        checked = check(scenario)
        admitted = self._admitted(checked)
        if scenario.predictor:
            admitted = replace(admitted, predictor=self._drivers.predictor_for(scenario))
        if scenario.safety_filter:
            admitted = _with_filter(admitted, self._drivers.filter_for(scenario))
        return admitted

    def admit_afresh(self, scenario: Scenario) -> Admitted:
        """Do the same as ``admit``, but restart the user's programs, so that they remember no earlier run.

        A policy in an ONNX file is not restarted, because its memory is reset before each run anyway.
        """
        self._avoiders.forget_programs()
        self._drivers.forget_programs()
        return self.admit(scenario)

    def _admitted(self, checked: Checked) -> Admitted:
        """Return the checked scenario with its avoider or controller.

        The safety filter and the predictor are not yet added.
        """
        scenario = checked.scenario
        if scenario.driven:
            return _driven(checked, self._drivers.driver_for(scenario))
        with _placed(scenario):
            avoider, sha256 = self._avoiders.avoider_for(scenario)
        hand, tcp = first_question(scenario.settings)
        return _admitted(checked, avoider, sha256, self._answers(cast(Hashable, avoider), hand, tcp))

    def seen_of(self, scenario: Scenario) -> SeenRegions:
        """Return the input space on which the scenario's avoider was trained, as computed by ``seen_by``."""
        settings = scenario.settings.steady
        return self._seen_by(scenario.under_test, folder=folder_of(scenario), settings=settings)


def admit(
    scenario: Scenario, *, avoider: Avoider | None = None, controller: UserController | None = None
) -> Admitted:
    """Resolve a scenario's references and check that it can run.

    Args:
        scenario: The scenario.
        avoider: An avoider that replaces the scenario's own.  The default None leaves the scenario's avoider
            in place.
        controller: A controller that replaces the scenario's own.  The default None leaves the scenario's
            controller in place.  Do not give both an avoider and a controller, because only the visual servo
            asks an avoider.

    Returns:
        The scenario together with its arm, its avoider or controller, and the property of each claim.

    Raises:
        InadmissibleError: The scenario cannot run.  The error states the place in the scenario file.
        InputError: A file that the scenario refers to cannot be used.

    """
    refuse_other_type("admit(scenario)", scenario, Scenario)
    if controller is not None:
        if avoider is not None:
            expected = "one of avoider and controller: only the visual servo asks an avoider"
            raise InadmissibleError.of_option("admit(controller)", expected, "both")
        driver = driver_of(controller)
        reference = f"{controller.name}{IN_PYTHON}"
        return _driven(check(replace(scenario, controller=reference, avoider=NO_AVOIDER)), driver)
    if avoider is None:
        return Admitter().admit(scenario)
    if isinstance(avoider, type) or not hasattr(avoider, "propose"):
        expected, hint = "an object with a propose", "shipped_avoider(name) is one of ours, Mine() of a class"
        raise InadmissibleError.of_option("admit(avoider)", expected, repr(avoider)[:80], hint)
    answers = answers_at_first(avoider, *first_question(scenario.settings))
    return _admitted(check(scenario), avoider, "", answers)


class Checker:
    """An admitter that makes only the checks that execute no user code."""

    def __init__(self) -> None:
        self._seen: set[tuple[tuple[str, ...], Path | None, Settings]] = set()

    def check(self, scenario: Scenario) -> Checked:
        """Check a scenario without creating or querying its avoider."""
        checked = check(scenario)
        self.check_tested(scenario)
        return checked

    def check_tested(self, scenario: Scenario) -> None:
        """Check only the scenario's avoider or controller, without executing user code."""
        key = scenario.parts_under_test, folder_of(scenario), scenario.settings
        if key not in self._seen:
            with _placed(scenario):
                (refuse_unusable_driver if scenario.driven else refuse_unusable)(scenario)
                refuse_unusable_filter(scenario)
                refuse_unusable_predictor(scenario)
            self._seen.add(key)


def refuse_no_answer(scenario: Scenario) -> None:
    """Create the scenario's controller, or create its avoider and query the avoider once.

    The function raises the same errors as ``admit``.
    """
    if scenario.safety_filter:
        Drivers().filter_for(scenario)
    if scenario.predictor:
        Drivers().predictor_for(scenario)
    if scenario.driven:
        Drivers().driver_for(scenario)
        return
    with _placed(scenario):
        avoider, _ = Avoiders().avoider_for(scenario)
    if not answers_at_first(avoider, *first_question(scenario.settings)):
        raise _no_answer(scenario)


def check(scenario: Scenario) -> Checked:
    """Run all checks of a scenario that need no avoider.

    The function raises the same errors as ``admit``. The function does not read or execute the avoider's
    file. If a controller other than the visual servo drives the arm, the function also skips the checks of
    that controller and of the view of the object.
    """
    return _check(scenario, sees_object=not scenario.driven)


def _check(scenario: Scenario, *, sees_object: bool) -> Checked:
    """Check a scenario.  If ``sees_object`` is true, also check the view of the object."""
    arm = _arm_of(scenario)
    with _placed(scenario):
        # The posture comes first, because the inverse kinematics of later checks prefers angles near it.
        check_posture(scenario, arm)
        refuse_gate(scenario)
        check_stuck_joints(scenario, arm)
        check_cameras(scenario)
        view = None
        if sees_object:
            view = _view_of_cell(_Cell(scenario.settings.steady, scenario.robot, scenario))
        start = checked_start(scenario, arm, sees_object=sees_object)
        if scenario.driven:
            refuse_faults_of_avoider(scenario)
        check_obstacles(scenario, arm, start)
        check_drives(scenario, arm, start)
        refuse_late_drives(scenario)
        check_hands(scenario, arm, start)
        check_faults(scenario)
        properties = tuple(property_of(claim, scenario) for claim in scenario.claims)
    return Checked(scenario=scenario, arm=arm, view=view, joint_position_rad=start, properties=properties)


def _driven(checked: Checked, driver: MadeDriver) -> Admitted:
    """Return the admitted scenario with the user's controller ``driver``."""
    # ``check`` did not know yet whether the controller needs the object in view.
    if driver.sees_object:
        checked = _check(checked.scenario, sees_object=True)
    refuse_no_images(checked.scenario, driver)
    check_decision_time(checked.scenario, NOBODY, driver.sha256)
    admitted = Admitted(**vars(checked), avoider=NOBODY, avoider_sha256="", driver=driver)
    refuse_no_action(admitted.scenario, driver, admitted.driven_by)
    return admitted


def _with_filter(admitted: Admitted, safety_filter: MadeDriver) -> Admitted:
    """Return the admitted scenario, extended by the filter ``safety_filter``."""
    refuse_no_images(admitted.scenario, safety_filter)
    if safety_filter.sees_object and admitted.view is None:
        admitted = replace(admitted, view=_check(admitted.scenario, sees_object=True).view)
    return replace(admitted, safety_filter=safety_filter)


def _arm_of(scenario: Scenario) -> ArmModel:
    """Return the model of the scenario's arm.

    Raise InadmissibleError if the arm's files cannot be used.
    """
    try:
        refuse_unfit(scenario.robot)
        drive_model(scenario.robot)
        return arm_model(scenario.robot)
    except ArmFileError as error:
        raise scenario.inadmissible("an arm that can be used", str(error), "robot") from error


def _admitted(checked: Checked, avoider: Avoider, sha256: str, answers: bool) -> Admitted:
    """Return the admitted scenario with ``avoider`` as its avoider.

    Raise InadmissibleError if ``answers`` is false, that is, if the avoider did not answer its first query.
    """
    if not answers:
        raise _no_answer(checked.scenario)
    check_decision_time(checked.scenario, avoider, sha256)
    return Admitted(**vars(checked), avoider=avoider, avoider_sha256=sha256)


def _no_answer(scenario: Scenario) -> InadmissibleError:
    """Return the error for an avoider that did not answer its first query."""
    expected = f"an avoider that answers its first question within {FIRST_ANSWER_S:g} s"
    return scenario.inadmissible(expected, "none until then", "avoider")


@dataclass(frozen=True)
class _Cell:
    """The settings and the robot of a scenario; both are independent of the scenario's hands and start.

    ``scenario`` is used only to state places in error messages. ``settings`` are the result of
    ``Settings.steady``: the cameras have no noise and no delay, because these do not affect the checks of a
    cell.
    """

    settings: Settings
    robot: AnyRobot
    scenario: Scenario = field(compare=False)


@lru_cache(maxsize=16)  # many scenarios share a cell
def _view_of_cell(cell: _Cell) -> DesiredView:
    """Return the view of the object at the desired pose, after checking that the cell allows servoing."""
    view = checked_view(cell.scenario)
    check_desired(cell.scenario, arm_model(cell.robot))
    return view


@contextmanager
def _placed(scenario: Scenario) -> Iterator[None]:
    """Convert a SettingsError into an InadmissibleError that states where the file contains the setting."""
    try:
        yield
    except SettingsError as error:
        field = error.place.field or "settings"
        same = [path for path in scenario.places if path.endswith(f".{field}")]
        expected = error.expected
        hint = error.hint
        raise scenario.inadmissible(expected, error.got, field, *same, *VIEW, DESIRED, hint=hint) from error


def first_question(settings: Settings) -> tuple[Vector3, Vector3]:
    """Return the input of a first query: the nominal hand position and the desired TCP position."""
    return settings.avoidance.nominal_hand_position_in_base_m, settings.cell.desired_tcp_position_in_base_m


def answers_at_first(avoider: Avoider, hand_in_base_m: Vector3, tcp_in_base_m: Vector3) -> bool:
    """Return whether the avoider answers a first query.

    The query precedes the run, so that the avoider imports and compiles everything before the run begins.
    The function ignores the answer's content, because a wrong answer will also show in the run.  If an
    avoider sees more than positions, the function skips the query and returns True, because no view exists
    yet.

    Returns:
        False if the avoider does not answer within FIRST_ANSWER_S.

    """
    if shown_to(avoider):
        return True
    try:
        ask(avoider, Question(np.array(hand_in_base_m), np.array(tcp_in_base_m), 0, FIRST_ANSWER_S))
    except NoAnswerError:
        return False
    return True
