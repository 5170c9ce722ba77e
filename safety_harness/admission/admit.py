"""Admission: resolve a scenario's references and refuse what cannot be tried, before anything runs."""

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
from safety_harness.base.settings import DecisionCost, Settings, Vector3
from safety_harness.cell.avoidance.asking import Question, ask
from safety_harness.cell.avoidance.avoider import Avoider, decision_time_of, shown_to
from safety_harness.cell.avoidance.gate import Gate
from safety_harness.cell.controller.controller import AvoidingServo
from safety_harness.cell.controller.decision_times import decision_times_s, recorded_late, recorded_times_s
from safety_harness.cell.controller.driven import DrivenController
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

FIRST_ANSWER_S = 300.0  # time to import, load and compile whatever an avoider needs


@dataclass(frozen=True, eq=False, kw_only=True)
class Checked:
    """A scenario that can be tried, as far as that can be said without making its avoider."""

    scenario: Scenario
    arm: ArmModel
    view: DesiredView | None  # None: nothing of the object is seen
    joint_position_rad: NDArray[np.float64]  # (n,) where the arm starts
    properties: tuple[Property, ...]  # in the order of the scenario's claims


@dataclass(frozen=True, eq=False, kw_only=True)
class Admitted(Checked):
    """A scenario with everything resolved: ready to be run and judged."""

    avoider: Avoider  # NOBODY where another controller than the visual servo drives
    avoider_sha256: str  # of the file that the avoider comes from; empty for one without
    driver: MadeDriver | None = None  # None: the visual servo

    def controller(self, recorded: Trace | None = None) -> AvoidingServo | DrivenController:
        """A fresh controller for one run; ``recorded`` is an earlier one, whose times count again.

        ControllerError for a user's whose ``reset`` raises.
        """
        if self.driver is None:
            return self.servo(recorded)
        return self.driven_by(self.driver.controller)

    def driven_by(self, controller: UserController) -> DrivenController:
        """With a user's controller for one run."""
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
        )

    def servo(self, recorded: Trace | None = None) -> AvoidingServo:
        """As ``controller``, of a scenario that the visual servo drives."""
        scenario, settings = self.scenario, self.scenario.settings
        assert self.view is not None
        robot = scenario.robot
        arm = inverse_kinematics(robot), arm_capsules(robot)
        gate = Gate.from_settings(settings, *arm, scenario.obstacles, scenario.gate)
        cost, declared_s = settings.avoidance.decision_time, decision_time_of(self.avoider)
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
        )

    def guard(self) -> Guard:
        """The scenario's shield for one run; empty if it has none."""
        scenario = self.scenario
        capsules = cell_capsules(arm_capsules(scenario.robot), scenario.settings)
        ticks = scenario.ticks + 1
        return guard_of(scenario.shield, scenario.settings, self.arm, capsules, ticks, scenario.hand_slots)


class Admitter:
    """Admits one scenario after another; what becomes of one does not depend on those before it.

    The avoider of a Python file is made once, so that one with a memory of its own keeps it from run to run.
    """

    def __init__(self) -> None:
        self._avoiders = Avoiders()
        self._drivers = Drivers()
        self._answers = lru_cache(maxsize=16)(answers_at_first)
        self._seen_by = lru_cache(maxsize=16)(seen_by)

    def admit(self, scenario: Scenario) -> Admitted:
        """Resolve and check; InadmissibleError names the place, what was expected and what came."""
        checked = check(scenario)
        if scenario.driven:
            return _driven(checked, self._drivers.of(scenario))
        with _placed(scenario):
            avoider, sha256 = self._avoiders.of(scenario)
        hand, tcp = first_question(scenario.settings)
        return _admitted(checked, avoider, sha256, self._answers(cast(Hashable, avoider), hand, tcp))

    def seen_of(self, scenario: Scenario) -> SeenRegions:
        """What the scenario's avoider was trained on, as ``seen_by`` has it."""
        settings = scenario.settings.steady
        return self._seen_by(scenario.under_test, folder=folder_of(scenario), settings=settings)


def admit(
    scenario: Scenario, *, avoider: Avoider | None = None, controller: UserController | None = None
) -> Admitted:
    """As an ``Admitter`` of its own; ``avoider`` takes the place of the one that the scenario names.

    So does ``controller``, which drives the arm in place of the visual servo.
    """
    refuse_other_type("admit(scenario)", scenario, Scenario)
    if controller is not None:
        if avoider is not None:
            expected = "one of avoider and controller: only the visual servo asks an avoider"
            raise InadmissibleError.of_option("admit(controller)", expected, "both")
        driver = driver_of(controller)
        named = f"{controller.name}{IN_PYTHON}"
        return _driven(check(replace(scenario, controller=named, avoider=NO_AVOIDER)), driver)
    if avoider is None:
        return Admitter().admit(scenario)
    if isinstance(avoider, type) or not hasattr(avoider, "propose"):
        expected, hint = "an object with a propose", "shipped_avoider(name) is one of ours, Mine() of a class"
        raise InadmissibleError.of_option("admit(avoider)", expected, repr(avoider)[:80], hint)
    answers = answers_at_first(avoider, *first_question(scenario.settings))
    return _admitted(check(scenario), avoider, "", answers)


class Looker:
    """What ``Admitter`` is to those who only look: everything is checked, nothing of a user's is executed."""

    def __init__(self) -> None:
        self._seen: set[tuple[str, Path | None, Settings]] = set()

    def look(self, scenario: Scenario) -> Checked:
        """As ``Admitter.admit``, but that an avoider can be made and answers is for the run to see."""
        checked = check(scenario)
        key = scenario.under_test, folder_of(scenario), scenario.settings
        if key not in self._seen:
            with _placed(scenario):
                (refuse_unusable_driver if scenario.driven else refuse_unusable)(scenario)
            self._seen.add(key)
        return checked


def refuse_no_answer(scenario: Scenario) -> None:
    """As ``admit`` refuses, for the sake of the scenario's avoider alone, which is made and asked once.

    Or of its controller, which is made.
    """
    if scenario.driven:
        Drivers().of(scenario)
        return
    with _placed(scenario):
        avoider, _ = Avoiders().of(scenario)
    if not answers_at_first(avoider, *first_question(scenario.settings)):
        raise _no_answer(scenario)


def check(scenario: Scenario) -> Checked:
    """All of admission but the avoider, of which nothing is read or executed; errors as of ``admit``.

    And but the controller, unless it is the visual servo: what of the object it sees is not known here.
    """
    return _check(scenario, sees_object=not scenario.driven)


def _check(scenario: Scenario, *, sees_object: bool) -> Checked:
    arm = _arm_of(scenario)
    with _placed(scenario):
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
    if driver.sees_object:
        checked = _check(checked.scenario, sees_object=True)
    refuse_no_images(checked.scenario, driver)
    admitted = Admitted(**vars(checked), avoider=NOBODY, avoider_sha256="", driver=driver)
    refuse_no_action(admitted.scenario, driver, admitted.driven_by)
    return admitted


def _arm_of(scenario: Scenario) -> ArmModel:
    """The arm; InadmissibleError, naming the key, for one whose files cannot be used."""
    try:
        refuse_unfit(scenario.robot)
        drive_model(scenario.robot)
        return arm_model(scenario.robot)
    except ArmFileError as error:
        raise scenario.inadmissible("an arm that can be used", str(error), "robot") from error


def _admitted(checked: Checked, avoider: Avoider, sha256: str, answers: bool) -> Admitted:
    if not answers:
        raise _no_answer(checked.scenario)
    check_decision_time(checked.scenario, avoider, sha256)
    return Admitted(**vars(checked), avoider=avoider, avoider_sha256=sha256)


def _no_answer(scenario: Scenario) -> InadmissibleError:
    expected = f"an avoider that answers its first question within {FIRST_ANSWER_S:g} s"
    return scenario.inadmissible(expected, "none until then", "avoider")


@dataclass(frozen=True)
class _Cell:
    """What is refused, or not, whatever hands and start are; ``scenario`` has the places for messages.

    ``settings`` are ``steady``: no camera's noise or delay is asked for.
    """

    settings: Settings
    robot: AnyRobot
    scenario: Scenario = field(compare=False)


@lru_cache(maxsize=16)  # many scenarios share a cell
def _view_of_cell(cell: _Cell) -> DesiredView:
    """The desired view in a cell that can be worked in."""
    view = checked_view(cell.scenario)
    check_desired(cell.scenario, arm_model(cell.robot))
    return view


@contextmanager
def _placed(scenario: Scenario) -> Iterator[None]:
    """A refusal of settings, at the place in the file that asks for what is refused."""
    try:
        yield
    except SettingsError as error:
        field = error.place.field or "settings"
        same = [path for path in scenario.places if path.endswith(f".{field}")]
        expected = error.expected
        hint = error.hint
        raise scenario.inadmissible(expected, error.got, field, *same, *VIEW, DESIRED, hint=hint) from error


def first_question(settings: Settings) -> tuple[Vector3, Vector3]:
    """What an avoider is asked before a run: the nominal hand, with the TCP where it is to be."""
    return settings.avoidance.nominal_hand_position_in_base_m, settings.cell.desired_tcp_position_in_base_m


def answers_at_first(avoider: Avoider, hand_in_base_m: Vector3, tcp_in_base_m: Vector3) -> bool:
    """Ask once before the run, so that no answer is waited for while it loads or compiles.

    Whatever comes is thrown away: a fault belongs to the run, which will meet it.  False if nothing does.
    One that sees more is not asked: nothing is seen yet.
    """
    if shown_to(avoider):
        return True
    try:
        ask(avoider, Question(np.array(hand_in_base_m), np.array(tcp_in_base_m), 0, FIRST_ANSWER_S))
    except NoAnswerError:
        return False
    return True
