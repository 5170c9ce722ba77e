"""Check that the arm soon gives way or stops when a predicted or a true hand is near the TCP.

Without a hand, the arm must not give way, and it must not alternate between giving way and its task.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from math import sqrt
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from safety_harness.base.compiled import compiled
from safety_harness.base.settings import Settings
from safety_harness.claims.properties.base import (
    HORIZON_M,
    Evaluation,
    Unit,
    Worded,
    begins_at,
    inconclusive,
    judged,
    runs_of,
    time_left_s,
    times_begun,
)
from safety_harness.claims.properties.entry import CatalogueEntry
from safety_harness.claims.properties.measured import reads, unexercised
from safety_harness.claims.signals.occasions import (
    NEAR_M,
    millimetres,
    no_decision,
    no_near_hand,
    no_predicted_hand,
)
from safety_harness.claims.signals.true_motion import nearest_hand_m, true_motion
from safety_harness.scenario.model import Verdict
from safety_harness.scenario.moves import REACHING_MPS
from safety_harness.trace.records import Limit, Mode
from safety_harness.trace.trace import Trace, once_a_trace


@once_a_trace
def gives_way(trace: Trace) -> NDArray[np.bool_]:
    """Return a mask of the ticks at which the mode is a repulsion or a protective stop, shape (n,)."""
    mode = trace.ticks["mode"]
    given: NDArray[np.bool_] = (mode == Mode.REPULSING) | (mode == Mode.PROTECTIVE_STOP)
    return given


def predicted_near(trace: Trace, within_m: float = np.inf) -> tuple[NDArray[np.bool_], int]:
    """Return a mask of the ticks at which a predicted hand is near the true TCP, shape (n,).

    A hand is near if it is within the critical distance and within ``within_m``. The second result is the
    first tick with a prediction that is not finite, or -1.
    """
    near_m = min(trace.scenario.settings.avoidance.critical_distance_m, within_m)
    apart_m, nowhere = predicted_apart_m(trace)
    return apart_m < near_m, nowhere


@once_a_trace
def predicted_apart_m(trace: Trace) -> tuple[NDArray[np.float64], int]:
    """Return the distance of the nearest predicted hand from the true TCP, shape (n,).

    The distance is infinite if no hand is predicted. The second result is the first tick with a prediction
    that is not finite, or -1.
    """
    ticks = trace.ticks
    return _predicted_apart(true_motion(trace).tcp_m, ticks["track_valid"], ticks["predicted_hand_in_base_m"])


@compiled
def _predicted_apart(
    tcp_m: NDArray[np.float64],  # (n, 3)
    tracked: NDArray[np.bool_],  # (n, tracks)
    predicted_m: NDArray[np.float64],  # (n, tracks, 3)
) -> tuple[NDArray[np.float64], int]:
    """Return the least |predicted - tcp| over tracks, shape (n,).

    The second result is the first tick with a prediction that is not finite, or -1.
    """
    nearest_m, nowhere = np.full(tcp_m.shape[0], np.inf), -1
    for k in range(nearest_m.shape[0]):
        for track in range(tracked.shape[1]):
            if not tracked[k, track]:
                continue
            total, somewhere = 0.0, True
            for i in range(3):
                somewhere &= abs(predicted_m[k, track, i]) < HORIZON_M
                total += (predicted_m[k, track, i] - tcp_m[k, i]) ** 2
            if sqrt(total) < nearest_m[k]:  # of a NaN it is not
                nearest_m[k] = sqrt(total)
            if nowhere < 0 and not somewhere:
                nowhere = k
    return nearest_m, nowhere


def may_give_way(trace: Trace) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Return two masks of ticks, both (n,).

    The first mask has the ticks at which the arm certainly gives way, and the second mask has the ticks at
    which the arm may give way.
    """
    known = trace.known.measured("mode", trace.ticks)
    return gives_way(trace) & known, gives_way(trace) | ~known


def _answer_ends(
    prop: GivesWay | GivesWayToTrueHand,
    trace: Trace,
    sure: NDArray[np.bool_],
    maybe: NDArray[np.bool_],
    whole_stretch: bool,
) -> tuple[float, float, bool]:
    """Return the margin's bounds for ``reads``, and whether the claim was certainly exercised.

    A hand is certainly near at the ticks ``sure`` (n,), and may be near at the ticks ``maybe`` (n,). The
    lower bound uses the longest time for which a hand may have been near without a response. The upper bound
    uses the longest time for which this is certain. Mode and hand may have changed anywhere between two
    ticks. So the time for the lower bound is lengthened by one period, and the time for the upper bound is
    shortened by one period.
    """
    gives, may = may_give_way(trace)
    last, longest, open_from, too_long = len(sure) - 1, [0, 0], len(sure), False
    for side, (close, giving) in enumerate(((maybe, gives), (sure, may))):
        for first, end in zip(*runs_of(~giving if whole_stretch else close & ~giving), strict=True):
            inside = np.flatnonzero(close[first:end])
            if len(inside):
                took = min(end, last) - (first + int(inside[0]))
                too_late = time_left_s(trace, prop.within_s, took - 1) < 0.0
                longest[side] = max(longest[side], took if side == 0 or end <= last or too_late else 0)
                if side == 0 and end > last:
                    open_from = first + int(inside[0])
                too_long |= side == 1 and end > last and too_late  # already, when the run ends
    low, high = (time_left_s(trace, prop.within_s, took) for took in (longest[0] + 1, longest[1] - 1))
    exercised = bool((sure if too_long else sure[:open_from]).any())
    if not whole_stretch:
        met = zip(*runs_of(maybe), strict=True)
        exercised &= too_long or all(end > last or gives[first:end].any() for first, end in met)
    return low, high if exercised else np.inf, exercised


def _predicted_ends(prop: GivesWay, trace: Trace) -> tuple[float, float, bool]:
    known, ticks, count = trace.known, trace.ticks, len(trace.ticks)
    off_m = known.uncertainty_of("transform_tcp_to_base", count) + known.uncertainty_of(
        "predicted_hand_in_base_m", count
    )
    critical_m = trace.scenario.settings.avoidance.critical_distance_m
    apart_m, _ = predicted_apart_m(trace)
    known_ticks = known.measured("track_valid", ticks) & known.measured("predicted_hand_in_base_m", ticks)
    sure, maybe = known_ticks & (apart_m + off_m < critical_m), ~known_ticks | (apart_m - off_m < critical_m)
    return _answer_ends(prop, trace, sure, maybe, whole_stretch=True)


def _true_ends(prop: GivesWayToTrueHand, trace: Trace) -> tuple[float, float, bool]:
    nearest_m, off_m = nearest_hand_m(trace), nearest_off_m(trace)
    critical_m = trace.scenario.settings.avoidance.critical_distance_m
    sure, maybe = nearest_m + off_m < critical_m, nearest_m - off_m < critical_m
    return _answer_ends(prop, trace, sure, maybe, whole_stretch=False)


def nearest_off_m(trace: Trace) -> NDArray[np.float64]:
    """Return the error of the nearest hand's distance from the TCP, shape (n,)."""
    count = len(trace.ticks)
    return trace.known.uncertainty_of("transform_tcp_to_base", count) + trace.known.uncertainty_of(
        "hand_position_in_base_m", count
    )


@dataclass(frozen=True, kw_only=True)
class GivesWay(Worded):
    """The claim that the arm gives way to each predicted hand within ``within_s``.

    The margin is ``within_s`` minus the longest time for which a predicted hand was near and the arm did not
    give way. A hand is near if its centre is within the critical distance of the true TCP, as in the
    controller's own rule. The time starts when a hand comes near while the arm does not give way, and it ends
    when the arm gives way. The time continues if the hand leaves, because the arm must respond to every
    prediction. If the run ends before the arm gives way, the time is used only if it is already too long.

    The controller's report of a repulsion or a protective stop is accepted as giving way, because other
    claims check the motion. A predicted hand exercises the claim if it comes near and is also within NEAR_M.
    Therefore a longer critical distance does not produce more occasions.
    """

    within_s: float
    unit: Unit = Unit.TIME
    wording: ClassVar[str] = "starts retreating within {within_s:ms} of a predicted hand"

    @reads(
        "transform_tcp_to_base",
        filled=["mode", "track_valid", "predicted_hand_in_base_m"],
        ends=lambda prop, trace, _: _predicted_ends(prop, trace),
    )
    def evaluate(self, trace: Trace) -> Evaluation:
        """Judge every stretch of the run in which the arm does not give way."""
        close, unknown = predicted_near(trace)
        if unknown >= 0:
            return inconclusive(self, f"the prediction is not finite from {trace.time_s[unknown]:.3f} s")
        stretches = []
        for first, end in zip(*runs_of(~gives_way(trace)), strict=True):
            inside = np.flatnonzero(close[first:end])
            if len(inside):
                stretches.append((first + int(inside[0]), end))
        return _judged(self, trace, predicted_near(trace, NEAR_M)[0], stretches, "predicted hand")


@dataclass(frozen=True, kw_only=True)
class GivesWayToTrueHand(Worded):
    """The claim that the arm gives way to each true hand within ``within_s``.

    The margin is ``within_s`` minus the longest time for which a true hand was near and the arm did not give
    way. A hand is near if its centre is within the critical distance of the TCP, whatever the controller
    sees, tracks or predicts. The time is a stretch of ticks at which a hand is near and the controller
    reports no repulsion and no protective stop. If a hand leaves within ``within_s`` and the arm never gave
    way to it, the claim is inconclusive. If a hand is still near when the run ends, its time is used only if
    it is already too long.

    The controller's report of a repulsion or a protective stop is accepted as giving way. A true hand
    exercises the claim if it comes near and is also within NEAR_M.
    """

    within_s: float
    unit: Unit = Unit.TIME
    wording: ClassVar[str] = "starts retreating within {within_s:ms} of a true hand"

    @reads(
        "transform_tcp_to_base",
        "hand_position_in_base_m",
        filled=["mode"],
        of_each_hand=True,
        ends=lambda prop, trace, _: _true_ends(prop, trace),
    )
    def evaluate(self, trace: Trace) -> Evaluation:
        """Judge every stretch in which a hand is near and the arm does not give way."""
        nearest_m, gives = nearest_hand_m(trace), gives_way(trace)
        close = nearest_m < trace.scenario.settings.avoidance.critical_distance_m
        ignored = [slice(*run) for run in zip(*runs_of(close), strict=True) if not gives[slice(*run)].any()]
        stretches = zip(*runs_of(close & ~gives), strict=True)
        return _judged(self, trace, close & (nearest_m < NEAR_M), stretches, "true hand", ignored)


def _judged(
    prop: GivesWay | GivesWayToTrueHand,
    trace: Trace,
    close: NDArray[np.bool_],  # (n,) what counts as an occasion
    unanswered: Iterable[tuple[int, int]],
    body: str,
    ignored: Sequence[slice] = (),  # encounters in which the arm never gave way
) -> Evaluation:
    """Judge the longest stretch in which the arm did not respond to a near hand."""
    occasions = times_begun(close)
    longest, since, open_from = 0, int(np.argmax(close)), len(close)  # in ticks
    for first, end in unanswered:
        took = min(end, len(close) - 1) - first
        # The run ends before the time is over, so this stretch decides nothing.
        if end == len(close) and time_left_s(trace, prop.within_s, took) >= 0.0:
            open_from = first
        elif took > longest:
            longest, since = took, first
    margin_s = time_left_s(trace, prop.within_s, longest)
    decided = times_begun(close[:open_from])  # an occasion that is open again was answered once
    if margin_s >= 0.0 and occasions == 0:
        true = isinstance(prop, GivesWayToTrueHand)
        return unexercised(prop, no_near_hand(trace) if true else no_predicted_hand(trace))
    if margin_s >= 0.0 and decided == 0:
        had_ms = (
            (len(close) - 1 - int(np.argmax(close))) * trace.scenario.settings.clock.control_period_s * 1e3
        )
        why = f"the run ends {had_ms:.0f} ms after a {body} came near, before the {prop.within_s * 1e3:g} ms"
        return inconclusive(prop, f"{why} allowed; a longer duration exercises it")
    reason = f"longest {trace.time_s[longest] * 1e3:.0f} ms, of {occasions} times that a {body} came near"
    evaluation = judged(prop, trace, margin_s, trace.time_s[since + longest], reason, decided)
    left = next((encounter for encounter in ignored if encounter.stop < len(close)), None)
    if left is None or evaluation.verdict is not Verdict.HOLDS:
        return evaluation
    when = f"from {trace.time_s[left.start]:.3f} s to {trace.time_s[left.stop]:.3f} s"
    why = f"a {body} was near {when} and left before the {prop.within_s * 1e3:g} ms allowed"
    why += "; the arm never gave way to it"
    return replace(evaluation, verdict=Verdict.INCONCLUSIVE, reason=why, exercised=decided - 1)


GIVES_WAY = CatalogueEntry(
    prop=GivesWay(within_s=0.1),
    former=("gives way within {within_s:ms} of a predicted hand",),
    rationale="every later step assumes that the arm reacts within the time for which its separation "
    "is designed",
    source="the paper, section 3.3; the reaction time T_r",
    margin=(
        "the time allowed minus the longest time during which a predicted hand was near and "
        "the arm neither retreated nor stopped"
    ),
    parameters="the time; the critical distance in the settings",
    exercised="a predicted hand comes within the critical distance of the TCP, and within 400 mm",
    inconclusive="a prediction is not finite, or the run ends within the time allowed",
    broken_by="a controller whose own critical distance is too short",
)
GIVES_WAY_TO_TRUE_HAND = replace(
    GIVES_WAY,
    prop=GivesWayToTrueHand(within_s=0.1),
    former=("gives way within {within_s:ms} of a true hand",),
    rationale=(
        "a hand that the sensor does not see, or sees in a wrong place, is in the same "
        "danger, but claims about predictions overlook this hand"
    ),
    source=(
        "the project's own; the reaction time T_r, measured from the true hand instead of the predicted hand"
    ),
    margin=(
        "the time allowed minus the longest time during which a true hand was near and the "
        "arm neither retreated nor stopped"
    ),
    exercised="a true hand comes within the critical distance of the TCP, and within 400 mm",
    inconclusive="the hand leaves or the run ends within the time allowed, before the arm reacts",
    scenario="hidden-by-the-arm",
    broken_by="a hand sensor that is blind",
)


@dataclass(frozen=True, kw_only=True)
class GivesWayAtMost(Worded):
    """The claim that the arm leaves its task to give way at most ``most`` times.

    The margin is ``most`` minus the number of times that the arm left its task. The arm leaves its task when
    a repulsion or a protective stop begins while the arm servoes, or while it waits for the object. A further
    decision while the arm gives way is not counted.
    """

    most: int
    unit: Unit = Unit.COUNT
    wording: ClassVar[str] = "retreats at most {most:} time(s)"

    @reads(also=["mode"])
    def evaluate(self, trace: Trace) -> Evaluation:
        """Count how often the arm leaves its task."""
        entered = gives_way_at(trace)
        times = len(entered)
        if times == 0:
            return unexercised(self, no_decision(trace))
        reason = f"left its task {times} times" if times > 1 else "left its task once"
        worst_time_s = trace.time_s[entered[min(times - 1, self.most)]]
        return judged(self, trace, self.most - times, worst_time_s, reason, exercised=times)


def gives_way_at(trace: Trace) -> NDArray[np.int64]:
    """Return the ticks at which the arm leaves its task to give way.

    The first tick is included if the arm already gives way there.
    """
    return np.flatnonzero(begins_at(gives_way(trace)))


GIVES_WAY_AT_MOST = CatalogueEntry(
    prop=GivesWayAtMost(most=3),
    former=("gives way at most {most:} time(s)",),
    rationale="an arm that moves back and forth in front of a hand is of no use, and its motion is "
    "hard to foresee",
    source="hysteresis, a common demand on switched controllers",
    margin=(
        "the number allowed minus the number of times at which the arm leaves its task to retreat or to stop"
    ),
    parameters="the number of times allowed",
    exercised="the arm retreats or stops",
    scenario="hand-returns",
    broken_by="an avoider that moves only slightly away from a hand that stays",
)


@dataclass(frozen=True, kw_only=True)
class NoFalseAlarms(Worded):
    """The claim that the arm gives way only if a true hand is near.

    The margin is the limit minus the distance of the nearest true hand from the TCP when the arm begins to
    give way. The claim judges each decision, and each moment at which a repulsion or a protective stop
    begins. The further course of the repulsion or stop is not judged, because the hand may leave before its
    end. Stops at a singularity are not judged. The limit is ``within_m``. By default, it is the critical
    distance plus the distance that a hand at 2 m/s covers within the prediction horizon. A correct prediction
    can be ahead of the hand by the distance that the hand covers within the horizon. If no hand is within
    twice the limit, the distance is set to twice the limit. If the arm never gave way, the margin is the
    limit.

    Each tick without a true hand within the limit exercises the claim.
    """

    within_m: float | None = None
    unit: Unit = Unit.LENGTH

    @property
    def wording(self) -> str:
        """Return the wording of the sentence, with the limit if ``within_m`` is given."""
        return "never retreats without a hand" + " within {within_m:mm}" * (self.within_m is not None)

    @reads(
        "transform_tcp_to_base",
        "hand_position_in_base_m",
        also=["decision.tick"],
        filled=["mode", "limits"],
        ends=lambda prop, trace, _: _alarm_ends(prop, trace),
    )
    def evaluate(self, trace: Trace) -> Evaluation:
        """Judge each tick at which the arm begins to give way."""
        limit_m = self.limit_m(trace.scenario.settings)
        nearest_m = np.minimum(nearest_hand_m(trace), 2.0 * limit_m)
        alarms = beginnings(trace)
        worst, margin_m, reason = 0, limit_m, "the arm never retreated or stopped"
        if len(alarms):
            worst = int(alarms[np.argmax(nearest_m[alarms])])
            margin_m = limit_m - nearest_m[worst]
            far = nearest_m[worst] >= 2.0 * limit_m
            reason = "nobody" if far else f"nearest hand {nearest_m[worst] * 1e3:.1f} mm from the TCP"
            reason += f", worst of {len(alarms)} alarms" if len(alarms) > 1 else ""
        exercised = int(np.count_nonzero(nearest_m > limit_m))

        def lacked() -> str:
            tick = int(np.argmax(nearest_m))
            far = f"a hand was always near the TCP, at most {millimetres(nearest_m[tick], limit_m)} away, at"
            return f"{far} {trace.time_s[tick]:.3f} s; beyond {limit_m * 1e3:g} mm exercises it"

        return judged(self, trace, margin_m, trace.time_s[worst], reason, exercised, lacked)

    def limit_m(self, settings: Settings) -> float:
        """Return the largest distance [m] of a hand to which the arm may give way."""
        if self.within_m is not None:
            return self.within_m
        horizon_s = settings.hand_filter.prediction_horizon_s
        return settings.avoidance.critical_distance_m + REACHING_MPS * horizon_s


@once_a_trace
def beginnings(trace: Trace) -> NDArray[np.int64]:
    """Return the ticks (k,) of decisions and of beginnings of giving way.

    Stops at a singularity are left out.
    """
    begins = begins_at(gives_way(trace))
    begins &= trace.ticks["limits"] & int(Limit.SINGULARITY) == 0
    # After the singularities are left out, so that a decision is judged even if it ends in such a stop.
    begins[trace.decisions["tick"]] = True
    return np.flatnonzero(begins)


def _alarm_ends(prop: NoFalseAlarms, trace: Trace) -> tuple[float, float, bool]:
    """Return the least and the largest possible margin, and whether the claim was exercised.

    For the least margin, the nearest hand is as far away as possible at every possible beginning. For the
    largest margin, the nearest hand is as near as possible at every certain beginning. The true time of a
    beginning may be anywhere between its tick and the previous tick. The true time of a decision may be one
    tick earlier or later, or anywhere in the gap that contains the decision.
    """
    limit_m, nearest_m, off_m = (
        prop.limit_m(trace.scenario.settings),
        nearest_hand_m(trace),
        nearest_off_m(trace),
    )
    far_m, near_m = np.minimum(nearest_m + off_m, 2.0 * limit_m), nearest_m - off_m
    known_ticks, (gives, may) = trace.known.measured("limits", trace.ticks), may_give_way(trace)
    singular = trace.ticks["limits"] & int(Limit.SINGULARITY) != 0
    lows, highs = [limit_m], [limit_m]
    gave_before = np.append(False, gives[:-1])
    for tick in np.flatnonzero(may & ~gave_before & ~(singular & known_ticks)).tolist():
        lows.append(limit_m - float(far_m[max(tick - 1, 0) : tick + 1].max()))
    for first, end in zip(*runs_of(may), strict=True):
        inside = np.flatnonzero(gives[first:end])
        begun = slice(max(first - 1, 0), first + int(inside[0]) + 1) if len(inside) else slice(0)
        if len(inside) and known_ticks[begun].all() and not singular[begun].any():
            highs.append(limit_m - min(float(near_m[begun].min()), 2.0 * limit_m))
    gaps = [(gap.first, gap.after) for gap in trace.known.column("decision").gaps]
    for tick in trace.decisions["tick"].tolist():
        around = next((gap for gap in gaps if gap[0] <= tick < gap[1]), (tick - 1, tick + 2))
        window = slice(max(around[0], 0), around[1])
        lows.append(limit_m - float(far_m[window].max()))
        highs.append(limit_m - min(float(near_m[window].min()), 2.0 * limit_m))
    return min(lows), min(highs), bool((near_m > limit_m).any())


FALSE_ALARMS = CatalogueEntry(
    prop=NoFalseAlarms(),
    former=("never gives way without a hand",),
    rationale="an arm that retreats from nobody loses time, and people then switch its avoidance off",
    source="the project's own",
    margin=(
        "the limit minus the distance of the nearest true hand from the TCP when a retreat or a stop begins"
    ),
    parameters=(
        "the critical distance and the prediction horizon in the settings, for hands that move at up to 2 m/s"
    ),
    exercised="no true hand is within the limit during at least one tick",
    scenario="fault-false-hand",
    broken_by="a controller whose own critical distance is too long",
)
FALSE_ALARMS_WITHIN = replace(
    FALSE_ALARMS,
    prop=NoFalseAlarms(within_m=0.6),
    former=("never gives way without a hand within {within_m:mm}",),
    parameters="the limit",
)
