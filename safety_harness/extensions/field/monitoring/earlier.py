"""Keep a few earlier samples of a stream, to compare the next sample with."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from safety_harness.extensions.field.logs.streams import NS

Values = NDArray[np.float64]
_LEVELS = 62  # 2**62 samples never come


class EarlierSamples:
    """Two earlier samples per level: those whose numbers are the last multiples of 1, 2, 4 and so on.

    Over a short step, the errors of two samples hide a speed above its bound. Samples that are farther apart
    show it. The log reader compares samples 1, 2, 4, ... apart for the same reason.
    """

    def __init__(self, count: int) -> None:
        self._times_ns = np.zeros((2, _LEVELS), dtype=np.int64)
        self._values = np.zeros((2, _LEVELS, count))
        self._number = self._levels = 0

    def add(self, time_ns: int, values: Values) -> None:
        """Add the next sample ``values`` (count,)."""
        number = self._number
        self._number += 1
        if number == 0:  # a multiple of each number
            self._times_ns[:], self._values[:] = time_ns, values
            return
        multiples = (number & -number).bit_length()  # 1, 2, 4, ... of which the number is a multiple
        for kept, new in ((self._times_ns, time_ns), (self._values, values)):
            kept[1, :multiples] = kept[0, :multiples]
            kept[0, :multiples] = new
        self._levels = max(self._levels, multiples)

    def kept_samples(self) -> tuple[NDArray[np.int64], Values]:
        """Return the times [ns] (2, levels) and values (2, levels, count) of these samples, later first."""
        levels = min(self._levels + 1, _LEVELS) if self._number else 0
        return self._times_ns[:, :levels], self._values[:, :levels]


def least_accelerations(
    time_ns: int, values: Values, earlier: EarlierSamples, known_to: float
) -> tuple[Values, NDArray[np.int64]]:
    """Return the least accelerations (levels, count) between three samples, and their spans [ns] (levels,).

    Twice the second divided difference is an acceleration at some time between the three samples: the latest
    with ``values`` (count,), and two of ``earlier``. Each value is known to ``known_to``.
    """
    times_ns, kept = earlier.kept_samples()
    distinct = times_ns[0] > times_ns[1]
    times_ns, kept = times_ns[:, distinct], kept[:, distinct]
    later_s, former_s = (time_ns - times_ns[0])[:, None] / NS, (times_ns[0] - times_ns[1])[:, None] / NS
    change = np.abs((values - kept[0]) / later_s - (kept[0] - kept[1]) / former_s)
    change -= 2.0 * known_to / later_s + 2.0 * known_to / former_s
    return change / ((later_s + former_s) / 2.0), time_ns - times_ns[1]
