"""Admission: resolve a scenario's references and refuse what cannot be tried, before anything runs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from safety_harness.admission.avoiders import avoider_of, avoider_sha256
from safety_harness.admission.checks import check_cameras, check_object, check_restart_delay, check_view
from safety_harness.admission.claims import property_of
from safety_harness.admission.faults import check_faults
from safety_harness.admission.hands import check_hands
from safety_harness.admission.poses import (
    DESIRED,
    VIEW,
    check_desired,
    check_start,
    kinematics,
    start_joint_position,
)
from safety_harness.avoidance.asking import ask
from safety_harness.avoidance.avoider import Avoider
from safety_harness.avoidance.gate import Gate
from safety_harness.controller.controller import AvoidingServo
from safety_harness.controller.desired import view_of
from safety_harness.exceptions import InadmissibleError, SettingsError
from safety_harness.properties.base import Property
from safety_harness.robot.description import ArmModel, load_arm
from safety_harness.scenario.fault_table import fault_table
from safety_harness.scenario.model import Robot, Scenario
from safety_harness.servoing.control import DesiredView
from safety_harness.settings import Settings

FIRST_ANSWER_S = 300.0  # time to import, load and compile whatever an avoider needs


@dataclass(frozen=True, eq=False)
class Admitted:
    """A scenario with everything resolved: ready to be run and judged."""

    scenario: Scenario
    arm: ArmModel
    view: DesiredView
    joint_position_rad: NDArray[np.float64]  # (6,) where the arm starts
    avoider: Avoider
    properties: tuple[Property, ...]  # in the order of the scenario's claims
    avoider_sha256: str  # of the file that the avoider comes from; empty for one without

    def controller(self, recorded_late: Sequence[str] = ()) -> AvoidingServo:
        """A fresh controller for one run; ``recorded_late`` as in ``AvoidingServo``."""
        settings = self.scenario.settings
        gate = Gate.of(settings, kinematics(self.arm.name))
        return AvoidingServo(
            settings,
            self.arm,
            self.view,
            self.avoider,
            gate,
            self.scenario.seed,
            recorded_late,
            fault_table(self.scenario.faults),
        )


def admit(scenario: Scenario, *, avoider: Avoider | None = None, rehearsed: bool = False) -> Admitted:
    """Resolve and check; InadmissibleError names the place, what was expected and what came.

    ``avoider`` takes the place of the one that the scenario names; ``rehearsed``: it has answered before.
    """
    arm = load_arm(scenario.robot.arm_name)
    sha256 = ""
    try:
        view = _view_of_cell(_Cell(scenario.settings, scenario.robot, scenario))
        start = start_joint_position(scenario, arm)
        check_start(scenario, arm, start)
        check_hands(scenario, arm, start)
        check_faults(scenario)
        properties = tuple(property_of(claim, scenario) for claim in scenario.claims)
        if avoider is None:
            avoider, sha256 = avoider_of(scenario), avoider_sha256(scenario)
    except SettingsError as error:
        raise _placed(error, scenario) from error
    if not rehearsed:
        rehearse(scenario, avoider)
    return Admitted(scenario, arm, view, start, avoider, properties, sha256)


@dataclass(frozen=True)
class _Cell:
    """What is refused, or not, whatever hands and start are; ``scenario`` has the places for messages."""

    settings: Settings
    robot: Robot
    scenario: Scenario = field(compare=False)


@lru_cache(maxsize=16)  # many scenarios share a cell
def _view_of_cell(cell: _Cell) -> DesiredView:
    """The desired view in a cell that can be worked in."""
    scenario = cell.scenario
    check_cameras(scenario)
    check_restart_delay(scenario)
    check_object(scenario)
    view = view_of(cell.settings)
    check_view(scenario, view)
    check_desired(scenario, load_arm(cell.robot.arm_name))
    return view


def _placed(error: SettingsError, scenario: Scenario) -> InadmissibleError:
    """The same refusal, at the place in the file that asks for what is refused."""
    field = error.place.field or "settings"
    same = [path for path in scenario.places if path.endswith(f".{field}")]
    return InadmissibleError(
        place=scenario.place(field, *same, *VIEW, DESIRED),
        expected=error.expected,
        got=error.got,
        hint=error.hint,
    )


def rehearse(scenario: Scenario, avoider: Avoider) -> None:
    """Ask once before the run, so that no decision is late for what a first call loads or compiles.

    Whatever comes is thrown away: a fault belongs to the run, which will meet it.
    """
    answer = ask(
        avoider,
        hand_position_in_base_m=np.array(scenario.settings.avoidance.nominal_hand_position_in_base_m),
        tcp_position_in_base_m=np.array(scenario.settings.cell.desired_tcp_position_in_base_m),
        seed=0,
        deadline_s=FIRST_ANSWER_S,
    )
    if answer.late:
        raise InadmissibleError(
            place=scenario.place("avoider"),
            expected=f"an avoider that answers its first question within {FIRST_ANSWER_S:g} s",
            got="none until then",
        )
