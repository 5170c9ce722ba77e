"""Turn a scenario's hands into records for the interpreter.

Each move becomes legs, waits and pursuits. The scenario's seed, the hand's number and the move's number
determine the points of a wander.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from safety_harness.base.elementary import length
from safety_harness.base.seeds import Branch, generator
from safety_harness.base.settings import Vector3
from safety_harness.cell.simulation.hand_motion import (
    FOLLOW_TCP,
    HAND,
    LEG,
    MOVE,
    REACH_FOR_TCP,
    WAIT,
    HandRecords,
    MoveRecords,
    advance_hands,
)
from safety_harness.scenario.model import JoinedHand, MovingHand, RecordedHand, Scenario
from safety_harness.scenario.moves import (
    FollowTcp,
    HandMove,
    MoveTo,
    Reach,
    ReachForObject,
    ReachForTcp,
    Sweep,
    Wait,
    Wander,
    shifted,
)

NOWHERE: Vector3 = (0.0, 0.0, 0.0)  # of a step without a target
# A choice. If these points do not fill the time, as many points as there are follow.
FIRST_DRAWN = 256


@dataclass(frozen=True, eq=False)
class Hands:
    """The hands of an episode, with their state and their programs.

    Each row of ``samples`` (s, 7) contains the time, the hand position and the elbow position of a recorded
    hand.
    """

    state: HandRecords
    moves: MoveRecords
    samples: NDArray[np.float64]


class Step(NamedTuple):
    """An entry of a hand's program, with the fields of the record MOVE in their order."""

    kind: int = LEG
    target_in_base_m: Vector3 = NOWHERE
    speed_mps: float = 0.0
    distance_m: float = 0.0
    duration_s: float = 0.0
    within_s: float = np.inf
    after: int = 0


def hands_at_start(scenario: Scenario) -> Hands:
    """Return the hands at the start of the scenario."""
    state = np.zeros(scenario.hand_slots, HAND)
    state["position_in_base_m"] = state["elbow_in_base_m"] = np.nan
    state["leader"] = -1
    moves: list[Step] = [Step()]  # never empty: compiled code needs its type
    samples: list[NDArray[np.float64]] = [np.zeros((1, 7))]
    for number, (record, hand) in enumerate(zip(state, scenario.hands, strict=False)):
        record["present"] = True
        record["forearm_length_m"] = scenario.settings.hand.forearm_length_m
        if isinstance(hand, RecordedHand):
            motion = hand.motion
            record["recorded"] = True
            record["first"], record["count"] = sum(map(len, samples)), len(motion.time_s)
            positions = (motion.hand_position_in_base_m, motion.elbow_position_in_base_m)
            samples.append(np.column_stack([motion.time_s, *positions]))
            continue
        record["elbow_towards_in_base_m"] = hand.elbow_towards_in_base_m
        if isinstance(hand, JoinedHand):
            leader = scenario.leader(hand)
            assert leader is not None  # admission checks this
            record["leader"] = scenario.hands.index(leader)
            record["apart_in_base_m"] = hand.apart_in_base_m
            continue
        program = _program(hand, number, scenario)
        record["first"], record["count"] = len(moves), len(program)
        moves += program
        _begin(record, hand, number, scenario)
    hands = Hands(state, np.array(moves, MOVE), np.concatenate(samples))
    # A step of no time fills the positions at the start, with tremor and forearm.
    advance_hands(hands.state, hands.moves, hands.samples, np.zeros(3), 0.0, 0.0)
    return hands


def _begin(record: np.void, hand: MovingHand, number: int, scenario: Scenario) -> None:
    """Set a moving hand at rest at its start position, and set its tremor."""
    record["steady_in_base_m"] = shifted(hand.starts_at_in_base_m, hand.shift_in_base_m)
    record["max_acceleration_mps2"] = hand.max_acceleration_mps2
    if hand.tremor is not None:
        # Along each axis, so that the vector of all three stays within the amplitude.
        record["tremor_m"] = hand.tremor.amplitude_m / np.sqrt(3.0)
        record["tremor_radps"] = 2.0 * np.pi * hand.tremor.rate_hz
        phases = generator(scenario.seed, Branch.HAND_MOTION, number).uniform(0.0, 2.0 * np.pi, 3)
        record["tremor_phase_rad"] = phases


def _program(hand: MovingHand, number: int, scenario: Scenario) -> list[Step]:
    """Return the steps of every move that can begin within the scenario's duration."""
    program: list[Step] = []
    least_s = hand.delay_s
    if hand.delay_s > 0.0:
        program.append(Step(WAIT, duration_s=hand.delay_s, after=1))
    for index, move in enumerate(hand.moves):
        if least_s > scenario.duration_s:
            break
        if isinstance(move, Wander):
            rng = generator(scenario.seed, Branch.HAND_MOTION, number, index)
            group = _wander(move, hand, scenario.duration_s, rng)
        else:
            group = _group(move, hand, scenario)
        next_group = len(program) + len(group)
        program += [step._replace(after=next_group) for step in group]
        least_s += _least_s(move, hand)
    return program


def _group(move: HandMove, hand: MovingHand, scenario: Scenario) -> list[Step]:
    """Return the steps of a move other than a wander."""
    shift = hand.shift_in_base_m
    if isinstance(move, Wait):
        return [Step(WAIT, duration_s=move.duration_s)]
    if isinstance(move, ReachForTcp | ReachForObject):
        return _reach(move, scenario.settings.object.position_in_base_m)
    if isinstance(move, FollowTcp):
        speed_mps, near_m = move.speed_mps, move.distance_m
        return [Step(FOLLOW_TCP, speed_mps=speed_mps, distance_m=near_m, within_s=move.duration_s)]
    if isinstance(move, Sweep):
        there = Step(target_in_base_m=shifted(move.from_in_base_m, shift), speed_mps=move.speed_mps)
        aside = Step(target_in_base_m=shifted(move.to_in_base_m, shift), speed_mps=move.speed_mps)
        return [there, *[aside, there] * move.times]
    goal = move.position_in_base_m if isinstance(move, MoveTo) else hand.starts_at_in_base_m
    return [Step(target_in_base_m=shifted(goal, shift), speed_mps=move.speed_mps)]


def _reach(move: Reach, object_position_in_base_m: Vector3) -> list[Step]:
    """Return the steps of a reach to the TCP or to the object, with any hesitation on the way."""
    kind, near_m = REACH_FOR_TCP if isinstance(move, ReachForTcp) else LEG, move.until_distance_m
    go = Step(kind, object_position_in_base_m, move.speed_mps, near_m, within_s=move.at_most_s)
    if move.hesitation is None:
        return [go]
    wait = Step(WAIT, duration_s=move.hesitation.duration_s, within_s=move.at_most_s)
    return [go._replace(distance_m=move.hesitation.distance_m), wait, go]


def _wander(move: Wander, hand: MovingHand, longest_s: float, rng: np.random.Generator) -> list[Step]:
    """Return legs to random points that fill the duration of the move or of the run, whichever is shorter."""
    corners = np.sort(np.array(move.corners_in_base_m) + hand.shift_in_base_m, axis=0)
    points, filled_s = np.empty((0, 3)), 0.0
    while filled_s < min(move.duration_s, longest_s):
        more = rng.uniform(corners[0], corners[1], (max(FIRST_DRAWN, len(points)), 3))
        points = np.concatenate([points, more])
        path_m = np.linalg.norm(np.diff(points, axis=0), axis=1)
        filled_s = float(_leg_s(path_m, move.speed_mps, hand.max_acceleration_mps2).sum())
    return [
        Step(target_in_base_m=(x, y, z), speed_mps=move.speed_mps, within_s=move.duration_s)
        for x, y, z in points.tolist()
    ]


def _leg_s(path_m: NDArray[np.float64], speed_mps: float, acceleration_mps2: float) -> NDArray[np.float64]:
    """Return the durations [s] of straight motions from rest to rest.

    ``path_m`` contains the lengths of the paths.
    """
    peak = np.minimum(speed_mps, np.sqrt(acceleration_mps2 * path_m))
    return np.divide(path_m, peak, out=np.zeros_like(path_m), where=peak > 0.0) + peak / acceleration_mps2


def _least_s(move: HandMove, hand: MovingHand) -> float:
    """Return a lower bound [s] of a move's duration."""
    if isinstance(move, Wait | FollowTcp | Wander):
        return move.duration_s
    if isinstance(move, Sweep):
        path_m = length(np.subtract(move.to_in_base_m, move.from_in_base_m))
        return 2 * move.times * float(_leg_s(np.array(path_m), move.speed_mps, hand.max_acceleration_mps2))
    return 0.0
