"""Compute the regression ResNet's passes for one decision, in one fixed order of operations.

The sum of a unit starts with its bias and adds its inputs in order. The processor may compute several *units*
at once, but never reorders a sum. The kernel uses no BLAS, because its order of sums depends on the batch. So
the bits of a decision depend on its input, its seed and the network alone. These bits are the same for a
single decision and for a batch of a million decisions.

``fold`` turns a model into a few arrays and folds batch norm into the layers. In evaluation mode batch norm
is affine: bn(z) = s z + (beta - s mean) with s = gamma / sqrt(var + eps). So bn(W x + b) = (s W) x + (s
(b - mean) + beta). ``fold`` computes this in float64 and rounds it to float32 once. Only bn_out stays
separate, because "full" dropout comes between it and the next layer.
"""

from __future__ import annotations

from collections.abc import Mapping
from math import sqrt
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from safety_harness.base.compiled import compiled
from safety_harness.base.geometry.arrays import Array3, ArrayNx3
from safety_harness.cell.avoidance.masks import fill_factors
from safety_harness.cell.avoidance.model_file import (
    BLOCKS,
    INPUTS,
    LAYERS,
    NORM,
    OUTPUTS,
    PLACES,
    STAGE_LAYERS,
    STAGES,
    WIDTH,
    Model,
    layer_names,
)

Float32s = NDArray[np.float32]
Float64s = NDArray[np.float64]

EPSILON = 1e-5  # PyTorch's BatchNorm1d
STEP = 8  # inputs per loop; WIDTH is a multiple of it
ROWS = 5  # rows per loop: a fifth quicker than row by row, with the same bits
FULL_PLACES = LAYERS + 1  # places of "full" dropout: before every layer and before fc_out
ZERO = np.float32(0.0)

# ``work`` (SLOTS, passes, WIDTH) holds the activations; functions get the number of a slot, not a view.
X, Y, H, G, DROPPED = range(5)
SLOTS = 5


class FoldedNetwork(NamedTuple):
    """The contiguous arrays of a model with m members.

    Layers are in the order of the state dict: fc1, fc2, fc3 and fcs of block 0 of stage 0, then the layers of
    block 1, and so on. Weights have their outputs on the last axis, so that the kernel's innermost loop reads
    memory in order. In the first layers, the weights of inputs beyond INPUTS are 0.
    """

    weight: Float32s  # (m, LAYERS, WIDTH, WIDTH), [input, output]
    bias: Float32s  # (m, LAYERS, WIDTH)
    scale_out: Float32s  # (m, WIDTH), bn_out
    shift_out: Float32s  # (m, WIDTH), bn_out
    weight_out: Float32s  # (m, WIDTH, OUTPUTS), [input, output]
    bias_out: Float32s  # (m, OUTPUTS)
    input_mean: Float64s  # (6,) [m]
    input_std: Float64s  # (6,) [m]
    target_mean: Float64s  # (3,) [m]
    target_std: Float64s  # (3,) [m]
    places: int  # places of dropout in a pass: 0, STAGES ("inter") or FULL_PLACES
    probability: float  # of dropping a unit
    passes: int  # 1 without places


def fold(model: Model) -> FoldedNetwork:
    """Return the arrays of ``model``, with batch norm folded into its layers."""
    count = model.members
    network = FoldedNetwork(
        weight=np.zeros((count, LAYERS, WIDTH, WIDTH), dtype=np.float32),
        bias=np.zeros((count, LAYERS, WIDTH), dtype=np.float32),
        scale_out=np.zeros((count, WIDTH), dtype=np.float32),
        shift_out=np.zeros((count, WIDTH), dtype=np.float32),
        weight_out=np.zeros((count, WIDTH, OUTPUTS), dtype=np.float32),
        bias_out=np.zeros((count, OUTPUTS), dtype=np.float32),
        input_mean=np.array(model.input_mean),
        input_std=np.array(model.input_std),
        target_mean=np.array(model.target_mean),
        target_std=np.array(model.target_std),
        places=PLACES[model.dropout],
        probability=model.dropout_probability,
        passes=model.passes,
    )
    for member in range(count):
        for layer, (prefix, number) in enumerate(layer_names()):
            weight, bias = _folded_layer(model.tensors, f"{member}/{prefix}", number)
            network.weight[member, layer, : weight.shape[1]] = weight.T
            network.bias[member, layer] = bias
        network.scale_out[member], network.shift_out[member] = _affine(model.tensors, f"{member}/bn_out")
        network.weight_out[member] = model.tensors[f"{member}/fc_out.weight"].T
        network.bias_out[member] = model.tensors[f"{member}/fc_out.bias"]
    return network


def _affine(tensors: Mapping[str, Float32s], prefix: str) -> tuple[Float64s, Float64s]:
    """Return the scale and the shift of a batch norm in evaluation mode, each (WIDTH,)."""
    gamma, beta, mean, variance = (tensors[f"{prefix}.{part}"].astype(np.float64) for part in NORM)
    scale = gamma / np.sqrt(variance + EPSILON)
    return scale, beta - scale * mean


def _folded_layer(tensors: Mapping[str, Float32s], prefix: str, number: str) -> tuple[Float64s, Float64s]:
    """Return the weight (WIDTH, inputs) and the bias (WIDTH,) of a layer.

    The weight and the bias include the batch norm after the layer.
    """
    scale, shift = _affine(tensors, f"{prefix}.bn{number}")
    weight = tensors[f"{prefix}.fc{number}.weight"].astype(np.float64)
    bias = tensors[f"{prefix}.fc{number}.bias"].astype(np.float64)
    return scale[:, None] * weight, scale * bias + shift


@compiled
def _layer(weight: Float32s, bias: Float32s, layer: int, work: Float32s, x: int, rows: int, out: int) -> None:
    """Compute bias + x weight for the layer ``layer``, and store the result in slot ``out``.

    The sum includes the batch norm but not the ReLU. The loop processes five rows at a time. So the loop
    loads each weight once for five rows, and no addition waits for the previous addition. The function
    computes the remaining rows one by one, and adds a unit's inputs in the same order. Everything is in one
    function. Numba would not vectorise an inner loop that contains a call, or whose bounds are not constants.
    """
    together = rows - rows % ROWS
    for row in range(together):
        for j in range(WIDTH):
            work[out, row, j] = bias[layer, j]
    for row in range(0, together, ROWS):
        for i in range(0, WIDTH, 4):
            a0, a1 = work[x, row, i], work[x, row, i + 1]
            a2, a3 = work[x, row, i + 2], work[x, row, i + 3]
            b0, b1 = work[x, row + 1, i], work[x, row + 1, i + 1]
            b2, b3 = work[x, row + 1, i + 2], work[x, row + 1, i + 3]
            c0, c1 = work[x, row + 2, i], work[x, row + 2, i + 1]
            c2, c3 = work[x, row + 2, i + 2], work[x, row + 2, i + 3]
            d0, d1 = work[x, row + 3, i], work[x, row + 3, i + 1]
            d2, d3 = work[x, row + 3, i + 2], work[x, row + 3, i + 3]
            e0, e1 = work[x, row + 4, i], work[x, row + 4, i + 1]
            e2, e3 = work[x, row + 4, i + 2], work[x, row + 4, i + 3]
            for j in range(WIDTH):
                w0, w1 = weight[layer, i, j], weight[layer, i + 1, j]
                w2, w3 = weight[layer, i + 2, j], weight[layer, i + 3, j]
                t0 = work[out, row, j]
                t1 = work[out, row + 1, j]
                t2 = work[out, row + 2, j]
                t3 = work[out, row + 3, j]
                t4 = work[out, row + 4, j]
                # A row adds its inputs in rising order, as ``_layer_of_row`` does. The rows alternate, so
                # that no addition waits.
                t0 += a0 * w0
                t1 += b0 * w0
                t2 += c0 * w0
                t3 += d0 * w0
                t4 += e0 * w0
                t0 += a1 * w1
                t1 += b1 * w1
                t2 += c1 * w1
                t3 += d1 * w1
                t4 += e1 * w1
                t0 += a2 * w2
                t1 += b2 * w2
                t2 += c2 * w2
                t3 += d2 * w2
                t4 += e2 * w2
                t0 += a3 * w3
                t1 += b3 * w3
                t2 += c3 * w3
                t3 += d3 * w3
                t4 += e3 * w3
                work[out, row, j] = t0
                work[out, row + 1, j] = t1
                work[out, row + 2, j] = t2
                work[out, row + 3, j] = t3
                work[out, row + 4, j] = t4
    for row in range(together, rows):
        _layer_of_row(weight, bias, layer, work, x, row, out)


@compiled
def _layer_of_row(
    weight: Float32s, bias: Float32s, layer: int, work: Float32s, x: int, row: int, out: int
) -> None:
    """Fill one row as ``_layer`` does.

    The loop adds STEP inputs at a time, to keep the sums in registers.
    """
    for j in range(WIDTH):
        work[out, row, j] = bias[layer, j]
    for i in range(0, WIDTH, STEP):
        x0, x1, x2, x3 = work[x, row, i], work[x, row, i + 1], work[x, row, i + 2], work[x, row, i + 3]
        x4, x5, x6, x7 = (work[x, row, i + 4], work[x, row, i + 5], work[x, row, i + 6], work[x, row, i + 7])
        for j in range(WIDTH):
            total = work[out, row, j]
            total += x0 * weight[layer, i, j]
            total += x1 * weight[layer, i + 1, j]
            total += x2 * weight[layer, i + 2, j]
            total += x3 * weight[layer, i + 3, j]
            total += x4 * weight[layer, i + 4, j]
            total += x5 * weight[layer, i + 5, j]
            total += x6 * weight[layer, i + 6, j]
            total += x7 * weight[layer, i + 7, j]
            work[out, row, j] = total


@compiled
def _rectify(work: Float32s, x: int, rows: int) -> None:
    """Apply ReLU in place.

    NaN stays NaN, whereas ``max`` would make it 0.
    """
    for row in range(rows):
        for j in range(WIDTH):
            work[x, row, j] = ZERO if work[x, row, j] < ZERO else work[x, row, j]


@compiled
def _add_rectified(work: Float32s, h: int, shortcut: int, rows: int, out: int) -> None:
    """Fill slot ``out`` with relu(h + shortcut)."""
    for row in range(rows):
        for j in range(WIDTH):
            total = work[h, row, j] + work[shortcut, row, j]
            work[out, row, j] = ZERO if total < ZERO else total


@compiled
def _drop(factors: Float32s, place: int, work: Float32s, x: int, rows: int, out: int) -> None:
    """Fill slot ``out`` with x times the dropout factors of ``place``."""
    for row in range(rows):
        for j in range(WIDTH):
            work[out, row, j] = work[x, row, j] * factors[place, row, j]


@compiled
def _connect(
    weight: Float32s,
    bias: Float32s,
    layer: int,
    factors: Float32s,
    work: Float32s,
    x: int,
    rows: int,
    out: int,
) -> None:
    """Apply "full" dropout, if the network has it, and then a layer."""
    if factors.shape[0] == FULL_PLACES:
        _drop(factors, layer, work, x, rows, DROPPED)
        x = DROPPED
    _layer(weight, bias, layer, work, x, rows, out)


@compiled
def _block(
    weight: Float32s,
    bias: Float32s,
    layer: int,
    dense: bool,
    factors: Float32s,
    work: Float32s,
    x: int,
    rows: int,
    out: int,
) -> None:
    """Apply a block (figure 4 of the paper) to slot ``x``, and store the result in slot ``out``.

    The number of the block's layer fc1 is ``layer``.
    """
    _connect(weight, bias, layer, factors, work, x, rows, H)
    _rectify(work, H, rows)
    _connect(weight, bias, layer + 1, factors, work, H, rows, G)
    _rectify(work, G, rows)
    _connect(weight, bias, layer + 2, factors, work, G, rows, H)
    if dense:
        _connect(weight, bias, layer + 3, factors, work, x, rows, G)
        _add_rectified(work, H, G, rows, out)
    else:
        _add_rectified(work, H, x, rows, out)


@compiled
def _repeat_first_row(work: Float32s, x: int, rows: int) -> None:
    """Copy the first row of slot ``x`` into the next rows, so that the first ``rows`` rows are equal."""
    for row in range(1, rows):
        for j in range(WIDTH):
            work[x, row, j] = work[x, 0, j]


@compiled
def _stages(weight: Float32s, bias: Float32s, factors: Float32s, work: Float32s, x: int, y: int) -> int:
    """Apply the three stages to row 0 of slot ``x``, and return the number of the result's slot.

    The result is in slot ``x`` or in slot ``y``.

    Until the first dropout all passes are the same, so they share one row.
    """
    places, passes = factors.shape[0], work.shape[1]
    rows = 1
    if places == FULL_PLACES:
        # Every pass has its own masks from here on.
        rows = passes
        _repeat_first_row(work, x, rows)
    for stage in range(STAGES):
        for block in range(BLOCKS):
            layer = stage * STAGE_LAYERS + 3 * block + (1 if block > 0 else 0)
            _block(weight, bias, layer, block == 0, factors, work, x, rows, y)
            x, y = y, x
        if places == STAGES:
            # The first dropout is after this stage, so the passes become different here.
            if stage == 0:
                rows = passes
                _repeat_first_row(work, x, rows)
            _drop(factors, stage, work, x, rows, y)
            x, y = y, x
    return x


@compiled
def _answer(
    network: FoldedNetwork, member: int, factors: Float32s, work: Float32s, x: int, answers: Float32s
) -> None:
    """Apply bn_out and fc_out to slot ``x``, and store the normalised answers of a member.

    ``answers`` has the shape (m, passes, OUTPUTS).
    """
    for row in range(work.shape[1]):
        for j in range(WIDTH):
            work[H, row, j] = work[x, row, j] * network.scale_out[member, j] + network.shift_out[member, j]
    out = H
    if factors.shape[0] == FULL_PLACES:
        _drop(factors, LAYERS, work, H, work.shape[1], G)
        out = G
    for row in range(work.shape[1]):
        for k in range(OUTPUTS):
            total = network.bias_out[member, k]
            for j in range(WIDTH):
                total += work[out, row, j] * network.weight_out[member, j, k]
            answers[member, row, k] = total


@compiled
def _summarise(network: FoldedNetwork, answers: Float32s, position: Array3, spread: Array3) -> None:
    """Fill ``position`` and ``spread`` [m] with the mean and standard deviation (ddof 0) of all answers."""
    members, passes = answers.shape[0], answers.shape[1]
    for k in range(OUTPUTS):
        # In float64, and in two passes: a mean of squares minus the square of the mean would cancel.
        mean = 0.0
        for member in range(members):
            for row in range(passes):
                mean += np.float64(answers[member, row, k])
        mean /= members * passes
        squares = 0.0
        for member in range(members):
            for row in range(passes):
                difference = np.float64(answers[member, row, k]) - mean
                squares += difference * difference
        position[k] = network.target_mean[k] + network.target_std[k] * mean
        spread[k] = network.target_std[k] * sqrt(squares / (members * passes))


@compiled
def decide(
    network: FoldedNetwork,
    hands_in_base_m: ArrayNx3,
    tcps_in_base_m: ArrayNx3,
    seeds: NDArray[np.uint64],  # (n,)
    positions: ArrayNx3,
    spreads: ArrayNx3,
) -> None:
    """Fill ``positions`` and ``spreads`` (n, 3) [m] for the given hands, TCPs and seeds.

    Hands and TCPs (n, 3) are in the base frame, and seeds have the shape (n,). Each member of an ensemble
    gives one answer. A NaN in a hand or a TCP gives NaN.
    """
    members, places = network.weight.shape[0], network.places
    rows = network.passes if places > 0 else 1
    factors = np.empty((places, rows, WIDTH), dtype=np.float32)
    work = np.zeros((SLOTS, rows, WIDTH), dtype=np.float32)
    answers = np.empty((members, rows, OUTPUTS), dtype=np.float32)
    x = np.zeros(WIDTH, dtype=np.float32)  # beyond INPUTS it stays 0
    x[INPUTS - 1] = 1.0
    for n in range(hands_in_base_m.shape[0]):
        for k in range(3):
            x[k] = (hands_in_base_m[n, k] - network.input_mean[k]) / network.input_std[k]
            x[k + 3] = (tcps_in_base_m[n, k] - network.input_mean[k + 3]) / network.input_std[k + 3]
        if places > 0:
            fill_factors(seeds[n], network.probability, factors)
        for member in range(members):
            for k in range(WIDTH):  # an assignment of arrays takes 1.5 s to compile, for its error message
                work[X, 0, k] = x[k]
            out = _stages(network.weight[member], network.bias[member], factors, work, X, Y)
            _answer(network, member, factors, work, out, answers)
        _summarise(network, answers, positions[n], spreads[n])
