"""Reading what a hand does: one function for each move."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from safety_harness.scenario.fields import LARGEST_COORDINATE_M, Field, Fields
from safety_harness.scenario.model import MovingHand
from safety_harness.scenario.moves import (
    FollowTcp,
    HandMove,
    Hesitation,
    MoveTo,
    ReachForObject,
    ReachForTcp,
    Sweep,
    Wait,
    Wander,
    Withdraw,
)
from safety_harness.scenario.units import LENGTH, SPEED, TIME, near_miss, shown
from safety_harness.settings import Vector3

LONGEST_S = 3600.0  # of a run, and of anything in it
FASTEST_MPS = 20.0
MOST_TIMES = 1000
SMALLEST_BOX_M = 0.01  # from corner to corner
SHORTEST_SWEEP_M = 0.001


def read_position(field: Field) -> Vector3:
    """A point in the base frame, or a shift, with a bound that catches slips of the unit."""
    return field.vector(LENGTH, largest=LARGEST_COORDINATE_M)


def read_move(field: Field, hand: MovingHand) -> HandMove:
    """The move that one of its keys names; ``hand`` is whose, with its bounds."""
    names = ", ".join(MOVES)
    given = [key for key, _ in field.entries(f"a move: a mapping with one of the keys {names}")]
    kinds = [key for key in given if key in MOVES]
    if len(kinds) != 1:
        hint = near_miss(given[0], MOVES) if given and not kinds else ""
        got = f"the keys {', '.join(map(shown, given))}" if given else "an empty mapping"
        raise field.error(f"one move: one of the keys {names}", got=got, hint=hint)
    further_keys, read = MOVES[kinds[0]]
    return read(field.fields((kinds[0], *further_keys)), hand)


def _move_to(move: Fields, hand: MovingHand) -> MoveTo:
    position_in_base_m = read_position(move.required("move to"))
    return MoveTo(position_in_base_m=position_in_base_m, speed_mps=_speed(move.required("speed"), hand))


def _wait(move: Fields, hand: MovingHand) -> Wait:
    return Wait(duration_s=_duration(move.required("wait")))


def _reach_for_tcp(move: Fields, hand: MovingHand) -> ReachForTcp:
    return ReachForTcp(
        speed_mps=_speed(move.required("reach for tcp"), hand),
        until_distance_m=_distance(move.required("until")),
        at_most_s=_duration(move.required("at most")),
        hesitation=_hesitation(move),
    )


def _reach_for_object(move: Fields, hand: MovingHand) -> ReachForObject:
    return ReachForObject(
        speed_mps=_speed(move.required("reach for object"), hand),
        until_distance_m=_distance(move.required("until")),
        at_most_s=_duration(move.required("at most")),
        hesitation=_hesitation(move),
    )


def _hesitation(reach: Fields) -> Hesitation | None:
    """Where a reach stops on its way, and for how long: both keys or none."""
    at, for_ = reach.optional("hesitating at"), reach.optional("for")
    if at is None and for_ is None:
        return None
    distance_m = _distance(reach.required("hesitating at"))
    until = reach.required("until")
    if distance_m <= _distance(until):
        raise reach.required("hesitating at").error(f'a distance farther away than "until", {until.got()}')
    return Hesitation(distance_m=distance_m, duration_s=_duration(reach.required("for")))


def _follow_tcp(move: Fields, hand: MovingHand) -> FollowTcp:
    return FollowTcp(
        speed_mps=_speed(move.required("follow tcp"), hand),
        distance_m=_distance(move.required("keeping")),
        duration_s=_duration(move.required("for")),
    )


def _wander(move: Fields, hand: MovingHand) -> Wander:
    within = move.required("within")
    corners = within.items("a box: a list of two opposite corners, each a list of three lengths", count=2)
    one, other = (read_position(corner) for corner in corners)
    if _apart_m(one, other) < SMALLEST_BOX_M:
        raise within.error(f"a box of at least {SMALLEST_BOX_M * 1e3:g} mm from corner to corner")
    return Wander(
        speed_mps=_speed(move.required("wander"), hand),
        corners_in_base_m=(one, other),
        duration_s=_duration(move.required("for")),
    )


def _sweep(move: Fields, hand: MovingHand) -> Sweep:
    from_, to = move.required("from"), move.required("to")
    from_in_base_m, to_in_base_m = read_position(from_), read_position(to)
    if _apart_m(from_in_base_m, to_in_base_m) < SHORTEST_SWEEP_M:
        raise to.error(f'a point at least {SHORTEST_SWEEP_M * 1e3:g} mm away from that of "from"')
    return Sweep(
        speed_mps=_speed(move.required("sweep"), hand),
        from_in_base_m=from_in_base_m,
        to_in_base_m=to_in_base_m,
        times=move.required("times").integer(least=1, most=MOST_TIMES),
    )


def _withdraw(move: Fields, hand: MovingHand) -> Withdraw:
    return Withdraw(speed_mps=_speed(move.required("withdraw"), hand))


# The key that names a move, the further keys it takes, and its reader.
MOVES: dict[str, tuple[tuple[str, ...], Callable[[Fields, MovingHand], HandMove]]] = {
    "move to": (("speed",), _move_to),
    "wait": ((), _wait),
    "reach for tcp": (("until", "at most", "hesitating at", "for"), _reach_for_tcp),
    "reach for object": (("until", "at most", "hesitating at", "for"), _reach_for_object),
    "follow tcp": (("keeping", "for"), _follow_tcp),
    "wander": (("within", "for"), _wander),
    "sweep": (("from", "to", "times"), _sweep),
    "withdraw": ((), _withdraw),
}


def _speed(field: Field, hand: MovingHand) -> float:
    """A speed above 0 that the hand's bound allows, beside its tremor."""
    speed_mps = field.quantity(SPEED, above=0.0, most=FASTEST_MPS)
    if speed_mps > hand.max_move_speed_mps:
        beside = " beside its tremor" if hand.tremor else ""
        raise field.error(
            f"a speed of at most {hand.max_move_speed_mps:.4g} m/s, the hand's bound{beside}",
            hint='a hand is faster on purpose with the key "speed at most" of its own, above "moves"',
        )
    return speed_mps


def _duration(field: Field) -> float:
    return field.quantity(TIME, above=0.0, most=LONGEST_S)


def _distance(field: Field) -> float:
    return field.quantity(LENGTH, least=0.0, most=LARGEST_COORDINATE_M)


def _apart_m(one: Vector3, other: Vector3) -> float:
    return float(np.linalg.norm(np.subtract(one, other)))
