"""Compute the decision of a small ReLU network: three affine maps in float64, so that proofs are short.

Each member computes the position p [m] from x (6,), which contains the hand and the TCP in the base frame
[m]:

    h = relu(A1 x + b1),  g = relu(A2 h + b2),  p = A3 g + b3

The layers have the widths 6, 32, 32 and 3. The sum of every unit starts with its bias and adds its inputs in
order. The kernel rounds each product and each sum to float64 separately, without fused operations. The
function relu(z) is 0 for z < 0, and z otherwise. A1, b1, A3 and b3 include the normalisation, which
``fold_perceptron`` computes and rounds once. These rounded numbers define the network. The float32 numbers of
a file are exact in float64. The position is the mean of the members: their sum in a fixed order, divided by
their number. The spread is the root mean square of the members' differences from the position, summed in the
same order.
"""

from __future__ import annotations

from math import sqrt
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from safety_harness.base.compiled import compiled
from safety_harness.base.elementary import product
from safety_harness.base.geometry.arrays import ArrayNx3
from safety_harness.cell.avoidance.model_file import OUTPUTS, PERCEPTRON_INPUTS, WIDTH, Model

Float64s = NDArray[np.float64]


class Perceptron(NamedTuple):
    """The contiguous arrays of a model with m members.

    Weights have the axes [input, output], and quantities are in metres.
    """

    weight1: Float64s  # (m, 6, WIDTH)
    bias1: Float64s  # (m, WIDTH)
    weight2: Float64s  # (m, WIDTH, WIDTH)
    bias2: Float64s  # (m, WIDTH)
    weight3: Float64s  # (m, WIDTH, OUTPUTS)
    bias3: Float64s  # (m, OUTPUTS)


def fold_perceptron(model: Model) -> Perceptron:
    """Return the arrays of ``model``, which include the normalisation of inputs and targets.

    W and v are the weights and biases in the file, m is the mean, and s is the standard deviation. For the
    inputs, A1 = W1 / s and b1 = v1 - A1 m. For the targets, A3 = s W3 and b3 = m + s v3.
    """

    def stacked(name: str) -> Float64s:
        return np.stack([model.tensors[f"{k}/{name}"].astype(np.float64) for k in range(model.members)])

    mean, std = np.array(model.input_mean), np.array(model.input_std)
    target_mean, target_std = np.array(model.target_mean), np.array(model.target_std)
    first = stacked("fc1.weight") / std  # (m, WIDTH, 6)
    last = stacked("fc_out.weight") * target_std[:, None]  # (m, OUTPUTS, WIDTH)
    return Perceptron(
        weight1=np.ascontiguousarray(first.transpose(0, 2, 1)),
        bias1=stacked("fc1.bias") - product(first, mean),
        weight2=np.ascontiguousarray(stacked("fc2.weight").transpose(0, 2, 1)),
        bias2=stacked("fc2.bias"),
        weight3=np.ascontiguousarray(last.transpose(0, 2, 1)),
        bias3=target_mean + target_std * stacked("fc_out.bias"),
    )


@compiled
def _layer(weight: Float64s, bias: Float64s, x: Float64s, rectified: bool, out: Float64s) -> None:
    """Fill ``out`` with bias + x weight, or with the ReLU of this sum if ``rectified`` is True.

    NaN stays NaN. The shapes are ``weight`` (n, m), ``bias`` (m,), ``x`` (n,) and ``out`` (m,).
    """
    for j in range(out.shape[0]):
        out[j] = bias[j]
    # Inputs outside, units inside: the loop over units can be vectorised without a change of any unit's order
    # of additions.
    for i in range(x.shape[0]):
        for j in range(out.shape[0]):
            out[j] += x[i] * weight[i, j]
    if rectified:
        for j in range(out.shape[0]):
            out[j] = 0.0 if out[j] < 0.0 else out[j]


@compiled
def answer(network: Perceptron, member: int, x: Float64s, h: Float64s, g: Float64s, out: Float64s) -> None:
    """Fill ``out`` (3,) with a member's position [m] for the input ``x`` (6,).

    The input contains the hand and the TCP. ``h`` (WIDTH,) and ``g`` (WIDTH,) are scratch arrays.
    """
    _layer(network.weight1[member], network.bias1[member], x, True, h)
    _layer(network.weight2[member], network.bias2[member], h, True, g)
    _layer(network.weight3[member], network.bias3[member], g, False, out)


@compiled
def decide_perceptron(
    network: Perceptron,
    hands_in_base_m: ArrayNx3,
    tcps_in_base_m: ArrayNx3,
    positions: ArrayNx3,
    spreads: ArrayNx3,
) -> None:
    """Fill ``positions`` and ``spreads`` [m] for hands and TCPs in the base frame, all of shape (n, 3)."""
    members = network.weight1.shape[0]
    x, h, g = np.empty(PERCEPTRON_INPUTS), np.empty(WIDTH), np.empty(WIDTH)
    answers = np.empty((members, OUTPUTS))
    for n in range(hands_in_base_m.shape[0]):
        x[:3], x[3:] = hands_in_base_m[n], tcps_in_base_m[n]
        for member in range(members):
            answer(network, member, x, h, g, answers[member])
        for k in range(OUTPUTS):
            total = 0.0
            for member in range(members):
                total += answers[member, k]
            mean, squares = total / members, 0.0
            for member in range(members):
                squares += (answers[member, k] - mean) * (answers[member, k] - mean)
            positions[n, k], spreads[n, k] = mean, sqrt(squares / members)
