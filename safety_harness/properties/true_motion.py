"""What many properties ask of the same trace: where arm and hands truly were."""

from __future__ import annotations

from dataclasses import dataclass
from math import sqrt

import numpy as np
from numpy.typing import NDArray

from safety_harness.compiled import compiled
from safety_harness.robot.capsules import CapsuleSet, load_capsules
from safety_harness.robot.description import load_arm
from safety_harness.robot.distance import chain_lengths
from safety_harness.scenario.model import MAX_HANDS
from safety_harness.simulation.truth import cell_capsules
from safety_harness.trace.records import COLUMNS, as_numbers
from safety_harness.trace.trace import Trace, history, once_a_trace

HANDS, ELBOWS = COLUMNS["hand_position_in_base_m"], COLUMNS["elbow_position_in_base_m"]
assert HANDS.stop == ELBOWS.start


@dataclass(frozen=True, eq=False)
class TrueMotion:
    """Of each of n ticks; positions in the base frame [m].  The arrays are read-only.

    ``joints_rad`` and ``rates_radps`` (n, 6), ``tcp_m`` (n, 3), ``hands_m`` (n, hands, 2, 3): hand and
    elbow, ``present`` (n, hands), ``nearest_m`` (n,): the least hand distance, surface to surface.
    """

    joints_rad: NDArray[np.float64]
    rates_radps: NDArray[np.float64]
    tcp_m: NDArray[np.float64]
    hands_m: NDArray[np.float64]
    present: NDArray[np.bool_]
    nearest_m: NDArray[np.float64]


@once_a_trace
def true_motion(trace: Trace) -> TrueMotion:
    """The true motion of arm and hands in a trace: views of its ticks, for copies would take longer."""
    ticks = trace.ticks
    hands_and_elbows = as_numbers(ticks)[:, HANDS.start : ELBOWS.stop].reshape(-1, 2, MAX_HANDS, 3)
    return TrueMotion(
        joints_rad=ticks["joint_position_rad"],
        rates_radps=ticks["joint_velocity_radps"],
        tcp_m=ticks["transform_tcp_to_base"][:, :3, 3],
        hands_m=hands_and_elbows.transpose(0, 2, 1, 3),
        present=ticks["hand_present"],
        nearest_m=history(trace, "hand_distance_m").min(axis=1),
    )


@once_a_trace
def nearest_hand_m(trace: Trace) -> NDArray[np.float64]:
    """(n,) distance of the nearest true hand's centre from the TCP; infinite without one."""
    true = true_motion(trace)
    return _nearest_m(true.tcp_m, true.hands_m, true.present)


@compiled
def _nearest_m(
    tcp_m: NDArray[np.float64],  # (n, 3)
    hands_m: NDArray[np.float64],  # (n, hands, 2, 3)
    present: NDArray[np.bool_],  # (n, hands)
) -> NDArray[np.float64]:
    nearest = np.full(tcp_m.shape[0], np.inf)
    for k in range(tcp_m.shape[0]):
        for hand in range(present.shape[1]):
            if not present[k, hand]:
                continue
            total = 0.0
            for i in range(3):
                total += (hands_m[k, hand, 0, i] - tcp_m[k, i]) ** 2
            if not sqrt(total) >= nearest[k]:
                nearest[k] = sqrt(total)
            if np.isnan(total):
                break
    return nearest


@once_a_trace
def capsules_of(trace: Trace) -> CapsuleSet:
    """The arm's and the camera's."""
    return cell_capsules(load_capsules(trace.scenario.robot.arm_name), trace.scenario.settings)


@once_a_trace
def joint_reach_m(trace: Trace) -> NDArray[np.float64]:
    """(6,) how far from each joint the farthest point of the arm can be that it moves."""
    arm, capsules = load_arm(trace.scenario.robot.arm_name), capsules_of(trace)
    return chain_lengths(
        arm.joint_origins, arm.flange, capsules.link_index, capsules.start_in_link, capsules.end_in_link
    )
