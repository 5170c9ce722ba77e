"""Random kinematic runs, and their least distance by following the motion in a thousand parts of a tick."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from examples import ConstantSpeed, hand, scenario
from numpy.typing import NDArray

from safety_harness import run_kinematic
from safety_harness.admission.admit import admit
from safety_harness.base.compiled import compiled
from safety_harness.cell.robot.distance import hand_distance, place_capsules
from safety_harness.cell.robot.kinematics import forward_kinematics
from safety_harness.cell.simulation.hand_motion import advance_hands
from safety_harness.cell.simulation.hand_programs import hands_at_start
from safety_harness.claims.signals.true_motion import arm_of
from safety_harness.scenario.model import Scenario
from safety_harness.scenario.moves import MoveTo, Tremor, Withdraw
from safety_harness.trace.trace import Trace

PARTS = 1000  # of a tick
NEAR_M = 0.04  # ticks farther than this from the least distance at ticks hold none that is less


def drawn(seed: int) -> tuple[Scenario, ConstantSpeed]:
    """A hand that goes somewhere and back, fast, beside an arm whose joints turn at constant speeds."""
    rng = np.random.default_rng(seed)
    at = rng.uniform((0.5, -0.6, 0.15), (1.2, 0.6, 0.7))
    speed_mps = rng.uniform(0.5, 2.2)
    who = replace(
        hand(MoveTo(position_in_base_m=tuple(at), speed_mps=speed_mps), Withdraw(speed_mps=speed_mps)),
        max_speed_mps=2.4,
        max_acceleration_mps2=rng.uniform(10.0, 90.0),
    )
    if rng.random() < 0.3:
        who = replace(who, tremor=Tremor(amplitude_m=0.002, rate_hz=8.0))
    kind = rng.random()
    if kind < 0.2:  # it begins at the point that its elbow is towards
        who = replace(who, starts_at_in_base_m=who.elbow_towards_in_base_m)
    elif kind < 0.4:  # it passes this point
        who = replace(who, elbow_towards_in_base_m=tuple(at + rng.normal(0.0, 0.05, 3)))
    radps = tuple(rng.uniform(-0.4, 0.4, 6) * (rng.random() < 0.8))
    return scenario(who, duration_s=0.6), ConstantSpeed(radps)


def ran(seed: int) -> Trace:
    """The run of one draw in the kinematic world."""
    what, controller = drawn(seed)
    return run_kinematic(admit(what), controller=controller)


def least_m(trace: Trace, joints_rad: NDArray[np.float64] | None = None, *, from_tcp: bool = False) -> float:
    """The least distance of the hand from the arm, followed in PARTS of each tick that may hold it.

    ``joints_rad`` (s (n - 1) + 1, joints): where an engine's s steps a tick left them; else the trace's.
    ``from_tcp``: of the hand's centre from the TCP.
    """
    settings = trace.scenario.settings
    joints_rad = trace.ticks["joint_position_rad"] if joints_rad is None else joints_rad
    hands, distance_m = hands_at_start(trace.scenario), trace.ticks["hand_distance_m"][:, 0].copy()
    if from_tcp:
        tcp_m = trace.ticks["transform_tcp_to_base"][:, :3, 3]
        distance_m = np.linalg.norm(trace.ticks["hand_position_in_base_m"][:, 0] - tcp_m, axis=1)
    return float(
        _least(
            arm_of(trace),
            np.ascontiguousarray(joints_rad),
            distance_m,
            hands.state,
            hands.moves,
            hands.samples,
            settings.clock.control_period_s,
            settings.hand.radius_m,
            settings.hand.forearm_radius_m,
            from_tcp,
        )
    )


@compiled
def _least(
    arm: Any,
    joints_rad: NDArray[np.float64],  # (s (n - 1) + 1, joints)
    distance_m: NDArray[np.float64],  # (n,) at the ticks
    hands: NDArray[np.void],  # overwritten
    moves: NDArray[np.void],
    samples: NDArray[np.float64],
    period_s: float,
    radius_m: float,
    forearm_radius_m: float,
    from_tcp: bool,
) -> float:
    """The moves one after the other, in steps of a part; joints go straight from one row to the next."""
    least, tcp = distance_m.min(), np.zeros(3)
    near = least + NEAR_M
    frames = arm.chain[0].joint_axes.shape[0] + 2
    transforms, ends = np.empty((frames, 4, 4)), np.empty((arm.capsules.shape[0], 2, 3))
    joints, steps = np.empty(frames - 2), (joints_rad.shape[0] - 1) // (distance_m.shape[0] - 1)
    for k in range(distance_m.shape[0] - 1):
        looked = min(distance_m[k], distance_m[k + 1]) < near
        parts = PARTS if looked else 1
        for part in range(1, parts + 1):
            begin_s = (k + (part - 1) / parts) * period_s
            advance_hands(hands, moves, samples, tcp, begin_s, period_s / parts)
            if looked:
                row = k * steps + min(int(part * steps / parts), steps - 1)
                share = (k + part / parts) * steps - row
                for i in range(joints.shape[0]):
                    joints[i] = joints_rad[row, i] + share * (joints_rad[row + 1, i] - joints_rad[row, i])
                forward_kinematics(arm.chain[0], joints, transforms)
                if from_tcp:
                    way = hands[0].position_in_base_m - transforms[frames - 1, :3, 3]
                    least = min(least, np.sqrt((way**2).sum()))
                    continue
                place_capsules(arm.capsules, transforms, ends)
                found, _ = hand_distance(
                    arm.capsules,
                    ends,
                    hands[0].position_in_base_m,
                    hands[0].elbow_in_base_m,
                    radius_m,
                    forearm_radius_m,
                )
                least = min(least, found)
    return float(least)
