"""Define faults that change the time at which events happen."""

from __future__ import annotations

from collections import deque

import numpy as np
from numpy.typing import NDArray

from safety_harness.admission.admit import Admitted
from safety_harness.cell.controller.cycle import ControllerRecords
from safety_harness.extensions.selftest.fault import (
    faults_in,
    known,
    obeying,
    of_timing,
    seeded,
    seeing,
    seen,
)
from safety_harness.extensions.selftest.system import Change, Records


@of_timing("late commands", "the arm obeys outdated commands")
@seeded(obeying, (0.4, 0.2, 0.1, 0.04), "ms", 1e3)
def _late_commands(delay_s: float, admitted: Admitted) -> Change:
    """Delay each command of the controller by ``delay_s``."""
    cycles = round(delay_s / admitted.scenario.settings.clock.control_period_s)
    waiting: deque[Records] = deque()

    def obey(command: Records) -> Records:
        waiting.append(command)
        if len(waiting) <= cycles:
            # Before the first delayed command, the arm stands still.
            return np.zeros_like(command)
        return waiting.popleft()

    return obey


@of_timing("missed cycles", "a controller that is not heard for part of every second")
@seeded(obeying, (0.9, 0.5, 0.2, 0.05), "ms of a second", 1e3)
def _missed(pause_s: float, admitted: Admitted) -> Change:
    """Lose the controller's commands during a part of each second.

    Meanwhile, the drives repeat the last command.
    """
    period_s = admitted.scenario.settings.clock.control_period_s
    held: list[Records] = []
    ticks = 0

    def obey(command: Records) -> Records:
        nonlocal ticks
        ticks += 1
        if (ticks * period_s) % 1.0 >= pause_s or not held:
            held[:] = [command]
        return held[0].copy()

    return obey


@of_timing("late encoders", "the controller uses outdated joint angles")
@seeded(seeing, (0.4, 0.2, 0.1, 0.04), "ms", 1e3)
def _late_joints(delay_s: float, admitted: Admitted) -> Change:
    cycles = round(delay_s / admitted.scenario.settings.clock.control_period_s)
    waiting: deque[tuple[NDArray[np.float64], NDArray[np.float64]]] = deque(maxlen=cycles + 1)

    def see(observation: Records) -> Records:
        o = observation[0]
        waiting.append((o["joint_position_rad"].copy(), o["joint_velocity_radps"].copy()))
        o["joint_position_rad"], o["joint_velocity_radps"] = waiting[0]
        return observation

    return see


@of_timing("slow avoider", "the hand moves on while the network thinks")
@seeded(known, (0.3, 0.15, 0.11), "ms", 1e3)
def _slow(records: ControllerRecords, seconds: float) -> None:
    records.decision_times_s[:] = seconds


@of_timing("frames stamped too early", "a hand is extrapolated over a time that has not passed")
@seeded(seen, (0.5, 0.2, 0.1, 0.05), "ms", 1e3)
def _stamped_late(admitted: Admitted, by_s: float, observation: Records) -> None:
    """Subtract ``by_s`` from the time of each camera frame."""
    if observation[0]["boxes_new"]:
        observation[0]["boxes_time_s"] -= by_s


@of_timing("fast clock", "the controller's time runs ahead of the sensor's")
@seeded(seen, (2.0, 1.2, 1.05, 1.02), "times")
def _fast_clock(admitted: Admitted, factor: float, observation: Records) -> None:
    observation[0]["time_s"] *= factor


@of_timing("hands forgotten", "a briefly hidden hand counts as gone")
@seeded(known, (0.0, 0.05, 0.2), "ms", 1e3)
def _forgetful(records: ControllerRecords, timeout_s: float) -> None:
    records.filter_parameters["track_timeout_s"] = timeout_s


@of_timing("restart too soon", "the arm starts while the hand is still on its way out")
@seeded(known, (-100.0, 0.0, 0.2), "s after the hand has left")
def _restarts(records: ControllerRecords, delay_s: float) -> None:
    records.parameters["restart_delay_s"] = delay_s


TIMING_FAULTS = faults_in(globals())
