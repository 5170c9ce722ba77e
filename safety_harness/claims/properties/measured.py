"""Evaluate a property on a partly measured trace; each property states the columns that it reads.

A property never guesses a missing value: if the property reads a column that was not measured, the verdict is
inconclusive and the reason states the column. In three cases there is still a verdict. A violation before a
column's first gap stays a violation. If a property treats each hand separately, a violation by a measured
hand remains a violation, independently of the hands that were not measured. A verdict also remains if it is
the same for all values within the uncertainty of the columns.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import wraps
from math import inf
from typing import Any, TypeVar, cast

import numpy as np

from safety_harness.claims.properties.base import (
    OF_HANDS,
    Evaluation,
    Property,
    Said,
    inconclusive,
    unreadable,
)
from safety_harness.claims.signals.true_motion import apart_moved_m, derived
from safety_harness.scenario.model import MAX_HANDS, MovingHand, RecordedHand, Verdict
from safety_harness.trace.known import (
    PER_HAND,
    PRESENCE,
    UNMEASURED,
    Knowledge,
    Measurement,
    Source,
    measurement,
)
from safety_harness.trace.trace import Trace
from safety_harness.trace.unmeasured import until

Judge = TypeVar("Judge", bound=Callable[[Any, Trace], Evaluation])
Ends = Callable[[Any, Trace, float], tuple[float, float, bool]]
# A choice: so far away that a hand decides no claim.
FAR_M = (100.0, 0.0, 0.0)
WITHOUT_ARMS = {"elbow_position_in_base_m", "hand_distance_m", "hand_distance_capsule"}  # the rest is hands


def reads(
    *finite: str,
    also: Sequence[str] = (),
    bounded: Sequence[str] = (),
    filled: Sequence[str] = (),
    of_each_hand: bool = False,
    ends: Ends | None = None,
) -> Callable[[Judge], Judge]:
    """Return a decorator for an ``evaluate`` that reads only these columns.

    If ``finite`` has a column of hands, ``evaluate`` also reads which hands are present.

    Args:
        finite: Columns that make the verdict inconclusive if they are not finite.
        also: Further columns that ``evaluate`` reads; they may contain values that are not finite.
        bounded: Columns that need not be measured, since ``ends`` covers all their possible values.
        filled: Columns that may have gaps, since ``ends`` covers the gaps.
        of_each_hand: Whether a violation by some of the hands is a violation, whatever the other hands do.
        ends: The function that returns the least and the largest margin (SI) that are possible within the
            uncertainty of the columns. It also returns whether the property was certainly exercised. Without
            it, an uncertain column gives no verdict.

    """
    there = [PRESENCE] if {*finite} & {*OF_HANDS} else []
    names = tuple(dict.fromkeys((*finite, *filled, *also, *bounded, *there)))

    def decorate(evaluate: Judge) -> Judge:
        def plain(prop: Property, trace: Trace) -> Evaluation:
            problem = unreadable(trace, finite)
            return evaluate(prop, trace) if problem is None else inconclusive(prop, problem)

        judging = _Judging(plain, names, tuple(bounded), tuple(filled), of_each_hand, ends)

        @wraps(evaluate)
        def evaluate_what_is_known(prop: Property, trace: Trace) -> Evaluation:
            return plain(prop, trace) if trace.known.whole else judging.evaluate(prop, trace)

        evaluate_what_is_known.reads = names  # type: ignore[attr-defined]
        return cast(Judge, evaluate_what_is_known)

    return decorate


def columns_read_by(prop: Property) -> tuple[str, ...] | None:
    """Return the columns that ``prop`` reads, or None if it does not state them."""
    columns = getattr(prop, "reads", getattr(prop.evaluate, "reads", None))
    return None if columns is None else tuple(columns)


def not_measured(
    prop: Said, columns: Sequence[str], detail: str = "", known: Knowledge | None = None
) -> Evaluation:
    """Return an inconclusive evaluation, because the columns ``columns`` were not measured.

    ``detail`` is a text that describes more exactly which parts are missing. The reason is "not reported" if
    ``known`` shows that the run's controller does not report these columns.
    """
    text = detail or ", ".join(columns)
    unreported = known is not None and known.unreported(columns)
    why = "not reported" if unreported else "not measured"
    return replace(inconclusive(prop, f"{why}: {text}"), unmeasured=tuple(columns), applicable=not unreported)


@dataclass(frozen=True)
class _Judging:
    """A property's function ``plain``, together with ``names``, the columns that it reads.

    The other fields are the arguments of ``reads``.
    """

    plain: Callable[[Property, Trace], Evaluation]
    names: tuple[str, ...]
    bounded: tuple[str, ...]
    filled: tuple[str, ...]
    of_each_hand: bool
    ends: Ends | None

    def evaluate(self, prop: Property, trace: Trace) -> Evaluation:
        """Judge the whole trace.

        If measurements are missing, the method only finds violations in the measured parts.
        """
        known = trace.known
        limited = [name for name in self.names if known.column(name).limited]
        lacking = [
            name
            for name in limited
            if name not in self.bounded
            and (known.missing([name]) or (known.column(name).gaps and name not in self.filled))
        ]
        if not lacking:
            evaluation = self.plain(prop, trace)
            return self._widened(evaluation, prop, trace, limited) if limited else evaluation
        text = ", ".join(_lack(trace, name) for name in lacking)
        reasons = [text]
        for piece_name, piece in _pieces(trace, lacking, self.of_each_hand):
            evaluation = self.evaluate(prop, piece)
            if evaluation.verdict is Verdict.VIOLATED:
                return replace(evaluation, reason=f"{evaluation.reason} ({piece_name}; not measured: {text})")
            words_of = evaluation.verdict.value if evaluation.margin is None else evaluation.margin_text()
            reasons.append(f"{piece_name}: {words_of} ({evaluation.reason})")
        return not_measured(prop, lacking, "; ".join(reasons), known)

    def _widened(
        self, evaluation: Evaluation, prop: Property, trace: Trace, limited: Sequence[str]
    ) -> Evaluation:
        """Return the verdict if all possible values agree on it, and otherwise inconclusive.

        If there is a verdict, the margin of the result is the worst possible margin for *holds*, and the best
        possible margin for *violated*.
        """
        if evaluation.verdict is Verdict.INCONCLUSIVE and self.ends is not None and not self.filled:
            return evaluation
        low, high, exercised = -inf, inf, False
        if self.ends is not None and evaluation.margin is not None:
            low, high, exercised = self.ends(prop, trace, evaluation.margin)
        if evaluation.verdict is Verdict.VIOLATED and high < 0.0:
            return replace(evaluation, margin=high)
        if evaluation.verdict is Verdict.HOLDS and low >= 0.0 and exercised:
            return replace(evaluation, margin=low)
        unknown = [name for name in limited if trace.known.column(name).uncertainty == 0.0]
        why = "not measured" if unknown else "known only to within an uncertainty"
        why = f"{why}: {', '.join(unknown or limited)}; the margin is "
        if low == -inf and high == inf:
            why += "not bounded"
        else:
            why += f"from {evaluation.unit.margin_text(low)} to {evaluation.unit.margin_text(high)}"
        if evaluation.verdict is Verdict.HOLDS and not exercised:
            why += ", and perhaps it was never exercised"
        why = f"{why}; by what was measured {evaluation.margin_text()}: {evaluation.reason}"
        return replace(inconclusive(prop, why, exercised=evaluation.exercised), unmeasured=tuple(limited))


def _lack(trace: Trace, name: str) -> str:
    """Return a text that says which part of the column ``name`` is missing."""
    first = trace.known.first_gap([name])
    if trace.known.missing([name]) or first is None:
        return name
    names = [hand.name for hand in trace.scenario.hands]
    of_hand = "" if first.hand is None else f" of {[*names, *['another hand'] * MAX_HANDS][first.hand]}"
    begin_s, end_s = (_time_s(trace, tick) for tick in (first.first, first.after))
    more = " and later" * (len(trace.known.column(name).gaps) > 1)
    return f"{name}{of_hand} from {begin_s:.3f} to {end_s:.3f} s{more}"


def _time_s(trace: Trace, tick: int) -> float:
    return tick * trace.scenario.settings.clock.control_period_s


def _pieces(trace: Trace, lacking: Sequence[str], of_each_hand: bool) -> Iterator[tuple[str, Trace]]:
    """Yield the names of the completely measured parts of a trace, and these parts.

    The parts are the time until the first gap, the hands without gaps, and the hands without their forearms.
    """
    known, hands = trace.known, trace.scenario.hands
    gap = known.first_gap(lacking)
    if gap is not None and gap.first > 0:
        yield f"until {_time_s(trace, gap.first):.3f} s", until(trace, gap.first, UNMEASURED)
    of_hands = {name for name in lacking if name in PER_HAND}
    if not of_each_hand or not of_hands:
        return
    gaps = [(name, gap.hand) for name in of_hands for gap in known.column(name).gaps]
    gaps += [(name, None) for name in known.missing(of_hands)]
    lost = {
        k
        for k in range(len(hands))
        for name, hand in gaps
        if hand == k or (hand is None and name != PRESENCE)  # that of others; these were measured
    }
    lost = {
        k for k, hand in enumerate(hands) if hands.index(trace.scenario.leader(hand) or hand) in lost
    } | lost
    kept = [hand.name for k, hand in enumerate(hands) if k not in lost]
    if kept:
        yield f"of {' and '.join(kept)} alone", _without(trace, lost)
    if of_hands <= WITHOUT_ARMS:
        yield "of hands without their forearms", _without_arms(trace)


def _without(trace: Trace, lost: set[int]) -> Trace:
    """Return a trace in which the hands ``lost`` rest at a place far from the robot.

    Hands that the scenario does not have are removed.
    """
    hands, ticks = list(trace.scenario.hands), trace.ticks.copy()
    ticks["hand_present"] = np.arange(ticks["hand_present"].shape[1]) < len(hands)
    for k in lost:
        hands[k] = MovingHand(
            name=hands[k].name, starts_at_in_base_m=FAR_M, elbow_towards_in_base_m=FAR_M, moves=()
        )
        ticks["hand_position_in_base_m"][:, k] = ticks["elbow_position_in_base_m"][:, k] = FAR_M
        ticks["elbow_position_in_base_m"][:, k, 2] += trace.scenario.settings.hand.forearm_length_m
        ticks["hand_distance_m"][:, k], ticks["hand_distance_capsule"][:, k] = FAR_M[0], 0
    kept = {*range(len(hands))} - lost
    columns = {
        name: replace(measurement, gaps=tuple(gap for gap in measurement.gaps if gap.hand in (None, *kept)))
        for name, measurement in trace.known.columns.items()
        if name != PRESENCE
    }
    scenario = replace(trace.scenario, hands=tuple(hands))
    return replace(trace, scenario=scenario, ticks=ticks, known=Knowledge(columns))


def _without_arms(trace: Trace) -> Trace:
    """Return the trace with hands that are spheres without forearms.

    The distances of the hands are computed again.
    """
    scenario, ticks = trace.scenario, trace.ticks.copy()
    # A forearm of length 0 inside the hand's sphere changes no distance.
    sphere = replace(
        scenario.settings.hand,
        forearm_length_m=0.0,
        forearm_radius_m=min(scenario.settings.hand.forearm_radius_m, scenario.settings.hand.radius_m),
    )
    hands = tuple(
        replace(
            hand, motion=replace(hand.motion, elbow_position_in_base_m=hand.motion.hand_position_in_base_m)
        )
        if isinstance(hand, RecordedHand)
        else hand
        for hand in scenario.hands
    )
    scenario = replace(scenario, hands=hands, settings=replace(scenario.settings, hand=sphere))
    ticks["elbow_position_in_base_m"] = ticks["hand_position_in_base_m"]
    position = trace.known.column("hand_position_in_base_m")
    columns = {**trace.known.columns, "elbow_position_in_base_m": position}
    armless = replace(trace, scenario=scenario, ticks=ticks, known=Knowledge(columns))
    ticks = ticks.copy()
    for name in ("hand_distance_m", "hand_distance_capsule"):
        ticks[name] = derived(armless)[name]
    distance = measurement(Source.DERIVED, apart_moved_m(armless), position.gaps)
    part = Measurement(source=Source.DERIVED, gaps=position.gaps)
    columns |= {"hand_distance_m": distance, "hand_distance_capsule": part}
    return replace(armless, ticks=ticks, known=Knowledge(columns))


def only_whole(*columns: str, of_any: bool = False) -> Callable[[Judge], Judge]:
    """Return a decorator for an ``evaluate`` that needs the whole run.

    If ``evaluate`` judged only a part of the run, the later ticks could change its verdict. The result is
    inconclusive if any of the columns has a gap or is missing. The columns are ``columns`` and all columns
    that ``evaluate`` reads. If ``of_any`` is True, the claim applies to every kind of controller, so columns
    that the controller of a simulated run does not report are accepted.
    """

    def decorate(evaluate: Judge) -> Judge:
        names = (*columns, *getattr(evaluate, "reads", ()))

        @wraps(evaluate)
        def evaluate_whole(prop: Property, trace: Trace) -> Evaluation:
            known = trace.known
            lacking = [name for name in names if known.missing([name]) or known.column(name).gaps]
            lacking = [] if of_any and known.simulated else lacking
            return not_measured(prop, lacking, known=trace.known) if lacking else evaluate(prop, trace)

        evaluate_whole.reads = names  # type: ignore[attr-defined]
        return cast(Judge, evaluate_whole)

    return decorate


def unexercised(prop: Said, lacked: str) -> Evaluation:
    """Return an inconclusive evaluation, because the claim was never exercised.

    ``lacked`` states the missing event.
    """
    return inconclusive(prop, f"never exercised: {lacked}")
