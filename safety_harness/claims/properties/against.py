"""Compare two avoiders on the same draws: the avoider under test and the reference.

Scenario, seed and all else are the same for both, so the avoiders cause every difference.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from enum import Enum
from math import isfinite
from typing import Any

import numpy as np

from safety_harness.base.proportions import sign_test
from safety_harness.claims.properties.answered import AvoiderAnswered, is_claimed
from safety_harness.claims.properties.base import Evaluation, Unit
from safety_harness.scenario.model import Verdict
from safety_harness.trace.overruling import Overruling
from safety_harness.trace.records import Check
from safety_harness.trace.trace import Trace

# For each unit, a common and relevant difference of margins.  A search divides margins by it, to compare
# several claims; a search for one claim does not depend on it.
SCALES = {
    Unit.LENGTH: 0.1,
    Unit.ANGLE: np.pi / 18.0,
    Unit.SPEED: 0.1,
    Unit.ANGULAR_SPEED: np.pi / 6.0,
    Unit.TIME: 1.0,
    Unit.ACCELERATION: 1.0,
    Unit.ANGULAR_ACCELERATION: np.pi,
    Unit.FRACTION: 0.1,
    Unit.COUNT: 1.0,
}
TOLERANCE = 0.1  # of the scale (10 mm of a length): a smaller loss of margin is not reported
TOLERANCES = {unit: TOLERANCE * scale for unit, scale in SCALES.items()} | {Unit.COUNT: 0.0}


def tolerance(*both: Evaluation) -> float:
    """Return the largest loss of margin [SI] that is not reported; for a share, at least one occasion.

    It is 0 for a count, which is exact, and whose best margin may be 0, as for questions without an answer.
    """
    unit, exercised = both[0].unit, min(evaluation.exercised for evaluation in both)
    whole = 1.0 / max(exercised, 1) if unit is Unit.FRACTION else 0.0
    return max(TOLERANCES[unit], whole)


class VerdictChange(Enum):
    """The change of a claim's result from the reference to the avoider under test."""

    NEW = "new violation"
    DEEPER = "violated by more"
    SILENT = "no verdict any more"
    LOST = "margin lost"
    GONE = "violation gone"
    NONE = "no difference"


_SHOWN_CHANGES = (VerdictChange.NEW, VerdictChange.DEEPER, VerdictChange.SILENT, VerdictChange.LOST)


@dataclass(frozen=True, kw_only=True)
class ClaimDifference:
    """The evaluations of a claim in a run with each of the two avoiders."""

    mine: Evaluation
    reference: Evaluation

    @property
    def lost(self) -> float:
        """Return by how much the reference's margin exceeds the other's [SI]; NaN if either is missing."""
        a, b = self.reference.margin, self.mine.margin
        return a - b if a is not None and b is not None else float("nan")

    @property
    def change(self) -> VerdictChange:
        """Return the change; a violation is also new if the reference has no verdict."""
        mine, reference = self.mine.verdict, self.reference.verdict
        less = self.lost > tolerance(self.mine, self.reference)
        if mine is Verdict.VIOLATED:
            if reference is not Verdict.VIOLATED:
                return VerdictChange.NEW
            return VerdictChange.DEEPER if less else VerdictChange.NONE
        if mine is Verdict.INCONCLUSIVE:
            silent = reference is Verdict.HOLDS and self.mine.applicable  # else there is nothing to compare
            return VerdictChange.SILENT if silent else VerdictChange.NONE
        if reference is Verdict.VIOLATED:
            return VerdictChange.GONE
        return VerdictChange.LOST if less and reference is Verdict.HOLDS else VerdictChange.NONE

    def summary(self, reference: str) -> str:
        """Return the margins of both in words, or the verdict if there is no margin."""
        mine, theirs = (
            evaluation.verdict.value if evaluation.margin is None else evaluation.margin_text()
            for evaluation in (self.mine, self.reference)
        )
        return f"{mine} against {theirs} with {reference}"


@dataclass(frozen=True, kw_only=True)
class RunDifference:
    """The results of a scenario with one seed, run with each of the two avoiders."""

    run: str
    claims: tuple[ClaimDifference, ...]
    mine: Overruling
    reference: Overruling

    @classmethod
    def from_traces(
        cls, mine: Trace, reference: Trace, judged: Iterable[tuple[Evaluation, Evaluation]]
    ) -> RunDifference:
        """Return the difference of two traces, with the pairs of evaluations in ``judged``.

        Unless the scenario claims it, the claim "the avoider answered" of two avoiders is judged too.
        """
        pairs = list(judged)
        same_avoider = mine.scenario.safety_filter != reference.scenario.safety_filter
        if not (same_avoider or is_claimed(mine.scenario.claims)):
            answered = AvoiderAnswered()
            pairs.append((answered.evaluate(mine), answered.evaluate(reference)))
        return cls(
            run=mine.scenario.name,
            claims=tuple(ClaimDifference(mine=a, reference=b) for a, b in pairs),
            mine=Overruling.from_traces([mine]),
            reference=Overruling.from_traces([reference]),
        )

    def has(self, *changes: VerdictChange) -> bool:
        """Return whether any claim of the run has one of ``changes``."""
        return any(claim.change in changes for claim in self.claims)

    def lines(self, reference: str) -> Iterator[str]:
        """Yield a line on each claim, and on overruling, if the avoider is worse than ``reference``."""
        for claim in self.claims:
            if claim.change in _SHOWN_CHANGES:
                yield f"{claim.change.value}: {self.run}: {claim.mine.sentence}: {claim.summary(reference)}"
        if self.more_overruled > 0.0:
            yield (
                f"overruled more: {self.run}: {self.mine.overruled} of {self.mine.proposals} proposals "
                f"against {self.reference.overruled} of {self.reference.proposals} with {reference}"
            )

    @property
    def more_refused(self) -> float:
        """Return how many more checks fail per proposal than with the reference, spread aside."""
        mine, reference = (
            sum(count for check, count in side.reasons.items() if check is not Check.UNCERTAIN)
            / max(side.proposals, 1)
            for side in (self.mine, self.reference)
        )
        return mine - reference if self.mine.proposals and self.reference.proposals else 0.0

    @property
    def more_overruled(self) -> float:
        """Return by how much the share of overruled proposals rises; 0 if an avoider proposed nothing."""
        more = self.mine.share - self.reference.share
        return more if isfinite(more) else 0.0


@dataclass(frozen=True, kw_only=True)
class Against:
    """The comparison of the avoider named ``mine`` with ``reference`` in ``runs`` on the same draws.

    Runs that a search chose are not ``drawn``, so no test is computed from them.
    """

    mine: str
    reference: str
    runs: Sequence[RunDifference]
    drawn: bool = True

    @property
    def worse(self) -> bool:
        """Return whether any run has a new or deeper violation, or has lost its verdict."""
        return any(
            run.has(VerdictChange.NEW, VerdictChange.DEEPER, VerdictChange.SILENT) for run in self.runs
        )

    def count(self, change: VerdictChange) -> int:
        """Return the number of runs in which any claim has ``change``."""
        return sum(run.has(change) for run in self.runs)

    @property
    def sentence(self) -> str:
        """Return a sentence on the violations in all pairs with two verdicts, and on their exact test."""
        new = [self._certain(run, VerdictChange.NEW) for run in self.runs]
        gone = [self._certain(run, VerdictChange.GONE) for run in self.runs]
        both = sum(a and b for a, b in zip(new, gone, strict=True))
        alone = sum(new) - both, sum(gone) - both
        unclear = sum(run.has(VerdictChange.NEW) for run in self.runs) - sum(new)
        more = f"; in {unclear} more, where {self.reference} has no verdict" if unclear else ""
        text = paired_words(self.mine, self.reference, *alone, len(self.runs), both=both)
        return text + (p_words(*alone) if self.drawn else "") + more

    @staticmethod
    def _certain(run: RunDifference, change: VerdictChange) -> bool:
        return any(
            claim.change is change
            and Verdict.INCONCLUSIVE not in (claim.mine.verdict, claim.reference.verdict)
            for claim in run.claims
        )

    @property
    def overruling(self) -> str:
        """Return a sentence on the overruled proposals of both, and on the runs that have more or fewer.

        It is empty without proposals.
        """
        mine, reference = (
            sum((getattr(run, name) for run in self.runs), Overruling()) for name in ("mine", "reference")
        )
        more = sum(run.more_overruled > 0.0 for run in self.runs)
        less = sum(run.more_overruled < 0.0 for run in self.runs)
        text = overruling_words((self.mine, mine), (self.reference, reference), more, less)
        return text and text + (p_words(more, less) if self.drawn else "")

    def lines(self) -> Iterator[str]:
        """Yield a line on the number of changes of each claim, then ``sentence`` and ``overruling``."""
        sentences = dict.fromkeys(claim.mine.sentence for run in self.runs for claim in run.claims)
        for sentence in sentences:
            differences = [
                (run, claim) for run in self.runs for claim in run.claims if claim.mine.sentence == sentence
            ]
            parts = [
                f"{change.value} in {count}"
                for change in (*_SHOWN_CHANGES, VerdictChange.GONE)
                if (count := sum(claim.change is change for _, claim in differences))
            ]
            if not parts:
                continue
            run, worst = max(
                differences, key=lambda pair: -np.inf if np.isnan(pair[1].lost) else pair[1].lost
            )
            if worst.change in _SHOWN_CHANGES and worst.lost > 0.0:
                parts.append(f"the most lost in {run.run}: {worst.summary(self.reference)}")
            yield f"{sentence}: {'; '.join(parts)}"
        if not self.worse:
            yield f"{self.mine}: no violation that {self.reference} does not have, in {len(self.runs)} runs"
        yield from filter(None, (self.sentence, self.overruling))

    def as_json(self) -> dict[str, Any]:
        """Return the comparison as JSON for programs; margins are in SI."""
        return {
            "mine": self.mine,
            "reference": self.reference,
            "tolerance": {unit.name.lower(): float(tolerance) for unit, tolerance in TOLERANCES.items()},
            "summary": list(self.lines()),
            "runs": [
                {
                    "scenario": run.run,
                    "claims": [_as_json(claim) for claim in run.claims],
                    "overruled": [run.mine.overruled, run.reference.overruled],
                    "proposals": [run.mine.proposals, run.reference.proposals],
                }
                for run in self.runs
            ],
        }


def _as_json(difference: ClaimDifference) -> dict[str, Any]:
    margins = (evaluation.margin for evaluation in (difference.mine, difference.reference))
    return {
        "claim": difference.mine.sentence,
        "change": difference.change.value,
        "verdicts": [difference.mine.verdict.value, difference.reference.verdict.value],
        "margins_si": [m if m is not None and isfinite(m) else None for m in margins],
    }


def paired_words(mine: str, reference: str, new: int, gone: int, runs: int, *, both: int = 0) -> str:
    """Return a sentence on the number of ``runs`` in which only one avoider violates a claim.

    ``p_words`` follows the sentence.

    A run in which each violates a claim that the other keeps (``both``) counts for neither.
    """
    as_well = f"; in {both} each violates one that the other keeps" if both else ""
    return (
        f"{mine} violates a claim that {reference} keeps in {new} of {runs} runs; the other way round in "
        f"{gone}{as_well}"
    )


def overruling_words(
    mine: tuple[str, Overruling], reference: tuple[str, Overruling], more: int, less: int
) -> str:
    """Return a sentence on both avoiders' overruled proposals, before ``p_words``; empty without any."""
    if not (mine[1].proposals and reference[1].proposals):
        return ""
    shares = ", ".join(
        f"of {name} {overruling.overruled} of {overruling.proposals} proposals ({overruling.share:.0%})"
        for name, overruling in (mine, reference)
    )
    return f"overruled were {shares}: a greater share in {more} runs, a lesser in {less}"


def p_words(more: int, fewer: int) -> str:
    """Return words on McNemar's exact test of "either is equally likely", in which ties do not count."""
    p = sign_test(more, fewer)
    return " (p < 0.001)" if p < 0.001 else f" (p = {p:.2g})"
