"""What tells good predictions, and honest uncertainties, from bad ones: numpy only.

Arrays are (n, 3), one row a decision, one column an axis; any one unit of length throughout.  Every
function raises ValueError for numbers that are not finite: none of them may be silently left out.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from fractions import Fraction
from statistics import NormalDist

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

RESIDUALS = "spread and residuals"  # the variant of the PICP that only a calibrated model has
NORMAL_95 = 1.96  # the paper's intervals: mean +- 1.96 standard deviations


@dataclass(frozen=True, eq=False)
class Errors:
    """Root mean square and mean absolute error by axis (3,), and over all axes' errors together."""

    rmse: Floats
    mae: Floats
    overall_rmse: float
    overall_mae: float


def errors(predictions: Floats, targets: Floats) -> Errors:
    """RMSE sqrt(mean e^2) and MAE mean |e| of e = ``predictions`` - ``targets`` (n, 3)."""
    difference = _finite(predictions - targets)
    squares, sizes = difference**2, np.abs(difference)
    return Errors(
        rmse=np.sqrt(squares.mean(axis=0)),
        mae=sizes.mean(axis=0),
        overall_rmse=math.sqrt(squares.mean()),
        overall_mae=float(sizes.mean()),
    )


def half_width_of_spread(spreads: Floats) -> Floats:
    """1.96 s with s = ``spreads`` (n, 3), standard deviations of the passes.

    It is what the paper's figures can be reached with.
    """
    return NORMAL_95 * spreads


def half_width_with(spreads: Floats, added_variance: Floats | float) -> Floats:
    """1.96 sqrt(s^2 + v): s is ``spreads`` (n, 3), v ``added_variance`` (n, 3), (3,) or a number."""
    return NORMAL_95 * np.sqrt(spreads**2 + added_variance)


@dataclass(frozen=True, eq=False)
class IntervalCoverage:
    """Share of targets within their intervals by axis (3,) (PICP, eq. 14), and on all three at once.

    ``mean_width`` (3,) is that of the whole interval, upper minus lower end.
    """

    picp: Floats
    joint: float
    mean_width: Floats


def coverage(predictions: Floats, targets: Floats, half_widths: Floats) -> IntervalCoverage:
    """PICP (eq. 14) and width of the intervals prediction +- half width, ends included.

    ``predictions``, ``targets`` and ``half_widths`` are (n, 3).
    """
    inside = _finite(np.abs(predictions - targets)) <= _finite(half_widths)
    return IntervalCoverage(
        picp=inside.mean(axis=0),
        joint=float(inside.all(axis=1).mean()),
        mean_width=2.0 * half_widths.mean(axis=0),
    )


def picp_variants(
    predictions: Floats, targets: Floats, spreads: Floats, *, precision: float, residual_std: Floats | None
) -> dict[str, IntervalCoverage]:
    """The readings of the paper's PICP side by side, by name.

    ``predictions`` and ``targets`` are (n, 3), ``spreads`` (n, 3) standard deviations over the passes;
    ``precision`` is tau and ``residual_std`` (3,) that of validation residuals, in the unit of the
    predictions.  Half the width of an interval is 1.96 times s, or with

    * the inverse model precision added to the variance, sqrt(s^2 + 1/tau) (Gal and Ghahramani 2016); at the
      paper's tau of 1e-6 per mm^2, 1/tau is a variance of one square metre;
    * eq. 11 as it is printed, the mean of the squares, the squared mean not taken off, sqrt(s^2 + y^2);
    * the variance of validation residuals, the labels' own noise, sqrt(s^2 + r^2); without them left out.
    """
    half_widths = {
        "spread": half_width_of_spread(spreads),
        "spread and 1/tau": half_width_with(spreads, 1.0 / precision),
        "eq. 11 as printed": half_width_with(spreads, predictions**2),
    }
    if residual_std is not None:
        half_widths[RESIDUALS] = half_width_with(spreads, residual_std**2)
    return {name: coverage(predictions, targets, width) for name, width in half_widths.items()}


def calibration_curve(predictions: Floats, targets: Floats, spreads: Floats, levels: Floats) -> Floats:
    """(k, 3): the share of targets within the central normal interval of each level, by axis.

    The interval of level p is prediction +- Phi^-1((1 + p)/2) s; ``predictions``, ``targets`` and ``spreads``
    (n, 3), ``levels`` (k,) in (0, 1).  For calibrated normal predictions the shares equal the levels.
    """
    distances, stds = _finite(np.abs(predictions - targets)), _finite(spreads)
    quantiles = [NormalDist().inv_cdf((1.0 + level) / 2.0) for level in levels]
    return np.array([(distances <= quantile * stds).mean(axis=0) for quantile in quantiles])


def auroc(scores_without: Floats, scores_with: Floats) -> float:
    """Area under the ROC curve of a score that should be higher *with* (unseen, say) than *without*.

    P(with > without) + P(with = without)/2 over all pairs (Mann and Whitney, 1947): exact.
    ``scores_without`` (n,) and ``scores_with`` (m,).
    """
    without, having = np.sort(_finite(scores_without)), _finite(scores_with)
    if not len(without) or not len(having):
        raise ValueError("the AUROC takes at least one score of each kind")
    below = np.searchsorted(without, having, side="left").sum()
    not_above = np.searchsorted(without, having, side="right").sum()
    return float(below + not_above) / (2.0 * len(without) * len(having))


def conformal_quantile(scores: Floats, level: float) -> float:
    """The ceil((n + 1) level)-th smallest of ``scores`` (n,) (Vovk, Gammerman and Shafer, 2005).

    A further score, exchangeable with these, is at most as large with probability ``level`` at
    least.  ValueError if there are too few scores to say so: level / (1 - level) are needed.
    """
    if not 0.0 < level < 1.0:
        raise ValueError(f"a level lies between 0 and 1: {level}")
    rank = math.ceil((len(scores) + 1) * Fraction(str(level)))  # exact: 0.95 of 100 is 95
    if rank > len(scores):
        raise ValueError(f"{len(scores)} scores are too few for the level {level}")
    return float(np.sort(_finite(scores))[rank - 1])


def conformal_multiplier(predictions: Floats, targets: Floats, scales: Floats, level: float = 0.95) -> float:
    """Split-conformal: m so that prediction +- m scale covers *all three* axes at ``level``.

    ``predictions`` and ``targets`` (n, 3) are held out; ``scales`` (n, 3), or (3,) for every row, are
    positive.  The score of a row is max_axis |prediction - target|/scale, m their ``conformal_quantile``.
    """
    if not np.all(_finite(scales) > 0.0):
        raise ValueError("a scale must be positive")
    return conformal_quantile((np.abs(predictions - targets) / scales).max(axis=1), level)


def largest_spread(spreads: Floats) -> Floats:
    """(n,): what a decision's spread is judged by, that of its worst axis, of ``spreads`` (n, 3)."""
    largest: Floats = _finite(spreads).max(axis=1)
    return largest


def spread_threshold(spreads: Floats, level: float = 0.99) -> float:
    """The threshold that the spread of a further decision like these exceeds with 1 - ``level`` at most.

    The ``conformal_quantile`` of the largest of each row of ``spreads`` (n, 3).
    """
    return conformal_quantile(largest_spread(spreads), level)


def _finite(array: Floats) -> Floats:
    """``array`` (...), if all of it is finite; ValueError otherwise."""
    if not np.all(np.isfinite(array)):
        raise ValueError("expected finite numbers")
    return array
