"""Did an interval contain the truth as often as it says?  An exact binomial limit, and no fixed tolerance."""

from __future__ import annotations

import scipy.stats


def misses_are_no_more_than(missed: int, trials: int, chance: float) -> bool:
    """Unless the intervals miss more often than ``chance``, this is true in 999 of 1,000 tests at least."""
    return bool(scipy.stats.binomtest(missed, trials, chance, "greater").pvalue > 1e-3)


def misses_are(missed: int, trials: int, chance: float) -> bool:
    """The same for intervals that miss neither more nor less often: for exact ones."""
    return bool(scipy.stats.binomtest(missed, trials, chance).pvalue > 1e-3)
