"""Check a scenario's hands against the cell, the robot and the hands' own bounds."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from safety_harness.base.geometry.arrays import ArrayN
from safety_harness.cell.robot.description import ArmModel
from safety_harness.cell.robot.distance import hand_distance, place_capsules
from safety_harness.cell.robot.kinematics import links_in_base
from safety_harness.cell.robot.robots import arm_capsules
from safety_harness.cell.simulation.hand_programs import hands_at_start
from safety_harness.cell.simulation.truth import cell_capsules
from safety_harness.scenario.model import JoinedHand, MovingHand, RecordedHand, Scenario
from safety_harness.scenario.moves import MoveTo, Sweep, Wait, Wander


def check_hands(scenario: Scenario, arm: ArmModel, joint_position_rad: ArrayN) -> None:
    """Refuse a hand that goes below the table, exceeds its own bounds or begins inside the robot.

    Only the hand's centre must stay above the table, while its surface may go below.
    """
    table_m, ceiling_m = scenario.settings.cell.table_height_m, _ceiling_m(scenario)
    for number, hand in enumerate(scenario.hands):
        leader = scenario.leader(hand)
        above_m = hand.apart_in_base_m[2] if isinstance(hand, JoinedHand) else 0.0
        if leader is None:
            expected = "the name of an earlier hand that moves by itself"
            got = f'"{hand.joined_to}"' if isinstance(hand, JoinedHand) else hand.name
            raise scenario.inadmissible(expected, got, f"hands[{number}].together with")
        if isinstance(hand, MovingHand):
            _check_speeds(scenario, number, hand)
        for field, suffix, height_m in _ends(leader, scenario.duration_s):
            where = "apart" if isinstance(hand, JoinedHand) else field
            too_high = height_m + above_m > ceiling_m
            if height_m + above_m < table_m or too_high:
                below = f"below the hand sensor, which a shield uses (z = {ceiling_m * 1e3:.0f} mm)"
                above = f"above the table (z = {table_m * 1e3:.0f} mm)"
                expected = f"a hand {below if too_high else above}"
                hint = "hand sensor: {overhead position: [...]} hangs it higher" if too_high else ""
                got = f"z = {(height_m + above_m) * 1e3:.0f} mm{suffix}"
                raise scenario.inadmissible(expected, got, f"hands[{number}].{where}", hint=hint)
    _check_clear_of_the_robot(scenario, arm, joint_position_rad)


def _check_speeds(scenario: Scenario, number: int, hand: MovingHand) -> None:
    """Refuse a move that is faster than the hand's speed bound, in a scenario created by a program.

    For a scenario from a file, the reader makes this check.
    """
    for index, move in enumerate(hand.moves):
        if not isinstance(move, Wait) and not move.speed_mps <= hand.max_move_speed_mps:
            expected = f"a speed within the hand's bound of {hand.max_move_speed_mps:.4g} m/s"
            got = f"{move.speed_mps:g} m/s"
            raise scenario.inadmissible(expected, got, f"hands[{number}].moves[{index}]")


def _ceiling_m(scenario: Scenario) -> float:
    """Return the greatest height [m] that a hand may reach.

    Only a shield limits the height, because its sensor looks down and would not see a hand above itself.
    """
    sensor = scenario.settings.hand_sensor
    if scenario.shield is None:
        return np.inf
    return sensor.overhead_position_in_base_m[2] - scenario.settings.hand.radius_m


def _ends(hand: MovingHand | RecordedHand, duration_s: float) -> list[tuple[str, str, float]]:
    """Return points of the hand's path, among which are its lowest and its highest point.

    The path is that of the hand's centre. Each entry is a tuple: the field, a text that states the time or
    the shift, and the height z [m]. The points do not include the hand's tremor.
    """
    if isinstance(hand, RecordedHand):
        motion = hand.motion
        used = int(np.searchsorted(motion.time_s, duration_s)) + 1  # up to the first sample after the end
        height_m = motion.hand_position_in_base_m[:used, 2]
        ends = (int(height_m.argmin()), int(height_m.argmax()))
        suffixes = {end: f" after {motion.time_s[end]:.2f} s of the run, in {hand.recording}" for end in ends}
        return [("starts at", suffixes[end], float(height_m[end])) for end in ends]
    points = [("starts at", hand.starts_at_in_base_m)]
    for number, move in enumerate(hand.moves):
        if isinstance(move, MoveTo):
            points.append((f"moves[{number}].move to", move.position_in_base_m))
        if isinstance(move, Wander):
            points += [(f"moves[{number}].within", corner) for corner in move.corners_in_base_m]
        if isinstance(move, Sweep):
            points.append((f"moves[{number}].from", move.from_in_base_m))
            points.append((f"moves[{number}].to", move.to_in_base_m))
    shift_m = hand.shift_in_base_m[2]
    suffix = " with its shift" if shift_m else ""
    return [(field, suffix, point[2] + shift_m) for field, point in points]


def _check_clear_of_the_robot(
    scenario: Scenario, arm: ArmModel, joint_position_rad: NDArray[np.float64]
) -> None:
    """Refuse a hand or forearm that is inside the robot at the start."""
    settings = scenario.settings
    capsules = cell_capsules(arm_capsules(scenario.robot), settings)
    ends = np.empty((len(capsules.names), 2, 3))
    place_capsules(capsules.records, links_in_base(arm, joint_position_rad), ends)
    hands = hands_at_start(scenario).state
    for number, _ in enumerate(scenario.hands):
        distance_m, nearest = hand_distance(
            capsules.records,
            ends,
            hands[number]["position_in_base_m"],
            hands[number]["elbow_in_base_m"],
            settings.hand.radius_m,
            settings.hand.forearm_radius_m,
        )
        if not distance_m > 0.0:
            part = capsules.names[nearest].replace("_", " ")
            expected = "a hand that begins outside the robot, its forearm too"
            got = f"one {-distance_m * 1e3:.0f} mm inside the {part}'s capsule"
            raise scenario.inadmissible(expected, got, f"hands[{number}].starts at", f"hands[{number}].apart")
