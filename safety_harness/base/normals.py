"""Draw from the standard normal distribution, with the same bits on every processor.

Numpy's generator uses the ziggurat method (Marsaglia and Tsang, 2000).  One draw in 3,700 lies beyond R =
3.65, and numpy computes such a draw with the C library's logarithm.  This module computes these draws again,
from the same random bits but with our own logarithm.  Draws below R are products, which are the same on every
processor.  In one of 80 draws below R, numpy also compares a number with a value of the C library's
exponential.  A different last bit of this exponential changes the draw with a probability below 1e-16.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from safety_harness.base.elementary import log1p

# Numpy's own constants. A different last bit would give other draws than numpy's from the same bits.
_R, _INVERSE_R = 3.6541528853610087963519472518, 0.27366123732975827203338247596


def standard_normal(rng: np.random.Generator, shape: int | tuple[int, ...]) -> NDArray[np.float64]:
    """Return independent draws of the shape ``shape``.

    Afterwards, ``rng`` has the same state as after a call of its own method ``standard_normal``.
    """
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
    """Compute the absolute value of the next draw by numpy's method, and return it.

    The next draw must lie beyond R.
    """
    while int(bits.random_raw()) & 0xFF:  # another layer: numpy rejected its draw after one more number
        bits.random_raw()
    while True:
        # The upper 53 bits give the uniform number that numpy would use. A draw beyond R is accepted if 2 y >
        # x^2.
        x, y = (-log1p(-(int(bits.random_raw()) >> 11) * 2.0**-53) for _ in range(2))
        x *= _INVERSE_R
        if 2.0 * y > x * x:
            return float(_R + x)
