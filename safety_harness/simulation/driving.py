"""A user's controller in the kinematic world: the loop of ``simulate`` without what numba looks up a call."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from safety_harness.controller.driven import DrivenController, entry_of
from safety_harness.controller.records import CommandRecords, command_dtype
from safety_harness.simulation.kinematic_world import BRAKING, KinematicWorld, step
from safety_harness.simulation.steps import sense
from safety_harness.trace.records import as_compiled


def drive(
    world: KinematicWorld,
    controller: DrivenController,
    ticks: NDArray[np.void],  # (n,) TICK, filled
    on_tick: Callable[[int], None] | None = None,
) -> None:
    """Fill ``ticks`` as ``simulate`` does, bit for bit."""
    sensing, stepping = _entries(world, ticks)
    of_sense, of_step, observation = world.records[4:], world.records[:10], world.records.observation
    compiled, truth, clock = as_compiled(ticks), world.records.truth, world.records.clock
    rows = ticks.view(np.uint8).reshape(len(ticks), ticks.dtype.itemsize)
    of_truth = truth.view(np.uint8)
    last = len(ticks) - 1
    for k in range(last + 1):
        tick = compiled[k : k + 1]
        rows[k] = of_truth
        sensing(*of_sense)
        command = controller.step(observation)
        controller.report_compiled(tick)
        if k < last and stepping(*of_step, command):
            tick["limits"] |= BRAKING
        if len(world.records.faults):
            tick["faults"] |= int(clock[0]["acted_faults"])
        if on_tick is not None:
            on_tick(k + 1)


def _entries(world: KinematicWorld, ticks: NDArray[np.void]) -> tuple[Callable[..., Any], Callable[..., Any]]:
    """``sense`` and ``step`` for the records of this world."""
    joints = len(ticks[0]["joint_position_rad"])
    command = CommandRecords(np.zeros(1, command_dtype(joints)))
    return entry_of(sense, *world.records[4:]), entry_of(step, *world.records[:10], command)
