"""Compute bounds over all inputs in a box, which decide a claim about the network's answers.

The module ``form_kernel`` computes the network's answer as an affine form.  This module then applies some 500
operations to unit vectors and to numbers below ``FARTHEST_M``.  A box with larger numbers remains undecided.
The total rounding error of these operations is at most 500 x 100 m x 100 m x u = 6e-10, with u = 2^-53.  A
bound therefore proves a claim only if it satisfies the claim's limit with a margin of at least ``MARGIN`` =
2e-9 (m, or m2).
"""

from __future__ import annotations

from math import log1p, sqrt

import numpy as np
from numpy.typing import NDArray

from safety_harness.base.compiled import compiled, njit_no_nrt
from safety_harness.cell.avoidance.model_file import OUTPUTS, PERCEPTRON_INPUTS
from safety_harness.extensions.lab.proof.form_kernel import UP, mean_answer, spreads
from safety_harness.extensions.lab.proof.network import ReluNetwork

Floats = NDArray[np.float64]
Codes = NDArray[np.uint8]

PROVEN, REFUTED, UNDECIDED, OUTSIDE = 6, 7, 8, 9  # codes of leaves; a lower code is the axis of a halved box
FARTHEST_M = 100.0  # the rounding bound above assumes numbers below this
MARGIN = 2e-9  # three times the rounding bound above
NEAREST_M = 1e-6  # the least length of a vector with a direction
AT_MOST, AT_LEAST, OPTIMUM, AWAY, UNSURE, CERTAIN = range(6)
OF_AXES, OF_CURVES = 0.4, 3.0  # weights in the choice of the axis to halve; found by trial


@njit_no_nrt
def _lengths(c: Floats, g: Floats, slack: Floats, out: Floats) -> None:
    """Write a lower and an upper bound of |c + d| to ``out``, where d = sum e_k g_k + slack.

    The lower bound is the least possible component of c + d in the direction of c. The upper bound is the
    root of a bound of the square |c|^2 + 2 c . d + |d|^2, in which the function bounds |d| axis by axis.

    Shapes: ``c`` (3,), ``g`` (k, 3), ``slack`` (3,), ``out`` (2,).
    """
    norm, dot, wide = sqrt(c[0] * c[0] + c[1] * c[1] + c[2] * c[2]), 0.0, 0.0
    # Each symbol lies in [-1, 1], so |c . d| is at most the sum of the magnitudes |g_k . c|.
    for k in range(g.shape[0]):
        dot += abs(g[k, 0] * c[0] + g[k, 1] * c[1] + g[k, 2] * c[2])
    for o in range(3):
        dot += slack[o] * abs(c[o])
        reach = slack[o]
        for k in range(g.shape[0]):
            reach += abs(g[k, o])
        wide += reach * reach
    # A c shorter than NEAREST_M has no reliable direction, and 0 is always a valid lower bound.
    out[0] = max(0.0, norm - dot / norm * UP) if norm > NEAREST_M else 0.0
    out[1] = sqrt(norm * norm + (2.0 * dot + wide) * UP) * UP


@njit_no_nrt
def _off_optimum(
    optimum: Floats,
    centre: Floats,
    half: Floats,
    p: Floats,
    g: Floats,
    count: int,
    slack: Floats,
    scratch: Floats,
    bounds_out: Floats,
    weight: Floats,
) -> bool:
    """Write a lower and an upper bound of |p - o(h, t)| to ``bounds_out``.

    Return False if the direction of the optimum may be undefined somewhere in the box.

    The module ``claims`` defines the optimum o by t_opt = t + R u.  Within the cone, u is the direction of d
    = desired - t.  Outside the cone, u = cos a + sin b, where a is the cone's axis and b is the direction of
    the component of d perpendicular to a.

    The direction f of a vector v has the derivative (1 - f f^T) / |v|.  Its second derivative is at most 2 /
    (sqrt(3) |v|^2).  Thus u deviates from its linear approximation at the centre by at most 2 / sqrt(3)
    (-ln(1 - s) - s).  This term equals 2 s^2 / sqrt(3) times the integral of (1 - x) / (1 - s x)^2 over x
    from 0 to 1.  Here s = rho / |v|, and rho is half the diagonal of the TCP's box.  If the box may contain
    points inside and outside the cone, the bounds cover both formulas of u.

    Shapes: ``optimum`` (10,), ``centre`` (6,), ``half`` (6,), ``p`` (3,), ``g`` (n, 3), ``slack`` (3,),
    ``scratch`` (4, 3), ``bounds_out`` (2,), ``weight`` (6,).
    """
    axis, radius, cos, sin, pull = optimum[3:6], optimum[6], optimum[7], optimum[8], optimum[9]
    wanted, vector, c, bounds = scratch[0], scratch[1], scratch[2], scratch[3]
    rho, along, length = 0.0, 0.0, 0.0
    for o in range(3):
        wanted[o] = optimum[o] - centre[3 + o]
        rho += half[3 + o] * half[3 + o]
        along += wanted[o] * axis[o]
        length += wanted[o] * wanted[o]
    rho, length = sqrt(rho) * UP, sqrt(length)
    cone_side = along - cos * length  # changes by at most 1 + cos for each metre of the TCP
    bounds_out[0], bounds_out[1] = np.inf, 0.0
    spread = 0.0
    for rim in range(2):
        # Skip a formula of u that applies nowhere in the box, because the box lies wholly on one side of the
        # cone.
        if (cone_side if rim == 0 else -cone_side) + (1.0 + abs(cos)) * rho < -MARGIN:
            continue
        norm = 0.0
        for o in range(3):
            vector[o] = wanted[o] - along * axis[o] if rim else wanted[o]
            norm += vector[o] * vector[o]
        norm = sqrt(norm)
        if norm - rho <= NEAREST_M:
            for i in range(3):  # only a smaller box of TCPs helps
                weight[3 + i] += 10.0 * half[3 + i]
            return False
        # The form below replaces u by its linear approximation; ``rest`` bounds the remainder, with s = rho /
        # |v|.
        scale = radius * (sin if rim else 1.0)
        rest = scale * 2.0 / sqrt(3.0) * (-log1p(-rho / norm) - rho / norm) * UP
        spread = max(spread, rest)
        # The coefficients of p - o: first subtract those of t + pull (t - h), then those of R u.
        for o in range(3):
            to = centre[3 + o] + scale * vector[o] / norm + (radius * cos * axis[o] if rim else 0.0)
            c[o] = p[o] - to - pull * (centre[3 + o] - centre[o])
        saved = g[count : count + PERCEPTRON_INPUTS]  # rows after the symbols keep a copy for the second side
        for i in range(PERCEPTRON_INPUTS):
            for o in range(3):
                saved[i, o] = g[i, o]
        for o in range(3):
            g[o, o] += pull * half[o]
            g[3 + o, o] -= (1.0 + pull) * half[3 + o]
        for i in range(3):
            for o in range(3):
                # d changes by -half e; on the rim, the part of d along the axis has no effect
                change = 1.0 if i == o else 0.0
                if rim:
                    change -= axis[i] * axis[o]
                change -= vector[i] * vector[o] / (norm * norm)
                g[3 + i, o] += scale * change / norm * half[3 + i]
        _lengths(c, g[:count], slack, bounds)
        for i in range(PERCEPTRON_INPUTS):
            for o in range(3):
                weight[i] += OF_AXES * abs(g[i, o])
                g[i, o] = saved[i, o]
        bounds_out[0] = min(bounds_out[0], bounds[0] - rest)  # ``rest``: the radius of a ball about the form
        bounds_out[1] = max(bounds_out[1], (bounds[1] + rest) * UP)
    for i in range(3):
        # The remainder grows with rho^2, so each axis of the TCP receives its part of rho^2.
        weight[3 + i] += OF_CURVES * spread * half[3 + i] * half[3 + i] / max(rho * rho, 1e-30)
    return True


@njit_no_nrt
def _away(
    centre: Floats,
    half: Floats,
    p: Floats,
    g: Floats,
    count: int,
    slack: Floats,
    bounds_out: Floats,
    weight: Floats,
) -> None:
    """Write a lower and an upper bound of the product (p - t) . (t - h) [m2] to ``bounds_out``.

    The function also adds the effect of each axis on the bounds to the entry of ``weight`` for this axis [m].

    Both factors are affine forms with the same six symbols: q = c + sum g_i e_i + ... and w = w0 + sum h_i
    e_i.  Their product contains squares e_i^2, which lie in [0, 1].  Products of two different symbols lie in
    [-1, 1].

    Shapes: ``centre`` (6,), ``half`` (6,), ``p`` (3,), ``g`` (n, 3), ``slack`` (3,), ``bounds_out`` (2,),
    ``weight`` (6,).
    """
    middle, radius, norm = 0.0, 0.0, 0.0
    for o in range(3):
        gap = centre[3 + o] - centre[o]
        norm += gap * gap
        middle += (p[o] - centre[3 + o]) * gap
        # The slack of q multiplies w, and |w| is at most this on axis o.
        radius += slack[o] * (abs(gap) + half[o] + half[3 + o])
        # q = p - t: subtract the coefficients of t, and restore them at the end.
        g[3 + o, o] -= half[3 + o]
    norm = max(sqrt(norm), NEAREST_M)
    for k in range(count):
        linear = 0.0
        for o in range(3):
            linear += g[k, o] * (centre[3 + o] - centre[o])
            # A ReLU's symbol does not occur in w, so its product with the variable part of w only has a
            # bound.
            if k >= PERCEPTRON_INPUTS:
                radius += abs(g[k, o]) * (half[o] + half[3 + o])
        if k < PERCEPTRON_INPUTS:
            o = k % 3
            sign = -1.0 if k < 3 else 1.0
            linear += sign * half[k] * (p[o] - centre[3 + o])
            weight[k] += abs(linear) / norm
            # e_k^2 lies in [0, 1], so its term adds half of its coefficient to the middle and half to the
            # radius.
            square = sign * half[k] * g[k, o]
            middle += square / 2.0
            radius += abs(square) / 2.0
            for m in range(k):
                b = m % 3
                second = -1.0 if m < 3 else 1.0
                # e_k e_m occurs twice.  The two coefficients may cancel, so add them before taking the
                # magnitude.
                both = abs(sign * half[k] * g[m, o] + second * half[m] * g[k, b])
                radius += both
                weight[k] += both / norm
                weight[m] += both / norm
        radius += abs(linear)
    for o in range(3):
        g[3 + o, o] += half[3 + o]
    bounds_out[0], bounds_out[1] = middle - radius * UP, middle + radius * UP


@compiled
def examine(
    network: ReluNetwork,
    optimum: Floats,
    kind: int,
    limit_m: float,
    doubt_m: float,
    near_m: float,
    far_m: float,
    low: Floats,
    high: Floats,
    codes: Codes,
    spreads_m: Floats,
) -> None:
    """Write a code for each box to ``codes``: PROVEN, REFUTED, OUTSIDE, or the axis along which to halve it.

    ``low`` and ``high`` are the corners of n boxes of hands and TCPs in the base frame, shape (n, 6) [m].  A
    box is REFUTED only if every input in it violates the claim.  A box is OUTSIDE if no pair of hand and TCP
    in it has a distance from ``near_m`` to ``far_m``.  ``optimum`` is the result of ``optimum_constants``,
    shape (10,).  A claim of the kind UNSURE is also satisfied by a spread above ``doubt_m``.  The function
    writes bounds of the spread to ``spreads_m``, shape (n, 2); they are NaN if they are unknown.
    """
    members, columns = network.weight.shape[0], PERCEPTRON_INPUTS + network.bias.shape[1]
    most = columns - OUTPUTS  # symbols of a member: the axes, and one for each ReLU
    symbols = PERCEPTRON_INPUTS + members * (most - PERCEPTRON_INPUTS)
    units, own = np.empty((4, columns)), np.empty((most, columns))
    of_symbol, share = np.empty(most, np.int64), np.empty((PERCEPTRON_INPUTS, columns))
    each_p = np.empty((members, 3))
    each_g, each_r = np.empty((members, PERCEPTRON_INPUTS, 3)), np.empty((members, 3))
    centre, half, weight, own_weight = np.empty(6), np.empty(6), np.empty(6), np.empty(6)
    g = np.empty((symbols + PERCEPTRON_INPUTS, 3))
    p, slack, scratch, bounds, spread = np.empty(3), np.empty(3), np.empty((4, 3)), np.empty(2), np.empty(2)
    for n in range(low.shape[0]):
        nearest, farthest = 0.0, 0.0
        for i in range(6):
            centre[i] = (low[n, i] + high[n, i]) / 2.0
            # The centre is rounded, so the larger of the two distances encloses the box.
            half[i] = max(high[n, i] - centre[i], centre[i] - low[n, i]) * UP
        for o in range(3):
            gap = abs(centre[3 + o] - centre[o])
            wide = half[o] + half[3 + o]
            nearest += max(0.0, gap - wide) ** 2
            farthest += (gap + wide) ** 2
        nearest, farthest = sqrt(nearest), sqrt(farthest)
        if farthest < near_m - MARGIN or nearest > far_m + MARGIN:
            codes[n], spreads_m[n, :] = OUTSIDE, np.nan
            continue
        whole = nearest >= near_m + MARGIN and farthest <= far_m - MARGIN
        count = mean_answer(
            *(network, centre, half, units, own, of_symbol, share, own_weight),
            *(each_p, each_g, each_r, p, g, slack, weight),
        )
        spreads(each_p, each_g, each_r, p, g, spread)
        decided = True
        for o in range(3):
            # NaN fails this comparison too, so a box with an overflow in the network remains undecided.
            reach = abs(p[o]) + slack[o]
            for k in range(count):
                reach += abs(g[k, o])
            decided = decided and reach < FARTHEST_M
        spreads_m[n, 0] = spread[0] if decided else np.nan
        spreads_m[n, 1] = spread[1] if decided else np.nan
        if kind in (OPTIMUM, UNSURE):
            decided = (
                _off_optimum(optimum, centre, half, p, g, count, slack, scratch, bounds, weight) and decided
            )
        elif kind == AWAY:
            _away(centre, half, p, g, count, slack, bounds, weight)
        elif kind == CERTAIN:
            bounds[:] = spread
        else:
            for o in range(3):
                scratch[0, o] = p[o] - centre[3 + o]
                g[3 + o, o] -= half[3 + o]
            _lengths(scratch[0], g[:count], slack, bounds)
            for i in range(6):
                weight[i] += abs(g[i, 0]) + abs(g[i, 1]) + abs(g[i, 2])
        at_least = kind in (AT_LEAST, AWAY)
        proven = bounds[0] >= limit_m + MARGIN if at_least else bounds[1] <= limit_m - MARGIN
        refuted = bounds[1] <= limit_m - MARGIN if at_least else bounds[0] >= limit_m + MARGIN
        # A spread above the threshold satisfies this claim, so a refutation also needs a spread below it.
        if kind == UNSURE:
            proven = proven or spread[0] >= doubt_m + MARGIN
            refuted = refuted and spread[1] <= doubt_m - MARGIN
        if decided and proven:
            codes[n] = PROVEN
        # If the box contains pairs outside the region, the wrong answers could be there.
        elif decided and refuted and whole:
            codes[n] = REFUTED
        else:
            # Halve the axis with the largest weight.  The weights are estimates: they affect the time, but no
            # verdict.
            axis = 0
            for i in range(6):
                if not whole:  # a smaller box may lie wholly inside or outside
                    weight[i] += half[i] * (1.0 if decided and refuted else 0.4)
                if weight[i] > weight[axis]:
                    axis = i
            codes[n] = axis
