"""Distributions for values that vary.

A distribution is an immutable object.  A distribution has a map from the unit cube to values, and the inverse
of this map.  All values are in SI units, and ``unit`` is the name of the SI unit that follows a value in a
file.  Every map converts cube coordinates (n, columns) row by row to values (n, columns), and never rejects a
draw.  If the inverse and then the map are applied to a value, the result should be the same value.  For
``Uniform``, ``Choice`` and ``InBox``, the result is equal to the last bit.  For ``TruncatedNormal``, the
result differs by at most 1e-9 standard deviations.  For all other distributions, the result differs by at
most the fraction 1e-12 of the distribution's size.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from safety_harness.base.elementary import arctan2, cbrt, cos, log, sin
from safety_harness.base.geometry.regions import Box, Region
from safety_harness.base.settings import Vector3
from safety_harness.base.special import lower_tail, normal_quantile

Vector = NDArray[np.float64]
Rows = NDArray[np.float64]  # (n, d): a row a draw, a column a number

# The quantiles of 0 and 1 are infinite, so probabilities are clipped to these.
_SMALLEST, _LARGEST = 1e-300, 1.0 - 2.0**-53
LEAST_MASS = 1e-6  # the least probability of a truncated normal between its bounds


@dataclass(frozen=True)
class Uniform:
    """A uniform distribution between two ends.

    Args:
        low: The lower end.  The constructor raises ValueError unless this end is finite and below ``high``.
        high: The upper end.
        unit: The SI unit.  An empty text means the unit of the replaced value, if it has a unit.

    """

    low: float
    high: float
    unit: str = ""
    columns = 1

    def __post_init__(self) -> None:
        _refuse_unless(math.isfinite(self.high - self.low) and self.low < self.high, "low < high", self)

    @property
    def simplest(self) -> tuple[float, ...]:
        """The value of the interval that is nearest to zero.

        This value is the simplest, because small values mean slow, short and straight motion.
        """
        return (min(max(self.low, 0.0), self.high),)

    def values_at(self, u: Rows) -> Vector:
        """Return the values (n, 1) at the coordinates ``u`` (n, 1).

        The values rise with the coordinate, and the coordinates 0 and 1 give the two ends.
        """
        inside = np.minimum(self.low + u * (self.high - self.low), self.high)  # rounding may overshoot
        return np.where(u >= 1.0, self.high, inside)

    def cube_at(self, values: Rows) -> Vector:
        """Return the coordinates (n, 1) that ``values_at`` maps to ``values`` (n, 1)."""
        u = np.clip((values - self.low) / (self.high - self.low), 0.0, 1.0)
        return _polished(self, u, values)

    def log_density(self, values: Rows) -> Vector:
        """Return the natural logarithm (n,) of the density at ``values`` (n, 1).

        Outside the two ends, it is -inf.
        """
        inside = (values[:, 0] >= self.low) & (values[:, 0] <= self.high)
        return np.where(inside, -log(self.high - self.low), -np.inf)


@dataclass(frozen=True)
class TruncatedNormal:
    """A normal distribution restricted to an interval.

    Args:
        mean: The mean of the unrestricted distribution.
        std: The standard deviation of the unrestricted distribution.  The constructor raises ValueError
            unless it is positive.
        low: The lower end.  The constructor raises ValueError unless this end is below ``high``, and unless
            the unrestricted distribution has a probability of at least one millionth between the two ends.
        high: The upper end.
        unit: The SI unit, as in ``Uniform``.

    """

    mean: float
    std: float
    low: float
    high: float
    unit: str = ""
    columns = 1

    def __post_init__(self) -> None:
        finite = all(map(math.isfinite, (self.mean, self.std, self.high - self.low)))
        _refuse_unless(finite and self.low < self.high and self.std > 0.0, "std > 0 and low < high", self)
        _refuse_unless(self._mass >= LEAST_MASS, "a millionth of it between low and high", self)

    @property
    def simplest(self) -> tuple[float, ...]:
        """The value of the interval that is nearest to zero."""
        return (min(max(self.low, 0.0), self.high),)

    def values_at(self, u: Rows) -> Vector:
        """Return the values (n, 1) at the coordinates ``u`` (n, 1).

        The values rise with the coordinate, and the coordinates 0 and 1 give the two ends.
        """
        p = self._below + (1.0 - u if self._mirrored else u) * self._mass
        z = normal_quantile(np.clip(p, _SMALLEST, _LARGEST))
        z = np.clip(-z if self._mirrored else z, *self._ends)
        inside = np.clip(self.mean + self.std * z, self.low, self.high)
        return np.where(u <= 0.0, self.low, np.where(u >= 1.0, self.high, inside))

    def cube_at(self, values: Rows) -> Vector:
        """Return the coordinates (n, 1) that ``values_at`` maps to ``values`` (n, 1)."""
        z = (values - self.mean) / self.std
        share = (lower_tail(-z if self._mirrored else z) - self._below) / self._mass
        return _polished(self, np.clip(1.0 - share if self._mirrored else share, 0.0, 1.0), values)

    def log_density(self, values: Rows) -> Vector:
        """Return the natural logarithm (n,) of the density at ``values`` (n, 1).

        Outside the two ends, it is -inf.
        """
        value = values[:, 0]
        z = (value - self.mean) / self.std
        constant = log(self.std * math.sqrt(2.0 * math.pi) * self._mass)
        inside = (value >= self.low) & (value <= self.high)
        return np.where(inside, -0.5 * z * z - constant, -np.inf)

    @cached_property
    def _ends(self) -> tuple[float, float]:
        """The two ends, expressed as numbers of standard deviations from the mean."""
        return (self.low - self.mean) / self.std, (self.high - self.mean) / self.std

    @property
    def _mirrored(self) -> bool:
        """Whether to compute with the mirrored distribution.

        This is the case if the interval is mostly above the mean.  The mirrored interval is in the lower
        tail, where probabilities are small numbers that do not lose digits.
        """
        return sum(self._ends) > 0.0

    @cached_property
    def _below(self) -> float:
        """The probability of a value below the interval, or above it if the distribution is mirrored."""
        low, high = self._ends
        return float(lower_tail(np.array(-high if self._mirrored else low)))

    @cached_property
    def _mass(self) -> float:
        """The probability of a value in the interval, for the unrestricted distribution."""
        low, high = self._ends
        return float(lower_tail(np.array(-low if self._mirrored else high))) - self._below


@dataclass(frozen=True)
class Choice:
    """A random choice among alternatives, which are numbered from 0.

    ``labels`` contains a name for each alternative, for people.  Every alternative has an interval of the
    unit cube.  The length of the interval is the alternative's probability.  The inverse map returns the
    middle of the interval.  The constructor raises ValueError unless all ``chances`` are positive.
    """

    labels: tuple[str, ...]
    chances: tuple[float, ...]
    columns = 1
    unit = ""

    def __post_init__(self) -> None:
        right = len(self.labels) == len(self.chances) > 0
        _refuse_unless(right and all(0.0 < c < math.inf for c in self.chances), "chances above 0", self)

    @classmethod
    def even(cls, labels: tuple[str, ...]) -> Choice:
        """Return the choice of equally likely alternatives."""
        return cls(labels, (1.0,) * len(labels))

    @property
    def simplest(self) -> tuple[float, ...]:
        """The first alternative."""
        return (0.0,)

    @cached_property
    def edges(self) -> Vector:
        """The ends (k + 1,) of the k alternatives' intervals in the unit cube, from 0 to 1."""
        edges = np.concatenate([[0.0], np.cumsum(self.chances)])
        scaled: Vector = edges / edges[-1]
        return scaled

    def values_at(self, u: Rows) -> Vector:
        """Return the numbers (n, 1) of the alternatives at the coordinates ``u`` (n, 1)."""
        number = np.searchsorted(self.edges[1:-1], u[:, 0], side="right")
        return number.astype(float)[:, None]

    def cube_at(self, values: Rows) -> Vector:
        """Return the middle (n, 1) of the interval of each alternative in ``values`` (n, 1)."""
        edges, number = self.edges, values[:, 0].astype(int)
        middle: Vector = (edges[number] + edges[number + 1])[:, None] / 2.0
        return middle

    def log_density(self, values: Rows) -> Vector:
        """Return the natural logarithm (n,) of the probability of ``values`` (n, 1).

        If a value is not the number of an alternative, the result is -inf.
        """
        value = np.nan_to_num(values[:, 0], nan=-1.0)
        number = np.clip(value, 0, len(self.chances) - 1).astype(int)
        probable = log(np.array(self.chances) / math.fsum(self.chances))[number]
        return np.where(number == value, probable, -np.inf)


@dataclass(frozen=True)
class InShell:
    """A uniform distribution over the points between two spheres with a common centre.

    Args:
        centre: The centre.
        inner: The radius of the inner sphere.  The constructor raises ValueError unless the radius is at
            least 0 and below ``outer``.
        outer: The radius of the outer sphere.
        unit: The SI unit of the centre and the radii.

    """

    centre: Vector3
    inner: float
    outer: float
    unit: str = "m"
    columns = 3

    def __post_init__(self) -> None:
        finite = all(map(math.isfinite, (*self.centre, self.outer)))
        _refuse_unless(finite and 0.0 <= self.inner < self.outer, "0 <= inner < outer", self)

    @property
    def simplest(self) -> tuple[float, ...]:
        """The point of the inner sphere in the direction of the x axis."""
        x, y, z = self.centre
        return x + self.inner, y, z

    @property
    def _volume(self) -> float:
        """The outer radius cubed minus the inner radius cubed."""
        return float(_cubed(self.outer) - _cubed(self.inner))

    def values_at(self, u: Rows) -> Vector:
        """Return the points (n, 3) at the coordinates ``u`` (n, 3).

        The three coordinates determine the radius, the height and the azimuth.
        """
        # Volume and height are uniform. Zones of equal height on a sphere have equal areas (Archimedes).
        r = cbrt(_cubed(self.inner) + u[:, 0] * self._volume)
        height, azimuth = 2.0 * u[:, 1] - 1.0, 2.0 * math.pi * u[:, 2]
        across = np.sqrt(np.maximum(1.0 - height * height, 0.0))
        direction = np.stack([across * cos(azimuth), across * sin(azimuth), height], axis=1)
        points: Vector = self.centre + r[:, None] * direction
        return points

    def cube_at(self, values: Rows) -> Vector:
        """Return the coordinates (n, 3) that ``values_at`` maps to the points ``values`` (n, 3).

        For the centre and the poles, which have no azimuth, the third coordinate is 0.
        """
        x, y, z = (values - np.array(self.centre)).T
        r = np.sqrt(x * x + y * y + z * z)
        volume = (_cubed(r) - _cubed(self.inner)) / self._volume
        height = np.divide(z, r, out=np.zeros_like(z), where=r > 0.0)
        azimuth = np.mod(arctan2(y, x) / (2.0 * math.pi), 1.0)
        u: Rows = np.clip(np.stack([volume, (height + 1.0) / 2.0, azimuth], axis=1), 0.0, 1.0)
        return u

    def log_density(self, values: Rows) -> Vector:
        """Return the natural logarithm (n,) of the density at ``values`` (n, 3).

        Outside the shell, it is -inf.  The radii have a tolerance of 1e-12 for rounding.
        """
        r = np.linalg.norm(values - np.array(self.centre), axis=1)
        slack = 1e-12 * (self.outer + float(np.abs(self.centre).max()))
        inside = (r >= self.inner - slack) & (r <= self.outer + slack)
        volume = 4.0 / 3.0 * math.pi * self._volume
        return np.where(inside, -log(volume), -np.inf)


@dataclass(frozen=True)
class InBox:
    """A uniform distribution over the points of a box.

    Args:
        low: The lowest corner.  The constructor raises ValueError unless each coordinate is below the same
            coordinate of ``high``.
        high: The highest corner.
        unit: The SI unit of the corners.

    """

    low: Vector3
    high: Vector3
    unit: str = "m"
    columns = 3

    def __post_init__(self) -> None:
        _ = self.sides

    @cached_property
    def sides(self) -> tuple[Uniform, ...]:
        """The distribution of each coordinate."""
        return tuple(Uniform(low, high) for low, high in zip(self.low, self.high, strict=True))

    @property
    def simplest(self) -> tuple[float, ...]:
        """The centre."""
        return tuple(
            min(max(round((low + high) / 2.0, 12) + 0.0, low), high)
            for low, high in zip(self.low, self.high, strict=True)
        )

    def values_at(self, u: Rows) -> Vector:
        """Return the points (n, 3) at ``u`` (n, 3).

        Each coordinate depends on one column of ``u``.
        """
        return np.hstack([side.values_at(u[:, [k]]) for k, side in enumerate(self.sides)])

    def cube_at(self, values: Rows) -> Vector:
        """Return the coordinates (n, 3) that ``values_at`` maps to the points ``values`` (n, 3)."""
        return np.hstack([side.cube_at(values[:, [k]]) for k, side in enumerate(self.sides)])

    def log_density(self, values: Rows) -> Vector:
        """Return the natural logarithm (n,) of the density at ``values`` (n, 3).

        Outside the box, it is -inf.
        """
        each = (side.log_density(values[:, [k]]) for k, side in enumerate(self.sides))
        return sum(each, np.zeros(len(values)))


@dataclass(frozen=True)
class InRegion:
    """A uniform distribution over the points of a named region.

    The region is a box, or a larger box with a hole.

    Args:
        name: The name: "seen hand", "unseen hand", "seen tcp" or "unseen tcp".
        region: The region.  It is None until the reader of the space knows which avoider's seen space
            applies.  If the value is a shift, such as the offset of the TCP start, the region contains
            shifts.

    """

    name: str
    region: Region | None = None
    columns = 3
    unit = "m"

    @property
    def known(self) -> Region:
        """The region that the reader has found for the name.

        The region is known only after the reader has resolved the name.
        """
        assert self.region is not None, "a region that reading has not resolved"
        return self.region

    @property
    def simplest(self) -> tuple[float, ...]:
        """The centre of the box, or the middle of the nearest face of the hole if there is a hole."""
        hole = self.known.hole
        if hole is None:
            return self.known.outer.centre_m
        axis, _, _, face = self.sides_of(hole)[0]
        return (*hole.centre_m[:axis], face, *hole.centre_m[axis + 1 :])

    def sides_of(self, hole: Box) -> list[tuple[int, float, float, float]]:
        """Return a tuple for the space outside each face of the hole.

        The tuple is (axis, lowest coordinate, highest coordinate, coordinate of the face).  The face that is
        nearest to the hole's centre comes first.
        """
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
        # Rounded, so that faces at equal distances keep their order whatever the last bits are.
        return sorted(sides, key=lambda side: round(abs(side[3] - centre[side[0]]), 9))

    def values_at(self, u: Rows) -> Vector:
        """Return the points (n, 3) at the coordinates ``u`` (n, 3).

        The first coordinate also selects one of at most six boxes that make up the region.
        """
        low, high, edges = self._pieces
        piece = np.searchsorted(edges[1:-1], u[:, 0], side="right")
        inner = u.copy()
        inner[:, 0] = (u[:, 0] - edges[piece]) / (edges[piece + 1] - edges[piece])
        points: Vector = np.clip(low[piece] + inner * (high - low)[piece], low[piece], high[piece])
        return points

    def cube_at(self, values: Rows) -> Vector:
        """Return the coordinates (n, 3) that ``values_at`` maps to the points ``values`` (n, 3).

        If a point is on the common face of two boxes, the first box is used.
        """
        low, high, edges = self._pieces
        inside = np.all((values[:, None] >= low) & (values[:, None] <= high), axis=2)
        piece = inside.argmax(axis=1)
        u: Rows = np.clip((values - low[piece]) / (high - low)[piece], 0.0, 1.0)
        first = edges[piece] + u[:, 0] * (edges[piece + 1] - edges[piece])
        # The end of an interval selects the next box, so the coordinate stays one float below it.
        last = piece == len(low) - 1
        u[:, 0] = np.where(last, first, np.minimum(first, np.nextafter(edges[piece + 1], 0.0)))
        return u

    def log_density(self, values: Rows) -> Vector:
        """Return the natural logarithm (n,) of the density at ``values`` (n, 3).

        Outside the region, it is -inf.
        """
        low, high, _ = self._pieces
        volume_m3 = math.fsum(np.prod(high - low, axis=1))
        return np.where(self.known.contains(values), -log(volume_m3), -np.inf)

    @property
    def edges(self) -> Vector:
        """The ends of the k intervals of the first coordinate, shape (k + 1,).

        The k intervals select the k boxes.  The ends rise from 0 to 1.
        """
        return self._pieces[2]

    @cached_property
    def _pieces(self) -> tuple[Vector, Vector, Vector]:
        """The corners of the region's k boxes, and ``edges`` (k + 1,).

        The lowest corners and the highest corners are two arrays (k, 3).
        """
        pieces = self.known.pieces
        low, high = (np.array([getattr(piece, end) for piece in pieces]) for end in ("low_m", "high_m"))
        edges = np.concatenate([[0.0], np.cumsum([piece.volume_m3 for piece in pieces])])
        return low, high, edges / edges[-1]


Distribution: TypeAlias = Uniform | TruncatedNormal | Choice | InBox | InShell | InRegion


def _cubed(x: float | Vector) -> float | Vector:
    """Return the third power of a number."""
    return x * x * x


def _polished(distribution: Uniform | TruncatedNormal, u: Rows, values: Rows) -> Vector:
    """Return the coordinates ``u`` with a correction of their last digits.

    If possible, the corrected coordinates map exactly to ``values``.

    The search covers the four nearest floats on either side.
    """
    rows = np.flatnonzero(distribution.values_at(u)[:, 0] != values[:, 0])
    if not len(rows):
        return u
    lower = upper = u[rows]
    for _ in range(4):
        lower, upper = np.nextafter(lower, 0.0), np.nextafter(upper, 1.0)
        for candidate in (lower, upper):
            exact = distribution.values_at(candidate)[:, 0] == values[rows, 0]
            u[rows[exact]] = candidate[exact]
    return u


def _refuse_unless(condition: bool, expected: str, got: object) -> None:
    """Raise ValueError unless ``condition`` is true."""
    if not condition:
        raise ValueError(f"expected {expected}; got {got}")
