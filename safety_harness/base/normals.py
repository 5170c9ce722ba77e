"""Draws from the standard normal distribution with the same bits on every processor.

Numpy's generator draws by a ziggurat (Marsaglia and Tsang, 2000).  For draws beyond R = 3.65, one in 3,700,
numpy uses the C library's logarithm.  This module computes those draws from the same random bits with our own
logarithm.  Below R, numpy multiplies.  In one draw of 80, numpy also compares with the C library's
exponential.  There, a different last bit changes the draw with a chance below 1e-16.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from safety_harness.base.elementary import log1p

_R, _INVERSE_R = 3.6541528853610087963519472518, 0.27366123732975827203338247596


def standard_normal(rng: np.random.Generator, shape: int | tuple[int, ...]) -> NDArray[np.float64]:
    """Return independent draws, and leave ``rng`` in the state that its own ``standard_normal`` leaves."""
    bits = rng.bit_generator
    start_state = bits.state
    drawn = rng.standard_normal(shape)
    flat, done = drawn.reshape(-1), 0
    if len(far := np.flatnonzero(np.abs(flat) >= _R)):
        again = np.random.Generator(type(bits)())
        again.bit_generator.state = start_state
        for k in far.tolist():
            again.standard_normal(k - done)
            flat[k], done = np.copysign(_draw_beyond_r(again.bit_generator), flat[k]), k + 1
    return drawn


def _draw_beyond_r(bits: np.random.BitGenerator) -> float:
    """Return the absolute value of the next draw, known to lie beyond R, by the same steps as numpy."""
    while int(bits.random_raw()) & 0xFF:  # another layer: numpy rejected its draw after one more number
        bits.random_raw()
    while True:
        x, y = (-log1p(-(int(bits.random_raw()) >> 11) * 2.0**-53) for _ in range(2))
        x *= _INVERSE_R
        if 2.0 * y > x * x:
            return float(_R + x)
