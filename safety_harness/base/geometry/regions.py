"""Regions of space: axis-parallel boxes, and shells between a box and a hole inside the box."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from safety_harness.base.exceptions import RegionError
from safety_harness.base.settings import Vector3

Vector = NDArray[np.float64]


@dataclass(frozen=True)
class Box:
    """An axis-parallel box, which includes its boundary.

    Args:
        low_m: The lowest corner in the base frame.
        high_m: The highest corner.  If one of its coordinates is not above the same coordinate of ``low_m``,
            the constructor raises RegionError.

    """

    low_m: Vector3
    high_m: Vector3

    def __post_init__(self) -> None:
        low, high = np.array(self.low_m), np.array(self.high_m)
        right = low.shape == high.shape == (3,) and bool(
            np.all(low < high) and np.all(np.isfinite(high - low))
        )
        if not right:
            expected = "three finite lower bounds, each below its upper bound"
            raise RegionError.of_option("box", expected, f"{self.low_m} and {self.high_m}")

    @classmethod
    def centred_at(cls, centre_m: Vector3, half_size_m: Vector3, factor: float = 1.0) -> Box:
        """Return the box around a given centre.

        Args:
            centre_m: The centre in the base frame.
            half_size_m: Half of the box's size along each axis.
            factor: Multiplies the half-sizes.

        """
        centre, half = np.array(centre_m), factor * np.array(half_size_m)
        return cls(_vector3(centre - half), _vector3(centre + half))

    about = centred_at  # deprecated: the old name, for one release

    def grown(self, factor: float) -> Box:
        """Return the box that has the same centre and whose sides are ``factor`` times as long.

        Its corners are rounded to a picometre, so that boxes computed in different ways have equal corners.
        """
        low, high = np.array(self.low_m), np.array(self.high_m)
        centre, half = (low + high) / 2.0, factor * (high - low) / 2.0
        return Box(_vector3(np.round(centre - half, 12) + 0.0), _vector3(np.round(centre + half, 12) + 0.0))

    @property
    def centre_m(self) -> Vector3:
        """The centre, rounded to a picometre."""
        return _vector3(np.round((np.array(self.low_m) + self.high_m) / 2.0, 12) + 0.0)

    @property
    def volume_m3(self) -> float:
        """The volume."""
        return float(np.prod(np.array(self.high_m) - self.low_m))

    def shifted(self, by_m: Vector3) -> Box:
        """Return this box shifted by ``by_m``, with its corners rounded to a picometre."""
        low, high = (np.round(np.array(corner) + by_m, 12) + 0.0 for corner in (self.low_m, self.high_m))
        return Box(_vector3(low), _vector3(high))

    def contains(self, points_in_base_m: Vector) -> NDArray[np.bool_]:
        """Return which points are in the box.

        A point with a NaN coordinate is not in the box.

        Args:
            points_in_base_m: The points (..., 3).

        Returns:
            An array (...) of booleans.

        """
        inside: NDArray[np.bool_] = np.all(
            (points_in_base_m >= self.low_m) & (points_in_base_m <= self.high_m), axis=-1
        )
        return inside

    def outside_m(self, points_in_base_m: Vector) -> Vector:
        """Return the distance [m] of each point to the box.

        The distance is 0 inside the box, and NaN for a point with a NaN coordinate.

        Args:
            points_in_base_m: The points (..., 3).

        Returns:
            An array (...).

        """
        excess = np.maximum(np.array(self.low_m) - points_in_base_m, points_in_base_m - np.array(self.high_m))
        outside: Vector = np.linalg.norm(np.maximum(excess, 0.0), axis=-1)
        return outside


@dataclass(frozen=True)
class Region:
    """A box, or the shell between a box and a hole inside the box.

    Args:
        outer: The box.
        hole: The hole, or None if there is no hole.  RegionError if the hole extends beyond the box or fills
            the box.

    """

    outer: Box
    hole: Box | None = None

    def __post_init__(self) -> None:
        if self.hole is None:
            return
        inside = np.all(np.array(self.hole.low_m) >= self.outer.low_m) and np.all(
            np.array(self.hole.high_m) <= self.outer.high_m
        )
        if not inside or self.hole == self.outer:
            expected = "a hole inside the outer box that leaves something of it"
            raise RegionError.of_option("shell", expected, f"the hole {self.hole} in {self.outer}")

    def contains(self, points_in_base_m: Vector) -> NDArray[np.bool_]:
        """Return which points are in the region.

        The boundary of the hole belongs to the region.

        Args:
            points_in_base_m: The points (..., 3).

        Returns:
            An array (...) of booleans.

        """
        inside = self.outer.contains(points_in_base_m)
        if self.hole is not None:
            inside &= ~np.all(
                (points_in_base_m > self.hole.low_m) & (points_in_base_m < self.hole.high_m), axis=-1
            )
        return inside

    def draw(self, rng: np.random.Generator, count: int) -> Vector:
        """Return random points (count, 3) with a uniform distribution over the region.

        Each point needs four uniform random numbers.  A shell is split into at most six boxes.  One number
        selects a box with a probability proportional to its volume.  Three numbers place a point in the box,
        so no draw is rejected.

        Args:
            rng: The source of the numbers.
            count: The number of points.

        """
        boxes = self.pieces
        low = np.array([box.low_m for box in boxes])  # (pieces, 3)
        size = np.array([box.high_m for box in boxes]) - low
        volume = np.prod(size, axis=1)
        uniform = rng.random((count, 4))
        # The last sum is left out, because its rounding could lead beyond the last piece.
        chosen = np.searchsorted(np.cumsum(volume)[:-1] / volume.sum(), uniform[:, 0], side="right")
        points: Vector = low[chosen] + uniform[:, 1:] * size[chosen]
        return points

    @property
    def pieces(self) -> tuple[Box, ...]:
        """The boxes, at most six, that fill the region without overlap."""
        return tuple(self._pieces())

    def shifted(self, by_m: Vector3) -> Region:
        """Return this region shifted by ``by_m``."""
        return Region(self.outer.shifted(by_m), None if self.hole is None else self.hole.shifted(by_m))

    def _pieces(self) -> Iterator[Box]:
        """Yield, for each axis, the boxes below and above the hole."""
        if self.hole is None:
            yield self.outer
            return
        low, high = list(self.outer.low_m), list(self.outer.high_m)
        for axis in range(3):
            for first, last in (
                (low[axis], self.hole.low_m[axis]),
                (self.hole.high_m[axis], high[axis]),
            ):
                if first < last:
                    piece_low, piece_high = low.copy(), high.copy()
                    piece_low[axis], piece_high[axis] = first, last
                    yield Box(_vector3(np.array(piece_low)), _vector3(np.array(piece_high)))
            # The pieces of the next axes are only as wide as the hole here, so that no two pieces overlap.
            low[axis], high[axis] = self.hole.low_m[axis], self.hole.high_m[axis]


def _vector3(array: Vector) -> Vector3:
    """Return an array (3,) as three floats."""
    return float(array[0]), float(array[1]), float(array[2])
