"""Fit distributions to samples for scenario spaces, test each fit, and compute intervals of the parameters.

The parameters of a normal distribution are maximum-likelihood estimates between known bounds. A uniform
distribution extends beyond the sample, at both ends, by the mean gap between values. The Anderson-Darling
distance measures the misfit of both families. A parametric bootstrap estimates the distribution of this
distance under the hypothesis that the family is right (Stute, Gonzalez Manteiga and Presedo Quindimil, 1993).
The bootstrap draws samples of the same size from the fit, and fits the family to each of them again. A table
of critical values for known parameters would hardly ever reject a family, since our parameters are estimates.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr, ndtri

Floats = NDArray[np.float64]
BOOTSTRAPS = 999  # samples of the parametric bootstrap, each fitted anew
REJECTED_BELOW = 0.05  # the p-value below which a family is rejected
CONFIDENCE = 0.95  # of the parameters' intervals, from the bootstrap's quantiles
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(240)  # for the moments of a cut normal distribution
_STEPS, _CLOSE = 60, 1e-10  # of Newton's method: the most steps, and the largest error of a moment
# Bounds beyond so many std cut nothing off; least mass of a fit between the bounds; floor of probabilities
_FAR_STDS, _LEAST_MASS, _LEAST_TAIL = 9.0, 1e-3, 1e-12


@dataclass(frozen=True)
class Family:
    """A family of distributions between two known bounds.

    ``parameters`` contains the names of the two parameters of the family. Each function processes b samples
    at once. ``fitted`` maps samples (b, n) to parameters (b, 2), which are NaN for a sample without a fit.
    ``below`` is the cumulative distribution function. It maps values (b, n) and parameters (b, 2) to
    probabilities (b, n). ``values`` is the inverse of ``below``.
    """

    name: str
    parameters: tuple[str, str]
    fitted: Callable[[Floats, float, float], Floats]
    below: Callable[[Floats, Floats, float, float], Floats]
    values: Callable[[Floats, Floats, float, float], Floats]


def _normal(samples: Floats, low: float, high: float) -> Floats:
    """Return the mean and std of truncated normal distributions that have the same moments as the samples.

    The distributions are truncated at the bounds. Let y run from -1 to 1 between the bounds. The density is
    proportional to exp(a y + b y^2). Newton's method finds a and b, since the log-likelihood is concave in
    both. A solution with b >= 0 is not a normal distribution.
    """
    middle, half = (low + high) / 2.0, (high - low) / 2.0
    y = (samples - middle) / half
    mean, std = y.mean(axis=1), y.std(axis=1)
    wanted = np.column_stack([mean, (y**2).mean(axis=1)])
    solution = np.column_stack([mean / std**2, -0.5 / std**2])
    # If the bounds cut nothing off, the moments of the sample are the solution already.
    cut = (mean - _FAR_STDS * std < -1.0) | (mean + _FAR_STDS * std > 1.0)
    powers = _NODES ** np.arange(1, 5)[:, None]  # (4, nodes)
    going = cut.copy()
    for _ in range(_STEPS):
        at = solution[going]
        if not len(at):
            break
        log = at @ powers[:2]
        # The constant factor of the density cancels; without the maximum, the exponential could overflow.
        density = np.exp(log - log.max(axis=1, keepdims=True)) * _WEIGHTS
        moments = (density @ powers.T) / density.sum(axis=1, keepdims=True)
        m1, m2, m3, m4 = moments.T
        hessian = np.array([[m2 - m1**2, m3 - m1 * m2], [m3 - m1 * m2, m4 - m2**2]]).transpose(2, 0, 1)
        misfit = wanted[going] - moments[:, :2]
        # The small term keeps the matrix regular if all the mass is at one point.
        step = np.linalg.solve(hessian + 1e-14 * np.eye(2), misfit[:, :, None])[:, :, 0]
        size = np.abs(step).max(axis=1, keepdims=True)
        # A limited step, because far from the solution Newton's full step may diverge.
        most = 0.5 * (1.0 + np.abs(at).max(axis=1, keepdims=True))
        solution[going] = at + step * np.minimum(1.0, most / np.maximum(size, 1e-300))
        going[np.flatnonzero(going)[(np.abs(misfit) < _CLOSE).all(axis=1)]] = False
    with np.errstate(invalid="ignore", divide="ignore"):
        spread = np.sqrt(-0.5 / solution[:, 1])
        result = np.column_stack([middle + half * solution[:, 0] * spread**2, half * spread])
        ends = ndtr((np.array([[low, high]]) - result[:, :1]) / result[:, 1:])
        none = going | ~(solution[:, 1] < 0.0) | ~(ends[:, 1] - ends[:, 0] > _LEAST_MASS)
    result[none] = np.nan
    return result


def _ends(parameters: Floats, low: float, high: float) -> tuple[Floats, Floats]:
    mean, std = parameters[:, :1], parameters[:, 1:]
    return np.asarray(ndtr((low - mean) / std)), np.asarray(ndtr((high - mean) / std))


def _normal_below(values: Floats, parameters: Floats, low: float, high: float) -> Floats:
    first, last = _ends(parameters, low, high)
    share = (ndtr((values - parameters[:, :1]) / parameters[:, 1:]) - first) / (last - first)
    return np.asarray(np.clip(share, 0.0, 1.0))


def _normal_values(share: Floats, parameters: Floats, low: float, high: float) -> Floats:
    first, last = _ends(parameters, low, high)
    z = ndtri(first + share * (last - first))
    return np.asarray(np.clip(parameters[:, :1] + parameters[:, 1:] * z, low, high))


def _even(samples: Floats, low: float, high: float) -> Floats:
    """Return the bounds of a uniform distribution for each sample.

    The lower bound is the least value minus the mean gap between values, and at least ``low``. The upper
    bound is the largest value plus this gap, and at most ``high``.
    """
    least, most = samples.min(axis=1), samples.max(axis=1)
    gap = (most - least) / (samples.shape[1] - 1)
    return np.column_stack([np.maximum(least - gap, low), np.minimum(most + gap, high)])


def _even_below(values: Floats, parameters: Floats, low: float, high: float) -> Floats:
    first, last = parameters[:, :1], parameters[:, 1:]
    return np.asarray(np.clip((values - first) / (last - first), 0.0, 1.0))


def _even_values(share: Floats, parameters: Floats, low: float, high: float) -> Floats:
    first, last = parameters[:, :1], parameters[:, 1:]
    return np.asarray(first + share * (last - first))


NORMAL = Family("normal", ("mean", "std"), _normal, _normal_below, _normal_values)
UNIFORM = Family("uniform", ("low", "high"), _even, _even_below, _even_values)
FAMILIES = (NORMAL, UNIFORM)


@dataclass(frozen=True, kw_only=True)
class Fit:
    """The fit of one family to one sample, the result of the test of this fit, and CONFIDENCE intervals."""

    family: str
    parameters: dict[str, float]
    intervals: dict[str, tuple[float, float]]
    distance: float
    p_value: float

    @property
    def rejected(self) -> bool:
        """Return whether the test rejects the family."""
        return self.p_value < REJECTED_BELOW


def fit(values: Floats, *, low: float, high: float, rng: np.random.Generator) -> tuple[Fit, ...]:
    """Return the fits of all families to ``values``, in order of quality, beginning with the best fit.

    The result is empty if all values are equal.

    Args:
        values: The sample (n,).
        low: The lower bound of the quantity.
        high: The upper bound of the quantity.
        rng: The random numbers of the bootstrap.

    """
    if float(np.ptp(values)) == 0.0:
        return ()
    fits = [_fit(family, values[None, :], low, high, rng) for family in FAMILIES]
    return tuple(sorted((f for f in fits if f is not None), key=lambda f: -f.p_value))


def _fit(family: Family, own: Floats, low: float, high: float, rng: np.random.Generator) -> Fit | None:
    """Return the fit of ``family`` to the sample ``own`` (1, n), or None if the family cannot be fitted."""
    parameters = family.fitted(own, low, high)
    if not np.isfinite(parameters).all():
        return None
    drawn = family.values(rng.random((BOOTSTRAPS, own.shape[1])), parameters, low, high)
    again = family.fitted(drawn, low, high)
    there = np.isfinite(again).all(axis=1)
    if np.count_nonzero(there) < BOOTSTRAPS // 2:
        return None
    distance = float(_distances(family, own, parameters, low, high)[0])
    by_chance = _distances(family, drawn[there], again[there], low, high)
    tails = np.array([(1.0 - CONFIDENCE) / 2.0, (1.0 + CONFIDENCE) / 2.0])
    intervals = np.quantile(again[there], tails, axis=0).T.tolist()
    return Fit(
        family=family.name,
        parameters=dict(zip(family.parameters, parameters[0].tolist(), strict=True)),
        intervals={key: (a, b) for key, (a, b) in zip(family.parameters, intervals, strict=True)},
        distance=distance,
        # The sample itself counts as one of the samples, so the p-value is never zero.
        p_value=float((1 + np.count_nonzero(by_chance >= distance)) / (1 + len(by_chance))),
    )


def _distances(family: Family, samples: Floats, parameters: Floats, low: float, high: float) -> Floats:
    """Return the Anderson-Darling distance A^2 (b,) between each sample in ``samples`` (b, n) and its fit."""
    below, n = family.below(np.sort(samples, axis=1), parameters, low, high), samples.shape[1]
    below = np.clip(below, _LEAST_TAIL, 1.0 - _LEAST_TAIL)
    weights = 2.0 * np.arange(1, n + 1) - 1.0
    logs = np.log(below) + np.log1p(-below[:, ::-1])
    return np.asarray(-n - (weights * logs).sum(axis=1) / n)
