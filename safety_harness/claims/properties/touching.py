"""Check that no moving part touches a hand.

Contact with an arm that stands still is allowed.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from safety_harness.base.compiled import compiled
from safety_harness.cell.controller.stack import STANDSTILL_RADPS
from safety_harness.cell.robot.capsules import Arm
from safety_harness.claims.properties.base import Evaluation, Unit, inconclusive
from safety_harness.claims.properties.entry import CatalogueEntry
from safety_harness.claims.properties.hand_distance import OF_DISTANCES, judged_nearest
from safety_harness.claims.properties.measured import reads, unexercised
from safety_harness.claims.properties.shield_theorem import NOT_KNOWN, REFUTED, SHIELDED, broken_assumptions
from safety_harness.claims.signals.hand_distance import (
    Nearest,
    closest_approach,
    closest_between,
    displacement_m,
    distance_moved_m,
    followed_hands,
    instants,
    known_to,
)
from safety_harness.claims.signals.occasions import NEAR_M, OFF_THE_GOAL
from safety_harness.claims.signals.true_motion import (
    RESOLUTION_M,
    HandPaths,
    arm_of,
    capsules_of,
    hand_paths,
    true_motion,
)
from safety_harness.scenario.model import Verdict
from safety_harness.trace.trace import Trace, once_a_trace


def _ends(prop: NoMovingPartTouches, trace: Trace, margin_m: float) -> tuple[float, float, bool]:
    """Return the margin's bounds for ``reads``, and whether the claim was exercised.

    The lower bound uses the distances of all parts, because any part may have moved by less than the
    uncertainty of the joints. The upper bound uses only the parts that are the nearest part at a tick and
    certainly turn in the period after that tick.
    """
    at_ticks_m, between_m = distance_moved_m(trace)
    off_m, true, surely_m = np.maximum(at_ticks_m, between_m), true_motion(trace), np.inf
    low_m = closest_approach(trace, hand_paths(trace), off_m).low_m - RESOLUTION_M
    known_rad = trace.known.uncertainty_of("joint_position_rad", len(trace.ticks))
    turned_rad = np.abs(np.diff(true.joints_rad, axis=0)) - (known_rad[1:] + known_rad[:-1])[:, None]
    turns = turned_rad >= STANDSTILL_RADPS * trace.scenario.settings.clock.control_period_s
    first = np.where(turns.any(axis=1), turns.argmax(axis=1), turns.shape[1])
    for hand in range(len(trace.scenario.hands)):
        moves = turns.any(axis=1) & (_nearest_links(trace, hand)[:-1] > first)
        reached_m = (trace.ticks["hand_distance_m"][:, hand] + off_m)[:-1][moves]
        surely_m = min(surely_m, float(reached_m.min(initial=np.inf)))
    return low_m, surely_m, bool((true.nearest_m + at_ticks_m).min() < prop.near_m and turns.any())


def _nearest_links(trace: Trace, hand: int) -> NDArray[np.int64]:
    """Return the link whose part is nearest to ``hand`` at each tick, shape (n,).

    The link is -1 if the trace states no part.
    """
    links, part = capsules_of(trace).link_index, trace.ticks["hand_distance_capsule"][:, hand]
    there = (part >= 0) & (part < len(links))
    nearest: NDArray[np.int64] = np.where(there, links[np.where(there, part, 0)], -1)
    return nearest


@dataclass(frozen=True, kw_only=True)
class NoMovingPartTouches:
    """The claim that no part of the arm touches a hand while that part moves.

    The margin is the least distance of any hand from any part while that part moves. A part moves in a tick
    if any joint between it and the base turns by at least STANDSTILL_RADPS times the period. The base never
    moves. Distances are from surface to surface. Between ticks they are bounded as for ``HandDistance``. At a
    margin of zero the part touches the hand, and in penetration the margin is negative.

    A run exercises the claim if a hand comes within ``near_m`` of the arm and the arm moves at some time of
    the run.
    """

    near_m: float
    unit: Unit = Unit.LENGTH
    sentence: str = "no moving part touches a hand"

    @reads(*OF_DISTANCES, also=["hand_distance_capsule"], of_each_hand=True, ends=_ends)
    def evaluate(self, trace: Trace) -> Evaluation:
        """Judge the closest approach of any hand to a part that moves."""
        paths, why = followed_hands(trace)
        if paths is None:
            return inconclusive(self, why)
        nearest = _nearest_moving(trace)
        if nearest == Nearest():
            return unexercised(self, f"the arm did not move while a hand was there: {OFF_THE_GOAL}")
        evaluation = judged_nearest(self, trace, nearest, 0.0, self.near_m, "a part that moves")
        standing = theorem_words(trace, evaluation)
        return replace(evaluation, reason=f"{evaluation.reason}; {standing}") if standing else evaluation


def theorem_words(trace: Trace, evaluation: Evaluation) -> str:
    """Return a text on whether the run refutes its shield's theorem, or why the theorem does not apply.

    The text is empty if the run has no shield, or if it agrees with the theorem. The verdict on touches does
    not depend on whether the theorem applies.
    """
    if trace.scenario.shield is None or len(trace.ticks) == 0:
        return ""
    broken = broken_assumptions(trace)
    if refutes_theorem(trace, evaluation):
        return "REFUTES THE SHIELD'S THEOREM: until then no assumption that a trace tells was broken"
    if broken and broken[0].number == NOT_KNOWN:
        return f"whether the shield's theorem applies is not known: {broken[0].text}"
    return f"the shield's theorem does not apply: {'; '.join(part.text for part in broken)}" if broken else ""


def refutes_theorem(trace: Trace, evaluation: Evaluation) -> bool:
    """Return whether a moving part touched a hand before any assumption of the shield's theorem broke."""
    if trace.scenario.shield is None or evaluation.verdict is not Verdict.VIOLATED:
        return False
    broken = broken_assumptions(trace)
    if not broken:
        return True
    held = slice(min(assumption.tick for assumption in broken) + 1)
    begun = replace(trace, ticks=trace.ticks[held], overshoot_radps=trace.overshoot_radps[held])
    return known_to(0.0, closest_moving, begun, hand_paths(begun)).high_m < 0.0


def theorem_bits(trace: Trace) -> int:
    """Return the bits of a run for ``counts_words``, or 0 if the run has no shield."""
    if trace.scenario.shield is None or len(trace.ticks) == 0:
        return 0
    refuted = refutes_theorem(trace, NO_MOVING_PART_TOUCHES.prop.evaluate(trace))
    return (
        SHIELDED | refuted * REFUTED | sum(1 << assumption.number for assumption in broken_assumptions(trace))
    )


@once_a_trace
def _nearest_moving(trace: Trace) -> Nearest:
    return known_to(0.0, closest_moving, trace, hand_paths(trace))


@once_a_trace
def first_turning(trace: Trace) -> NDArray[np.int64]:
    """Return the first joint from the base that turns in each tick, shape (n - 1,).

    If no joint turns, the entry is the number of joints.
    """
    joints_rad = true_motion(trace).joints_rad
    period_s = trace.scenario.settings.clock.control_period_s
    turns = np.abs(np.diff(joints_rad, axis=0)) >= STANDSTILL_RADPS * period_s
    first: NDArray[np.int64] = np.where(turns.any(axis=1), turns.argmax(axis=1), joints_rad.shape[1])
    return first


def closest_moving(trace: Trace, paths: HandPaths) -> Nearest:
    """Return the closest approach of any hand to a moving part.

    If no part moves, the distance is infinite.
    """
    best = Nearest()
    hand_size = trace.scenario.settings.hand
    for hand in range(len(trace.scenario.hands)):
        at, joints_rad, hand_m, elbow_m, distance_m, slack_m = instants(trace, paths, hand)
        nearest = _nearest_links(trace, hand)
        tick_before = np.minimum(at[:-1].astype(int), len(trace.ticks) - 2)
        first = first_turning(trace)[tick_before]
        lower_m = _lower_bounds(arm_of(trace).reach_m, joints_rad, hand_m, elbow_m, distance_m, slack_m)
        met = (nearest[tick_before] > first) & (at[:-1] == tick_before) & (first < joints_rad.shape[1])
        most_m = distance_m[:-1][met].min(initial=np.inf)  # the result is not above it
        # While the same joint is the first to turn, the same parts move.
        for begin, end in _runs(first):
            if first[begin] == joints_rad.shape[1]:
                continue  # it stands
            if lower_m[begin:end].min() > min(best.high_m, most_m):  # never of a NaN
                continue  # nothing comes as near
            arm = _distal_part(arm_of(trace), int(first[begin]))
            if len(arm.capsules) == 0:
                continue
            own = slice(begin, end + 1)
            known = _known(distance_m[own], at[own], nearest > first[begin])
            ends_m, instant = closest_between(
                arm,
                at[own],
                joints_rad[own],
                hand_m[own],
                elbow_m[own],
                known,
                slack_m[begin:end],
                hand_size,
                paths,
            )
            time_s = instant * trace.scenario.settings.clock.control_period_s
            best = best.or_nearer(Nearest(ends_m[0], time_s, hand, ends_m[1]))
    return best


@compiled
def _lower_bounds(
    reach_m: NDArray[np.float64],  # (joints,)
    joints_rad: NDArray[np.float64],  # (n, joints)
    hand_m: NDArray[np.float64],  # (n, 3)
    elbow_m: NDArray[np.float64],  # (n, 3)
    distance_m: NDArray[np.float64],  # (n,) infinite where it is not known
    slack_m: NDArray[np.float64],  # (n - 1,)
) -> NDArray[np.float64]:
    """Return lower bounds of the distances in ``closest_between``, shape (n - 1,).

    Each bound covers the time from an instant to the next.
    """
    lower_m, left_m = np.empty(slack_m.shape[0]), -np.inf
    for k in range(slack_m.shape[0]):
        # A stored distance is exact, so the bound starts from it again.
        if distance_m[k] != np.inf:  # it is known
            left_m = distance_m[k]
        left_m -= displacement_m(reach_m, joints_rad, hand_m, elbow_m, k)
        lower_m[k] = left_m - slack_m[k] - 2.0 * RESOLUTION_M
    return lower_m


def _runs(first: NDArray[np.int64]) -> list[tuple[int, int]]:
    """Return the beginning of each stretch of equal values in ``first``, and its end.

    The end is the first index after the stretch.
    """
    cuts = (np.flatnonzero(np.diff(first)) + 1).tolist()
    return list(zip([0, *cuts], [*cuts, len(first)], strict=True)) if len(first) else []


def _distal_part(arm: Arm, joint: int) -> Arm:
    """Return the arm, reduced to the capsules that move when ``joint`` turns."""
    return Arm(arm.chain, _moved(arm.capsules.tobytes(), arm.capsules.dtype, joint), arm.reach_m)


@lru_cache(maxsize=64)
def _moved(capsules: bytes, dtype: np.dtype[np.void], joint: int) -> NDArray[np.void]:
    moving = np.frombuffer(capsules, dtype)
    moving = moving[moving["link_index"] > joint].copy()
    moving.setflags(write=False)  # like all others, so that compiled code gets the same type
    return moving


def _known(
    distance_m: NDArray[np.float64], at: NDArray[np.float64], moves: NDArray[np.bool_]
) -> NDArray[np.float64]:
    """Return the known distances of moving parts at each instant, shape (k,).

    At an instant without a known distance, the result is inf. A distance is known at a tick at which the
    nearest part of the arm moves. The memory layout is that of ``distance_m`` (k,), because compiled code
    distinguishes arrays by their layout.
    """
    whole = at == np.floor(at)
    known_m = np.empty((len(at), 1 if distance_m.flags.c_contiguous else 2))[:, 0]
    known_m[:] = np.where(whole & moves[np.minimum(at.astype(int), len(moves) - 1)], distance_m, np.inf)
    known_m.setflags(write=distance_m.flags.writeable)
    return known_m


NO_MOVING_PART_TOUCHES = CatalogueEntry(
    prop=NoMovingPartTouches(near_m=NEAR_M),
    rationale=(
        "a person may touch a stationary arm, or even run into it, but a moving arm can hurt the person"
    ),
    source="speed and separation monitoring: the arm stops before a person reaches it",
    margin=(
        "the least distance of the surface of any hand or forearm from the surface of any "
        "part of the arm, over the ticks in which that part moves. Between ticks, it is a "
        "guaranteed lower bound"
    ),
    parameters="the sizes of the hands in the settings; a part stands still if its joints turn by less "
    "than 1 mrad/s",
    exercised="a hand comes within 400 mm of the arm's surface, and the arm moves in that run",
    inconclusive="a hand deviates from the motion in its scenario, or the arm did not move beside a hand",
    broken_by="an avoider that moves towards the hand, behind a gate that accepts every proposal",
)
