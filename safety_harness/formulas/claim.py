"""A formula as a property: judged on a trace, three-valued, each part with its own margin and unit."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from safety_harness.exceptions import Place
from safety_harness.formulas.formula import (
    Comparison,
    Formula,
    Globally,
    Initially,
    Truth,
    Until,
    check_windows,
    formula_of,
    parts_of,
    shown_in,
    signals_of,
    unit_of,
)
from safety_harness.formulas.semantics import (
    LEAST,
    MarginBounds,
    Margins,
    Witness,
    comparison_bounds,
    margins,
    truth_bounds,
    witness,
)
from safety_harness.formulas.signal import Measure, Sampled, Signal
from safety_harness.properties.base import Evaluation, Unit, inconclusive, times_begun, unreadable
from safety_harness.scenario.model import Scenario, Verdict
from safety_harness.trace.trace import Trace

_GRAVEST = (Verdict.VIOLATED, Verdict.INCONCLUSIVE, Verdict.HOLDS)


@dataclass(frozen=True)
class FormulaClaim:
    """The property that ``formula`` says; FormulaError if it mixes margins that cannot be compared.

    It is violated if that is certain at the ticks, whatever is unknown; it holds if that is certain
    at the ticks and between them, in a run that was not cut short and put it to the test; else it
    is inconclusive, with the reason.  Of several parts the gravest verdict counts.
    """

    formula: Formula

    def __post_init__(self) -> None:
        parts_of(formula_of(self.formula, "claim"))

    @property
    def sentence(self) -> str:
        """As a scenario file writes it."""
        return str(self.formula)

    @property
    def unit(self) -> Unit:
        """Of the first part's margin."""
        return unit_of(parts_of(self.formula)[0])

    def check(self, scenario: Scenario, place: Place | None = None) -> None:
        """FormulaError at ``place`` for windows that a run of ``scenario`` has no room for."""
        check_windows(self.formula, scenario, place or Place(field="formula"))

    def evaluate(self, trace: Trace) -> Evaluation:
        """Judge one trace; FormulaError as ``check`` says."""
        self.check(trace.scenario)
        problem = unreadable(trace, ())
        if problem is not None:
            return inconclusive(self, problem)
        parts = tuple(judge_part(part, trace) for part in parts_of(self.formula))
        if len(parts) == 1:
            return replace(parts[0], sentence=self.sentence)
        return replace(
            _deciding(parts),
            sentence=self.sentence,
            exercised=min(part.exercised for part in parts),
            parts=parts,
        )


def _deciding(parts: tuple[Evaluation, ...]) -> Evaluation:
    """The first part with the gravest verdict, of those in its unit the one with the least margin.

    The reason says how each of them came out.
    """
    verdict = next(v for v in _GRAVEST if any(part.verdict is v for part in parts))
    grave = [part for part in parts if part.verdict is verdict]
    same = [part for part in grave if part.unit is grave[0].unit and part.margin is not None]
    worst = min(same, key=lambda part: part.margin or 0.0, default=grave[0])
    each = (f"{p.sentence}: {p.verdict.value}, {p.margin_text()} ({p.reason})" for p in parts)
    return replace(worst, reason="; ".join(each))


WITHOUT_END = 1.0  # the margin, as a plain number, of what truths alone decide
Values = NDArray[np.float64]


def judge_part(part: Formula, trace: Trace) -> Evaluation:
    """The verdict on one part; ``trace`` is not empty and does not contradict itself."""
    with np.errstate(invalid="ignore", over="ignore"):  # of values that no run has, which is found below
        sampled = {signal: signal.sample(trace) for signal in signals_of(part)}
    for signal, one in sampled.items():
        why = one.absent or _impossible(signal, one, trace)
        if why:
            return _evaluation(part, Verdict.INCONCLUSIVE, None, None, why, 0)
    period_s = trace.scenario.settings.clock.control_period_s
    at_ticks = margins(part, lambda atom: _at_ticks(atom, sampled, trace), period_s)
    between = margins(part, lambda atom: _between(atom, sampled, trace), period_s)
    low, surely = between.bounds.low[0], at_ticks.bounds.high[0]
    exercised, untried = _exercised(part, at_ticks, sampled)
    if surely < 0.0:
        seen, lower = (between, True) if np.isfinite(low) else (at_ticks, False)
        margin = low if np.isfinite(low) else surely
        found = witness(seen, 0, period_s, low=lower)
        return _told(part, Verdict.VIOLATED, float(margin), found, trace, sampled, max(exercised, 1))
    if low < 0.0:
        return _undecided(part, at_ticks, between, trace, sampled, exercised)
    found = witness(between, 0, period_s, low=True)
    told = _told(part, Verdict.HOLDS, float(low), found, trace, sampled, exercised)
    if exercised == 0 and np.isinf(low):  # nothing was asked at all
        return _evaluation(part, Verdict.INCONCLUSIVE, None, None, f"never exercised: {untried}", 0)
    if exercised == 0:
        return replace(told, verdict=Verdict.INCONCLUSIVE, reason=f"never exercised: {untried}")
    if not trace.complete:
        cut = f"the run was cut short ({trace.ended}): {told.reason}"
        return replace(told, verdict=Verdict.INCONCLUSIVE, reason=cut)
    return told


def _impossible(signal: Signal, one: Sampled, trace: Trace) -> str:
    """Why a signal's values are no evidence; empty if a run can have them."""
    found = signal.impossible(one) if isinstance(signal, Measure) else None
    if found is None:
        return ""
    (tick, value), shown = found, shown_in(signal.dimension)
    number = f"{value * shown.per_si:.4g} {shown.symbol}".rstrip()
    return f"no run has what is stored: {signal.words} {number} at {trace.time_s[tick]:.3f} s"


def _at_ticks(atom: Comparison | Truth, sampled: dict[Signal, Sampled], trace: Trace) -> MarginBounds:
    value = _whole_run(sampled[atom.signal].value, trace)
    return truth_bounds(value) if isinstance(atom, Truth) else comparison_bounds(atom, value, value)


def _between(atom: Comparison | Truth, sampled: dict[Signal, Sampled], trace: Trace) -> MarginBounds:
    """From each tick to the next; what is not known at the tick is not known after it either."""
    one = sampled[atom.signal]
    if isinstance(atom, Truth) or one.low is one.high:
        return _at_ticks(atom, sampled, trace)
    unknown = np.isnan(one.value)
    low, high = (_whole_run(np.where(unknown, np.nan, side), trace) for side in (one.low, one.high))
    return comparison_bounds(atom, low, high)


def _whole_run(values: Values, trace: Trace) -> Values:
    """(scenario.ticks + 1,): NaN for the ticks that the run did not reach."""
    missing = trace.scenario.ticks + 1 - len(values)
    return np.append(values, np.full(missing, np.nan)) if missing > 0 else values


def _exercised(part: Formula, at_ticks: Margins, sampled: dict[Signal, Sampled]) -> tuple[int, str]:
    """How often the part was put to the test, and what it is that never happened if that is 0.

    A trigger counts each time that it begins to hold, "until" the ticks before its second part does,
    anything else every tick that is known.  A signal that counts its own occasions bounds the
    number, unless the trigger has set it.
    """
    tried = set(sampled)
    known = np.all([~np.isnan(one.value) for one in sampled.values()], axis=0)
    count, untried = int(np.count_nonzero(known)), "what it reads is never known"
    if isinstance(part, Globally):
        count = times_begun(at_ticks.parts[0].bounds.low >= 0.0)
        untried = f'"{part.trigger}" never holds'
        tried -= set(signals_of(part.trigger))
    elif isinstance(part, Initially):
        count = int(known[0])
    elif isinstance(part, Until):
        ends = np.flatnonzero(at_ticks.parts[1].bounds.low >= 0.0)
        count = min(count, int(ends[0])) if len(ends) else count
        untried = f'"{part.second}" holds from the beginning'
    for signal in tried:
        one = sampled[signal]
        if one.occasions is not None and one.occasions < count:
            count, untried = one.occasions, one.untried
    return count, untried


def _undecided(
    part: Formula,
    at_ticks: Margins,
    between: Margins,
    trace: Trace,
    sampled: dict[Signal, Sampled],
    exercised: int,
) -> Evaluation:
    """Inconclusive: something is unknown, or the bounds between the ticks are too wide."""
    period_s = trace.scenario.settings.clock.control_period_s
    if at_ticks.bounds.low[0] >= 0.0:
        found = witness(between, 0, period_s, low=True)
        margin = float(between.bounds.low[0])
        told = _told(part, Verdict.INCONCLUSIVE, margin, found, trace, sampled, exercised)
        reason = f"it holds at the ticks, perhaps not between them (half the period tells): {told.reason}"
        return replace(told, reason=reason)
    found = witness(at_ticks, 0, period_s, low=True)
    return _evaluation(part, Verdict.INCONCLUSIVE, None, None, _unknown(found, sampled, trace), exercised)


def _unknown(found: Witness, sampled: dict[Signal, Sampled], trace: Trace) -> str:
    """What is not known: at the tick that would decide, else the first thing of all."""
    if found.tick < len(trace.ticks) and found.atom is not None:
        holes = {signal: np.flatnonzero(np.isnan(one.value)) for signal, one in sampled.items()}
        for signal in (found.atom.signal, *holes):
            if len(holes[signal]):
                tick = found.tick if found.tick in holes[signal] else holes[signal][0]
                return f"{signal.words} is not known at {trace.time_s[tick]:.3f} s"
    if not trace.complete:
        return f"the run was cut short ({trace.ended})"
    return "a window runs beyond the end of the run, which does not decide it"


def _told(
    part: Formula,
    verdict: Verdict,
    margin: float,
    found: Witness,
    trace: Trace,
    sampled: dict[Signal, Sampled],
    exercised: int,
) -> Evaluation:
    """A verdict with the moment that decided it, and what was seen then."""
    unit = unit_of(part)
    margin = 0.0 if margin == LEAST else margin
    if not np.isfinite(margin):
        margin, unit = float(np.copysign(WITHOUT_END, margin)), Unit.COUNT
    if found.atom is None or found.tick >= len(trace.ticks):
        return _evaluation(part, verdict, margin, None, "what comes after the run decides", exercised, unit)
    signal = found.atom.signal
    value = float(sampled[signal].value[found.tick])
    if isinstance(found.atom, Truth):
        reason = signal.words if value else f"not {signal.words}"
    else:
        shown = shown_in(signal.dimension)
        reason = f"{signal.words} {value * shown.per_si:.4g} {shown.symbol}".rstrip()
        reason += ", exactly the limit" if abs(margin) <= LEAST else ""
    return _evaluation(part, verdict, margin, float(trace.time_s[found.tick]), reason, exercised, unit)


def _evaluation(
    part: Formula,
    verdict: Verdict,
    margin: float | None,
    worst_time_s: float | None,
    reason: str,
    exercised: int,
    unit: Unit | None = None,
) -> Evaluation:
    return Evaluation(
        sentence=str(part),
        verdict=verdict,
        unit=unit or unit_of(part),
        margin=margin,
        worst_time_s=worst_time_s,
        reason=reason,
        exercised=exercised,
    )
