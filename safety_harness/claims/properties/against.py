"""Compare two avoiders on the same draws: the avoider under test and the reference.

Both avoiders get the same scenario and the same seed, so every difference in the results comes from them.
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
    """Return the largest loss of margin [SI] that is not reported.

    For a percentage, the result is at least the percentage that one occasion contributes. For a count, the
    result is 0, because a count is exact, and its best margin may be 0, for example if no answer is missing.
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
    """A claim's evaluations in two runs: with the avoider under test, and with the reference."""

    mine: Evaluation
    reference: Evaluation

    @property
    def lost(self) -> float:
        """Return the reference's margin minus the other margin [SI], or NaN if a margin is missing."""
        a, b = self.reference.margin, self.mine.margin
        return a - b if a is not None and b is not None else float("nan")

    @property
    def change(self) -> VerdictChange:
        """Return the change from the reference to the avoider under test.

        A violation is new if the reference does not violate the claim.
        """
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
        """Return a text with both margins.

        If a margin is missing, the text has the verdict instead.
        """
        mine, theirs = (
            evaluation.verdict.value if evaluation.margin is None else evaluation.margin_text()
            for evaluation in (self.mine, self.reference)
        )
        return f"{mine} against {theirs} with {reference}"


@dataclass(frozen=True, kw_only=True)
class RunDifference:
    """The results of two runs with the same scenario and seed, one run with each of the two avoiders."""

    run: str
    claims: tuple[ClaimDifference, ...]
    mine: Overruling
    reference: Overruling

    @classmethod
    def from_traces(
        cls, mine: Trace, reference: Trace, judged: Iterable[tuple[Evaluation, Evaluation]]
    ) -> RunDifference:
        """Return the difference between two traces.

        ``judged`` contains pairs of evaluations, and each pair is about one claim. The claim "the avoider
        answered" is judged too if the traces have different avoiders and the scenario does not contain this
        claim.
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
        """Return whether the change of any claim of the run is in ``changes``."""
        return any(claim.change in changes for claim in self.claims)

    def lines(self, reference: str) -> Iterator[str]:
        """Yield a line for each claim with a worse result than for ``reference``.

        A further line follows if more proposals were overruled.
        """
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
        """Return the number of failed checks per proposal, minus this number for the reference.

        The check of the spread is ignored.
        """
        mine, reference = (
            sum(count for check, count in side.reasons.items() if check is not Check.UNCERTAIN)
            / max(side.proposals, 1)
            for side in (self.mine, self.reference)
        )
        return mine - reference if self.mine.proposals and self.reference.proposals else 0.0

    @property
    def more_overruled(self) -> float:
        """Return the increase of the percentage of overruled proposals.

        The result is 0 if an avoider made no proposal.
        """
        more = self.mine.share - self.reference.share
        return more if isfinite(more) else 0.0


@dataclass(frozen=True, kw_only=True)
class Against:
    """The comparison of the avoider ``mine`` with the avoider ``reference``.

    Both avoiders ran on the same draws, and ``runs`` contains the results. If a search chose the runs,
    ``drawn`` is False, and no statistical test is computed.
    """

    mine: str
    reference: str
    runs: Sequence[RunDifference]
    drawn: bool = True

    @property
    def worse(self) -> bool:
        """Return whether any run has a new or deeper violation.

        The result is also True if a verdict is no longer conclusive.
        """
        return any(
            run.has(VerdictChange.NEW, VerdictChange.DEEPER, VerdictChange.SILENT) for run in self.runs
        )

    def count(self, change: VerdictChange) -> int:
        """Return the number of runs in which at least one claim has the change ``change``."""
        return sum(run.has(change) for run in self.runs)

    @property
    def sentence(self) -> str:
        """Return a sentence on the violations of both avoiders, with the p-value if runs are ``drawn``.

        The sentence compares the runs in which both avoiders have a verdict, and counts other new violations
        separately.
        """
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
        """Return a sentence on the overruled proposals.

        It also states in how many runs more or fewer proposals are overruled than with the reference. The
        text is empty if an avoider made no proposal.
        """
        mine, reference = (
            sum((getattr(run, name) for run in self.runs), Overruling()) for name in ("mine", "reference")
        )
        more = sum(run.more_overruled > 0.0 for run in self.runs)
        less = sum(run.more_overruled < 0.0 for run in self.runs)
        text = overruling_words((self.mine, mine), (self.reference, reference), more, less)
        return text and text + (p_words(more, less) if self.drawn else "")

    def lines(self) -> Iterator[str]:
        """Yield a line with the number of changes for each claim, then ``sentence`` and ``overruling``."""
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
        """Return the comparison as JSON for programs, with margins in SI."""
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
    """Return a sentence that states, for each avoider, the number of runs that only this avoider violates.

    ``runs`` is the number of all runs. The result of ``p_words`` may follow the sentence.

    Some runs have violations by both avoiders, but of different claims; such a run is counted only in
    ``both``.
    """
    as_well = f"; in {both} each violates one that the other keeps" if both else ""
    return (
        f"{mine} violates a claim that {reference} keeps in {new} of {runs} runs; the other way round in "
        f"{gone}{as_well}"
    )


def overruling_words(
    mine: tuple[str, Overruling], reference: tuple[str, Overruling], more: int, less: int
) -> str:
    """Return a sentence on the overruled proposals of both avoiders.

    The text is empty if an avoider made no proposal. The result of ``p_words`` may follow the text.
    """
    if not (mine[1].proposals and reference[1].proposals):
        return ""
    shares = ", ".join(
        f"of {name} {overruling.overruled} of {overruling.proposals} proposals ({overruling.share:.0%})"
        for name, overruling in (mine, reference)
    )
    return f"overruled were {shares}: a greater share in {more} runs, a lesser in {less}"


def p_words(more: int, fewer: int) -> str:
    """Return a text with the p-value of McNemar's exact test.

    The null hypothesis is that both directions are equally likely. Runs without a difference are ignored.
    """
    p = sign_test(more, fewer)
    return " (p < 0.001)" if p < 0.001 else f" (p = {p:.2g})"
