"""Points in boxes and in named regions, as distributions: uniform in volume."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from safety_harness.geometry.regions import Box, Region
from safety_harness.settings import Vector3
from safety_harness.space.distributions import Choice, InShell, TruncatedNormal, Uniform

Vector = NDArray[np.float64]


@dataclass(frozen=True)
class InBox:
    """Every point of a box between two corners alike.  ValueError unless low < high in each coordinate."""

    low: Vector3
    high: Vector3
    unit: str = "m"
    columns = 3

    def __post_init__(self) -> None:
        _ = self.sides

    @cached_property
    def sides(self) -> tuple[Uniform, ...]:
        """Each coordinate by itself."""
        return tuple(Uniform(low, high) for low, high in zip(self.low, self.high, strict=True))

    @property
    def simplest(self) -> tuple[float, ...]:
        """The centre."""
        return tuple(
            min(max(round((low + high) / 2.0, 12) + 0.0, low), high)
            for low, high in zip(self.low, self.high, strict=True)
        )

    def values_at(self, u: Vector) -> Vector:
        """(n, 3) -> (n, 3), coordinate by coordinate."""
        return np.hstack([side.values_at(u[:, [k]]) for k, side in enumerate(self.sides)])

    def cube_at(self, values: Vector) -> Vector:
        """The inverse of ``values_at``."""
        return np.hstack([side.cube_at(values[:, [k]]) for k, side in enumerate(self.sides)])

    def log_density(self, values: Vector) -> Vector:
        """(n, 3) -> (n,) natural logarithm; -inf outside."""
        density = np.zeros(len(values))
        for k, side in enumerate(self.sides):
            density = density + side.log_density(values[:, [k]])
        return density


@dataclass(frozen=True)
class InRegion:
    """Every point of a named region alike: of a box, or of the shell around a hole in one.

    ``region`` is None until the space is read, which knows whose seen space is meant.  Where the point
    is a shift (the TCP start's offset), so is the region.
    """

    name: str
    region: Region | None = None
    columns = 3
    unit = "m"

    @property
    def known(self) -> Region:
        """The region itself."""
        assert self.region is not None, "a region that reading has not resolved"
        return self.region

    @property
    def simplest(self) -> tuple[float, ...]:
        """The box's centre; of a shell, the middle of the hole's nearest side."""
        hole = self.known.hole
        if hole is None:
            return self.known.outer.centre_m
        axis, _, _, face = self.sides_of(hole)[0]
        return (*hole.centre_m[:axis], face, *hole.centre_m[axis + 1 :])

    def sides_of(self, hole: Box) -> list[tuple[int, float, float, float]]:
        """(axis, least, most, the hole's face) beyond each face of the hole, the nearest face first."""
        outer, centre = self.known.outer, hole.centre_m
        sides = [
            (axis, low, high, face)
            for axis in range(3)
            for low, high, face in (
                (hole.high_m[axis], outer.high_m[axis], hole.high_m[axis]),
                (outer.low_m[axis], hole.low_m[axis], hole.low_m[axis]),
            )
            if low < high
        ]
        return sorted(sides, key=lambda side: round(abs(side[3] - centre[side[0]]), 9))

    def values_at(self, u: Vector) -> Vector:
        """(n, 3) -> (n, 3): the first coordinate picks one of at most six boxes as well."""
        low, high, edges = self._pieces
        piece = np.searchsorted(edges[1:-1], u[:, 0], side="right")
        within = u.copy()
        within[:, 0] = (u[:, 0] - edges[piece]) / (edges[piece + 1] - edges[piece])
        points: Vector = np.clip(low[piece] + within * (high - low)[piece], low[piece], high[piece])
        return points

    def cube_at(self, values: Vector) -> Vector:
        """The inverse of ``values_at``; of a side that two boxes share, in the first."""
        low, high, edges = self._pieces
        inside = np.all((values[:, None] >= low) & (values[:, None] <= high), axis=2)
        piece = inside.argmax(axis=1)
        u: Vector = np.clip((values - low[piece]) / (high - low)[piece], 0.0, 1.0)
        first = edges[piece] + u[:, 0] * (edges[piece + 1] - edges[piece])
        last = piece == len(low) - 1
        u[:, 0] = np.where(last, first, np.minimum(first, np.nextafter(edges[piece + 1], 0.0)))
        return u

    def log_density(self, values: Vector) -> Vector:
        """(n, 3) -> (n,) natural logarithm; -inf outside."""
        low, high, _ = self._pieces
        volume_m3 = math.fsum(np.prod(high - low, axis=1))
        return np.where(self.known.contains(values), -math.log(volume_m3), -np.inf)

    @property
    def edges(self) -> Vector:
        """(k + 1,) from 0 to 1: where along the first coordinate one box ends and the next begins."""
        return self._pieces[2]

    @cached_property
    def _pieces(self) -> tuple[Vector, Vector, Vector]:
        """Corners (k, 3) and the edges (k + 1,) of the boxes' shares of the first coordinate."""
        pieces = self.known.pieces
        low, high = (np.array([getattr(piece, end) for piece in pieces]) for end in ("low_m", "high_m"))
        edges = np.concatenate([[0.0], np.cumsum([piece.volume_m3 for piece in pieces])])
        return low, high, edges / edges[-1]


Distribution: TypeAlias = Uniform | TruncatedNormal | Choice | InBox | InShell | InRegion
