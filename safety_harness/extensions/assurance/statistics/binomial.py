"""Exact bounds of the probability that a run violates a claim, given that it exercises the claim.

Upper bounds count inconclusive and failed runs as violations, lower bounds as none; untested runs are no
trials, and are counted beside.  A stream of fixed length has Clopper and Pearson's (1934) bounds, one that
may stop early those of ``sequential``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum

from safety_harness.base.proportions import lower_bound, upper_bound
from safety_harness.extensions.assurance.statistics.sample import (
    EpisodeOutcome,
    IndependentSample,
    independent,
    refusal,
)
from safety_harness.extensions.assurance.statistics.sequential import anytime_lower, anytime_upper


class Sides(Enum):
    """Which ends are bounds; the value is how many bounds that is."""

    UPPER = 1  # how often at most.  The lower end is 0, and no statement.
    BOTH = 2


class Method(Enum):
    """Where a bound comes from."""

    EXACT = "Clopper-Pearson"
    ANYTIME = "at every time (mixture martingale)"


@dataclass(frozen=True, kw_only=True)
class ProbabilityBounds:
    """The violation probability of one claim in one stratum.

    With ``confidence`` at least it is from ``low`` to ``high``; with ``joint_confidence`` all of the
    ``family`` of bounds hold, these among them: each end that is a bound counts as one.

    ``trials`` are the tested runs; of them ``violations`` were seen, ``inconclusive`` and ``failed`` may have
    been.  ``model_only``: of a simplified world.
    """

    stratum: str
    claim: str
    low: float
    high: float
    trials: int
    violations: int
    inconclusive: int
    failed: int
    untested: int
    planned: int
    confidence: float
    joint_confidence: float
    family: int
    sides: Sides
    method: Method
    model_only: bool

    @property
    def share(self) -> float | None:
        """Violations seen, of the tested runs; None if there is none."""
        return self.violations / self.trials if self.trials else None

    def shows(self, target: float) -> bool:
        """Is it shown that ``target`` of the tested runs violate it at most, in the reference world?"""
        return self.trials > 0 and not self.model_only and self.high <= target


def bounds_of(
    samples: Sequence[IndependentSample],
    confidence: float,
    sides: Sides = Sides.UPPER,
    *,
    family: int | None = None,
) -> tuple[ProbabilityBounds, ...]:
    """Bounds that all hold together with ``confidence`` (0 to 1), one for each sample, in their order.

    Bonferroni: of m bounds each may fail with (1 - confidence) / m.  The samples need not be independent
    of each other.  ``family`` is m where more bounds are shown than are made here: of samples that are
    missing yet, say.  StatisticsError for no sample, an impossible confidence or a smaller family, TypeError
    for what is no IndependentSample.
    """
    known = [independent(sample) for sample in samples]
    shown = len(known) * sides.value
    many = shown if family is None else family
    if many < shown:
        ends = "upper bounds" if sides is Sides.UPPER else "both ends"
        expected = f"a family of at least {shown} bounds ({ends} of {len(known)} samples)"
        raise refusal("family", expected, str(many))
    chance = chance_of_each(confidence, many if known else 0)
    return tuple(_bounds(sample, chance, confidence, many, sides) for sample in known)


def ends_of(claims: int, strata: int) -> int:
    """How many bounds a plan shows, which share its error: both ends for each claim in each stratum."""
    return Sides.BOTH.value * claims * strata


def violation_bounds(
    sample: IndependentSample, confidence: float, sides: Sides = Sides.UPPER
) -> ProbabilityBounds:
    """Of one sample alone: for two-sided bounds both ends hold together with ``confidence``."""
    return bounds_of([sample], confidence, sides)[0]


def chance_of_each(confidence: float, family: int) -> float:
    """With what chance each of ``family`` bounds may fail, for all to hold with ``confidence``."""
    if not 0.0 < confidence < 1.0:
        raise refusal("confidence", "a confidence between 0 and 1", f"{confidence:g}")
    if family < 1:
        raise refusal("claims", "at least one sample", "none")
    return (1.0 - confidence) / family


def _bounds(
    sample: IndependentSample, chance: float, joint: float, family: int, sides: Sides
) -> ProbabilityBounds:
    early = sample.declaration.stop_early
    upper, lower = (anytime_upper, anytime_lower) if early else (upper_bound, lower_bound)
    return ProbabilityBounds(
        stratum=sample.declaration.stratum,
        claim=sample.claim,
        low=lower(sample.violations, sample.trials, chance) if sides is Sides.BOTH else 0.0,
        high=upper(sample.at_worst, sample.trials, chance),
        trials=sample.trials,
        violations=sample.violations,
        inconclusive=sample.count(EpisodeOutcome.INCONCLUSIVE),
        failed=sample.count(EpisodeOutcome.FAILED),
        untested=sample.count(EpisodeOutcome.UNTESTED),
        planned=sample.declaration.planned,
        confidence=1.0 - sides.value * chance,
        joint_confidence=joint,
        family=family,
        sides=sides,
        method=Method.ANYTIME if early else Method.EXACT,
        model_only=sample.declaration.model_only,
    )
