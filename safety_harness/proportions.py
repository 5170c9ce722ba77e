"""A share of independent trials, with its exact interval."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
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
        low = 0.0 if count == 0 else 1.0 - _share(trials - count, trials, tail)
        high = 1.0 if count == trials else _share(count, trials, tail)
        return cls(count, trials, low, high)

    @property
    def share(self) -> float:
        """Between 0 and 1."""
        return self.count / self.trials


def _share(most: int, trials: int, chance: float) -> float:
    """The share p under which at most ``most`` < ``trials`` successes have this chance, by bisection."""
    at_most = _cumulative(most, trials)
    low, high = 0.0, 1.0  # the chance falls from 1 to 0 in between
    while low < (middle := (low + high) / 2.0) < high:
        low, high = (middle, high) if at_most(middle) > chance else (low, middle)
    return middle


def _cumulative(most: int, trials: int) -> Callable[[float], float]:
    """P(at most ``most`` of ``trials``) as a function of the share; terms by their logarithms."""
    k = np.arange(most + 1)
    choices = np.append(0.0, np.cumsum(np.log((trials - k[1:] + 1) / k[1:])))  # log (n choose k)

    def chance(share: float) -> float:
        return float(np.exp(choices + k * np.log(share) + (trials - k) * np.log1p(-share)).sum())

    return chance
