"""What a property reads of a trace, and its word on a trace of which not all of that was measured.

It never guesses: what reads a column that nobody measured is inconclusive, and names it.  Three things can be
said all the same.  What is violated until a column ends is violated.  What is violated by the hands that were
measured is violated, whatever the others did, if the property says the same of each hand.  And a margin that
is farther from zero than the uncertainty of its columns can move it keeps its verdict.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import wraps
from typing import Any, TypeVar, cast

import numpy as np

from safety_harness.properties.base import (
    OF_HANDS,
    Evaluation,
    Property,
    Said,
    inconclusive,
    unreadable,
)
from safety_harness.scenario.model import JoinedHand, Verdict
from safety_harness.trace.known import PER_HAND, PRESENCE, Knowledge, Measurement, until
from safety_harness.trace.trace import Trace

Judge = TypeVar("Judge", bound=Callable[[Any, Trace], Evaluation])
Widening = Callable[[Trace], float]


def reads(
    *finite: str,
    also: Sequence[str] = (),
    of_each_hand: bool = False,
    moved_by: Widening | None = None,
) -> Callable[[Judge], Judge]:
    """For ``evaluate``, which reads these columns and no others.

    Those that are ``finite`` make it inconclusive where they are not; ``also`` are the rest.  Whether a hand
    is there is read with everything of hands.  ``of_each_hand``: it is violated if it is for some of the
    hands alone.  ``moved_by`` says by how much the margin may move (SI) as the columns are uncertain; without
    it nothing is said of a trace in which any is.
    """
    names = tuple(dict.fromkeys((*finite, *also, *([PRESENCE] if {*finite} & {*OF_HANDS} else []))))

    def decorate(evaluate: Judge) -> Judge:
        def plain(prop: Property, trace: Trace) -> Evaluation:
            problem = unreadable(trace, finite)
            return evaluate(prop, trace) if problem is None else inconclusive(prop, problem)

        @wraps(evaluate)
        def evaluate_what_is_known(prop: Property, trace: Trace) -> Evaluation:
            if trace.known.whole:
                return plain(prop, trace)
            return _in_part(plain, prop, trace, names, of_each_hand, moved_by)

        evaluate_what_is_known.reads = names  # type: ignore[attr-defined]
        return cast(Judge, evaluate_what_is_known)

    return decorate


def columns_read_by(prop: Property) -> tuple[str, ...] | None:
    """The columns that it reads; None for one that does not say."""
    said = getattr(prop, "reads", None) or getattr(prop.evaluate, "reads", None)
    return None if said is None else tuple(said)


def not_measured(prop: Said, columns: Sequence[str], what: str = "") -> Evaluation:
    """Inconclusive for want of ``columns``; ``what`` says more exactly what of them was not measured."""
    words = what or ", ".join(columns)
    return replace(inconclusive(prop, f"not measured: {words}"), unmeasured=tuple(columns))


def _in_part(
    plain: Callable[[Property, Trace], Evaluation],
    prop: Property,
    trace: Trace,
    names: tuple[str, ...],
    of_each_hand: bool,
    moved_by: Widening | None,
) -> Evaluation:
    """By all that was measured of ``names``."""
    known = trace.known
    missing = known.missing(names)
    if missing and not (of_each_hand and missing == (PRESENCE,)):
        return not_measured(prop, missing)
    gap = known.first_gap(names)
    if not missing and gap is None:
        return _widened(plain(prop, trace), prop, trace, names, moved_by)
    lacking = [name for name in names if known.of(name).gaps] or list(missing)
    words = ", ".join(_lack(trace, name) for name in lacking)
    told = []
    for which, piece in _pieces(trace, names, of_each_hand):
        found = _in_part(plain, prop, piece, names, of_each_hand, moved_by)
        if found.verdict is Verdict.VIOLATED:
            return replace(found, reason=f"{found.reason} ({which}; not measured: {words})")
        told.append(f"{which}: {found.margin_text()} ({found.reason})")
    return not_measured(prop, lacking, "; ".join([words, *told]))


def _lack(trace: Trace, name: str) -> str:
    """What is lacking of a column, in words."""
    gaps = trace.known.of(name).gaps
    if not gaps:
        return "whether other hands were there" if name == PRESENCE else name
    first = min(gaps, key=lambda gap: gap.first)
    hands = trace.scenario.hands
    whose = f" of {hands[first.hand].name}" if first.hand is not None and first.hand < len(hands) else ""
    return f"{name}{whose} from {_time_s(trace, first.first):.3f} s"


def _time_s(trace: Trace, tick: int) -> float:
    return tick * trace.scenario.settings.clock.control_period_s


def _pieces(trace: Trace, names: tuple[str, ...], of_each_hand: bool) -> Iterator[tuple[str, Trace]]:
    """What was measured whole: the run until the first gap, and that of the hands without one."""
    gap = trace.known.first_gap(names)
    if gap is not None and gap.first > 0:
        when = f"until {_time_s(trace, gap.first):.3f} s"
        yield when, until(trace, gap.first, "what follows was not measured")
    if not of_each_hand:
        return
    gaps = [gap for name in names if name in PER_HAND for gap in trace.known.of(name).gaps]
    lost = {gap.hand for gap in gaps if gap.hand is not None}
    kept = [hand for hand in range(len(trace.scenario.hands)) if hand not in lost]
    if trace.known.missing([PRESENCE]):
        yield "of the hands that were measured", replace(trace, known=_presumed(trace.known))
    elif kept and lost:
        left = _of_hands(trace, kept)
        if left is not None:
            yield f"of {' and '.join(hand.name for hand in left.scenario.hands)} alone", left


def _presumed(known: Knowledge) -> Knowledge:
    """As if no other hands had been there."""
    return Knowledge({**known.columns, PRESENCE: Measurement()})


def _of_hands(trace: Trace, kept: list[int]) -> Trace | None:
    """The trace as if only the hands ``kept`` had been there; None if one of them is led by another."""
    hands = tuple(trace.scenario.hands[hand] for hand in kept)
    if any(isinstance(hand, JoinedHand) and hand.joined_to not in {h.name for h in hands} for hand in hands):
        return None
    ticks, columns = trace.ticks.copy(), dict(trace.known.columns)
    for name in PER_HAND:
        values = trace.ticks[name]
        absent = {"hand_distance_m": np.inf, "hand_distance_capsule": -1}.get(name, 0)
        ticks[name] = absent
        ticks[name][:, : len(kept)] = values[:, kept]
        if name in columns:
            one = columns[name]
            gaps = [gap for gap in one.gaps if gap.hand in (None, *kept)]
            gaps = [gap if gap.hand is None else replace(gap, hand=kept.index(gap.hand)) for gap in gaps]
            columns[name] = replace(one, gaps=tuple(gaps))
    scenario = replace(trace.scenario, hands=hands)
    return replace(trace, scenario=scenario, ticks=ticks, known=Knowledge(columns))


def _widened(
    found: Evaluation, prop: Property, trace: Trace, names: Sequence[str], moved_by: Widening | None
) -> Evaluation:
    """The verdict that every value within the uncertainty gives, with the margin that is certain."""
    uncertain = trace.known.uncertain(names)
    if not uncertain or found.verdict is Verdict.INCONCLUSIVE or found.margin is None:
        return found
    if moved_by is None:
        why = f"known only to within an uncertainty, with which it is not judged: {', '.join(uncertain)}"
        return replace(inconclusive(prop, why, exercised=found.exercised), unmeasured=uncertain)
    by, holds = moved_by(trace), found.verdict is Verdict.HOLDS
    low, high = found.margin - by, found.margin + by
    if low < 0.0 <= high:
        ends = " to ".join(found.unit.margin_text(end) for end in (low, high))
        why = f"between {ends}, as {', '.join(uncertain)} may be that far off: {found.reason}"
        return replace(inconclusive(prop, why, exercised=found.exercised), unmeasured=uncertain)
    return replace(found, margin=low if holds else high)
