"""Simulate the kinematic world, in which joints follow their set points exactly and bodies have no mass.

Apart from the motion of the arm, this world uses the same compiled steps as the reference world. In the
reference world, the velocity motors reach their set points within the first physics sub-step, unless a torque
limit prevents this. The error is at most the world's ``known_to_radps``. So in both worlds, each joint turns
in a tick by its set point times the period. Joints have no stops here, and the arm cannot touch the table or
itself.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from safety_harness.base.compiled import njit_no_nrt
from safety_harness.base.geometry.arrays import ArrayNx2x3
from safety_harness.base.geometry.linear import copy_matrix
from safety_harness.cell.controller.cycle import ControllerRecords, act, report, watch
from safety_harness.cell.controller.records import CommandRecords, FaultRecords, ParameterRecords
from safety_harness.cell.robot.distance import CapsuleRecords
from safety_harness.cell.robot.drive import DriveRecords
from safety_harness.cell.simulation.hand_motion import HandRecords, MoveRecords
from safety_harness.cell.simulation.records import WorldRecords
from safety_harness.cell.simulation.steps import (
    ArmRecords,
    ClockRecords,
    Floats,
    Records,
    TruthRecords,
    drive_on,
    move_on,
    sense,
)
from safety_harness.cell.simulation.world import RecordedWorld
from safety_harness.trace.records import Limit, as_compiled

BRAKING = int(Limit.BRAKING)


class KinematicWorld(RecordedWorld):
    """A scenario in the kinematic world, for any controller.

    Only the harness's own controller uses ``advance``.
    """

    name = "kinematic"

    def advance(
        self, controller: ControllerRecords, ticks: NDArray[np.void], decided: bool
    ) -> NDArray[np.void] | None:
        """Continue to the next decision or the end, as ``BatchWorld.advance`` describes, in compiled code.

        ``ticks`` (n,) contains records TICK.
        """
        more = advance(self.records, controller, as_compiled(ticks), decided)
        return self.records.observation if more else None

    def step(self, command: NDArray[np.void]) -> bool:
        """Move drives, joints and hands for a control period.

        ``command`` (1,) is a record COMMAND.
        """
        return step(*self.records[:10], CommandRecords(command))


@njit_no_nrt
def step(
    drives: DriveRecords,
    moves: MoveRecords,
    samples: Floats,  # (s, 7)
    arms: ArmRecords,
    truths: TruthRecords,
    hands: HandRecords,
    capsules: CapsuleRecords,
    capsule_endpoints_in_base_m: ArrayNx2x3,
    clocks: ClockRecords,
    faults: FaultRecords,
    commands: CommandRecords,
) -> bool:
    """Execute a command for a control period, and return True while the brakes act.

    The command is a record COMMAND (1,).
    """
    rates, joints = clocks[0].commanded_radps, clocks[0].joint_position_rad
    truth, period_s = truths[0], clocks[0].control_period_s
    braking = drive_on(drives, arms, truths, clocks, faults, commands, rates)
    for i in range(joints.shape[0]):
        # The set points are constant within a period, so this is the exact integral.
        joints[i] = truth.joint_position_rad[i] + rates[i] * period_s
    move_on(moves, samples, arms, truths, hands, capsules, capsule_endpoints_in_base_m, clocks, joints, rates)
    return braking


@njit_no_nrt
def advance(
    world: WorldRecords,
    controller: ControllerRecords,
    ticks: Records,  # (n,) ``as_compiled``, written from the present tick on
    decided: bool,
) -> bool:
    """Continue to the next decision or to the run's end.

    Return True at a decision, and False at the end. The function contains the loop of ``simulate``. If
    ``decided`` is True, the run is at a decision, and the controller already has the answer.
    """
    w, c = world, controller
    last, alike = ticks.shape[0] - 1, same_chain(w.arm, c.parameters)
    k = w.clock[0].tick
    while True:
        tick = ticks[k : k + 1]
        if not decided:
            ticks[k] = w.truth[0]
            sense(*w[4:])
            if alike:  # encoders are exact
                for i in range(w.arm[0].link_transforms.shape[0]):
                    copy_matrix(w.arm[0].link_transforms[i], c.state[0].link_transforms[i])
                c.state[0].placed = True
            if watch(*c[:7], w.observation):
                return True
        decided = False
        act(*c[4:], w.observation)
        report(*c[5:8], tick)
        if k < last:
            tick[0].limits |= BRAKING if step(*w[:10], c.command) else 0
        tick[0].faults |= w.clock[0].acted_faults
        if k == last:
            return False
        k += 1


@njit_no_nrt
def same_chain(arms: ArmRecords, parameters: ParameterRecords) -> bool:
    """Return whether the world's arm equals the arm in the controller's computations."""
    own, assumed, same = arms[0].chain, parameters[0].chain, True
    for i in range(4):
        for j in range(4):
            same = same and own.flange[i, j] == assumed.flange[i, j]
            for k in range(own.joint_origins.shape[0]):
                same = same and own.joint_origins[k, i, j] == assumed.joint_origins[k, i, j]
    for k in range(own.joint_axes.shape[0]):
        for i in range(3):
            same = same and own.joint_axes[k, i] == assumed.joint_axes[k, i]
    return same
