"""Define faults of the arm's drives, joints and brakes, of which the controller gets no information."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from safety_harness.admission.admit import Admitted
from safety_harness.cell.controller.cycle import ControllerRecords
from safety_harness.extensions.selftest.fault import (
    anywhere,
    commanded,
    faults_in,
    known,
    obeying,
    of_motion,
    seeded,
)
from safety_harness.extensions.selftest.system import Change, ChangedSystem, Records

WRIST = 5  # the last joint: whole turns of it leave the pose unchanged
JOINTS = tuple(f"joint {number}" for number in range(1, 7))
PAIRS = ((0, 1), (1, 2), (2, 3), (4, 5))  # of neighbouring joints; a choice


@of_motion("overspeed", "the arm is faster than commanded: people cannot step back in time")
@seeded(commanded, (4.0, 1.5, 1.1, 1.02), "times")
def _faster(factor: float, command: Records) -> None:
    command[0]["joint_velocity_radps"] *= factor


@of_motion("speed limit misread", "the same, with the controller's knowledge")
@seeded(known, (4.0, 1.5, 1.1, 1.02), "times")
def _unlimited(records: ControllerRecords, factor: float) -> None:
    for name in ("max_tcp_speed_mps", "repulsion_speed_mps"):
        records.parameters[name] *= factor


@of_motion("too slow", "the arm gives way, but too late")
@seeded(commanded, (0.0, 0.2, 0.5, 0.8), "times")
def _slower(factor: float, command: Records) -> None:
    command[0]["joint_velocity_radps"] *= factor


@of_motion("wrong link", "two joints' cables are exchanged: the arm goes anywhere")
@seeded(commanded, (1.0, 2.0, 3.0, 4.0), names=tuple(f"joints {a + 1}, {b + 1}" for a, b in PAIRS))
def _wrong_link(pair: float, command: Records) -> None:
    a, b = PAIRS[int(pair) - 1]
    speeds = command[0]["joint_velocity_radps"]
    speeds[a], speeds[b] = speeds[b], speeds[a]


@of_motion("joint reversed", "a joint turns the wrong way, and control drives it on")
@seeded(commanded, (1.0, 2.0, 3.0, 4.0, 5.0, 6.0), names=JOINTS)
def _reversed(joint: float, command: Records) -> None:
    command[0]["joint_velocity_radps"][int(joint) - 1] *= -1.0


@of_motion("joint stuck", "the arm leaves its straight way")
@seeded(commanded, (1.0, 2.0, 3.0, 4.0, 5.0, 6.0), names=JOINTS)
def _stuck(joint: float, command: Records) -> None:
    command[0]["joint_velocity_radps"][int(joint) - 1] = 0.0


@of_motion("drift", "the arm creeps when it should stand still")
@seeded(commanded, (0.3, 0.1, 0.01, 1e-3, 1e-4), "deg/s", 180.0 / np.pi)
def _drifting(rate_radps: float, command: Records) -> None:
    command[0]["joint_velocity_radps"][0] += rate_radps


@of_motion("coarse drives", "small speeds are lost, larger ones jump")
@seeded(commanded, (0.3, 0.1, 0.03, 0.01), "deg/s", 180.0 / np.pi)
def _coarse(step_radps: float, command: Records) -> None:
    speeds = command[0]["joint_velocity_radps"]
    speeds[:] = np.round(speeds / step_radps) * step_radps


@of_motion("joint limit ignored", "the arm winds its cables up until they tear")
@seeded(anywhere, (3.0, 2.0), "turns of the wrist")
def _wound(system: ChangedSystem, turns: float) -> ChangedSystem:
    joints = system.admitted.joint_position_rad.copy()
    joints[WRIST] += 2.0 * np.pi * turns
    return system.starting_at(joints)


@of_motion("stop that does not stop", "the arm goes on without a position to go to")
@seeded(obeying, (1.0, 0.5, 0.2), "% of the speed", 100.0)
def _rolls_on(share: float, admitted: Admitted) -> Change:
    """Ignore a protective stop, so that the drives continue at a fraction of their last speed."""
    last: list[NDArray[np.float64]] = [np.zeros_like(admitted.joint_position_rad)]

    def obey(command: Records) -> Records:
        if command[0]["protective_stop"]:
            command[0]["protective_stop"] = False
            command[0]["joint_velocity_radps"] = share * last[0]
        else:
            last[0] = command[0]["joint_velocity_radps"].copy()
        return command

    return obey


@of_motion("weak brakes", "the arm stops later than its separation allows for")
@seeded(anywhere, (10.0, 4.0, 2.0, 1.2), "times the time")
def _weak_brakes(system: ChangedSystem, factor: float) -> ChangedSystem:
    def weaken(world: Any) -> Any:
        drives = world.records.drives
        for name in ("reaction_time_s", "stop_time_base_s"):
            drives[name] *= factor
        return world

    return system.with_world(weaken)


@of_motion("acceleration unlimited", "the arm jerks: people cannot foresee its way")
@seeded(known, (100.0, 10.0, 3.0, 2.1), "times")
def _hasty(records: ControllerRecords, factor: float) -> None:
    for name in ("max_tcp_acceleration_mps2", "repulsion_acceleration_mps2"):
        records.parameters[name] *= factor


MOTION_FAULTS = faults_in(globals())
