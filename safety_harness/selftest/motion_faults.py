"""What can be wrong with the arm itself: drives, joints, brakes.  The controller knows nothing of it."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from safety_harness.admission.admit import Admitted
from safety_harness.controller.cycle import ControllerRecords
from safety_harness.selftest.fault import FaultyPart, SeededFault, SeverityLevels
from safety_harness.selftest.perception_faults import parameters
from safety_harness.selftest.system import Change, ChangedSystem, Records

WRIST = 5
JOINTS = tuple(f"joint {number}" for number in range(1, 7))
PAIRS = ((0, 1), (1, 2), (2, 3), (4, 5))


def told(change: Callable[[float, Records], None]) -> Callable[[ChangedSystem, float], ChangedSystem]:
    """Seeds a change of each command that remembers nothing."""

    def seed_into(system: ChangedSystem, magnitude: float) -> ChangedSystem:
        def make(admitted: Admitted) -> Change:
            def obey(command: Records) -> Records:
                change(magnitude, command)
                return command

            return obey

        return system.obeying(make)

    return seed_into


def _faster(factor: float, command: Records) -> None:
    command[0]["joint_velocity_radps"] *= factor


def _wrong_link(pair: float, command: Records) -> None:
    a, b = PAIRS[int(pair) - 1]
    speeds = command[0]["joint_velocity_radps"]
    speeds[a], speeds[b] = speeds[b], speeds[a]


def _reversed(joint: float, command: Records) -> None:
    command[0]["joint_velocity_radps"][int(joint) - 1] *= -1.0


def _stuck(joint: float, command: Records) -> None:
    command[0]["joint_velocity_radps"][int(joint) - 1] = 0.0


def _drifting(rate_radps: float, command: Records) -> None:
    command[0]["joint_velocity_radps"][0] += rate_radps


def _coarse(step_radps: float, command: Records) -> None:
    speeds = command[0]["joint_velocity_radps"]
    speeds[:] = np.round(speeds / step_radps) * step_radps


def _wound(system: ChangedSystem, turns: float) -> ChangedSystem:
    joints = system.admitted.joint_position_rad.copy()
    joints[WRIST] += 2.0 * np.pi * turns
    return system.starting_at(joints)


def _rolls_on(share: float, admitted: Admitted) -> Change:
    """A protective stop is not carried out: the drives go on as before, at a share of the speed."""
    before: list[NDArray[np.float64]] = [np.zeros(6)]

    def obey(command: Records) -> Records:
        if command[0]["protective_stop"]:
            command[0]["protective_stop"] = False
            command[0]["joint_velocity_radps"] = share * before[0]
        else:
            before[0] = command[0]["joint_velocity_radps"].copy()
        return command

    return obey


def _weak_brakes(system: ChangedSystem, factor: float) -> ChangedSystem:
    def weaken(world: Any) -> Any:
        drives = world.records.drives
        for name in ("reaction_time_s", "stop_time_base_s"):
            drives[name] *= factor
        return world

    return system.with_world(weaken)


def _hasty(records: ControllerRecords, factor: float) -> None:
    for name in ("max_tcp_acceleration_mps2", "repulsion_acceleration_mps2"):
        records.parameters[name] *= factor


def _unlimited(records: ControllerRecords, factor: float) -> None:
    for name in ("max_tcp_speed_mps", "repulsion_speed_mps"):
        records.parameters[name] *= factor


_motion = partial(SeededFault, part=FaultyPart.MOTION)

MOTION_FAULTS = (
    _motion(
        name="overspeed",
        hazard="the arm is faster than it is told: nobody can step back in time",
        seed_into=told(_faster),
        ladder=SeverityLevels((4.0, 1.5, 1.1, 1.02), "times"),
    ),
    _motion(
        name="speed limit misread",
        hazard="the same, with the controller's knowledge",
        seed_into=parameters(_unlimited),
        ladder=SeverityLevels((4.0, 1.5, 1.1, 1.02), "times"),
    ),
    _motion(
        name="too slow",
        hazard="the arm gives way, but too late",
        seed_into=told(_faster),
        ladder=SeverityLevels((0.0, 0.2, 0.5, 0.8), "times"),
    ),
    _motion(
        name="wrong link",
        hazard="two joints' cables are exchanged: the arm goes anywhere",
        seed_into=told(_wrong_link),
        ladder=SeverityLevels(
            (1.0, 2.0, 3.0, 4.0), names=("joints 1, 2", "joints 2, 3", "joints 3, 4", "joints 5, 6")
        ),
    ),
    _motion(
        name="joint reversed",
        hazard="a joint turns the wrong way, and control drives it on",
        seed_into=told(_reversed),
        ladder=SeverityLevels((1.0, 2.0, 3.0, 4.0, 5.0, 6.0), names=JOINTS),
    ),
    _motion(
        name="joint stuck",
        hazard="the arm leaves its straight way",
        seed_into=told(_stuck),
        ladder=SeverityLevels((1.0, 2.0, 3.0, 4.0, 5.0, 6.0), names=JOINTS),
    ),
    _motion(
        name="drift",
        hazard="the arm creeps when it should stand still",
        seed_into=told(_drifting),
        ladder=SeverityLevels((0.3, 0.1, 0.01, 1e-3, 1e-4), "deg/s", 180.0 / np.pi),
    ),
    _motion(
        name="coarse drives",
        hazard="small speeds are lost, larger ones jump",
        seed_into=told(_coarse),
        ladder=SeverityLevels((0.3, 0.1, 0.03, 0.01), "deg/s", 180.0 / np.pi),
    ),
    _motion(
        name="joint limit ignored",
        hazard="the arm winds its cables up until they tear",
        seed_into=_wound,
        ladder=SeverityLevels((3.0, 2.0), "turns of the wrist"),
    ),
    _motion(
        name="stop that does not stop",
        hazard="the arm goes on when nothing is safe",
        seed_into=lambda s, share: s.obeying(partial(_rolls_on, share)),
        ladder=SeverityLevels((1.0, 0.5, 0.2), "% of the speed", 100.0),
    ),
    _motion(
        name="weak brakes",
        hazard="the arm stops later than its separation allows for",
        seed_into=_weak_brakes,
        ladder=SeverityLevels((10.0, 4.0, 2.0, 1.2), "times the time"),
    ),
    _motion(
        name="acceleration unlimited",
        hazard="the arm jerks: nobody can foresee where it goes",
        seed_into=parameters(_hasty),
        ladder=SeverityLevels((100.0, 10.0, 3.0, 2.1), "times"),
    ),
)
