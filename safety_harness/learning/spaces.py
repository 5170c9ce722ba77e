"""Where TCPs and hands of a data set are: the seen space and the three unseen ones (Table 3 of the paper).

The paper gives the seen hands (nominal +- 300 mm, section 4.1) and no other bound.  Ours, chosen before
any result, and why:

* Seen TCPs lie within +-(60, 150, 100) mm of the desired position, x narrowest as in the paper: in the
  default cell all of that box is within reach of the arm and has the object in view.
* Unseen TCPs lie outside that box and inside one of twice its half-sizes.  They border on what was seen (a
  TCP on its rim that gives way by R = 100 mm ends there) and seven eighths of the larger box are new.  In
  the default cell the arm reaches all of them; in about a fifth the object is partly out of view.
* Unseen hands lie outside the seen box and inside one of 1.5 times its half-sizes, and no hand's centre is
  below the table's top.  A hand only shifts the target, by 0.05 of its own displacement (eq. 13), so that
  little would be learnt further away, and twice the box would have hands among the arm's own links.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from safety_harness.exceptions import DatasetError, Place
from safety_harness.settings import Settings, Vector3

Vector = NDArray[np.float64]

SEEN_TCP_HALF_SIZE_M: Vector3 = (0.060, 0.150, 0.100)
SEEN_HAND_HALF_SIZE_M: Vector3 = (0.300, 0.300, 0.300)
UNSEEN_TCP_FACTOR = 2.0
UNSEEN_HAND_FACTOR = 1.5


@dataclass(frozen=True)
class Box:
    """An axis-parallel box in the base frame, its boundary included; DatasetError unless low < high."""

    low_m: Vector3
    high_m: Vector3

    def __post_init__(self) -> None:
        low, high = np.array(self.low_m), np.array(self.high_m)
        right = low.shape == high.shape == (3,) and bool(
            np.all(low < high) and np.all(np.isfinite(high - low))
        )
        if not right:
            raise DatasetError(
                place=Place(field="box"),
                expected="three finite lower bounds, each below its upper bound",
                got=f"{self.low_m} and {self.high_m}",
            )

    @classmethod
    def about(cls, centre_m: Vector3, half_size_m: Vector3, factor: float = 1.0) -> Box:
        """The box of ``factor`` times the half-sizes about a centre."""
        centre, half = np.array(centre_m), factor * np.array(half_size_m)
        return cls(_vector3(centre - half), _vector3(centre + half))

    def contains(self, points_in_base_m: Vector) -> NDArray[np.bool_]:
        """(..., 3) -> (...): which points are in the box; NaN is not."""
        inside: NDArray[np.bool_] = np.all(
            (points_in_base_m >= self.low_m) & (points_in_base_m <= self.high_m), axis=-1
        )
        return inside


@dataclass(frozen=True)
class Region:
    """A box, or the shell between it and a hole inside it.  DatasetError if nothing is left."""

    outer: Box
    hole: Box | None = None

    def __post_init__(self) -> None:
        if self.hole is None:
            return
        inside = np.all(np.array(self.hole.low_m) >= self.outer.low_m) and np.all(
            np.array(self.hole.high_m) <= self.outer.high_m
        )
        if not inside or self.hole == self.outer:
            raise DatasetError(
                place=Place(field="shell"),
                expected="a hole inside the outer box that leaves something of it",
                got=f"the hole {self.hole} in {self.outer}",
            )

    def contains(self, points_in_base_m: Vector) -> NDArray[np.bool_]:
        """(..., 3) -> (...): in the box and not in the hole; the hole's boundary belongs to the shell."""
        inside = self.outer.contains(points_in_base_m)
        if self.hole is not None:
            inside &= ~np.all(
                (points_in_base_m > self.hole.low_m) & (points_in_base_m < self.hole.high_m), axis=-1
            )
        return inside

    def draw(self, rng: np.random.Generator, count: int) -> Vector:
        """(count, 3) points, uniform over the region, four uniform numbers a point.

        The shell is cut into at most six boxes; one is chosen by its volume and drawn into, so nothing
        is ever thrown away.
        """
        boxes = list(self._pieces())
        low = np.array([box.low_m for box in boxes])  # (pieces, 3)
        size = np.array([box.high_m for box in boxes]) - low
        volume = np.prod(size, axis=1)
        uniform = rng.random((count, 4))
        chosen = np.searchsorted(np.cumsum(volume)[:-1] / volume.sum(), uniform[:, 0], side="right")
        points: Vector = low[chosen] + uniform[:, 1:] * size[chosen]
        return points

    def _pieces(self) -> Iterator[Box]:
        """Boxes that fill the region without overlap: below and above the hole, axis by axis."""
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
            low[axis], high[axis] = self.hole.low_m[axis], self.hole.high_m[axis]


@dataclass(frozen=True)
class Space:
    """Where the TCPs and, independently of them, the hands of a data set are."""

    name: str
    tcp: Region
    hand: Region

    def draw_tcps(self, rng: np.random.Generator, count: int) -> Vector:
        """(count, 3) TCP positions in the base frame [m], uniform."""
        return self.tcp.draw(rng, count)

    def draw_hands(self, rng: np.random.Generator, count: int) -> Vector:
        """(count, 3) hand positions in the base frame [m], uniform."""
        return self.hand.draw(rng, count)

    def contains(self, *, hand_in_base_m: Vector, tcp_in_base_m: Vector) -> NDArray[np.bool_]:
        """(..., 3) each -> (...): which pairs belong to the space."""
        return self.hand.contains(hand_in_base_m) & self.tcp.contains(tcp_in_base_m)


def seen(settings: Settings) -> Space:
    """Where training happens: TCPs about the desired one, hands about the nominal one."""
    return Space("seen", Region(_seen_tcps(settings)), Region(_seen_hands(settings)))


def unseen_hand(settings: Settings) -> Space:
    """Seen TCPs with hands that were not."""
    return Space("unseen hand", Region(_seen_tcps(settings)), _hands_around(settings))


def unseen_tcp(settings: Settings) -> Space:
    """Seen hands with TCPs that were not."""
    return Space("unseen tcp", _tcps_around(settings), Region(_seen_hands(settings)))


def unseen_both(settings: Settings) -> Space:
    """Neither the hand nor the TCP was seen."""
    return Space("unseen both", _tcps_around(settings), _hands_around(settings))


SPACES: dict[str, Callable[[Settings], Space]] = {
    "seen": seen,
    "unseen hand": unseen_hand,
    "unseen tcp": unseen_tcp,
    "unseen both": unseen_both,
}


def space_named(name: str, settings: Settings) -> Space:
    """The space that a user names; DatasetError with the four names for any other."""
    if name not in SPACES:
        raise DatasetError(
            place=Place(field="space"), expected=f"one of {', '.join(map(repr, SPACES))}", got=repr(name)
        )
    return SPACES[name](settings)


def _seen_tcps(settings: Settings) -> Box:
    return Box.about(settings.cell.desired_tcp_position_in_base_m, SEEN_TCP_HALF_SIZE_M)


def _seen_hands(settings: Settings) -> Box:
    return Box.about(settings.avoidance.nominal_hand_position_in_base_m, SEEN_HAND_HALF_SIZE_M)


def _tcps_around(settings: Settings) -> Region:
    centre = settings.cell.desired_tcp_position_in_base_m
    return Region(Box.about(centre, SEEN_TCP_HALF_SIZE_M, UNSEEN_TCP_FACTOR), _seen_tcps(settings))


def _hands_around(settings: Settings) -> Region:
    hole = _seen_hands(settings)
    outer = Box.about(
        settings.avoidance.nominal_hand_position_in_base_m, SEEN_HAND_HALF_SIZE_M, UNSEEN_HAND_FACTOR
    )
    x, y, z = outer.low_m
    above_table_m = min(max(z, settings.cell.table_height_m), hole.low_m[2])
    return Region(Box((x, y, above_table_m), outer.high_m), hole)


def _vector3(array: Vector) -> Vector3:
    return float(array[0]), float(array[1]), float(array[2])
