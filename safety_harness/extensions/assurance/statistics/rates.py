"""From a bound per run to a bound per hour: how often approaches come, and how often one goes wrong.

With approaches of a Poisson process at a rate r, of which each is at worst a run that violates with the
probability p, violations come at the rate r p, whatever follows upon what.  If r is above its bound R with a
chance of a, and p above its bound P with a chance of b, then r p is above R P with a chance of a + b at
most (Boole), whether the two were seen together or not.  The chance that a confidence leaves is halved: one
half is shared by the rates of approaches, the other by the bounds per run.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import inf

import scipy

from safety_harness.extensions.assurance.statistics.binomial import ProbabilityBounds, bounds_of
from safety_harness.extensions.assurance.statistics.sample import IndependentSample


def most_an_hour(count: int, hours: float, chance: float) -> float:
    """Above which a Poisson rate lies with this chance at most, of ``count`` events in ``hours``.

    Garwood (1936): the rate under which as few events or fewer have that chance.
    """
    if not hours > 0.0:  # nobody looked: any rate may be
        return inf
    return float(scipy.special.gammainccinv(count + 1, chance)) / hours


@dataclass(frozen=True)
class SharedError:
    """How the chance that ``confidence`` leaves is shared among ``rates`` of approaches and the runs."""

    confidence: float
    rates: int

    @property
    def of_each_rate(self) -> float:
        """The chance with which one rate of approaches may be above its bound."""
        return (1.0 - self.confidence) / 2.0 / self.rates

    @property
    def confidence_of_runs(self) -> float:
        """With which all bounds per run hold together."""
        return 1.0 - (1.0 - self.confidence) / 2.0

    def worst_run(self, samples: Sequence[IndependentSample], claims: int = 1) -> ProbabilityBounds:
        """The largest upper bound per run of one claim over the strata, one sample of each.

        ``claims`` are those whose bounds have to hold together.
        """
        bounds = bounds_of(samples, self.confidence_of_runs, family=claims * len(samples))
        return max(bounds, key=lambda one: one.high)
