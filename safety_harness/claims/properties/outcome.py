"""Judge by motion alone whether the arm keeps its place, and whether it reacts to hands in time."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from safety_harness.base.elementary import power, product
from safety_harness.claims.properties.base import (
    Evaluation,
    Unit,
    Worded,
    inconclusive,
    judged,
    runs_of,
    time_left_s,
)
from safety_harness.claims.properties.entry import CatalogueEntry
from safety_harness.claims.properties.measured import reads, unexercised
from safety_harness.claims.properties.reaction import NoFalseAlarms, nearest_off_m
from safety_harness.claims.properties.servoing import retreat_s
from safety_harness.claims.signals.occasions import MOVES, no_near_hand
from safety_harness.claims.signals.poses import position_errors_m
from safety_harness.claims.signals.true_motion import nearest_hand_m, true_motion
from safety_harness.scenario.model import Verdict
from safety_harness.trace.records import Limit
from safety_harness.trace.trace import Trace

HELD_S = 1.0  # an arm that stays within the limit of a place for so long holds that place
HELD_AT = 32  # least number of times in HELD_S at which the arm's place is checked
HALF = 0.5  # of its speed: an arm that loses it, or gains it away from the hand, has reacted
BEFORE_S = 0.5  # an arm that reacted within this time before a hand came near has reacted to it
STARTED_S = 0.1  # in which an arm that stands at the beginning of a run gets up to speed
HALVED_S = 0.25  # in which a reacting arm loses half of its speed
TINY_MPS = TINY_M = 1e-6  # nothing moves so slowly, or is so near


@dataclass(frozen=True, kw_only=True)
class KeepsItsPlace(Worded):
    """The claim that the TCP moves away from its place or the desired position only if a hand is near.

    The margin is ``within_m`` minus the distance by which the TCP moves away without a near hand. The arm has
    a place once the TCP has stayed for one second within ``within_m`` of one position. No true hand may be
    *near* during this second. Also, no hand may have been *near* before this second for as long as a retreat
    lasts. A hand is *near* if a correct prediction of its position can be within the critical distance
    (``NoFalseAlarms``). Until a hand is near again, the claim measures two distances. The first is by how
    much the TCP's distance from the desired position exceeds its least value so far. The second is the TCP's
    distance from the point at which it reached its place, minus the progress towards the desired position
    since that time. When the TCP has come nearer to the desired position by the limit, it has reached a new
    place. So an arm that moves towards the desired position keeps its place, whereas an arm that circles
    around the desired position does not keep its place. Only positions matter, not angles.
    """

    within_m: float
    unit: Unit = Unit.LENGTH
    wording: ClassVar[str] = "keeps its place within {within_m:mm}"

    @reads("transform_tcp_to_base", "hand_position_in_base_m", ends=lambda prop, trace, _: prop.ends(trace))
    def evaluate(self, trace: Trace) -> Evaluation:
        """Judge every stretch of the run in which no hand is near."""
        worst_m, tick, held = self._worst(trace)
        reason = f"{1e3 * worst_m:.2f} mm from its place or from the desired position, with no hand near"
        free = (nearest_hand_m(trace) > NoFalseAlarms().limit_m(trace.scenario.settings)).any()
        lacked = f"with no hand near the TCP never stayed within {self.within_m * 1e3:g} mm for 1 s; "
        lacked += f"a {'longer duration' if free else 'hand that leaves earlier'} exercises it"
        left_m = self.within_m - worst_m
        return judged(self, trace, left_m, trace.time_s[tick], reason, held, lambda: lacked)

    def _worst(self, trace: Trace, farther_m: float = 0.0) -> tuple[float, int, int]:
        """Return the largest distance by which the TCP left its place, and the tick of that distance.

        The third result is how often the arm had a place. The function adds ``farther_m`` times the error of
        the hands' distances to the hands' distances.
        """
        period_s = trace.scenario.settings.clock.control_period_s
        left, held = (round(time_s / period_s) for time_s in (retreat_s(trace), HELD_S))
        errors_m, tcp_m = position_errors_m(trace), true_motion(trace).tcp_m
        margins = []
        nearest_m = nearest_hand_m(trace) + farther_m * nearest_off_m(trace)
        slack_m = 4.0 * farther_m * trace.known.column("transform_tcp_to_base").uncertainty
        for begin, end in np.transpose(runs_of(nearest_m > NoFalseAlarms().limit_m(trace.scenario.settings))):
            first = begin + left * bool(begin)
            ways_m = np.zeros(max(end - held - first, 0))
            for later in range(held, 0, -max(held // HELD_AT, 1)):
                way_m = tcp_m[first + later :][: len(ways_m)] - tcp_m[first:][: len(ways_m)]
                ways_m = np.maximum(ways_m, np.linalg.norm(way_m, axis=1))
            stays = np.flatnonzero(ways_m <= self.within_m + slack_m)
            if len(stays):
                first += int(stays[0])
                error_m, least_m = errors_m[first:end], np.minimum.accumulate(errors_m[first:end])
                places = np.floor((least_m[0] - least_m) / self.within_m)
                place = np.searchsorted(places, places)  # (n,) the tick at which it came there
                way_m = np.linalg.norm(tcp_m[first:end] - tcp_m[first:end][place], axis=1)
                gone_m = np.maximum(error_m - least_m, way_m - np.maximum(error_m[place] - error_m, 0.0))
                margins.append((float(gone_m.max()), first + int(gone_m.argmax())))
        worst_m, worst = max(margins, default=(0.0, 0))
        return worst_m + slack_m, worst, len(margins)

    def ends(self, trace: Trace) -> tuple[float, float, bool]:
        """Return the margin's bounds for ``reads``.

        The lower bound is for hands that are as far away as possible, and the upper bound is for hands that
        are as near as possible.
        """
        (most_m, _, _), (least_m, _, held) = self._worst(trace, 1.0), self._worst(trace, -1.0)
        return self.within_m - most_m, self.within_m - least_m, held > 0


@dataclass(frozen=True, kw_only=True)
class ReactsWithin(Worded):
    """The claim that the arm reacts to each hand within ``within_s``.

    The margin is ``within_s`` minus the longest time from a hand's approach to the arm's reaction. Each true
    hand is judged separately, and so is each of its approaches, that is, each time at which the hand comes
    within the critical distance of a moving TCP. The arm reacts when its drives brake, or when its motion
    begins to change sufficiently. The change is sufficient if the arm soon has half the speed that it would
    have had without the hand. It is also sufficient if the arm's speed away from the hand rises by half of
    the arm's speed. For this comparison, the arm without the hand is assumed to continue its deceleration,
    and to slow down when it arrives at the desired position. So an arrival is not a reaction. An approach is
    ignored if the arm reacted to that hand in the half second before. An approach is also ignored if the arm
    already moves away from the hand with at least half the speed of a retreat. If the arm does not approach
    the desired position at that time, any speed away from the hand is sufficient for ignoring the approach. A
    hand that leaves too early, or a run that ends too early, is not evidence. The time of a reaction is the
    beginning of the stop or the retreat.
    """

    within_s: float
    unit: Unit = Unit.TIME
    wording: ClassVar[str] = "reacts within {within_s:ms}"

    @reads("transform_tcp_to_base", "hand_position_in_base_m", also=["limits"], of_each_hand=True)
    def evaluate(self, trace: Trace) -> Evaluation:
        """Judge each approach of a hand."""
        hands = range(len(trace.scenario.hands))
        encounters = [encounter for hand in hands for encounter in self._encounters(trace, hand)]
        if not encounters:
            near_m = float(nearest_hand_m(trace).min())
            if near_m >= trace.scenario.settings.avoidance.critical_distance_m:
                return unexercised(self, no_near_hand(trace))
            why = f"a hand came to {1e3 * near_m:.1f} mm of the TCP, which stood, or had reacted to it"
            return unexercised(self, f"{why}; one that stays until the arm comes back exercises it")
        decided = [(took, tick) for took, tick, known in encounters if known]
        took, tick = max(decided, default=(0, 0))
        reason = f"longest {1e3 * trace.time_s[took]:.0f} ms, of {len(decided)} times that a hand came near"
        margin_s = time_left_s(trace, self.within_s, took)
        evaluation = judged(self, trace, margin_s, trace.time_s[tick + took], reason, len(decided))
        if len(decided) == len(encounters) or evaluation.verdict is Verdict.VIOLATED:
            return evaluation
        open_s = next(trace.time_s[tick] for _, tick, known in encounters if not known)
        why = f"a hand came near at {open_s:.3f} s, and it left, or the run ended, before the arm reacted"
        return inconclusive(self, why, exercised=len(decided))

    def _encounters(self, trace: Trace, hand: int) -> Iterator[tuple[int, int, bool]]:
        """Yield the approaches of a hand.

        Each entry is (ticks until the reaction, tick of the approach, whether the reaction is known).
        """
        settings, ticks = trace.scenario.settings, trace.ticks
        period_s, tcp_m = settings.clock.control_period_s, true_motion(trace).tcp_m
        last, halved = len(ticks) - 1, round(HALVED_S / period_s)
        from_hand_m = tcp_m - ticks["hand_position_in_base_m"][:, hand]
        apart_m, errors_m = np.linalg.norm(from_hand_m, axis=1), position_errors_m(trace)
        is_near = ticks["hand_present"][:, hand] & (apart_m < settings.avoidance.critical_distance_m)
        velocity, braking = np.diff(tcp_m, axis=0) / period_s, ticks["limits"] & int(Limit.BRAKING) != 0
        speed = np.maximum(np.linalg.norm(velocity, axis=1), TINY_MPS)
        for first, end in np.transpose(runs_of(is_near)).tolist():
            prior, was = (first - 1, max(first - 1 - round(BEFORE_S / period_s), round(STARTED_S / period_s)))
            if prior < was or first == last or speed[prior] <= MOVES or braking[prior]:
                continue
            leads = product(velocity, from_hand_m[first] / max(apart_m[first], TINY_MPS))
            # an arriving arm slows down in proportion to the way that is left
            now, away, left = (speed[prior], leads[prior], errors_m / max(errors_m[prior], TINY_M))
            arrives = min(1.0 / max(left[was], TINY_M), 1.0)
            reacted = now <= HALF * arrives * speed[was]
            reacted |= away - arrives * leads[was] >= HALF * speed[was] > HALF * MOVES
            reacted |= away > 0.0 and errors_m[first] > errors_m[prior]
            if reacted or away >= HALF * settings.avoidance.repulsion_speed_mps:
                continue
            until = slice(first, min(end + halved, last))
            slowing = power(min(now / speed[was], 1.0), 1.0 / max(prior - was, 1))
            usual = np.minimum(power(slowing, np.arange(1, until.stop - first + 1)), left[until])
            change = 1.0 - speed[until] / np.maximum(usual * now, TINY_MPS)
            change = np.maximum(change, (leads[until] - away * usual) / now)
            motion, avoids = settings.motion, settings.avoidance
            most_mps2 = min(motion.max_tcp_acceleration_mps2, avoids.repulsion_acceleration_mps2)
            soon = halved + round(HALF * now / most_mps2 / period_s)
            took, lasted = _began(np.where(braking[until], np.inf, change), soon), end - 1 - first
            known = took is not None and time_left_s(trace, self.within_s, took) >= 0.0
            if not known and time_left_s(trace, self.within_s, lasted) < 0.0:  # the hand stayed
                known = took is not None or (last - first) * period_s >= self.within_s + HALVED_S
            yield lasted if took is None else took, first, known


def _began(change: NDArray[np.float64], soon: int) -> int | None:
    """Return the tick at which ``change`` (n,) begins to rise to HALF, or None if it stays below HALF.

    This tick is the knee of the curve, which lies farthest below the chord. The tick is at most ``soon``
    ticks before HALF, because a slower change, such as a wide curve, is not a reaction.
    """
    end = int(np.argmax(change >= HALF))
    if not change[end] >= HALF:
        return None
    chord = min(change[end], 1.0) * np.arange(1, end + 2) / (end + 1)
    return end if np.isinf(change[end]) else max(int(np.argmin(change[: end + 1] - chord)), end - soon)


KEEPS_ITS_PLACE = CatalogueEntry(
    prop=KeepsItsPlace(within_m=0.005),
    rationale="people approach an arm that stands still, and do not expect it to drift",
    source="the project's own; judged by the motion, whatever mode the controller reports",
    margin=(
        "the limit minus the largest distance by which the TCP moves from its place or away "
        "from the desired position while no hand is near"
    ),
    parameters="the limit; critical distance, prediction horizon and retreat in the settings",
    exercised="for the time of a retreat no hand has been near, and the TCP stays within the limit for 1 s",
    scenario="servoing-alone",
    broken_by="a controller that drifts",
)
REACTS = CatalogueEntry(
    prop=ReactsWithin(within_s=0.12),
    rationale="an arm must slow down or retreat when a hand comes near, whatever mode its controller reports",
    source="the reaction time T_r for each hand, judged by the motion and the drives of the arm",
    margin=(
        "the time allowed minus the longest time until the drives brake, or the TCP slows down or retreats"
    ),
    parameters="the time; the critical distance and the speed of a retreat in the settings",
    exercised="a true hand comes within the critical distance of a TCP that moves and does not yet retreat",
    inconclusive=(
        "the hand leaves or the run ends before a reaction could be recognised, or the log is uncertain"
    ),
    scenario="hand-stays",
    broken_by="a controller that stops too late",
)
