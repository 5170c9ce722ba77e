"""A formula as a property: judged on a trace, three-valued, each part with its own margin and unit."""

from __future__ import annotations

from dataclasses import dataclass, replace

from safety_harness.exceptions import Place
from safety_harness.formulas.asked import check_windows, parts_of, unit_of
from safety_harness.formulas.formula import Formula, formula_of
from safety_harness.formulas.judging import judge_part
from safety_harness.properties.base import Evaluation, Unit, inconclusive, unreadable
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
