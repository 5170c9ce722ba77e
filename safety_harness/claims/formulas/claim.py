"""Judge a formula on a trace.

The result is one of three verdicts, and each part of the formula has a margin with a unit.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from safety_harness.base.exceptions import FormulaError, Place
from safety_harness.claims.formulas.formula import (
    Always,
    Comparison,
    Eventually,
    Formula,
    Globally,
    Relation,
    Truth,
    Until,
    check_windows,
    formula_of,
    goal_of,
    parts_of,
    shown_in,
    signals_of,
    unit_of,
)
from safety_harness.claims.formulas.measures import Measure
from safety_harness.claims.formulas.semantics import (
    LEAST,
    OF_A_TICK,
    Atoms,
    Case,
    MarginBounds,
    Margins,
    Witness,
    comparison_bounds,
    margins,
    ticks_asked,
    truth_bounds,
    witness,
)
from safety_harness.claims.formulas.signals import MODES
from safety_harness.claims.properties.base import (
    MAY_SATURATE,
    Evaluation,
    Unit,
    inconclusive,
    times_begun,
    unreadable,
)
from safety_harness.claims.properties.measured import not_measured
from safety_harness.claims.signals.occasions import NEAR_M, nearest_of, occasion_m, went
from safety_harness.claims.signals.signal import Interpolation, Sampled, Signal
from safety_harness.claims.signals.uncertainty import as_known, blanked, gaps_of
from safety_harness.scenario.model import EDITION, Scenario, Verdict
from safety_harness.trace.trace import Trace

WORST_FIRST = (Verdict.VIOLATED, Verdict.INCONCLUSIVE, Verdict.HOLDS)


@dataclass(frozen=True)
class FormulaClaim:
    """The property that ``formula`` states.

    The constructor raises FormulaError if the formula mixes dimensions of margins. The verdict is *violated*
    if the values at the ticks certainly violate the formula, for all possible values of the unknown signals.
    It is *holds* if two conditions are met: the run is complete and contains an occasion that tests the
    formula, and the formula certainly holds at and between the ticks. Otherwise the verdict is
    *inconclusive*, and the evaluation states the reason. A claim with several parts has the worst verdict of
    its parts. If measurements are missing or inexact, a conclusive verdict must be right for every possible
    value. ``edition`` is the edition of the language in which the sentence was stored.
    """

    formula: Formula
    edition: int = EDITION

    def __post_init__(self) -> None:
        parts_of(formula_of(self.formula, "claim"))

    @property
    def sentence(self) -> str:
        """Return the formula's sentence, as in a scenario file."""
        return str(self.formula)

    @property
    def close(self) -> float | None:
        """Return the margin of ``close_to`` if the claim is one comparison at every tick, otherwise None."""
        match parts_of(self.formula):
            case (Always(body=Comparison() as one),):
                least = one.relation in (Relation.ABOVE, Relation.AT_LEAST)
                return abs(one.limit.value) * (1.0 if least else 0.5)
        return None

    @property
    def unit(self) -> Unit:
        """Return the unit of the first part's margin."""
        return unit_of(parts_of(self.formula)[0])

    @property
    def reads(self) -> tuple[str, ...]:
        """Return the columns of a trace that the formula's signals read."""
        return _columns_of(self.formula)

    def check(self, scenario: Scenario, place: Place | None = None) -> None:
        """Raise FormulaError at ``place`` if a window has no tick, or ends after a run of ``scenario``."""
        check_windows(self.formula, scenario, place or Place(field="formula"))

    def evaluate(self, trace: Trace) -> Evaluation:
        """Judge ``trace``.

        Raise FormulaError in the same cases as ``check``.
        """
        self.check(trace.scenario)
        problem = unreadable(trace, ())
        if problem is not None:
            return inconclusive(self, problem)
        parts = tuple(judge_part(part, trace, self.edition) for part in parts_of(self.formula))
        if len(parts) == 1:
            return replace(parts[0], sentence=self.sentence, close=self.close)
        return replace(
            _deciding(parts),
            sentence=self.sentence,
            exercised=min(part.exercised for part in parts),
            parts=parts,
        )


def _deciding(parts: tuple[Evaluation, ...]) -> Evaluation:
    """Return the part with the worst verdict.

    If several parts have that verdict, the function compares only the parts that have the same unit as the
    first of these parts. It returns the part with the least margin. The reason states the verdict of each
    part.
    """
    verdict = next(v for v in WORST_FIRST if any(part.verdict is v for part in parts))
    grave = [part for part in parts if part.verdict is verdict]
    same = [part for part in grave if part.unit is grave[0].unit and part.margin is not None]
    worst = min(same, key=lambda part: part.margin or 0.0, default=grave[0])
    each = (f"{p.sentence}: {p.verdict.value}, {p.margin_text()} ({p.reason})" for p in parts)
    unmeasured = tuple(dict.fromkeys(name for part in grave for name in part.unmeasured))
    return replace(worst, reason="; ".join(each), unmeasured=unmeasured)


def _columns_of(formula: Formula) -> tuple[str, ...]:
    return tuple(dict.fromkeys(name for signal in signals_of(formula) for name in signal.reads))


WITHOUT_END = 1.0  # the margin, as a plain number, if truths alone decide
Values = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class _Asked:
    """The part of a claim that is judged on a run, with the signals of that run."""

    part: Formula
    trace: Trace
    sampled: dict[Signal, Sampled]
    edition: int = EDITION

    @property
    def period_s(self) -> float:
        return self.trace.scenario.settings.clock.control_period_s

    @property
    def sentence(self) -> str:
        return str(self.part)

    @property
    def unit(self) -> Unit:
        return unit_of(self.part)

    def at_ticks(self, atom: Comparison | Truth) -> MarginBounds:
        sampled = self.sampled[atom.signal]
        value = _whole_run(sampled.value, self.trace)
        if isinstance(atom, Truth):
            return truth_bounds(value)
        if sampled.value_low is None or sampled.value_high is None:
            return comparison_bounds(atom, value, value)
        low, high = (_whole_run(side, self.trace) for side in (sampled.value_low, sampled.value_high))
        return comparison_bounds(atom, low, high)

    def bounds_between_ticks(self, atom: Comparison | Truth) -> MarginBounds:
        """Return bounds of the margin from each tick to the next.

        The bounds are infinite if the signal is unknown at the tick.
        """
        sampled = self.sampled[atom.signal]
        if isinstance(atom, Truth) or sampled.low is sampled.high:
            return self.at_ticks(atom)
        unknown = np.isnan(sampled.value)
        low, high = (
            _whole_run(np.where(unknown, np.nan, side), self.trace) for side in (sampled.low, sampled.high)
        )
        return comparison_bounds(atom, low, high)

    def reached(self, atom: Comparison | Truth) -> MarginBounds:
        """Return bounds of the margin from each tick to the next.

        The bounds include the value that the signal certainly reaches between the ticks, if this value is
        known.
        """
        sampled = self.sampled[atom.signal]
        if sampled.surely is None or isinstance(atom, Truth):
            return self.bounds_between_ticks(atom)
        low, high = (_whole_run(side, self.trace) for side in (sampled.low, sampled.surely))
        return comparison_bounds(atom, low, high)

    def surely(self, at_ticks: Margins) -> float:
        """Return an upper bound of the part's margin.

        The bound covers the ticks. It also covers the moments between the ticks if the part makes the same
        demand at every moment. The last moment is the last tick.
        """
        part, most = self.part, float(at_ticks.bounds.high[0])
        always = isinstance(part, Globally) or (isinstance(part, Always) and part.span is None)
        plain = all(isinstance(node, OF_A_TICK) for operand in part.parts for node in operand.nodes())
        known = all(signal.between is not Interpolation.TICKS_ONLY for signal in self.sampled)
        if self.lacking or not (always and plain and known):
            return most
        return min(most, float(margins(part, self.reached, self.period_s).bounds.high[0]))

    def cases(self, atoms: Atoms) -> list[Case]:
        """Return one case for each mode that is possible in a gap.

        The result is empty if the part does not read several modes.
        """
        gaps = self.trace.known.column("mode").gaps
        several = len(MODES.keys() & self.sampled.keys()) > 1
        either = {mode for gap in gaps for mode in gap.either} if several else set()
        count, margin_cases = self.trace.scenario.ticks + 1, []
        for mode in sorted(either):
            where = np.zeros(count, np.bool_)
            for gap in sorted(gaps, key=lambda gap: gap.either == ()):  # those of any mode last
                where[gap.first : gap.after] = mode in gap.either

            def atom_margins(atom: Comparison | Truth, mode: int = mode) -> MarginBounds:
                own = MODES.get(atom.signal) if isinstance(atom, Truth) else None
                return atoms(atom) if own is None else truth_bounds(np.full(count, float(own == mode)))

            margin_cases.append(Case(where, atom_margins))
        return margin_cases

    def exercised(self, at_ticks: Margins, *, perhaps: bool = False) -> tuple[int, str]:
        """Return how often the run certainly exercised the part, and a text on the missing event.

        The text is used if the run never exercised the part. A part with a trigger is exercised each time
        that the trigger begins to hold. "until" and "eventually" are exercised at each known tick before
        their goal is met. Before edition 3, only "until" follows this rule. Any other part is exercised at
        each known tick to which it applies. If a signal counts its own occasions, the number of these
        occasions is an upper bound, unless the signal belongs to the trigger. Suppose that a speed is not
        known exactly enough at any tick. If the position that changes with this speed certainly changes, the
        part is exercised once. If ``perhaps`` is True, ticks whose values are unknown are included.
        """
        part, tried = self.part, set(self.sampled)
        ticks = ticks_asked(at_ticks, self.period_s)
        when = {signal: np.zeros(len(self.trace.ticks), np.bool_) for signal in self.sampled}
        for node, mask in ticks:
            when[node.signal] |= mask[: len(self.trace.ticks)]
        known = np.all([perhaps | ~np.isnan(sampled.value) for sampled in self.sampled.values()], axis=0)
        known &= np.any(list(when.values()), axis=0)
        count, untried = int(np.count_nonzero(known)), "what it reads is never known"
        if isinstance(part, Globally):
            trigger = at_ticks.parts[0].bounds
            count = self.begun((trigger.high if perhaps else trigger.low) >= 0.0, trigger.high < 0.0)
            untried = f'"{part.trigger}" never holds{self.nearest(part.trigger, at_ticks.parts[0])}'
            tried -= set(signals_of(part.trigger))
        elif (goal := goal_of(part)) is not None and (self.edition > 2 or isinstance(part, Until)):
            met = at_ticks.parts[-1].bounds
            if not isinstance(part, Until | Eventually):
                met = -at_ticks.parts[0].parts[0].bounds
            ends = np.flatnonzero((met.high if self.lacking and not perhaps else met.low) >= 0.0)
            count = min(count, int(ends[0])) if len(ends) else count
            untried = f'"{goal}" holds from the beginning'
        for signal in tried:
            sampled = self.sampled[signal]
            if sampled.tried is not None:
                near_m = near_of(part, signal) if sampled.comes else 0.0
                least, most = (side + (near_m - NEAR_M) * bool(sampled.comes) for side in sampled.tried)
                tries, never = ((least, most)[perhaps] > 0.0) & when[signal], (most <= 0.0) | ~when[signal]
                own = self.begun(tries, never) if sampled.comes else int(np.count_nonzero(tries))
                if own == 0 and signal.place in self.lacking:
                    own = int(went(self.trace, signal.place, when[signal]))
                if own < count:
                    count, untried = own, self.untried(sampled, when[signal], near_m)
        return count, untried

    def untried(self, sampled: Sampled, when: NDArray[np.bool_], near_m: float) -> str:
        """Return a text about the missing event.

        ``when`` (n,) marks the ticks to which the part applies.
        """
        where = "" if when.all() else " at any tick that the formula asks of"
        if sampled.comes is None:
            return f"{sampled.untried}{where}"
        body, target = sampled.comes
        nearest = nearest_of(self.trace, np.where(when, sampled.value, np.inf), near_m, body, target)
        return (nearest or f"there was no {body}") + where

    def begun(self, surely: NDArray[np.bool_], never: NDArray[np.bool_]) -> int:
        """Return how often a state certainly begins.

        The state may have continued over unknown ticks, so these ticks are skipped.
        """
        return times_begun(surely[surely | never] if self.lacking else surely)

    def unexercised(self, at_ticks: Margins, untried: str) -> Evaluation:
        """Return an inconclusive evaluation for a part that was never exercised.

        If only unmeasured values may have exercised it, the reason says so.
        """
        if self.lacking and self.exercised(at_ticks, perhaps=True)[0]:
            return self.lacks(self.lacking, "nothing else tells whether it was exercised")
        return inconclusive(self, f"never exercised: {untried}")

    @cached_property
    def lacking(self) -> tuple[str, ...]:
        """Return the columns that the part reads and that the trace does not know completely."""
        known = self.trace.known
        return () if known.whole else tuple(n for n in _columns_of(self.part) if known.column(n).limited)

    def lacks(self, columns: tuple[str, ...], reason: str = "", exercised: int = 0) -> Evaluation:
        """Return an inconclusive evaluation, because the columns ``columns`` are not known well enough.

        ``reason`` gives more detail.
        """
        gaps = gaps_of(self.trace, columns)
        text = f"not measured: {', '.join(gaps)}" if gaps else ""
        rest = [name for name in columns if name not in gaps]
        if rest:
            text += f"{'; ' * bool(gaps)}known only to within an uncertainty: {', '.join(rest)}"
        text += f"; {reason}" * bool(reason)
        return replace(inconclusive(self, text, exercised=exercised), unmeasured=columns)

    def nearest(self, trigger: Formula, at_ticks: Margins) -> str:
        """Return a text about the smallest amount by which ``trigger`` failed to hold.

        The text is empty if the trigger compares several quantities, or if the amount is unknown.
        """
        low = at_ticks.bounds.low[: len(self.trace.ticks)]
        try:
            unit = unit_of(trigger)
        except FormulaError:  # of several kinds, which a trigger may mix
            return ""
        if not np.isfinite(low).any():
            return ""
        tick = int(np.argmax(np.where(np.isfinite(low), low, -np.inf)))
        lacked = unit.margin_text(-float(low[tick])).removeprefix("+")
        return f": it lacked at least {lacked}, at {self.trace.time_s[tick]:.3f} s"

    def undecided(
        self, at_ticks: Margins, between_ticks: Margins, surely: float, exercised: int
    ) -> Evaluation:
        """Return an inconclusive evaluation for a part whose bounds are too far apart.

        The reason may also be that a value is unknown or uncertain.
        """
        holds, uncertain = at_ticks.bounds.low[0] >= 0.0, self.trace.known.uncertain(self.lacking)
        ends = [float(between_ticks.bounds.low[0]), surely]
        evaluation = self.evaluation_of(Verdict.INCONCLUSIVE, between_ticks, exercised)
        least, most = (self.unit.margin_text(end) for end in ends)
        if uncertain and np.isfinite(ends).all():
            why = f"between {least} and {most}, as {', '.join(uncertain)} may be that far off: "
            why += evaluation.reason
            return replace(inconclusive(self, why, exercised=exercised), unmeasured=uncertain)
        if not self.lacking and holds and ends[0] == -np.inf:
            why = f"{MAY_SATURATE}; at the ticks {most} ({evaluation.reason})"
            return inconclusive(self, why, exercised=exercised)
        if not self.lacking and (holds or np.isfinite(ends).all()):
            why = "it holds at the ticks, perhaps not between them" if holds else "it is not known so closely"
            return replace(evaluation, reason=f"{why}: between {least} and {most} ({evaluation.reason})")
        return self.unknown(
            witness(between_ticks if holds else at_ticks, 0, self.period_s, low=True), exercised
        )

    def unknown(self, decisive: Witness, exercised: int) -> Evaluation:
        """Return inconclusive because a value is unknown or a window ends after the run.

        The reason states the unknown value at the ``decisive`` tick. If the deciding signal is known there,
        the reason states the first unknown value.
        """
        trace, columns = self.trace, self.lacking
        why = "a window runs beyond the end of the run, which does not decide it"
        if not trace.complete:
            why = f"the run was cut short ({trace.ended})"
        if decisive.tick < len(trace.ticks) and decisive.atom is not None:
            every = sorted(
                (decisive.atom.signal, *self.sampled), key=lambda signal: not gaps_of(trace, signal.reads)
            )
            for signal in every:  # first those that were not always measured
                holes = _holes(self.sampled[signal])
                if holes.any():
                    tick = decisive.tick if holes[decisive.tick] else int(np.argmax(holes))
                    why = f"{signal.words} is not known at {trace.time_s[tick]:.3f} s"
                    gaps = gaps_of(trace, signal.reads)
                    columns = gaps_of(trace, gaps, tick) or gaps or columns
                    break
        if columns:
            return self.lacks(columns, why, exercised)
        return inconclusive(self, why, exercised=exercised)

    def evaluation_of(
        self, verdict: Verdict, seen: Margins, exercised: int, *, low: bool = True
    ) -> Evaluation:
        """Return an evaluation with ``verdict``, a bound of the margin and the decisive moment.

        The bound is the lower bound of ``seen`` if ``low`` is true, and the upper bound of ``seen``
        otherwise.
        """
        decisive = witness(seen, 0, self.period_s, low=low)
        margin, unit = float((seen.bounds.low if low else seen.bounds.high)[0]), self.unit
        margin = 0.0 if margin == LEAST else margin
        if not np.isfinite(margin):
            margin, unit = float(np.copysign(WITHOUT_END, margin)), Unit.COUNT
        evaluation = replace(
            inconclusive(self, "what comes after the run decides", exercised=exercised),
            verdict=verdict,
            unit=unit,
            margin=margin,
        )
        if decisive.atom is None or decisive.tick >= len(self.trace.ticks):
            return evaluation
        signal = decisive.atom.signal
        value = float(self.sampled[signal].value[decisive.tick])
        if isinstance(decisive.atom, Truth):
            reason = signal.words if value else f"not {signal.words}"
        else:
            shown = shown_in(signal.dimension)
            reason = f"{signal.words} {value * shown.per_si:.4g} {shown.symbol}".rstrip()
            reason += ", exactly the limit" if abs(margin) <= LEAST else ""
        return replace(evaluation, worst_time_s=float(self.trace.time_s[decisive.tick]), reason=reason)


def near_of(part: Formula, signal: Signal) -> float:
    """Return the distance at which ``signal`` begins to exercise ``part``.

    A distance below this limit exercises the part.
    """
    comparisons = (node for node in part.nodes() if isinstance(node, Comparison) and node.signal is signal)
    return occasion_m(max((comparison.limit.value for comparison in comparisons), default=0.0))


def judge_part(part: Formula, trace: Trace, edition: int = EDITION, *, finely: bool = False) -> Evaluation:
    """Return the evaluation of ``part`` on ``trace``, which must not be empty or contradict itself.

    If ``finely`` is true, the function uses closer bounds of the signals. It calls itself with
    ``finely=True`` if the closer bounds may lead to a verdict.
    """
    whole = trace.known.whole
    missing = () if whole else trace.known.missing(_columns_of(part))
    if missing:
        return not_measured(_Asked(part, trace, {}), missing, known=trace.known)
    seen = trace if whole else blanked(trace)
    with np.errstate(invalid="ignore", over="ignore"):  # values that no run has are found below
        sampled = {
            signal: (signal.finer if finely and signal.finer else signal.sample)(seen)
            for signal in signals_of(part)
        }
    judging = _Asked(part, trace, sampled, edition)
    for signal, values in sampled.items():
        gaps = () if whole else gaps_of(trace, signal.reads)
        uncertain = () if whole else trace.known.uncertain(signal.reads)
        if values.absent and (gaps or (uncertain and values.lost is not None and values.lost.any())):
            return judging.lacks(gaps or uncertain, values.absent)
        why = values.absent or _impossible(signal, values, trace)
        if why:
            return inconclusive(judging, why)
        if uncertain and signal.off is None:
            return judging.lacks(uncertain, f"{signal.words} is not judged by that")
        sampled[signal] = values if whole else as_known(signal, values, trace)
    at_ticks, between_ticks = (
        margins(part, atoms, judging.period_s, judging.cases(atoms))
        for atoms in (judging.at_ticks, judging.bounds_between_ticks)
    )
    low, surely = between_ticks.bounds.low[0], judging.surely(at_ticks)
    # The finer signals take longer, so they are computed only where they may decide.
    if low < 0.0 <= surely and not finely and any(signal.finer for signal in sampled):
        return judge_part(part, trace, edition, finely=True)
    exercised, untried = judging.exercised(at_ticks)
    if surely < 0.0:
        exercised = max(exercised, 1)
        if np.isfinite(low) and not judging.lacking:
            return judging.evaluation_of(Verdict.VIOLATED, between_ticks, exercised)
        return judging.evaluation_of(Verdict.VIOLATED, at_ticks, exercised, low=False)
    if low < 0.0:
        return judging.undecided(at_ticks, between_ticks, surely, exercised)
    if exercised == 0 and (judging.lacking or np.isinf(low)):  # nothing was asked at all
        return judging.unexercised(at_ticks, untried)
    evaluation = judging.evaluation_of(Verdict.HOLDS, between_ticks, exercised)
    if exercised == 0:
        return replace(evaluation, verdict=Verdict.INCONCLUSIVE, reason=f"never exercised: {untried}")
    if not trace.complete:
        cut = f"the run was cut short ({trace.ended}): {evaluation.reason}"
        return replace(evaluation, verdict=Verdict.INCONCLUSIVE, reason=cut)
    return evaluation


def _holes(sampled: Sampled) -> NDArray[np.bool_]:
    """Return a mask of the ticks at which a signal is unknown or only partly known, shape (n,)."""
    return np.isnan(sampled.value) if sampled.lost is None else np.isnan(sampled.value) | sampled.lost


def _impossible(signal: Signal, sampled: Sampled, trace: Trace) -> str:
    """Return a message that says why the signal's values are impossible in a run.

    The message is empty if the values are possible.
    """
    impossible = signal.impossible(sampled) if isinstance(signal, Measure) else None
    if impossible is None:
        return ""
    (tick, value), shown = impossible, shown_in(signal.dimension)
    number = f"{value * shown.per_si:.4g} {shown.symbol}".rstrip()
    return f"no run has what is stored: {signal.words} {number} at {trace.time_s[tick]:.3f} s"


def _whole_run(values: Values, trace: Trace) -> Values:
    """Return the values of a whole run, with NaN for the ticks that the run did not reach.

    The shape is (scenario.ticks + 1,).
    """
    missing = trace.scenario.ticks + 1 - len(values)
    return np.append(values, np.full(missing, np.nan)) if missing > 0 else values
