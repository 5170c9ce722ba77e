"""What a handful of trainings or trials says of the true value, and how surely.

A *training* is the unit of most figures: five seeds give five numbers, whose mean has a t interval.  Shares
of independent trials have exact intervals (``proportions``).  Nothing here takes a number that is
not finite.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import bdtr, stdtrit

from safety_harness.base.proportions import LEVEL, Proportion, sign_test

BOOTSTRAP_DRAWS = 4000
_TAIL = (1.0 - LEVEL) / 2.0


@dataclass(frozen=True, kw_only=True)
class Estimate:
    """A value with its 95 % interval, and where one more observation of the same kind would lie.

    ``next_low`` to ``next_high`` is the 95 % prediction interval for one more training (or whatever ``of``
    counts): the paper's own figure is one.  NaN where that makes no sense, infinite ends from a single
    observation.
    """

    value: float
    low: float
    high: float
    next_low: float = math.nan
    next_high: float = math.nan
    of: str = ""


def mean_of(values: ArrayLike, of: str = "trainings") -> Estimate:
    """The mean of independent numbers, with Student's intervals; one alone has infinite ones.

    ValueError for none at all, or one that is not finite.
    """
    numbers = _finite(values)
    n, mean = len(numbers), float(numbers.mean())
    if n == 1:
        ends = (-math.inf, math.inf)
        return Estimate(
            value=mean, low=ends[0], high=ends[1], next_low=ends[0], next_high=ends[1], of=f"1 of the {of}"
        )
    spread = float(stdtrit(n - 1, 1.0 - _TAIL)) * float(numbers.std(ddof=1))
    half, half_next = spread / math.sqrt(n), spread * math.sqrt(1.0 + 1.0 / n)
    return Estimate(
        value=mean,
        low=mean - half,
        high=mean + half,
        next_low=mean - half_next,
        next_high=mean + half_next,
        of=f"{n} {of}",
    )


def share_of(having: ArrayLike, of: str = "trials") -> Estimate:
    """A share of independent trials with its exact (Clopper-Pearson) interval."""
    found = Proportion.from_rows(np.asarray(having, dtype=np.bool_))
    return Estimate(value=found.share, low=found.low, high=found.high, of=f"{found.trials} {of}")


def bootstrap_of(
    rows: ArrayLike, statistic: str, *, seed: int, of: str = "trials", draws: int = BOOTSTRAP_DRAWS
) -> Estimate:
    """The mean of (n,), or the ratio of the means of (n, 2), with a percentile interval over redrawn rows.

    One row alone says nothing of the others: infinite ends.
    """
    numbers = _finite(rows)
    if statistic not in ("mean", "ratio of means") or numbers.ndim != (1 if statistic == "mean" else 2):
        raise ValueError(f"no statistic {statistic!r} of an array with {numbers.ndim} dimensions")
    rng = np.random.Generator(np.random.PCG64(seed))
    rows_again = rng.integers(0, len(numbers), (draws, len(numbers)))
    redrawn = numbers[rows_again].mean(axis=1)  # (draws,) or (draws, 2)
    whole = numbers.mean(axis=0)
    with np.errstate(divide="ignore", invalid="ignore"):
        values = redrawn if statistic == "mean" else redrawn[:, 0] / redrawn[:, 1]
        value = float(whole if statistic == "mean" else whole[0] / whole[1])
    if len(numbers) == 1:
        return Estimate(value=value, low=-math.inf, high=math.inf, of=f"1 of the {of}")
    ends = [_TAIL, 1.0 - _TAIL]
    low, high = np.quantile(values, ends, method="inverted_cdf")  # a ratio may be infinite: nothing between
    return Estimate(value=value, low=float(low), high=float(high), of=f"{len(numbers)} {of}")


def median_of(values: ArrayLike, of: str = "calls") -> Estimate:
    """The median with an interval between two order statistics, exact for independent numbers.

    The ends are infinite where there are too few numbers for 95 %.
    """
    numbers = np.sort(_finite(values))
    n = len(numbers)
    rank = median_rank(n, _TAIL)
    low, high = (float(numbers[rank - 1]), float(numbers[n - rank])) if rank else (-math.inf, math.inf)
    return Estimate(value=float(np.median(numbers)), low=low, high=high, of=f"{n} {of}")


@dataclass(frozen=True)
class Paired:
    """Two yes-or-no outcomes of the same trials: McNemar's table.

    ``first_only`` trials had it with the first alone, ``second_only`` with the second alone.
    """

    first_only: int
    second_only: int
    trials: int

    @classmethod
    def of(cls, first: ArrayLike, second: ArrayLike) -> Paired:
        """From two boolean arrays (n,); ValueError if they differ in length or are empty."""
        a, b = np.asarray(first, dtype=np.bool_), np.asarray(second, dtype=np.bool_)
        if a.shape != b.shape or a.ndim != 1 or not len(a):
            raise ValueError(f"expected two outcomes of each of the same trials; got {a.shape} and {b.shape}")
        return cls(int(np.count_nonzero(a & ~b)), int(np.count_nonzero(~a & b)), len(a))

    @property
    def p_value(self) -> float:
        """Of the exact two-sided test that either alone is equally likely; 1 without a discordant trial."""
        return sign_test(self.first_only, self.second_only)


def _finite(values: ArrayLike) -> NDArray[np.float64]:
    array = np.asarray(values, dtype=np.float64)
    if not array.size or not np.all(np.isfinite(array)):
        raise ValueError("expected at least one number, and only finite ones")
    return array


def differences(first: ArrayLike, second: ArrayLike) -> NDArray[np.float64]:
    """(n,) first - second, pair by pair; ValueError where the pairs do not fit."""
    a, b = _finite(first), _finite(second)
    if a.shape != b.shape:
        raise ValueError(f"expected as many of the one as of the other; got {a.shape} and {b.shape}")
    return a - b


def median_rank(n: int, chance: float) -> int:
    """The greatest r for which the r-th smallest of n is above the median with at most ``chance``; 0 if none.

    That is P(Bin(n, 1/2) < r) <= chance, whatever the distribution.
    """
    return int(np.count_nonzero(bdtr(np.arange(0, n // 2), n, 0.5) <= chance))
