"""Compiled bounds over all questions of a box, which decide a claim from the affine form of the answer.

After the network (``form_kernel``) come some 500 operations on unit vectors and on numbers below
``FARTHEST_M``.  A box with larger numbers stays undecided.  The rounding of the operations is at most
500 x 100 m x 100 m x u = 6e-10, with u = 2^-53.  So a bound proves a claim only if it keeps the limit with a
margin of at least ``MARGIN`` = 2e-9 (m, or m2).
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
FARTHEST_M = 100.0
MARGIN = 2e-9
NEAREST_M = 1e-6  # the least length of a vector with a direction
AT_MOST, AT_LEAST, OPTIMUM, AWAY, UNSURE, CERTAIN = range(6)
OF_AXES, OF_CURVES = 0.4, 3.0  # weights in the choice of the axis to halve; found by trial


@njit_no_nrt
def _lengths(c: Floats, g: Floats, slack: Floats, out: Floats) -> None:
    """Fill ``out`` (2,) with bounds of |c + d|, where d = sum e_k g_k + slack.

    The lower bound is the part of c + d along c.  The upper bound comes from the square, which is
    |c|^2 + 2 c . d + |d|^2, with |d| bounded axis by axis.

    ``c`` (3,), ``g`` (k, 3), ``slack`` (3,).
    """
    norm, dot, wide = sqrt(c[0] * c[0] + c[1] * c[1] + c[2] * c[2]), 0.0, 0.0
    for k in range(g.shape[0]):
        dot += abs(g[k, 0] * c[0] + g[k, 1] * c[1] + g[k, 2] * c[2])
    for o in range(3):
        dot += slack[o] * abs(c[o])
        reach = slack[o]
        for k in range(g.shape[0]):
            reach += abs(g[k, o])
        wide += reach * reach
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
    """Fill ``bounds_out`` (2,) with bounds of |p - o(h, t)|; return False if the optimum has no direction.

    The optimum o of ``claims`` uses t_opt = t + R u.  Within the cone, u is the direction of d = desired - t.
    Elsewhere u = cos a + sin b, where b is the direction of d without its part along the axis a.

    The direction f of a vector v has the derivative (1 - f f^T) / |v|.  Its second derivative is at most
    2 / (sqrt(3) |v|^2).  So u deviates from its tangent at the centre by at most
    2 / sqrt(3) (-ln(1 - s) - s).  This is 2 s^2 / sqrt(3) times the integral of (1 - x) / (1 - s x)^2 over x
    from 0 to 1.  Here s = rho / |v|, and rho is half the diagonal of the TCP's box.  If the box may lie on
    both sides of the cone, the claim has to hold for both formulas of u.

    ``optimum`` (10,), ``centre`` (6,), ``half`` (6,), ``p`` (3,), ``g`` (n, 3), ``slack`` (3,), ``scratch``
    (4, 3), ``weight`` (6,).
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
        scale = radius * (sin if rim else 1.0)
        rest = scale * 2.0 / sqrt(3.0) * (-log1p(-rho / norm) - rho / norm) * UP
        spread = max(spread, rest)
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
    """Fill ``bounds_out`` (2,) with bounds of (p - t) . (t - h) [m2], and increase ``weight`` (6,) [m].

    Each entry of ``weight`` grows by the effect of its axis on the bounds.

    Both factors are forms with the same six symbols: q = c + sum g_i e_i + ..., w = w0 + sum h_i e_i.  Their
    product contains squares e_i^2, which lie in [0, 1].  Any other product of symbols lies in [-1, 1].

    ``centre`` (6,), ``half`` (6,), ``p`` (3,), ``g`` (n, 3), ``slack`` (3,).
    """
    middle, radius, norm = 0.0, 0.0, 0.0
    for o in range(3):
        gap = centre[3 + o] - centre[o]
        norm += gap * gap
        middle += (p[o] - centre[3 + o]) * gap
        radius += slack[o] * (abs(gap) + half[o] + half[3 + o])
        g[3 + o, o] -= half[3 + o]
    norm = max(sqrt(norm), NEAREST_M)
    for k in range(count):
        linear = 0.0
        for o in range(3):
            linear += g[k, o] * (centre[3 + o] - centre[o])
            if k >= PERCEPTRON_INPUTS:
                radius += abs(g[k, o]) * (half[o] + half[3 + o])
        if k < PERCEPTRON_INPUTS:
            o = k % 3
            sign = -1.0 if k < 3 else 1.0
            linear += sign * half[k] * (p[o] - centre[3 + o])
            weight[k] += abs(linear) / norm
            square = sign * half[k] * g[k, o]
            middle += square / 2.0
            radius += abs(square) / 2.0
            for m in range(k):
                b = m % 3
                second = -1.0 if m < 3 else 1.0
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
    """Fill ``codes`` (n,) with PROVEN, REFUTED (the whole box), OUTSIDE, or the axis along which to halve.

    ``low``, ``high`` (n, 6) are boxes of hands and TCPs in the base frame [m].  A box is OUTSIDE if every
    hand in it is nearer than ``near_m`` to the TCP, or farther than ``far_m``.  ``optimum`` (10,) comes from
    ``optimum_constants``. For the kind UNSURE, a spread above ``doubt_m`` also keeps the claim.
    ``spreads_m`` (n, 2) receives bounds of the spread, NaN if unknown.
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
        if kind == UNSURE:
            proven = proven or spread[0] >= doubt_m + MARGIN
            refuted = refuted and spread[1] <= doubt_m - MARGIN
        if decided and proven:
            codes[n] = PROVEN
        elif decided and refuted and whole:
            codes[n] = REFUTED
        else:
            axis = 0
            for i in range(6):
                if not whole:  # a smaller box may lie wholly inside or outside
                    weight[i] += half[i] * (1.0 if decided and refuted else 0.4)
                if weight[i] > weight[axis]:
                    axis = i
            codes[n] = axis
