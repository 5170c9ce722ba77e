"""Quantiles and tail probabilities with the same bits on every processor, based on ``elementary``.

To compute a bound, ``settled`` searches among all floats with 44 significant bits, and uses the tail
probabilities of this module.  Therefore a bound does not depend on the installed libraries.  The relative
rounding error of a bound is at most 2^-43.  Rounding can only make a confidence interval wider.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from safety_harness.base.compiled import compiled
from safety_harness.base.elementary import exp, log, log1p

Floats = NDArray[np.float64]
_MOST_TERMS = 10**6  # of a series or fraction
_WINDOW = 64  # places about a guide
_SPARE = 9  # bits of a float beyond 44
# 1/(12 z) - 1/(360 z^3) + ..., Stirling's series
_STIRLING = (1 / 12, -1 / 360, 1 / 1260, -1 / 1680, 1 / 1188, -691 / 360360, 1 / 156)
# log(2 pi) / 2, to more digits than a float64 keeps.
_HALF_LOG_2PI = 0.91893853320467274178
# Wichura's coefficients of numerator and denominator, by falling powers
_NEAR = (
    (2509.0809287301226727, 33430.575583588128105, 67265.770927008700853, 45921.953931549871457)
    + (13731.693765509461125, 1971.5909503065514427, 133.14166789178437745, 3.387132872796366608),
    (5226.495278852545925, 28729.085735721942674, 39307.89580009271061, 21213.794301586595867)
    + (5394.1960214247511077, 687.1870074920579083, 42.313330701600911252, 1.0),
)
# For probabilities between about 1e-11 and 0.075, in r = sqrt(-log p); _FAR is for smaller ones.
_TAIL = (
    (7.7454501427834140764e-4, 0.0227238449892691845833, 0.24178072517745061177, 1.27045825245236838258)
    + (3.64784832476320460504, 5.7694972214606914055, 4.6303378461565452959, 1.42343711074968357734),
    (1.05075007164441684324e-9, 5.475938084995344946e-4, 0.0151986665636164571966, 0.14810397642748007459)
    + (0.68976733498510000455, 1.6763848301838038494, 2.05319162663775882187, 1.0),
)
_FAR = (
    (2.01033439929228813265e-7, 2.71155556874348757815e-5, 0.0012426609473880784386, 0.026532189526576123093)
    + (0.29656057182850489123, 1.7848265399172913358, 5.4637849111641143699, 6.6579046435011037772),
    (2.04426310338993978564e-15, 1.4215117583164458887e-7, 1.8463183175100546818e-5, 7.868691311456132591e-4)
    + (0.0148753612908506148525, 0.13692988092273580531, 0.59983220655588793769, 1.0),
)


def _ratio(x: Any, coefficients: tuple[tuple[float, ...], tuple[float, ...]]) -> Any:
    """Return the ratio of two polynomials at x."""
    above, below = coefficients[0][0], coefficients[1][0]
    for a, b in zip(coefficients[0][1:], coefficients[1][1:], strict=True):
        above, below = above * x + a, below * x + b
    return above / below


def normal_quantile(chance: Any) -> Any:
    """Return the standard normal quantile for probabilities between 0 and 1 (Wichura, 1988, AS 241)."""
    p = np.asarray(chance, np.float64)
    q = p - 0.5
    with np.errstate(all="ignore"):
        r = np.sqrt(-log(np.where(q > 0.0, 1.0 - p, p)))
        middle = q * _ratio(0.180625 - q * q, _NEAR)
        tail = np.copysign(np.where(r <= 5.0, _ratio(r - 1.6, _TAIL), _ratio(r - 5.0, _FAR)), q)
    return np.where(np.abs(q) <= 0.425, middle, tail)[()]


def lower_tail(z: Any) -> Any:
    """Return P(Z <= z) for a standard normal Z, with a relative error of about 1e-14."""
    z = np.asarray(z, np.float64)
    half = 0.5 * upper_gamma(0.5, 0.5 * z * z)
    return np.where(z < 0.0, half, 1.0 - half)[()]


def log_gamma(x: Any) -> Any:
    """Return the logarithm of the gamma function at a positive x."""
    x = np.asarray(x, np.float64)
    return ((x - 0.5) * log(x) - x + _HALF_LOG_2PI + _stirling(x))[()]


def log_beta(a: Any, b: Any) -> Any:
    """Return the logarithm of the beta function, computed without large terms that would cancel."""
    small, large = np.minimum(a, b), np.maximum(a, b)
    both = small + large
    balance = (0.5 - large) * log1p(small / large) - small * (log(both) - 1.0)
    return balance + _stirling(large) - _stirling(both) + log_gamma(small)


def _stirling(x: Any) -> Any:
    """Return the difference between the logarithm of the gamma function at x and Stirling's approximation.

    The approximation is (x - 1/2) log x - x + log(2 pi)/2.
    """
    below, shifted = np.ones_like(x), np.asarray(x, np.float64)
    # Stirling's series is used from 12 on, which 12 recurrences log G(x + 1) = log x + log G(x) reach.
    for _ in range(12):
        low = shifted < 12.0
        below, shifted = np.where(low, below * shifted, below), np.where(low, shifted + 1.0, shifted)
    rest, power = np.zeros_like(shifted), 1.0 / shifted
    for term in _STIRLING:
        rest, power = rest + term * power, power / (shifted * shifted)
    moved = (shifted - 0.5) * log(shifted) - shifted - log(below) - ((x - 0.5) * log(x) - x)
    return np.where(below == 1.0, rest, moved + rest)


@lru_cache
def _stirling_of(x: float) -> Any:
    """Return ``_stirling`` of a single number, with a cache of earlier results."""
    return _stirling(x)


def _deviance(x: Any, mean: Any) -> Any:
    """Return x log(x / mean) + mean - x, without a difference of nearly equal numbers (Loader, 2000)."""
    deviation, v = x - mean, (x - mean) / (x + mean)
    # Loader's series in v. For |v| < 0.1, eleven terms reach the precision of a float64.
    total, term = deviation * v, 2.0 * x * v
    for j in range(1, 12):
        term = term * v * v
        total = total + term / (2 * j + 1)
    return np.where(np.abs(v) < 0.1, total, x * log(x / mean) - deviation)


def upper_gamma(a: Any, x: Any) -> Any:
    """Return P(X > x), elementwise, for a gamma distribution with shape ``a``."""
    a, x = np.asarray(a, np.float64), np.asarray(x, np.float64)
    with np.errstate(all="ignore"):
        rest = _stirling(a) if a.ndim else _stirling_of(float(a))
        # x^a e^-x / G(a), without large terms that would cancel.
        factor = np.sqrt(a) * exp(-_deviance(a, x) - rest - _HALF_LOG_2PI)
        a, x = np.broadcast_arrays(a, x)
        parts = _gamma_parts(np.array(a).reshape(-1), np.array(x).reshape(-1)).reshape(x.shape)
        result = np.where(x < a + 1.0, 1.0 - factor * parts, factor / parts)
        return np.where(x <= 0.0, 1.0, result)[()]


@compiled
def _gamma_parts(a: Floats, x: Floats) -> Floats:
    """Return the series or continued fractions that ``upper_gamma`` needs for ``a`` (n,) and ``x`` (n,).

    The result has the shape (n,).  If x is less than a + 1, the entry is a series for the lower tail.
    Otherwise the entry is a continued fraction for the upper tail, computed by Lentz's method.
    """
    parts = np.empty_like(x)
    for i in range(len(x)):
        if x[i] < a[i] + 1.0:
            k = a[i]
            # The series 1/a + x/(a (a + 1)) + ...; it converges fast for x below a + 1.
            term = value = 1.0 / k
            for _ in range(_MOST_TERMS):
                k += 1.0
                term = term * x[i] / k
                value += term
                # Smaller terms no longer change the sum. The negated form also ends the loop for NaN.
                if not term > 1e-17 * value:
                    break
        else:
            # The continued fraction of the upper tail, from the first term on; it converges fast for x above
            # a + 1.
            d, value = 0.0, x[i] + 1.0 - a[i]
            c = value
            for m in range(1, _MOST_TERMS):
                above, below = -m * (m - a[i]), x[i] + 2.0 * m + 1.0 - a[i]
                d = 1.0 / (below + above * d)
                c = below + above / c
                value = value * c * d
                # The factor cannot come much nearer to 1 than its rounding, 2.2e-16.
                if not abs(c * d - 1.0) > 1e-15:
                    break
        parts[i] = value
    return parts


def beta_share(a: Any, b: Any, x: Any, *, above: bool = False) -> Any:
    """Return P(X <= x), elementwise, for a beta distribution.

    If ``above`` is true, return P(X > x) instead.
    """
    a, b, x = np.broadcast_arrays(*(np.asarray(v, np.float64) for v in (a, b, x)))
    with np.errstate(all="ignore"):
        # The fraction converges fast below this x. Above it, use I_x(a, b) = 1 - I_(1-x)(b, a).
        turned = x > (a + 1.0) / (a + b + 2.0)
        p, q, y = np.where(turned, b, a), np.where(turned, a, b), np.where(turned, 1.0 - x, x)
        both, rest = p + q, np.where(turned, x, 1.0 - x)
        deviance = _deviance(p, both * y) + _deviance(q, both * rest)
        deviance = deviance + _stirling(p) + _stirling(q) - _stirling(both) + _HALF_LOG_2PI
        factor = np.sqrt(q / (p * both)) * exp(-deviance)

        def term(m: int) -> tuple[Any, Any]:
            half = m // 2
            if m % 2:
                return -(p + half) * (p + q + half) * y / ((p + m - 1.0) * (p + m)), 1.0
            return half * (q - half) * y / ((p + m - 1.0) * (p + m)), 1.0

        share = factor / _lentz(term, np.ones_like(y))
        result = np.where(turned != above, 1.0 - share, share)
        result = np.where(x <= 0.0, 1.0 * above, np.where(x >= 1.0, 1.0 - above, result))
        return np.where(np.isnan(x), np.nan, result)[()]


def _lentz(term: Callable[[int], tuple[Any, Any]], first: Floats) -> Floats:
    """Return first + a_1/(b_1 + a_2/(b_2 + ...)), a continued fraction whose ``term(m)`` is (a_m, b_m)."""
    value, c, d, wanted = np.array(first), np.array(first), np.zeros_like(first), np.ones(first.shape, bool)
    for m in range(1, _MOST_TERMS):
        above, below = term(m)
        d = 1.0 / (below + above * d)
        c = below + above / c
        value = np.where(wanted, value * c * d, value)
        # A component that has converged stays as it is, so its bits do not depend on the other components.
        wanted = wanted & (np.abs(c * d - 1.0) > 1e-15)
        if not wanted.any():
            break
    return value


def binomial_at_most(count: Any, trials: Any, share: Any) -> Any:
    """Return P(X <= count), elementwise, for ``trials`` trials with the success probability ``share``."""
    count, trials = np.floor(np.asarray(count, np.float64)), np.asarray(trials, np.float64)
    inside = (count >= 0.0) & (count < trials)
    k = np.where(inside, count, 0.0)
    n = np.where(inside, trials, 1.0)
    return np.where(inside, beta_share(k + 1.0, n - k, share, above=True), 1.0 * (count >= trials))[()]


def settled(crossed: Callable[[Floats], Any], low: float, high: float, guide: float) -> tuple[float, float]:
    """Return the two neighbouring floats of 44 significant bits between which ``crossed`` becomes true.

    Args:
        crossed: A function that is false below some number between ``low`` and ``high`` and true above it,
            elementwise.
        low: A number of at least 0 for which ``crossed`` is false.
        high: A number for which ``crossed`` is true.
        guide: An approximate value of the crossing, from any library.  This value only speeds up the search.

    """
    first, last, start = (int(np.float64(end).view(np.int64)) >> _SPARE for end in (low, high, guide))
    # Try a small window about the guide first. If the crossing lies outside, the whole range remains.
    if first < start - _WINDOW and start + _WINDOW < last:
        lower, upper = crossed(_of_44_bits([start - _WINDOW, start + _WINDOW]))
        first, last = first if lower else start - _WINDOW, start + _WINDOW if upper else last
    while last - first > 1:
        # One call with 32 places narrows the range by 33, and costs little more than a call with one place.
        inside = np.unique(np.linspace(first, last, 34).astype(np.int64)[1:-1].clip(first + 1, last - 1))
        place = int(np.argmax(np.append(np.asarray(crossed(_of_44_bits(inside)), bool), np.True_)))
        ends = [first, *inside.tolist(), last]
        first, last = ends[place], ends[place + 1]
    lower, upper = _of_44_bits([first, last]).tolist()
    return float(lower), float(upper)


def _of_44_bits(places: Any) -> Floats:
    """Return the positive floats of 44 significant bits with the given indices.

    The indices refer to all such floats in rising order.
    """
    return (np.asarray(places, np.int64) << _SPARE).view(np.float64)
