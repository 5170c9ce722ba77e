"""Compute dropout masks as a pure function of (seed, pass, place, unit), without a generator's state.

The generator is counter-based. It applies the finalizer of splitmix64 (Steele, Lea, Flood 2014) to the sum of
the seed's key and counter x golden gamma. So a decision has the same masks alone or in a batch, on any
machine and in any order of passes. PyTorch can use the same masks.

A *place* is a point of the network where dropout removes units. With "inter" dropout, place s is after stage
s. With "full" dropout, places count the layers in the order of the state dict. For each block, this is fc1,
fc2, fc3 and, in a dense block, fcs. Block 0 of stage 0 is the first, and fc_out is the last layer.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from safety_harness.base.compiled import compiled

GAMMA = np.uint64(0x9E3779B97F4A7C15)
FIRST_FACTOR = np.uint64(0xBF58476D1CE4E5B9)
SECOND_FACTOR = np.uint64(0x94D049BB133111EB)
FIRST_SHIFT = np.uint64(30)
SECOND_SHIFT = np.uint64(27)
THIRD_SHIFT = np.uint64(31)
PASS_SHIFT = np.uint64(32)
PLACE_SHIFT = np.uint64(16)  # enough for 65,536 places and units, far more than there are


@compiled
def mixed(z: np.uint64) -> np.uint64:
    """Return the finalizer of splitmix64 for ``z``: a bijection of 64 bits that leaves no pattern."""
    z = (z ^ (z >> FIRST_SHIFT)) * FIRST_FACTOR
    z = (z ^ (z >> SECOND_SHIFT)) * SECOND_FACTOR
    return z ^ (z >> THIRD_SHIFT)


@compiled
def key_of(seed: np.uint64) -> np.uint64:
    """Return the number at which a seed's counters start; 0 and neighbouring seeds are suitable too."""
    return mixed(np.uint64(seed) + GAMMA)


@compiled
def is_kept(key: np.uint64, which_pass: int, place: int, unit: int, drop_below: np.uint64) -> np.bool_:
    """Return whether dropout keeps a unit; ``key`` is key_of(seed), ``drop_below`` the probability x 2^64."""
    counter = (np.uint64(which_pass) << PASS_SHIFT) | (np.uint64(place) << PLACE_SHIFT) | np.uint64(unit)
    return mixed(key + counter * GAMMA) >= drop_below


@compiled
def fill_factors(seed: np.uint64, probability: float, out: NDArray[np.float32]) -> None:
    """Fill ``out`` (places, passes, width) with the factors of inverted dropout: 0 or 1/(1 - p).

    The network multiplies its units by these factors, so that a NaN stays NaN. ``probability`` p is in [0,
    1).
    """
    scale = np.float32(1.0 / (1.0 - probability))
    drop_below = np.uint64(probability * 2.0**64)
    key = key_of(seed)
    for place in range(out.shape[0]):
        for which_pass in range(out.shape[1]):
            for unit in range(out.shape[2]):
                kept = is_kept(key, which_pass, place, unit, drop_below)
                out[place, which_pass, unit] = scale if kept else np.float32(0.0)


@compiled
def masks(seed: np.uint64, passes: int, places: int, width: int, probability: float) -> NDArray[np.bool_]:
    """Return the masks (passes, places, width), True for a kept unit, with chance 1 - ``probability``.

    A call for fewer passes, places or units returns the beginning of the larger masks.
    """
    out = np.empty((passes, places, width), dtype=np.bool_)
    drop_below = np.uint64(probability * 2.0**64)
    key = key_of(seed)
    for which_pass in range(passes):
        for place in range(places):
            for unit in range(width):
                out[which_pass, place, unit] = is_kept(key, which_pass, place, unit, drop_below)
    return out
