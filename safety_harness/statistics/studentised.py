"""What the two bootstraps of this package have in common: quantiles of redrawn t's."""

from __future__ import annotations

import numpy as np

from safety_harness.statistics.sample import Floats


def ends_of_t(redrawn: Floats, chance: float) -> tuple[float, float]:
    """The ``chance`` and 1 - ``chance`` quantiles of t, ``redrawn`` (n,), each outwards.

    One that is infinite or NaN, as of a redrawn sample without spread, is beyond either end.
    """
    beyond = ~np.isfinite(redrawn)
    least = np.quantile(np.where(beyond, -np.inf, redrawn), chance, method="lower")
    most = np.quantile(np.where(beyond, np.inf, redrawn), 1.0 - chance, method="higher")
    return float(least), float(most)
