"""Define the moves of a hand, each as a frozen object, and their form in a file.

A hand is at rest before its first move. A straight move begins and ends at rest. During a straight move, the
speed changes at the hand's acceleration and does not exceed the speed of the move. If a move begins while the
hand still moves, the hand stops first.
"""

from __future__ import annotations

import typing
from dataclasses import replace
from math import pi
from typing import Any

from safety_harness.base.settings import Vector3
from safety_harness.scenario.codec import (
    POINT,
    Below,
    KeyTable,
    QuantityValue,
    Several,
    declared,
    key,
    keyed,
    table_of,
)
from safety_harness.scenario.fields import LARGEST_COORDINATE_M
from safety_harness.scenario.units import LENGTH, NUMBER, RATE, SPEED, TIME

# ISO 13855 takes 2.0 m/s for a hand that reaches from close by (1.6 m/s for a person who walks up).
REACHING_MPS = 2.0

LONGEST_S = 3600.0  # of a run, and of anything in it
FASTEST_MPS = 20.0  # a choice
MOST_TIMES = 1000  # repetitions in a row; a choice
# Bounds of a tremor: a value outside them means a mistaken unit.
TREMORS_M = (1e-5, 0.02)
TREMORS_HZ = (0.1, 20.0)

SPEEDS = QuantityValue(SPEED, above=0.0, most=FASTEST_MPS)
LASTING = QuantityValue(TIME, above=0.0, most=LONGEST_S)
_DISTANCE = QuantityValue(LENGTH, least=0.0, most=LARGEST_COORDINATE_M)
_BOX = Several(
    of=POINT,
    kind="two opposite corners of a box",
    expected="a box: a list of two opposite corners, each a list of three lengths",
    count=2,
)
_AMPLITUDE = QuantityValue(LENGTH, least=TREMORS_M[0], most=TREMORS_M[1])
_RATE = QuantityValue(RATE, least=TREMORS_HZ[0], most=TREMORS_HZ[1])
_TIMES = QuantityValue(NUMBER, least=1, most=MOST_TIMES, whole=True)
_TREMOR_OF_1_MM = "tremor: {amplitude: 1 mm, rate: 8 Hz}"


@declared
class Tremor:
    """A small involuntary motion on an ellipse.

    This motion is added to every move, and also to a hand at rest. At time t, the displacement along each
    axis is ``amplitude_m`` / sqrt(3) sin(2 pi ``rate_hz`` t + phase). The phases come from the scenario's
    seed, and the displacement never exceeds the amplitude.
    """

    amplitude_m: float = key("amplitude", _AMPLITUDE, "the displacement is never larger", _TREMOR_OF_1_MM)
    rate_hz: float = key("rate", _RATE, "of the ellipse that it goes along", _TREMOR_OF_1_MM)

    @property
    def max_speed_mps(self) -> float:
        """The speed that the tremor never exceeds."""
        return self.amplitude_m * 2.0 * pi * self.rate_hz

    @property
    def max_acceleration_mps2(self) -> float:
        """The acceleration that the tremor never exceeds."""
        rate_radps = 2.0 * pi * self.rate_hz
        return self.amplitude_m * rate_radps * rate_radps


TREMOR = table_of(Tremor, "tremor", where="tremor of a hand")


@declared
class MoveTo:
    """Straight motion to a point."""

    position_in_base_m: Vector3 = key("move to", POINT, "straight there")
    speed_mps: float = key("speed", SPEEDS, "how fast the hand moves")


@declared
class Wait:
    """A stop that lasts for a given time, including the time to come to rest."""

    duration_s: float = key("wait", LASTING, "stop, and stay there")


@declared
class Hesitation:
    """A pause during a reach, after which the reach continues.

    At the distance ``distance_m`` from its goal, the hand stops for the time ``duration_s``.
    """

    distance_m: float = key("hesitating at", _DISTANCE, "the distance at which the hand stops on its way")
    duration_s: float = key("for", LASTING, "how long it stops there")


HESITATION = table_of(Hesitation, "hesitation")


@declared
class ReachForTcp:
    """A reach for the moving TCP, until the hand is ``until_distance_m`` from the TCP.

    If the hand does not come so near, for example because the TCP retreats, the reach ends after the time
    ``at_most_s``.
    """

    speed_mps: float = key(
        "reach for tcp",
        SPEEDS,
        "head for the TCP, wherever it is, until that near, or give up; on the way, if the last two "
        "are there, stop that far from it for that long",
    )
    until_distance_m: float = key(
        "stop at distance", _DISTANCE, "the distance to the TCP at which the reach ends", former="until"
    )
    at_most_s: float = key(
        "give up after",
        LASTING,
        "when the hand gives up, if the TCP retreats for that long",
        former="at most",
    )
    hesitation: Hesitation | None = keyed(HESITATION, default=None)


@declared
class ReachForObject:
    """A straight reach to the object's origin, until the hand is ``until_distance_m`` from this origin."""

    speed_mps: float = key("reach for object", SPEEDS, "the same, straight to the object")
    until_distance_m: float = key(
        "stop at distance",
        _DISTANCE,
        "the distance to the object's origin at which the reach ends",
        former="until",
    )
    at_most_s: float = key("give up after", LASTING, "when the hand gives up", former="at most")
    hesitation: Hesitation | None = keyed(HESITATION, default=None)


@declared
class FollowTcp:
    """A pursuit of the TCP for ``duration_s``.

    The hand stops when it is ``distance_m`` from the TCP.
    """

    speed_mps: float = key(
        "follow tcp", SPEEDS, "keep heading for the TCP for that long, to stop that far from it"
    )
    distance_m: float = key("keeping", _DISTANCE, "the distance to the TCP at which the hand stops")
    duration_s: float = key("for", LASTING, "how long the hand follows")


@declared
class Wander:
    """Motion from one random point of a box to the next, for the time ``duration_s``.

    The points are distributed uniformly and drawn from the seed. ``corners_in_base_m`` are two opposite
    corners of the box, in any order.
    """

    speed_mps: float = key(
        "wander",
        SPEEDS,
        "straight from one point of the box to another for that long; the points are drawn from the seed",
    )
    corners_in_base_m: tuple[Vector3, Vector3] = key("within", _BOX, "the box that the hand does not leave")
    duration_s: float = key("for", LASTING, "how long the hand wanders")


@declared
class Sweep:
    """Motion to ``from_in_base_m``, and then ``times`` motions to ``to_in_base_m`` and back."""

    speed_mps: float = key("sweep", SPEEDS, "to the one point, then so many times to the other and back")
    from_in_base_m: Vector3 = key("from", POINT, "where a sweep begins and ends")
    to_in_base_m: Vector3 = key("to", POINT, "where it turns")
    times: int = key("times", _TIMES, "how often it goes there and back")


@declared
class Withdraw:
    """Straight motion back to the hand's start."""

    speed_mps: float = key("withdraw", SPEEDS, "straight back to where the hand started")


HandMove = MoveTo | Wait | ReachForTcp | ReachForObject | FollowTcp | Wander | Sweep | Withdraw
Reach = ReachForTcp | ReachForObject

# Each move as a page shows it, with an example.
_EXAMPLES: dict[type[Any], str] = {
    Wait: "- wait: 1 s",
    MoveTo: "- move to: [840 mm, -350 mm, 5 mm]\n  speed: 0.5 m/s",
    ReachForTcp: "- reach for tcp: 2 m/s\n  stop at distance: 100 mm\n  give up after: 3 s",
    ReachForObject: "- reach for object: 2 m/s\n  stop at distance: 100 mm\n  give up after: 3 s\n"
    "  hesitating at: 400 mm\n  for: 300 ms",
    FollowTcp: "- follow tcp: 0.3 m/s\n  keeping: 250 mm\n  for: 4 s",
    Wander: "- wander: 0.6 m/s\n  within: [[1.0 m, -0.6 m, 0 mm], [1.2 m, -0.4 m, 200 mm]]\n  for: 2 s",
    Sweep: "- sweep: 0.8 m/s\n  from: [0.9 m, -0.3 m, -100 mm]\n  to: [0.9 m, -0.6 m, -100 mm]\n  times: 3",
    Withdraw: "- withdraw: 1.6 m/s",
}


def _table_of_move(kind: type[Any], example: str) -> KeyTable:
    """Return the table of a move.

    The first key gives the move its name, and ``example`` is the example of every key.
    """
    table = table_of(kind, "")
    keys = tuple(replace(key, example=example) for key in table.keys)
    name = keys[0].name
    return replace(table, name=name, where=f"the move {name}", path=f"hands.moves.{name}", keys=keys)


MOVES = tuple(_table_of_move(kind, example) for kind, example in _EXAMPLES.items())
_KINDS = typing.get_args(HandMove)
MOVE = Below(
    tables=MOVES,
    noun="move",
    order=tuple(table.told_by for table in sorted(MOVES, key=lambda table: _KINDS.index(table.kind))),
)


def shifted(point: Vector3, offset: Vector3) -> Vector3:
    """Return ``point`` + ``offset``."""
    return point[0] + offset[0], point[1] + offset[1], point[2] + offset[2]
