"""Compiled affine forms through a ReLU network: its members' answers in a box, with their mean and spread.

The value of a unit is c + sum_k g_k e_k + r e', with every e in [-1, 1].  The first six e are the position in
the box (hand, then TCP).  Each further e, a symbol, stands for the addition of a ReLU, and r is the slack.
An affine map keeps the form.  If l <= z <= u with l < 0 < u, relu(z) - s z lies in [0, 2 m] for any s in
[0, 1].  Here 2 m = max(-s l, (1 - s) u).  This band is narrowest for s = u / (u - l) (Singh et al. 2018,
DeepZ).

Each layer multiplies the slack by |W|, so that it would grow beyond all bounds in a deep network.  There the
ReLUs of every layer, or of the last of every ``network.gathers`` layers, turn the slack into symbols too.

**Rounding.**  The bounds hold for the values that the *program* computes.  ``network.error`` bounds the
program's rounding; in float64 (``cell.avoidance.perceptron_kernel``) it is as small as the rounding here.  A
sum of n products has an error of at most gamma (|b| + sum |w| |x|).  Here gamma = n u / (1 - n u) and
u = 2^-53.  This holds in any order, with or without fused operations (Higham 2002, 3.1).  It also holds for
the centre computed here, and for symbols and slacks, whose magnitudes are part of |x| <= size.
``network.rounding`` is four times the sum of these errors, and the kernel adds it to the slack.  ``UP`` is
above the rounding of every sum of up to 30,000 magnitudes.
"""

from __future__ import annotations

from math import sqrt

import numpy as np
from numpy.typing import NDArray

from safety_harness.base.compiled import njit_no_nrt
from safety_harness.cell.avoidance.model_file import OUTPUTS, PERCEPTRON_INPUTS
from safety_harness.extensions.lab.proof.network import ReluNetwork

Floats = NDArray[np.float64]

UP = 1.0 + 4e-12
MOST = 1e8  # the largest unit: beyond it, a box stays undecided
OF_RELUS = 2.5  # weight of the ReLUs' additions in the choice of the axis to halve; found by trial
Z, SLACK, SIZE, SLOPE = range(4)  # rows of ``units``


@njit_no_nrt
def _rectify(
    network: ReluNetwork,
    units: Floats,
    g: Floats,
    count: int,
    of_symbol: NDArray[np.int64],
    share: Floats,
    first: int,
    last: int,
    gathers: bool,
) -> int:
    """Apply ReLU to the units from ``first`` to before ``last``, in place; return the new count of symbols.

    In a deep network, a unit with a symbol of its own adds its slack to the symbol.  If ``gathers`` is set,
    every unit receives such a symbol.

    ``units`` (4, n), ``g`` (k, n), ``share`` (6, n), ``of_symbol`` (k,).  ``share`` receives the part of a
    unit's width that each axis causes.
    """
    rounding, old_count = network.rounding, count
    width, sizes = last - first, units[SIZE, first:last]
    sizes[:] = 0.0
    for k in range(old_count):
        row = g[k, first:last]
        for q in range(width):
            sizes[q] += abs(row[q])
    for j in range(first, last):
        z, r = units[Z, j], (units[SIZE, j] + units[SLACK, j]) * UP
        low, high = z - r, z + r
        slope, half = 1.0, 0.0
        units[SIZE, j] = abs(z) + r
        if low < 0.0 and high == high:  # NaN stays NaN, so that the box stays undecided
            slope = high / (high - low) if high > 0.0 else 0.0
            half = max(-slope * low, (1.0 - slope) * high) / 2.0 if high > 0.0 else 0.0
            z = slope * z + half
            size = abs(z) + slope * r + half
            units[Z, j], units[SIZE, j] = z, size
            units[SLACK, j] = (slope * units[SLACK, j] + rounding * size) * UP if high > 0.0 else 0.0
        units[SLOPE, j] = slope
        for i in range(PERCEPTRON_INPUTS):  # only a hint for halving, never part of a bound
            share[i, j] = (
                abs(g[i, j]) / r * (1.0 if first == PERCEPTRON_INPUTS else slope) if half > 0.0 else 0.0
            )
        if gathers or (network.gathers > 0 and half > 0.0):
            half, units[SLACK, j] = half + units[SLACK, j], 0.0
        if half > 0.0:
            g[count, :last] = 0.0
            g[count, j] = half * UP
            of_symbol[count] = j
            count += 1
    slopes = units[SLOPE, first:last]
    for k in range(old_count):
        row = g[k, first:last]
        for q in range(width):
            row[q] *= slopes[q]
    return count


@njit_no_nrt
def _answer(
    network: ReluNetwork,
    member: int,
    centre: Floats,
    half: Floats,
    units: Floats,
    g: Floats,
    of_symbol: NDArray[np.int64],
    share: Floats,
    weight: Floats,
) -> int:
    """Fill ``units`` (4, n) and ``g`` (k, n) for one member in a box; return the count of symbols.

    The columns are the six coordinates of the question, then all ReLUs, then the answer.  ``centre`` and
    ``half`` (6,) define the box.  ``weight`` (6,) receives the part of the ReLUs' additions to the answer
    that each axis causes [m].  Scratch: ``of_symbol`` (k,), ``share`` (6, n).
    """
    widths, blocks, rounding = network.widths, network.blocks, network.rounding
    weights, errors = network.weight[member], network.error[member]
    bias, bias_error = network.bias[member], network.bias_error[member]
    inexact = errors.shape[0] > 0
    count, first, at = PERCEPTRON_INPUTS, PERCEPTRON_INPUTS, 0
    for i in range(PERCEPTRON_INPUTS):
        units[Z, i], units[SLACK, i], units[SIZE, i] = centre[i], 0.0, abs(centre[i]) + half[i]
        for k in range(PERCEPTRON_INPUTS):
            g[k, i] = half[i] if k == i else 0.0
    for layer in range(widths.shape[0]):
        width = widths[layer]
        last = first + width
        z, slack = units[Z, first:last], units[SLACK, first:last]
        for q in range(width):
            z[q] = bias[first + q - PERCEPTRON_INPUTS]
            slack[q] = bias_error[first + q - PERCEPTRON_INPUTS] + rounding * abs(z[q])
        g[:count, first:last] = 0.0
        while at < blocks.shape[0] and blocks[at, 0] == layer:
            source, start = blocks[at, 1], blocks[at, 2]
            column, inputs = 0, PERCEPTRON_INPUTS
            if source > 0:
                column, inputs = PERCEPTRON_INPUTS, widths[source - 1]
                for earlier in range(source - 1):
                    column += widths[earlier]
            w = weights[start : start + inputs * width].reshape((inputs, width))
            for j in range(inputs):
                x, size = units[Z, column + j], units[SIZE, column + j]
                if size == 0.0:
                    continue
                spread = (units[SLACK, column + j] + rounding * size) * UP
                for q in range(width):
                    z[q] += x * w[j, q]
                    slack[q] += spread * abs(w[j, q])
                if inexact:
                    e = errors[start + j * width : start + (j + 1) * width]
                    for q in range(width):
                        slack[q] += size * e[q]
            for k in range(count):
                low, high = 0, inputs
                if k >= PERCEPTRON_INPUTS and of_symbol[k] >= column:  # of this layer, or of a later one
                    low, high = of_symbol[k] - column, min(inputs, of_symbol[k] - column + 1)
                parts, to = g[k, column : column + inputs], g[k, first:last]
                if width == OUTPUTS:
                    for j in range(low, high):
                        for o in range(OUTPUTS):
                            to[o] += parts[j] * w[j, o]
                    continue
                for j in range(low, high):
                    part = parts[j]
                    if part != 0.0:
                        for q in range(width):
                            to[q] += part * w[j, q]
            at += 1
        for q in range(width):
            slack[q] *= UP
        if layer + 1 < widths.shape[0]:
            gathers = network.gathers > 0 and layer % network.gathers == network.gathers - 1
            count = _rectify(network, units, g, count, of_symbol, share, first, last, gathers)
            for j in range(first, last):
                if not units[SIZE, j] < MOST:
                    units[Z, j] = np.nan
        first = last
    weight[:] = 0.0
    answer = first - OUTPUTS
    for m in range(PERCEPTRON_INPUTS, count):
        length = abs(g[m, answer]) + abs(g[m, answer + 1]) + abs(g[m, answer + 2])
        for i in range(PERCEPTRON_INPUTS):
            weight[i] += OF_RELUS * length * share[i, of_symbol[m]]
    return count


@njit_no_nrt
def mean_answer(
    network: ReluNetwork,
    centre: Floats,
    half: Floats,
    units: Floats,
    own: Floats,
    of_symbol: NDArray[np.int64],
    share: Floats,
    own_weight: Floats,
    each_p: Floats,
    each_g: Floats,
    each_r: Floats,
    p: Floats,
    g: Floats,
    slack: Floats,
    weight: Floats,
) -> int:
    """Fill ``p`` (3,), ``g`` (n, 3), ``slack`` (3,) for the mean over m members; return the count of symbols.

    The members share the symbols of the six axes.  ``each_p`` (m, 3), ``each_g`` (m, 6, 3) and ``each_r``
    (m, 3) receive the members' forms; ``each_r`` sums all other symbols and the slack.  ``centre``, ``half``,
    ``weight`` (6,). Scratch: ``own_weight`` (6,), and as in ``_answer``: ``units`` (4, n), ``own`` (k, n),
    ``share`` (6, n).
    """
    members, count = each_p.shape[0], PERCEPTRON_INPUTS
    answer = units.shape[1] - OUTPUTS
    p[:], slack[:], weight[:] = 0.0, 0.0, 0.0
    g[:PERCEPTRON_INPUTS] = 0.0
    for member in range(members):
        many = _answer(network, member, centre, half, units, own, of_symbol, share, own_weight)
        for i in range(PERCEPTRON_INPUTS):
            weight[i] += own_weight[i] / members
        for o in range(OUTPUTS):
            each_p[member, o] = units[Z, answer + o]
            p[o] += each_p[member, o] / members
            rest = units[SLACK, answer + o]
            for m in range(PERCEPTRON_INPUTS):
                each_g[member, m, o] = own[m, answer + o]
                g[m, o] += own[m, answer + o] / members
            for m in range(PERCEPTRON_INPUTS, many):
                g[count + m - PERCEPTRON_INPUTS, o] = own[m, answer + o] / members
                rest += abs(own[m, answer + o])
            each_r[member, o] = rest * UP
            size = abs(each_p[member, o]) + rest
            for m in range(PERCEPTRON_INPUTS):
                size += abs(own[m, answer + o])
            slack[o] += (units[SLACK, answer + o] + network.rounding * size) / members * UP
        count += many - PERCEPTRON_INPUTS
    return count


@njit_no_nrt
def spreads(each_p: Floats, each_g: Floats, each_r: Floats, p: Floats, g: Floats, bounds_out: Floats) -> None:
    """Fill ``bounds_out`` (2,) with bounds of the largest axis's spread over the members of ``mean_answer``.

    A member and the mean share the symbols of the six axes, so their difference has one coefficient for each.
    For all other symbols, the magnitudes of the member and of the mean add up.

    ``each_p`` (m, 3), ``each_g`` (m, 6, 3), ``each_r`` (m, 3), ``p`` (3,), ``g`` (n, 3).
    """
    members = each_p.shape[0]
    bounds_out[0], bounds_out[1] = 0.0, 0.0
    for o in range(OUTPUTS):
        rest, low, high = 0.0, 0.0, 0.0
        for member in range(members):
            rest += each_r[member, o] / members
        for member in range(members):
            middle, radius = abs(each_p[member, o] - p[o]), rest + each_r[member, o]
            for m in range(PERCEPTRON_INPUTS):
                radius += abs(each_g[member, m, o] - g[m, o])
            radius *= UP
            low += max(0.0, middle - radius) ** 2
            high += (middle + radius) ** 2
        bounds_out[0] = max(bounds_out[0], sqrt(low / members) / UP)
        bounds_out[1] = max(bounds_out[1], sqrt(high / members) * UP)
