"""What a hand can do, one frozen object for each move.

A hand is at rest before its first move.  Straight ways lead from rest to rest: the speed rises and
falls at the hand's acceleration and is at most the move's.  A move that begins while the hand is
still under way first lets it stop.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import pi

from safety_harness.settings import Vector3

# ISO 13855 takes 2.0 m/s for a hand that reaches from close by (1.6 m/s for a person who walks up).
REACHING_MPS = 2.0
# An assumption: a reach of 0.66 m with the minimum-jerk profile of Flash and Hogan (1985) that peaks
# at 2.0 m/s has 1.642 v^2/d = 10 m/s^2 at most.
REACHING_MPS2 = 10.0


@dataclass(frozen=True, kw_only=True)
class Tremor:
    """A small involuntary motion on top of every move, and at rest: an ellipse of that size and rate.

    The displacement is ``amplitude_m`` / sqrt(3) sin(2 pi ``rate_hz`` t + phase) along each axis,
    with phases from the scenario's seed, and so never larger than the amplitude.
    """

    amplitude_m: float
    rate_hz: float

    @property
    def max_speed_mps(self) -> float:
        """The speed that it never exceeds."""
        return self.amplitude_m * 2.0 * pi * self.rate_hz

    @property
    def max_acceleration_mps2(self) -> float:
        """The acceleration that it never exceeds."""
        return self.amplitude_m * (2.0 * pi * self.rate_hz) ** 2


@dataclass(frozen=True, kw_only=True)
class MoveTo:
    """Straight to a point."""

    position_in_base_m: Vector3
    speed_mps: float


@dataclass(frozen=True, kw_only=True)
class Wait:
    """Stop, and stay there; the time to stop counts."""

    duration_s: float


@dataclass(frozen=True, kw_only=True)
class Hesitation:
    """A reach stops ``distance_m`` before its goal for ``duration_s``, then goes on."""

    distance_m: float
    duration_s: float


@dataclass(frozen=True, kw_only=True)
class ReachForTcp:
    """Head for the TCP, wherever it is just now, until ``until_distance_m`` from it.

    Ends after ``at_most_s`` if the TCP gives way for that long.
    """

    speed_mps: float
    until_distance_m: float
    at_most_s: float
    hesitation: Hesitation | None = None


@dataclass(frozen=True, kw_only=True)
class ReachForObject:
    """Straight towards the object's own origin, until ``until_distance_m`` from it."""

    speed_mps: float
    until_distance_m: float
    at_most_s: float
    hesitation: Hesitation | None = None


@dataclass(frozen=True, kw_only=True)
class FollowTcp:
    """Keep heading for the TCP for ``duration_s``, to stop ``distance_m`` from it."""

    speed_mps: float
    distance_m: float
    duration_s: float


@dataclass(frozen=True, kw_only=True)
class Wander:
    """From one point of a box to the next for ``duration_s``; points are uniform, from the seed.

    ``corners_in_base_m`` are two opposite corners of the box, in any order.
    """

    speed_mps: float
    corners_in_base_m: tuple[Vector3, Vector3]
    duration_s: float


@dataclass(frozen=True, kw_only=True)
class Sweep:
    """To one point, then ``times`` times to the other and back."""

    speed_mps: float
    from_in_base_m: Vector3
    to_in_base_m: Vector3
    times: int


@dataclass(frozen=True, kw_only=True)
class Withdraw:
    """Straight back to where the hand started."""

    speed_mps: float


HandMove = MoveTo | Wait | ReachForTcp | ReachForObject | FollowTcp | Wander | Sweep | Withdraw
Reach = ReachForTcp | ReachForObject


def shifted(point: Vector3, by: Vector3) -> Vector3:
    """``point`` + ``by``."""
    return point[0] + by[0], point[1] + by[1], point[2] + by[2]
