"""Compute affine forms of a ReLU network's answers in a box, and of their mean and spread over the members.

The value of a unit is c + sum_k g_k e_k + r e', where e' and each e_k are unknown numbers in [-1, 1].  The
first six e_k are the coordinates of the input within the box (hand, then TCP).  Each further e_k, called a
symbol, represents the uncertainty that a ReLU adds, and r is the slack.  An affine map of such forms is again
such a form.  Let l <= z <= u with l < 0 < u.  Then relu(z) - s z lies in [0, 2 m] for any s in [0, 1], with 2
m = max(-s l, (1 - s) u).  This interval is shortest for s = u / (u - l) (Singh et al. 2018, DeepZ).

Each layer multiplies the slack by |W|, so the slack would become too large in a deep network.  In a deep
network, the ReLUs therefore convert the slack into symbols: in every layer, or in the last of every
``network.gathers`` layers.

**Rounding.** The bounds apply to the values that the *program* computes with rounding.  ``network.error``
bounds the program's rounding errors.  If the program computes in float64
(``cell.avoidance.perceptron_kernel``), they are as small as the rounding errors in this module.  Let gamma =
n u / (1 - n u) and u = 2^-53.  A sum of n products then has an error of at most gamma (|b| + sum |w| |x|).
This bound is valid for any order of the sum, with or without fused operations (Higham 2002, 3.1).  It also
covers the errors of the centres, symbols and slacks that this module computes, because |x| <= size includes
their magnitudes.  ``network.rounding`` is four times the sum of these errors, and the kernel adds it to the
slack.  The factor ``UP`` exceeds the relative rounding error of every sum of up to 30,000 magnitudes.
"""

from __future__ import annotations

from math import sqrt

import numpy as np
from numpy.typing import NDArray

from safety_harness.base.compiled import njit_no_nrt
from safety_harness.cell.avoidance.model_file import OUTPUTS, PERCEPTRON_INPUTS
from safety_harness.extensions.lab.proof.network import ReluNetwork

Floats = NDArray[np.float64]

UP = 1.0 + 4e-12  # 30,000 u = 3.3e-12, with u = 2^-53
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
    """Apply ReLU in place to the units from ``first`` to ``last`` - 1, and return the new number of symbols.

    In a deep network, a unit that receives a new symbol adds its slack to this symbol.  If ``gathers`` is
    True, every unit receives a new symbol.

    The function writes to ``share`` the fraction of a unit's width that each axis causes.  Shapes: ``units``
    (4, n), ``g`` (k, n), ``share`` (6, n), ``of_symbol`` (k,).
    """
    rounding, old_count = network.rounding, count
    width, sizes = last - first, units[SIZE, first:last]
    # The sums over the symbols run row by row, because a row of ``g`` is contiguous.
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
            # The slope u / (u - l) gives the shortest interval; a unit that is never positive becomes 0.
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
        # The new symbol's row begins with zeros, because the scratch memory still contains another box.
        if half > 0.0:
            g[count, :last] = 0.0
            g[count, j] = half * UP
            of_symbol[count] = j
            count += 1
    # Scale the old symbols only now, because ``share`` above needs their coefficients before the ReLU.
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
    """Compute the affine forms of one member's units in a box, and return the number of symbols.

    The function writes the forms to ``units``, shape (4, n), and ``g``, shape (k, n).  Their columns are the
    six coordinates of the input, followed by all ReLUs and by the answer.  ``centre`` and ``half`` define the
    box, shape (6,) each.  The ReLUs add uncertainty to the answer.  The function writes the contribution of
    each axis to ``weight``, shape (6,) [m]. It uses ``of_symbol``, shape (k,), and ``share``, shape (6, n),
    as scratch memory.
    """
    widths, blocks, rounding = network.widths, network.blocks, network.rounding
    weights, errors = network.weight[member], network.error[member]
    bias, bias_error = network.bias[member], network.bias_error[member]
    inexact = errors.shape[0] > 0
    count, first, at = PERCEPTRON_INPUTS, PERCEPTRON_INPUTS, 0
    for i in range(PERCEPTRON_INPUTS):
        # The form of the input is exact: centre_i + half_i e_i without slack.
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
            # Find the columns of the source: the input's columns come first, then those of each earlier
            # layer.
            if source > 0:
                column, inputs = PERCEPTRON_INPUTS, widths[source - 1]
                for earlier in range(source - 1):
                    column += widths[earlier]
            w = weights[start : start + inputs * width].reshape((inputs, width))
            for j in range(inputs):
                x, size = units[Z, column + j], units[SIZE, column + j]
                # A unit that is 0 in the whole box adds nothing, not even a rounding error.
                if size == 0.0:
                    continue
                # |W| carries the slack of the source; the rounding errors of the products join it.
                spread = (units[SLACK, column + j] + rounding * size) * UP
                for q in range(width):
                    z[q] += x * w[j, q]
                    slack[q] += spread * abs(w[j, q])
                # The rounding errors of the program itself: E |a|.
                if inexact:
                    e = errors[start + j * width : start + (j + 1) * width]
                    for q in range(width):
                        slack[q] += size * e[q]
            for k in range(count):
                low, high = 0, inputs
                # The symbol of a ReLU in the source layer occurs in this unit only; that of a later layer, in
                # no unit.
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
            # With larger units, a float32 sum in the program could overflow.  NaN keeps the box undecided.
            for j in range(first, last):
                if not units[SIZE, j] < MOST:
                    units[Z, j] = np.nan
        first = last
    # How much each axis contributes to the answer's uncertainty, through the ReLUs that added the symbols.
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
    """Compute the affine form of the mean answer over m members, and return the number of symbols.

    The function writes the form of the mean to ``p``, ``g`` and ``slack``, with the shapes (3,), (n, 3) and
    (3,).  All members have the symbols of the six axes in common.  The function writes the members' forms to
    ``each_p``, ``each_g`` and ``each_r``, with the shapes (m, 3), (m, 6, 3) and (m, 3).  ``each_r`` is the
    sum of the slack and of the magnitudes of all other symbols.  ``centre``, ``half`` and ``weight`` have the
    shape (6,).  The remaining arrays are scratch memory: ``own_weight`` (6,), ``units`` (4, n), ``own`` (k,
    n), ``of_symbol`` (k,) and ``share`` (6, n).
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
            # Every member has its own ReLUs, so its symbols receive rows after those of the earlier members.
            for m in range(PERCEPTRON_INPUTS, many):
                g[count + m - PERCEPTRON_INPUTS, o] = own[m, answer + o] / members
                rest += abs(own[m, answer + o])
            each_r[member, o] = rest * UP
            # The sums over the members round too, in proportion to the magnitudes.
            size = abs(each_p[member, o]) + rest
            for m in range(PERCEPTRON_INPUTS):
                size += abs(own[m, answer + o])
            slack[o] += (units[SLACK, answer + o] + network.rounding * size) / members * UP
        count += many - PERCEPTRON_INPUTS
    return count


@njit_no_nrt
def spreads(each_p: Floats, each_g: Floats, each_r: Floats, p: Floats, g: Floats, bounds_out: Floats) -> None:
    """Write a lower and an upper bound of the largest spread over the three axes to ``bounds_out``.

    The spread is the standard deviation over the members of ``mean_answer``.  A member and the mean have the
    symbols of the six axes in common, so the function subtracts their coefficients.  For all other symbols,
    it adds the magnitudes of the member and of the mean.

    Shapes: ``each_p`` (m, 3), ``each_g`` (m, 6, 3), ``each_r`` (m, 3), ``p`` (3,), ``g`` (n, 3),
    ``bounds_out`` (2,).
    """
    members = each_p.shape[0]
    bounds_out[0], bounds_out[1] = 0.0, 0.0
    for o in range(OUTPUTS):
        rest, low, high = 0.0, 0.0, 0.0
        # The mean deviates from its axes' part by at most the mean of the members' remainders.
        for member in range(members):
            rest += each_r[member, o] / members
        for member in range(members):
            middle, radius = abs(each_p[member, o] - p[o]), rest + each_r[member, o]
            for m in range(PERCEPTRON_INPUTS):
                radius += abs(each_g[member, m, o] - g[m, o])
            radius *= UP
            low += max(0.0, middle - radius) ** 2
            high += (middle + radius) ** 2
        # The gate compares the largest spread over the axes, and each axis bounds the maximum from below.
        bounds_out[0] = max(bounds_out[0], sqrt(low / members) / UP)
        bounds_out[1] = max(bounds_out[1], sqrt(high / members) * UP)
