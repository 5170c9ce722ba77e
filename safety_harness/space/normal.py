"""The normal distribution between two bounds, by numbers that stay exact far out in either tail."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from statistics import NormalDist

import numpy as np
from numpy.typing import NDArray

Vector = NDArray[np.float64]

_INVERSE = np.frompyfunc(NormalDist().inv_cdf, 1, 1)
_ERFC = np.frompyfunc(math.erfc, 1, 1)
_SMALLEST, _LARGEST = 1e-300, 1.0 - 2.0**-53


@dataclass(frozen=True)
class TruncatedStandardNormal:
    """A standard normal variable z, given that low <= z <= high."""

    low: float
    high: float

    @property
    def mass(self) -> float:
        """How probable low <= z <= high is without the condition."""
        below, above = self._ends
        return above - below

    def quantile(self, u: Vector) -> Vector:
        """(n,) in [0, 1] -> (n,) z with P(Z <= z) = u, rising, its ends the bounds themselves."""
        below, above = self._ends
        p = np.clip(below + (1.0 - u if self._mirrored else u) * (above - below), _SMALLEST, _LARGEST)
        z = np.asarray(_INVERSE(p), float)
        z = np.clip(-z if self._mirrored else z, self.low, self.high)
        return np.where(u <= 0.0, self.low, np.where(u >= 1.0, self.high, z))

    def cumulative(self, z: Vector) -> Vector:
        """(n,) z within the bounds -> (n,) P(Z <= z)."""
        below, above = self._ends
        share = (_lower_tail(-z if self._mirrored else z) - below) / (above - below)
        u: Vector = np.clip(1.0 - share if self._mirrored else share, 0.0, 1.0)
        return u

    @property
    def _mirrored(self) -> bool:
        """Bounds mostly above the mean are computed below it, where small numbers keep their digits."""
        return self.low + self.high > 0.0

    @cached_property
    def _ends(self) -> tuple[float, float]:
        low, high = (-self.high, -self.low) if self._mirrored else (self.low, self.high)
        below, above = _lower_tail(np.array([low, high]))
        return float(below), float(above)


def _lower_tail(z: Vector) -> Vector:
    """P(Z <= z) for a standard normal Z."""
    tail: Vector = 0.5 * np.asarray(_ERFC(-z / math.sqrt(2.0)), float)
    return tail
