"""Exact bounds of the probability that a run violates a claim, given that the run exercises the claim.

Upper bounds count inconclusive and failed runs as violations, and lower bounds do not. Untested runs are not
trials, and the sample counts them separately.

A stream of fixed length has Clopper and Pearson's (1934) bounds. A stream that may stop early has the bounds
of ``sequential``.
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
    """The kinds of intervals: only the upper end is a bound, or both ends are bounds.

    The value of each member is the number of ends that are bounds.
    """

    UPPER = 1  # the greatest probability; the lower end is 0 and states nothing
    BOTH = 2


class Method(Enum):
    """The method by which a bound was computed."""

    EXACT = "Clopper-Pearson"
    ANYTIME = "at every time (mixture martingale)"


@dataclass(frozen=True, kw_only=True)
class ProbabilityBounds:
    """The violation probability of a claim in a stratum, which lies between ``low`` and ``high``.

    This interval holds by itself with at least ``confidence``. The interval belongs to a family of ``family``
    bounds, which hold simultaneously with ``joint_confidence``. An interval with two bounds adds 2 to the
    size of the family.

    ``trials`` is the number of tested runs. ``violations`` is the number of certain violations among these
    runs. ``inconclusive`` and ``failed`` are the numbers of inconclusive runs and failed runs. Such a run may
    have violated the claim. ``model_only`` is true if the runs come from a simplified world.
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
        """The fraction of tested runs that certainly violated the claim, or None if no run tested it."""
        return self.violations / self.trials if self.trials else None

    def shows(self, target: float) -> bool:
        """Return whether the upper bound shows ``target`` in a world that is not simplified.

        Args:
            target: The largest fraction of tested runs that may violate the claim, between 0 and 1.

        Returns:
            True if there are tested runs, the world is not simplified, and ``high`` is at most ``target``.

        """
        return self.trials > 0 and not self.model_only and self.high <= target


def bounds_of(
    samples: Sequence[IndependentSample],
    confidence: float,
    sides: Sides = Sides.UPPER,
    *,
    family: int | None = None,
) -> tuple[ProbabilityBounds, ...]:
    """Return one bound per sample, in the order of ``samples``.

    All bounds hold simultaneously with ``confidence``. The method is Bonferroni's: each of m bounds may fail
    with a probability of (1 - confidence) / m. The bounds also hold if the samples are dependent.

    Args:
        samples: At least one sample.
        confidence: The simultaneous confidence of all bounds, between 0 and 1.
        sides: The ends that are bounds. If the lower end is no bound, ``low`` is 0.
        family: The number m. The number m is larger than the number of returned bounds if a report shows
            further bounds, for example of samples that are still missing. The default is the number of bounds
            of these samples.

    Raises:
        StatisticsError: There is no sample, the confidence is impossible, or the family is too small.
        TypeError: An element of ``samples`` is no IndependentSample.

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
    """Return the number of bounds among which a plan's error is divided.

    Each claim has two bounds in each stratum.

    Args:
        claims: The number of claims.
        strata: The number of strata.

    """
    return Sides.BOTH.value * claims * strata


def violation_bounds(
    sample: IndependentSample, confidence: float, sides: Sides = Sides.UPPER
) -> ProbabilityBounds:
    """Return the bounds of a single sample.

    Args:
        sample: The sample.
        confidence: The confidence, between 0 and 1. The two ends of a two-sided interval hold simultaneously
            with this confidence.
        sides: The ends that are bounds.

    Raises:
        StatisticsError: The confidence is impossible.
        TypeError: ``sample`` is no IndependentSample.

    """
    return bounds_of([sample], confidence, sides)[0]


def chance_of_each(confidence: float, family: int) -> float:
    """Return the probability with which each bound of a family may fail.

    All bounds then hold simultaneously with ``confidence``.

    Args:
        confidence: The simultaneous confidence of all bounds, between 0 and 1.
        family: The number m of bounds.

    Returns:
        The probability (1 - confidence) / m, according to Bonferroni.

    Raises:
        StatisticsError: The confidence is impossible, or the family is empty.

    """
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
        # A run without a verdict counts as a violation in the upper bound only.
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
