"""Bounds of violations an hour, from bounds of violations per run and from the rate of approaches.

Approaches are a Poisson process with a rate r. At worst, each approach is a run that violates a claim with
the probability p. Then violations occur at the rate r p, whatever the pattern of the approaches.

Suppose that r exceeds its bound R with a probability of at most a, and that p exceeds its bound P with a
probability of at most b. Then r p exceeds R P with a probability of at most a + b (Boole). The two errors
need not be independent. One half of the error is divided among the rates of approaches. The other half is
divided among the bounds per run.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import inf

from safety_harness.base.special import settled, upper_gamma
from safety_harness.extensions.assurance.statistics.binomial import ProbabilityBounds, bounds_of
from safety_harness.extensions.assurance.statistics.sample import IndependentSample


def most_an_hour(count: int, hours: float, chance: float) -> float:
    """Return Garwood's (1936) upper bound of a Poisson rate, in events an hour.

    If the true rate equals the bound, ``count`` events or fewer occur with probability ``chance``.

    Args:
        count: The number of events.
        hours: The time of observation. If the time is 0, the bound is infinite.
        chance: The largest probability that the true rate exceeds the bound.

    """
    if not hours > 0.0:  # without observation any rate is possible
        return inf
    most = 4.0 * count + 1e3  # a chance below 1e-400
    return settled(lambda mean: upper_gamma(count + 1.0, mean) <= chance, 0.0, most, 0.0)[1] / hours


@dataclass(frozen=True)
class SharedError:
    """The probability of error that ``confidence`` leaves, divided into two halves.

    All ``rates`` bounds of approach rates share one half. The bounds per run share the other half.
    """

    confidence: float
    rates: int

    @property
    def of_each_rate(self) -> float:
        """The probability with which a single rate of approaches may exceed its bound."""
        return (1.0 - self.confidence) / 2.0 / self.rates

    @property
    def confidence_of_runs(self) -> float:
        """The confidence with which all bounds per run hold simultaneously."""
        return 1.0 - (1.0 - self.confidence) / 2.0

    def worst_run(self, samples: Sequence[IndependentSample], claims: int = 1) -> ProbabilityBounds:
        """Return the largest upper bound per run of a claim over all strata.

        Args:
            samples: One sample of the claim per stratum.
            claims: The number of claims whose bounds hold simultaneously.

        """
        bounds = bounds_of(samples, self.confidence_of_runs, family=claims * len(samples))
        return max(bounds, key=lambda bound: bound.high)
