"""Exact statistics of independent trials: confidence bounds, sign tests, and percentages as text."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import scipy  # scipy loads its special functions at their first use, which takes half a second
from numpy.typing import NDArray

from safety_harness.base.special import beta_share, binomial_at_most, settled

# The usual level. Pages and reports print it as 95 %, so another value would make their texts wrong.
LEVEL = 0.95


@dataclass(frozen=True)
class Proportion:
    """The proportion of successes in a number of trials, with the confidence interval of this proportion.

    There are ``count`` successes in ``trials`` trials.

    The interval from ``low`` to ``high`` contains the true probability with at least 95 % confidence.
    """

    count: int
    trials: int
    low: float
    high: float

    @classmethod
    def from_rows(cls, having: NDArray[np.bool_]) -> Proportion:
        """Return the proportion of true rows in ``having`` (n,) with its two-sided confidence interval.

        The interval is that of Clopper and Pearson (1934).  If the true probability equals the lower end,
        ``count`` or more successes have a probability of 2.5 %.  If it equals the upper end, ``count`` or
        fewer successes have that probability.  Raise ValueError if there are no trials.
        """
        trials, count = len(having), int(np.count_nonzero(having))
        if not trials:
            raise ValueError("a share takes at least one trial")
        tail = (1.0 - LEVEL) / 2.0
        return cls(count, trials, lower_bound(count, trials, tail), upper_bound(count, trials, tail))

    @property
    def share(self) -> float:
        """The proportion, between 0 and 1."""
        return self.count / self.trials


def share_words(count: int, total: int) -> str:
    """Return a proportion as a percentage with one decimal, as text.

    A positive ``count`` never gives 0 %, and a ``count`` below ``total`` never gives 100 %.
    """
    if total == 0:
        return "\u2013"
    if count in (0, total):
        return "0 %" if count == 0 else "100 %"
    per_mille = round(1000.0 * count / total)
    if per_mille == 0:
        return "under 0.1 %"
    return "over 99.9 %" if per_mille == 1000 else f"{per_mille / 10:.1f} %"


@lru_cache(maxsize=4096)
def upper_bound(count: int, trials: int, chance: float) -> float:
    """Return the upper confidence bound for a success probability (Clopper and Pearson, 1934).

    If the success probability equals the bound, ``count`` or fewer successes in ``trials`` trials occur with
    the probability ``chance``.  The result is 1 if all trials were successes.  The true success probability
    exceeds the bound with a probability of at most ``chance``.
    """
    if count >= trials:
        return 1.0
    if 2 * count > trials:  # near 1, only the rest keeps all its digits
        return 1.0 - lower_bound(trials - count, trials, chance)
    guide = float(scipy.special.betainccinv(count + 1.0, trials - count, chance))
    return settled(lambda p: binomial_at_most(count, trials, p) <= chance, 0.0, 1.0, guide)[1]


@lru_cache(maxsize=4096)
def lower_bound(count: int, trials: int, chance: float) -> float:
    """Return the lower confidence bound for a success probability, or 0 if ``count`` is 0.

    If the success probability equals the bound, ``count`` or more successes in ``trials`` trials occur with
    the probability ``chance``.
    """
    if count <= 0:
        return 0.0
    guide = float(scipy.special.betaincinv(count, trials - count + 1.0, chance))
    return settled(lambda p: beta_share(count, trials - count + 1.0, p) > chance, 0.0, 1.0, guide)[0]


def sign_test(more: int, fewer: int) -> float:
    """Return the exact two-sided p-value of the hypothesis that both outcomes are equally likely.

    The result is 1 if there is no observation.  If an observation is an episode that exactly one of two
    systems violates, the test is McNemar's test.

    Args:
        more: The number of observations in favour of the first outcome.
        fewer: The number of observations in favour of the second outcome.

    """
    return min(1.0, 2.0 * float(binomial_at_most(min(more, fewer), more + fewer, 0.5)))
