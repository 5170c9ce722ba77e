"""Exact statements about independent trials: shares with their bounds, signs, ranks of a median.

And a share in words.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy  # whose special functions take half a second to load, and are loaded when they are used
from numpy.typing import NDArray

LEVEL = 0.95


@dataclass(frozen=True)
class Proportion:
    """``count`` of ``trials``, and the interval that contains the true share with 95 % at least."""

    count: int
    trials: int
    low: float
    high: float

    @classmethod
    def of(cls, having: NDArray[np.bool_]) -> Proportion:
        """How many of the rows (n,) have it: Clopper and Pearson (1934), two-sided.

        The ends are the shares under which as many successes or more, or as few or fewer, have a chance
        of 2.5 %.  ValueError without any trial.
        """
        trials, count = len(having), int(np.count_nonzero(having))
        if not trials:
            raise ValueError("a share takes at least one trial")
        tail = (1.0 - LEVEL) / 2.0
        return cls(count, trials, lower_bound(count, trials, tail), upper_bound(count, trials, tail))

    @property
    def share(self) -> float:
        """Between 0 and 1."""
        return self.count / self.trials


def share_words(count: int, total: int) -> str:
    """Per cent with one decimal; never 0 % of something nor 100 % of less than all."""
    if total == 0:
        return "\u2013"
    if count in (0, total):
        return "0 %" if count == 0 else "100 %"
    per_mille = round(1000.0 * count / total)
    if per_mille == 0:
        return "under 0.1 %"
    return "over 99.9 %" if per_mille == 1000 else f"{per_mille / 10:.1f} %"


def upper_bound(count: int, trials: int, chance: float) -> float:
    """The share under which at most ``count`` of ``trials`` successes have this chance; 1 if all are.

    Clopper and Pearson's upper end: whatever the true share is, it is above with this chance at most.
    """
    return 1.0 if count >= trials else float(scipy.special.betainccinv(count + 1.0, trials - count, chance))


def lower_bound(count: int, trials: int, chance: float) -> float:
    """The share under which at least ``count`` of ``trials`` successes have this chance; 0 if none are."""
    return 0.0 if count <= 0 else float(scipy.special.betaincinv(count, trials - count + 1.0, chance))


def sign_test(more: int, fewer: int) -> float:
    """The p-value of "either is equally likely", exact and two-sided; 1 without any.

    Of episodes that only one of two systems violates it is McNemar's.
    """
    return min(1.0, 2.0 * float(scipy.special.bdtr(min(more, fewer), more + fewer, 0.5)))
