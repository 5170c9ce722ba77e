"""Compute metrics of predictions and of their uncertainties, with only numpy.

Arrays are (n, 3), with a row for each decision and a column for each axis, in any common unit of length.
Every function except those for half widths raises ValueError if a number is not finite.
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
    """The root mean square error and the mean absolute error, for each axis and over all axes."""

    rmse: Floats
    mae: Floats
    overall_rmse: float
    overall_mae: float


def errors(predictions: Floats, targets: Floats) -> Errors:
    """Return the RMSE sqrt(mean e^2) and the MAE mean |e|.

    Here e is ``predictions`` - ``targets``, shape (n, 3).
    """
    difference = _finite(predictions - targets)
    squares, sizes = difference**2, np.abs(difference)
    return Errors(
        rmse=np.sqrt(squares.mean(axis=0)),
        mae=sizes.mean(axis=0),
        overall_rmse=math.sqrt(squares.mean()),
        overall_mae=float(sizes.mean()),
    )


def half_width_of_spread(spreads: Floats) -> Floats:
    """Return 1.96 times ``spreads``, the standard deviations over the passes, shape (n, 3).

    Intervals with these half widths can reproduce the coverage that the paper reports.
    """
    return NORMAL_95 * spreads


def half_width_with(spreads: Floats, added_variance: Floats | float) -> Floats:
    """Return the half widths 1.96 sqrt(s^2 + v), shape (n, 3).

    Here s is ``spreads``, and v is ``added_variance``, which is a number or has the shape (3,) or (n, 3).
    """
    return NORMAL_95 * np.sqrt(spreads**2 + added_variance)


@dataclass(frozen=True, eq=False)
class IntervalCoverage:
    """The fraction of targets within their intervals.

    ``picp`` has the fraction for each axis, shape (3,) (PICP, eq. 14).  ``joint`` is the fraction of targets
    that lie within their intervals on all axes at once.

    ``mean_width`` is the mean distance from the lower to the upper end of an interval, shape (3,).
    """

    picp: Floats
    joint: float
    mean_width: Floats


def coverage(predictions: Floats, targets: Floats, half_widths: Floats) -> IntervalCoverage:
    """Return the coverage (PICP, eq. 14) and the mean width of the intervals prediction +- half width.

    The intervals include their ends.

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
    """Return a dictionary with the coverage for each interpretation of the paper's PICP.

    ``predictions`` y, ``targets`` and ``spreads`` s are (n, 3), and ``residual_std`` r is (3,).  The
    interpretations differ in the half width of an interval.  The half width is 1.96 times s, or 1.96 times
    one of these terms:

    * sqrt(s^2 + 1/tau), where tau is the model precision (Gal and Ghahramani 2016); at the paper's tau of
      1e-6 per mm^2, 1/tau is a variance of one square metre;
    * sqrt(s^2 + y^2), eq. 11 in its printed form: it does not subtract the squared mean from the mean of the
      squares;
    * sqrt(s^2 + r^2), where r^2 is the variance of the validation residuals, that is, of the noise in the
      labels.

    Args:
        predictions: The predictions.
        targets: The labels.
        spreads: The standard deviations over the passes.
        precision: Tau, in the unit of the predictions.
        residual_std: The standard deviation of the validation residuals.  If it is None, the result omits the
            last interpretation.

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
    """Return the fraction of targets within the central normal interval of each level, shape (k, 3).

    ``predictions``, ``targets`` and ``spreads`` s are (n, 3), and ``levels`` p in (0, 1) are (k,).  The
    interval of level p is prediction +- Phi^-1((1 + p)/2) s.  If the predictions are normally distributed and
    calibrated, the fractions equal the levels.

    Args:
        predictions: The predictions.
        targets: The labels.
        spreads: The standard deviations.
        levels: The levels.

    """
    distances, stds = _finite(np.abs(predictions - targets)), _finite(spreads)
    quantiles = [NormalDist().inv_cdf((1.0 + level) / 2.0) for level in levels]
    return np.array([(distances <= quantile * stds).mean(axis=0) for quantile in quantiles])


def auroc(scores_without: Floats, scores_with: Floats) -> float:
    """Return the area under the ROC curve of a score that should be higher in the second group.

    The area is P(with > without) + P(with = without)/2 (Mann and Whitney, 1947).  The function computes it
    exactly over all pairs of a score in ``scores_with`` and a score in ``scores_without``.

    Args:
        scores_without: (n,) the scores of the first group, for example of seen inputs.
        scores_with: (m,) the scores of the second group, for example of unseen inputs.

    Raises:
        ValueError: A group is empty, or a score is not finite.

    """
    without, having = np.sort(_finite(scores_without)), _finite(scores_with)
    if not len(without) or not len(having):
        raise ValueError("the AUROC takes at least one score of each kind")
    below = np.searchsorted(without, having, side="left").sum()
    not_above = np.searchsorted(without, having, side="right").sum()
    return float(below + not_above) / (2.0 * len(without) * len(having))


def conformal_quantile(scores: Floats, level: float) -> float:
    """Return the conformal quantile of n scores (Vovk, Gammerman and Shafer, 2005).

    The quantile is the k-th smallest score, with k = ceil((n + 1) level).

    Let a new score be exchangeable with the n ``scores`` (n,).  The new score is at most the quantile with a
    probability of at least ``level``.

    Raises:
        ValueError: There are fewer than level / (1 - level) scores, or ``level`` is not between 0 and 1.

    """
    if not 0.0 < level < 1.0:
        raise ValueError(f"a level lies between 0 and 1: {level}")
    rank = math.ceil((len(scores) + 1) * Fraction(str(level)))  # exact: 0.95 of 100 is 95
    if rank > len(scores):
        raise ValueError(f"{len(scores)} scores are too few for the level {level}")
    return float(np.sort(_finite(scores))[rank - 1])


def conformal_multiplier(predictions: Floats, targets: Floats, scales: Floats, level: float = 0.95) -> float:
    """Return the split-conformal multiplier m of the interval prediction +- m scale.

    The intervals contain a new target on all three axes at once with a probability of at least ``level``.

    The score of a row is the maximum of |prediction - target|/scale over the axes, and m is the
    ``conformal_quantile`` of the scores.

    Args:
        predictions: (n, 3) predictions for held-out inputs.
        targets: (n, 3) the labels of these inputs.
        scales: (n, 3) positive scales, or (3,) the same scales for every row.
        level: The fraction of targets that the intervals contain.

    Raises:
        ValueError: A scale is not positive, or there are too few rows.

    """
    if not np.all(_finite(scales) > 0.0):
        raise ValueError("a scale must be positive")
    return conformal_quantile((np.abs(predictions - targets) / scales).max(axis=1), level)


def largest_spread(spreads: Floats) -> Floats:
    """Return the largest of the three spreads of each decision, shape (n,).

    ``spreads`` has the shape (n, 3).
    """
    largest: Floats = _finite(spreads).max(axis=1)
    return largest


def spread_threshold(spreads: Floats, level: float = 0.99) -> float:
    """Return a threshold for the largest spread of a new decision.

    The spread exceeds the threshold with a probability of at most 1 - ``level``.

    The threshold is the ``conformal_quantile`` of the largest spread in each row of ``spreads``, which has
    the shape (n, 3).
    """
    return conformal_quantile(largest_spread(spreads), level)


def _finite(array: Floats) -> Floats:
    """Return ``array``, and raise ValueError if it contains a number that is not finite."""
    if not np.all(np.isfinite(array)):
        raise ValueError("expected finite numbers")
    return array
