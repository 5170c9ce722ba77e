"""A model as the compiled kernel wants it: batch norm folded into the layers, all in a few arrays.

In evaluation mode batch norm is affine: bn(z) = s z + (beta - s mean), s = gamma / sqrt(var + eps).
So bn(W x + b) = (s W) x + (s (b - mean) + beta): folded in float64, then rounded to float32 once.
Only bn_out stays by itself, for "full" dropout comes between it and the layer that follows.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from safety_harness.avoidance.model_file import BLOCKS, OUTPUTS, STAGES, WIDTH, Dropout, Model

EPSILON = 1e-5  # PyTorch's BatchNorm1d
STAGE_LAYERS = 3 * BLOCKS + 1  # a stage's one dense block has a layer in its shortcut too
LAYERS = STAGES * STAGE_LAYERS
PLACES = {Dropout.NONE: 0, Dropout.INTER: STAGES, Dropout.FULL: LAYERS + 1}  # of masks in one pass

Float32s = NDArray[np.float32]
Float64s = NDArray[np.float64]


class FoldedNetwork(NamedTuple):
    """Contiguous arrays of a model with m members.

    Layers are in the state dict's order (fc1, fc2, fc3, fcs of block 0 of stage 0, then block 1, ...).
    Weights have the outputs last, so that the kernel's innermost loop runs over memory in order;
    the first layers' inputs beyond INPUTS have weight 0.
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


def fold(model: Model) -> FoldedNetwork:
    """The arrays of ``model``."""
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


def layer_names() -> list[tuple[str, str]]:
    """(block, number) of every layer before fc_out, in the order of the arrays and of the masks."""
    return [
        (f"stages.{stage}.{block}", number)
        for stage in range(STAGES)
        for block in range(BLOCKS)
        for number in (("1", "2", "3", "s") if block == 0 else ("1", "2", "3"))
    ]


def _affine(tensors: Mapping[str, Float32s], prefix: str) -> tuple[Float64s, Float64s]:
    """Scale and shift of a batch norm in evaluation mode, each (WIDTH,)."""
    gamma, beta, mean, variance = (
        tensors[f"{prefix}.{part}"].astype(np.float64)
        for part in ("weight", "bias", "running_mean", "running_var")
    )
    scale = gamma / np.sqrt(variance + EPSILON)
    return scale, beta - scale * mean


def _folded_layer(tensors: Mapping[str, Float32s], prefix: str, number: str) -> tuple[Float64s, Float64s]:
    """Weight (WIDTH, inputs) and bias (WIDTH,) of a layer with the batch norm that follows it."""
    scale, shift = _affine(tensors, f"{prefix}.bn{number}")
    weight = tensors[f"{prefix}.fc{number}.weight"].astype(np.float64)
    bias = tensors[f"{prefix}.fc{number}.bias"].astype(np.float64)
    return scale[:, None] * weight, scale * bias + shift
