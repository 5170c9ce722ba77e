"""Exact statistics of independent trials: shares with their bounds, sign tests, and shares in words."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import scipy  # scipy loads its special functions at their first use, which takes half a second
from numpy.typing import NDArray

from safety_harness.base.special import beta_share, binomial_at_most, settled

LEVEL = 0.95


@dataclass(frozen=True)
class Proportion:
    """The share ``count`` of ``trials``, and an interval that contains the true share with at least 95 %."""

    count: int
    trials: int
    low: float
    high: float

    @classmethod
    def from_rows(cls, having: NDArray[np.bool_]) -> Proportion:
        """Return the share of true rows (n,) with its two-sided interval (Clopper and Pearson, 1934).

        If the true share is the lower end, ``count`` or more successes have a chance of 2.5 %.  If it is the
        upper end, ``count`` or fewer successes have that chance.  ValueError without any trial.
        """
        trials, count = len(having), int(np.count_nonzero(having))
        if not trials:
            raise ValueError("a share takes at least one trial")
        tail = (1.0 - LEVEL) / 2.0
        return cls(count, trials, lower_bound(count, trials, tail), upper_bound(count, trials, tail))

    @property
    def share(self) -> float:
        """The share, between 0 and 1."""
        return self.count / self.trials


def share_words(count: int, total: int) -> str:
    """Return a share in per cent with one decimal.

    A positive count never gives 0 %, and a count below ``total`` never gives 100 %.
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
    """Return the share at which at most ``count`` of ``trials`` successes have the probability ``chance``.

    The result is 1 if all trials are successes.  It is the upper end of Clopper and Pearson (1934): with at
    most this probability, the true share lies above it.
    """
    if count >= trials:
        return 1.0
    if 2 * count > trials:  # near 1, only the rest keeps all its digits
        return 1.0 - lower_bound(trials - count, trials, chance)
    guide = float(scipy.special.betainccinv(count + 1.0, trials - count, chance))
    return settled(lambda p: binomial_at_most(count, trials, p) <= chance, 0.0, 1.0, guide)[1]


@lru_cache(maxsize=4096)
def lower_bound(count: int, trials: int, chance: float) -> float:
    """Return the share at which ``count`` or more of ``trials`` succeed with ``chance``; 0 for no success."""
    if count <= 0:
        return 0.0
    guide = float(scipy.special.betaincinv(count, trials - count + 1.0, chance))
    return settled(lambda p: beta_share(count, trials - count + 1.0, p) > chance, 0.0, 1.0, guide)[0]


def sign_test(more: int, fewer: int) -> float:
    """Return the exact two-sided p-value of the hypothesis that either side is equally likely.

    It is 1 without any observation.  For episodes that only one of two systems violates, this is McNemar's
    test.

    Args:
        more: Observations in favour of the first.
        fewer: Observations in favour of the second.

    """
    return min(1.0, 2.0 * float(binomial_at_most(min(more, fewer), more + fewer, 0.5)))
