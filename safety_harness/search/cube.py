"""The unit cube of a searcher: its coordinates, their intervals, and the points with the same scenario."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from safety_harness.space.distributions import Choice, InRegion
from safety_harness.space.space import ScenarioSpace

Point = NDArray[np.float64]  # (d,): of the unit cube
Points = NDArray[np.float64]  # (n, d): of the unit cube, one a row
Scores = NDArray[np.float64]  # (n, k): one a claim, NaN where nothing was learnt of it


@dataclass(frozen=True, eq=False)
class Column:
    """One coordinate of the cube.

    ``edges`` divide the range from 0 to 1 into intervals, and the scenario may change abruptly at an edge. A
    ``flat`` coordinate chooses among alternatives, so that the scenario is the same everywhere between two
    edges.
    """

    edges: tuple[float, ...] = (0.0, 1.0)
    flat: bool = False

    def interval_of(self, u: NDArray[np.float64]) -> NDArray[np.int64]:
        """Return the numbers of the intervals that contain the coordinates ``u`` (n,).

        The result has the shape (n,).
        """
        return np.searchsorted(np.array(self.edges[1:-1]), u, side="right")

    def middle_of(self, interval: NDArray[np.int64]) -> NDArray[np.float64]:
        """Return the middle of each interval whose number is in ``interval`` (n,), shape (n,)."""
        edges = np.array(self.edges)
        middle: NDArray[np.float64] = (edges[interval] + edges[interval + 1]) / 2.0
        return middle


def _all_used(points: Points) -> NDArray[np.bool_]:
    """Return True for every coordinate of ``points`` (n, d).

    This means that all coordinates influence the scenario.
    """
    return np.ones(points.shape, bool)


@dataclass(frozen=True, eq=False)
class Cube:
    """The unit cube of a space.

    ``same`` is a function that maps points (n, d) to the canonical points of their scenarios. If ``same`` is
    None, ``canonical`` uses only the columns. ``used`` is a function that returns, for points (n, d), which
    coordinates influence the scenario.
    """

    columns: tuple[Column, ...]
    same: Callable[[Points], Points] | None = None
    used: Callable[[Points], NDArray[np.bool_]] = _all_used

    @property
    def dimension(self) -> int:
        """The number of coordinates."""
        return len(self.columns)

    @classmethod
    def from_space(cls, space: ScenarioSpace) -> Cube:
        """Return the cube of a scenario ``space``."""
        columns = [Column() for _ in range(space.dimension)]
        for parameter in space.parameters:
            distribution = parameter.distribution
            if isinstance(distribution, Choice | InRegion):
                edges = tuple(distribution.edges.tolist())
                columns[parameter.column] = Column(edges, flat=isinstance(distribution, Choice))

        def same(points: Points) -> Points:
            return space.cube_at(space.values_at(points))

        def used(points: Points) -> NDArray[np.bool_]:
            mask = np.zeros(points.shape, bool)
            values = space.values_at(points)
            for parameter, uses in zip(space.parameters, space.used_by(values), strict=True):
                mask[:, parameter.columns] = uses[:, None]
            return mask

        return cls(tuple(columns), same, used)

    of = from_space  # deprecated: the old name, for one release

    @property
    def flat_columns(self) -> NDArray[np.int64]:
        """The numbers of the coordinates that choose among alternatives."""
        return np.flatnonzero([column.flat for column in self.columns])

    def canonical(self, points: Points) -> Points:
        """Return the canonical points of ``points`` (n, d).

        A flat coordinate becomes the middle of its interval, so that it has the same value at all points with
        the same alternative. A coordinate that the scenario does not use becomes 0.5. All other coordinates
        stay the same.
        """
        if self.same is not None:
            return self.same(points)
        middles = points.copy()
        for number in self.flat_columns:
            column = self.columns[number]
            middles[:, number] = column.middle_of(column.interval_of(points[:, number]))
        return middles

    def distances(self, points: Points, to: Point) -> NDArray[np.float64]:
        """Return the distances (n,) of ``points`` from ``to``.

        A distance is the root mean square over the coordinates. In a flat coordinate, two different
        alternatives have the distance 1. In many coordinates, two random points are about 0.41 apart.

        Args:
            points: (n, d) canonical points.
            to: (d,) a canonical point.

        """
        difference = points - to
        flat = self.flat_columns
        difference[:, flat] = difference[:, flat] != 0.0
        rms: NDArray[np.float64] = np.sqrt(np.mean(difference * difference, axis=1))
        return rms
