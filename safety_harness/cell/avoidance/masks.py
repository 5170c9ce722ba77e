"""Compute dropout masks without a stateful random generator.

A mask's value depends only on the seed, the pass, the place and the unit.

The generator is counter-based. The generator adds the counter times the golden gamma to the seed's key. Then
the generator applies the finalizer of splitmix64 (Steele, Lea, Flood 2014) to the sum. So the masks of a
decision do not depend on the machine, on the order of the passes, or on the size of a batch. PyTorch can use
the same masks.

A *place* is a point of the network where dropout removes units. Place s of "inter" dropout is after stage s.
Place k of "full" dropout is before layer k, in the order of the state dict. The layers of a block are fc1,
fc2, fc3 and, in a dense block, fcs. The first block is block 0 of stage 0, and the last layer is fc_out.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from safety_harness.base.compiled import compiled

# The constants of splitmix64: 2^64 divided by the golden ratio (odd), and the finalizer's factors and shifts.
# Another value would change all masks, and with them the decisions of every shipped network with dropout.
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
    """Return the finalizer of splitmix64 for ``z``, a bijection of 64-bit numbers that serves as a hash."""
    z = (z ^ (z >> FIRST_SHIFT)) * FIRST_FACTOR
    z = (z ^ (z >> SECOND_SHIFT)) * SECOND_FACTOR
    return z ^ (z >> THIRD_SHIFT)


@compiled
def key_of(seed: np.uint64) -> np.uint64:
    """Return the number at which the counters of a seed start.

    The seed 0 and neighbouring seeds are suitable, too.
    """
    return mixed(np.uint64(seed) + GAMMA)


@compiled
def is_kept(key: np.uint64, which_pass: int, place: int, unit: int, drop_below: np.uint64) -> np.bool_:
    """Return whether dropout keeps a unit.

    ``key`` is key_of(seed), and ``drop_below`` is the dropout probability times 2^64.
    """
    counter = (np.uint64(which_pass) << PASS_SHIFT) | (np.uint64(place) << PLACE_SHIFT) | np.uint64(unit)
    return mixed(key + counter * GAMMA) >= drop_below


@compiled
def fill_factors(seed: np.uint64, probability: float, out: NDArray[np.float32]) -> None:
    """Fill ``out`` (places, passes, width) with the factors of inverted dropout, 0 or 1/(1 - p).

    The network multiplies its units by these factors, so that a NaN stays NaN. The dropout ``probability`` p
    is at least 0 and less than 1.
    """
    scale = np.float32(1.0 / (1.0 - probability))
    # Exact: 2^64 is a power of two, and the largest float64 below 1 still fits.
    drop_below = np.uint64(probability * 2.0**64)
    key = key_of(seed)
    for place in range(out.shape[0]):
        for which_pass in range(out.shape[1]):
            for unit in range(out.shape[2]):
                kept = is_kept(key, which_pass, place, unit, drop_below)
                out[place, which_pass, unit] = scale if kept else np.float32(0.0)


@compiled
def masks(seed: np.uint64, passes: int, places: int, width: int, probability: float) -> NDArray[np.bool_]:
    """Return the masks, shape (passes, places, width).

    The entry of a mask is True if dropout keeps the unit.

    Dropout keeps each unit with the probability 1 - ``probability``. Masks with fewer passes, places or units
    are the first part of larger masks.
    """
    out = np.empty((passes, places, width), dtype=np.bool_)
    drop_below = np.uint64(probability * 2.0**64)
    key = key_of(seed)
    for which_pass in range(passes):
        for place in range(places):
            for unit in range(width):
                out[which_pass, place, unit] = is_kept(key, which_pass, place, unit, drop_below)
    return out
