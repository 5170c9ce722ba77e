"""Elementary functions with the same bits on every processor.

The sine of a C library and numpy's exponential have different code for different processors.  Therefore their
last bits differ between machines.  The functions in this module only add, subtract, multiply, divide, take
square roots, compare and scale by powers of two.  IEEE 754 fixes the result of each of these.  The functions
do not branch.  The result of a comparison is instead used as a factor, 0 or 1.

A compiled function that calls one of these functions contains the compiled code of the called function.
Python runs these functions as Python code, with a float or an array as the argument.  The polynomials come
from fdlibm (Sun Microsystems, 1993).  The error is at most 1 unit in the last place for sine and cosine, and
at most 2 units for the other functions (``tests/base/test_elementary.py``).  Arguments are finite.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from safety_harness.base.compiled import arithmetic

Number = Any  # a float, or an array of floats

ARITHMETIC = 1  # the version of these functions; earlier traces have 0: C library, matrix kernels

# To add and then subtract this number rounds to the nearest integer.
_ROUND = 1.5 * 2.0**52
# pi/2 in four parts.  The first three have 33 bits, so their products with integers below 2^20 are exact.
_TURNS = 2.0 / 3.14159265358979323846
_HALF_PI_1, _HALF_PI_2 = 1.57079632673412561417e00, 6.07710050630396597660e-11
_HALF_PI_3, _HALF_PI_4 = 2.02226624871116645580e-21, 8.47842766036889956997e-32
LARGEST_ANGLE_RAD = 2.0**20  # sine and cosine of this and more are NaN
_TO_INFINITY = 2.0**1004  # times this factor, a smaller angle stays finite
# pi/4 in two parts.  The first has 50 bits, so four times this part is exact.
_QUARTER_PI, _QUARTER_PI_REST = 7.85398163397448278999e-01, 3.06161699786838301793e-17
# atan(1/2) as the nearest float and the rounding error of that float.
_ATAN_HALF, _ATAN_HALF_REST = 4.63647609000806093515e-01, 2.26987774529616870924e-17
# _LN2 has 32 bits, so its product with the exponent of any float64 is exact; _LN2_REST is the rest.
_LOG2_E, _LN2, _LN2_REST = 1.44269504088896338700, 6.93147180369123816490e-01, 1.90821492927058770002e-10


@arithmetic
def sin_cos(angle_rad: Number) -> tuple[Number, Number]:
    """Return the sine and cosine of an angle below ``LARGEST_ANGLE_RAD``, or NaN for a larger angle."""
    x = angle_rad
    n = (x * _TURNS + _ROUND) - _ROUND
    # x - n pi/2 = r + rest, by differences whose rounding errors are kept
    first, second, third = x - n * _HALF_PI_1, n * _HALF_PI_2, n * _HALF_PI_3
    middle = first - second
    back = middle - first
    rest = (first - (middle - back)) - (second + back)
    r = middle - third
    back = r - middle
    rest += ((middle - (r - back)) - (third + back)) - n * _HALF_PI_4
    # fdlibm's polynomials on [-pi/4, pi/4]. The rest of the reduced angle enters to first order.
    z = r * r
    p = -2.50507602534068634195e-08 + z * 1.58969099521155010221e-10
    p = 8.33333333332248946124e-03 + z * (
        -1.98412698298579493134e-04 + z * (2.75573137070700676789e-06 + z * p)
    )
    s = r - ((z * (0.5 * rest - z * r * p) - rest) + z * r * 1.66666666666666324348e-01)
    q = 2.08757232129817482790e-09 - z * 1.13596475577881948265e-11
    q = 2.48015872894767294178e-05 + z * (-2.75573143513906633035e-07 + z * q)
    q = z * (4.16666666666666019037e-02 + z * (-1.38888888888741095749e-03 + z * q))
    half, w = 0.5 * z, 1.0 - 0.5 * z
    c = w + (((1.0 - w) - half) + (z * q - r * rest))
    # n counts quarter turns. An odd n swaps sine and cosine, and n mod 4 gives the sign.
    odd = abs(n - 2.0 * ((0.5 * n + _ROUND) - _ROUND))
    fourth = n - 4.0 * (((0.25 * n - 0.375) + _ROUND) - _ROUND)  # 0 to 3
    sign = 1.0 - 2.0 * (fourth > 1.5)
    infinite = x * _TO_INFINITY - x * _TO_INFINITY  # 0, or NaN of a large angle
    even = 1.0 - odd
    return sign * (even * s + odd * c) + infinite, sign * (even * c - odd * s) + infinite


@arithmetic
def sin(angle_rad: Number) -> Number:
    """Return the sine of an angle, which ``sin_cos`` computes."""
    return sin_cos(angle_rad)[0]


@arithmetic
def cos(angle_rad: Number) -> Number:
    """Return the cosine of an angle, which ``sin_cos`` computes."""
    return sin_cos(angle_rad)[1]


@arithmetic
def arctan2(y: Number, x: Number) -> Number:
    """Return the polar angle [rad] of the point (x, y), from -pi to pi.

    At the origin, the angle is 0.  A negative zero has the same effect as 0.
    """
    across, along = abs(y), abs(x)
    # Divide the smaller by the larger coordinate, so that the quotient is at most 1 and cannot overflow.
    steep = 1.0 * (across > along)
    most, least = steep * across + (1.0 - steep) * along, steep * along + (1.0 - steep) * across
    # atan(t) = atan(1/2) + atan((2 t - 1) / (2 + t)) for t about 1/2, pi/4 + atan((t - 1) / (1 + t)) above
    wide = 1.0 * (16.0 * least > 11.0 * most)
    middle = (16.0 * least > 7.0 * most) - wide
    twice, once = 1.0 + middle, middle + wide
    # The last term makes the denominator 1 at the origin, where the angle must be 0 and not NaN.
    u = (twice * least - once * most) / (twice * most + once * least + (most == 0.0))
    z = u * u
    w = z * z
    # fdlibm's polynomial of degree 11 in z, split into odd and even powers.
    odd = -7.69187620504482999495e-02 + w * (-5.83357013379057348645e-02 + w * -3.65315727442169155270e-02)
    odd = w * (-1.99999999998764832476e-01 + w * (-1.11111104054623557880e-01 + w * odd))
    even = 6.66107313738753120669e-02 + w * (4.97687799461593236017e-02 + w * 1.62858201153657823623e-02)
    even = 1.42857142725034663711e-01 + w * (9.09088713343650656196e-02 + w * even)
    even = z * (3.33333333333329318027e-01 + w * even)
    angle = middle * _ATAN_HALF + (middle * _ATAN_HALF_REST + (u - u * (odd + even)))
    # Reflect the angle into its octant. The multiples of pi/4 are added last, with their rest, so that they
    # cost no digits.
    behind = 1.0 * (x < 0.0)
    quarters = wide + steep * (2.0 - 2.0 * wide)
    quarters += behind * (4.0 - 2.0 * quarters)
    turned = (1.0 - 2.0 * steep) * (1.0 - 2.0 * behind) * angle
    return (1.0 - 2.0 * (y < 0.0)) * (quarters * _QUARTER_PI + (turned + quarters * _QUARTER_PI_REST))


@arithmetic
def arccos(cosine: Number) -> Number:
    """Return the angle [rad], 0 to pi, of a cosine between -1 and 1."""
    return arctan2(np.sqrt((1.0 - cosine) * (1.0 + cosine)), cosine)


@arithmetic
def hypot(x: Number, y: Number) -> Number:
    """Return the length of (x, y), whose components must not exceed 1e150.

    Components below 1e-150 count as 0.
    """
    return np.sqrt(x * x + y * y)


def _grown(x: Number) -> tuple[Number, Number]:
    """Return the integer n and the number g in exp(x) = 2^n (1 + g), with -0.3 < g < 0.42."""
    n = (x * _LOG2_E + _ROUND) - _ROUND
    # x = n ln 2 + r. High and low part stay separate, because their difference r is already rounded.
    high, low = x - n * _LN2, n * _LN2_REST
    r = high - low
    z = r * r
    p = 6.61375632143793436117e-05 + z * (-1.65339022054652515390e-06 + z * 4.13813679705723846039e-08)
    c = r - z * (1.66666666666666019037e-01 + z * (-2.77777777770155933842e-03 + z * p))
    return n, high - (low - r * c / (2.0 - c))


def exp(x: Number) -> Number:
    """Return e^x, which is 0 for x below -746 and infinity for x above 710."""
    with np.errstate(over="ignore", under="ignore", invalid="ignore"):
        # Beyond these limits the result is 0 or infinity anyway, and n stays a valid exponent.
        n, grown = _grown(np.clip(x, -800.0, 800.0))
        return np.ldexp(1.0 + grown, np.asarray(n).astype(np.int64))[()]


def expm1(x: Number) -> Number:
    """Return e^x - 1, also accurate for x near 0; for x above 700, return e^700 - 1."""
    # Below -60 the result is -1 to the last bit; at 700, 2^n is still finite.
    n, grown = _grown(np.clip(x, -60.0, 700.0))
    power = np.ldexp(1.0, np.asarray(n).astype(np.int64))
    return power * grown + (power - 1.0)


def log(x: Number) -> Number:
    """Return the natural logarithm of x.

    The result is -infinity if x is 0, and NaN if x is negative.
    """
    m, n = np.frexp(x)
    # Move m into [sqrt(1/2), sqrt(2)), where the polynomial below applies.
    small = m < 0.70710678118654752440
    m, n = np.where(small, 2.0 * m, m), n - small
    with np.errstate(divide="ignore", invalid="ignore"):
        f = m - 1.0
        s = f / (2.0 + f)
        z = s * s
        w = z * z
        odd = w * (3.999999999940941908e-01 + w * (2.222219843214978396e-01 + w * 1.531383769920937332e-01))
        even = 2.857142874366239149e-01 + w * (1.818357216161805012e-01 + w * 1.479819860511658591e-01)
        rest, half = odd + z * (6.666666666666735130e-01 + w * even), 0.5 * f * f
        value = n * _LN2 - ((half - (s * (half + rest) + n * _LN2_REST)) - f)
        return np.where(np.asarray(x) > 0.0, value, np.where(np.asarray(x) == 0.0, -np.inf, np.nan))[()]


def log1p(x: Number) -> Number:
    """Return the natural logarithm of 1 + x, also accurate for x near 0."""
    near_one = 1.0 + np.asarray(x, np.float64)
    with np.errstate(divide="ignore", invalid="ignore"):
        # 1 + x is rounded. The second term adds the logarithm of the part that was lost (first order).
        return np.where(near_one == 0.0, -np.inf, log(near_one) + (x - (near_one - 1.0)) / near_one)[()]


def power(base: Number, exponent: Number) -> Number:
    """Return ``base`` to the power ``exponent``, where ``base`` must be positive.

    The relative error grows with the logarithm of the result.
    """
    return exp(exponent * log(base))


def cbrt(x: Number) -> Number:
    """Return the cube root of x, which must be at least 0."""
    with np.errstate(divide="ignore", invalid="ignore"):
        # A Newton step removes most of the error that log and exp leave.
        root = exp(log(x) / 3.0)
        return np.where(np.asarray(x) > 0.0, root - (root - x / (root * root)) / 3.0, x)[()]


def log_sum_exp(logarithms: Any, axis: int = -1, keepdims: bool = False) -> Any:
    """Return log(sum(exp(``logarithms``))), where the sum runs along an axis."""
    values = np.asarray(logarithms, np.float64)
    most = values.max(axis=axis, keepdims=True)
    # If all terms are 0 or one is infinite, subtracting the maximum would give NaN.
    most = np.where(np.isfinite(most), most, 0.0)
    total = log(exp(values - most).sum(axis=axis, keepdims=True)) + most
    return total if keepdims else np.squeeze(total, axis=axis)[()]


def product(first: Any, second: Any) -> Any:
    """Return ``first @ second`` for small arrays.

    The order of additions is the same on every processor.
    """
    first, second = np.asarray(first), np.asarray(second)
    if second.ndim == 1:
        return (first * second).sum(axis=-1)
    if first.ndim == 1:
        return (first[:, None] * second).sum(axis=-2)
    # BLAS is not used here, because its order of addition depends on the processor.
    return (first[..., None] * second[..., None, :, :]).sum(axis=-2)


def length(vector: Any) -> float:
    """Return the Euclidean length of an array of any shape."""
    vector = np.asarray(vector)
    return float(np.sqrt((vector * vector).sum()))
