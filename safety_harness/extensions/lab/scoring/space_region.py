"""Find the questions that can occur in the scenarios of a space, without a run."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from safety_harness.admission.poses import start_joint_position
from safety_harness.admission.spaces import draw_admissible
from safety_harness.base.geometry.arrays import Array3, ArrayNx3
from safety_harness.cell.robot.kinematics import links_in_base
from safety_harness.cell.robot.robots import arm_model
from safety_harness.cell.simulation.hand_motion import advance_hands
from safety_harness.cell.simulation.hand_programs import hands_at_start
from safety_harness.extensions.lab.scoring.regions import Pairs, QuestionRegion, are_near
from safety_harness.scenario.model import Scenario
from safety_harness.space.space import ScenarioSpace

DRAWS = 200  # scenarios; a choice
STEP_S = 0.1  # between two recorded positions of a hand


@dataclass(frozen=True, eq=False)
class _Drawn:
    """The positions of the hands in one scenario, shape (m, 3), and the ends of the TCP's path.

    All positions are in the base frame [m].
    """

    hands_in_base_m: ArrayNx3
    start_in_base_m: Array3
    desired_in_base_m: Array3


def space_region(space: ScenarioSpace, seed: int, draws: int = DRAWS) -> QuestionRegion:
    """Return the region of the questions that can occur in random, admitted scenarios of a space.

    A hand moves according to its program, which the function evaluates every 100 ms.  At the same time, the
    TCP moves on a straight path from its start to the desired position.  A pair consists of a hand position
    and a TCP position in the same scenario, which may belong to different times.  The TCP position of a pair
    lies at most the repulsion radius from the path, because the arm may retreat in a run.  The region
    contains only pairs within the critical distance.  The function assumes perception without errors, and it
    does not execute a user's code.

    Args:
        space: The space.
        seed: The seed for the random scenarios.
        draws: The number of admitted scenarios.

    Raises:
        InadmissibleError: Admission refuses almost every scenario.

    """
    places = [_places(scenario) for scenario in draw_admissible(space, seed, draws).scenarios]
    settings = space.simplest.settings
    near_m, radius_m = settings.avoidance.critical_distance_m, settings.avoidance.radius_m
    counts = np.array([len(place.hands_in_base_m) for place in places])
    hands = np.concatenate([place.hands_in_base_m for place in places])
    starts = np.array([place.start_in_base_m for place in places])
    paths = np.array([place.desired_in_base_m for place in places]) - starts
    firsts = np.cumsum(counts) - counts

    def pairs(rng: np.random.Generator, count: int) -> Pairs:
        # Every scenario with a hand is equally likely, however many positions its hands have.
        rows = rng.choice(np.flatnonzero(counts), count) if counts.any() else np.empty(0, np.int64)
        u = rng.random((len(rows), 3))
        aside = rng.normal(size=(len(rows), 3))
        # The cube root makes the point uniform in a ball, because the volume grows with the cube of the
        # radius.
        aside *= radius_m * np.cbrt(u[:, :1]) / np.linalg.norm(aside, axis=1, keepdims=True)
        tcps = starts[rows] + u[:, 1:2] * paths[rows] + aside
        return hands[firsts[rows] + (u[:, 2] * counts[rows]).astype(np.int64)], tcps

    return QuestionRegion(
        name=space.name,
        about=f"{space.name}: questions in {draws} draws of the space; hands within {near_m * 1e3:g} mm",
        pairs=pairs,
        holds=lambda hand, tcp: are_near(hand, tcp, near_m),
        asked_in_runs=True,
        settings=settings,
        robot=space.simplest.robot,
    )


def _places(scenario: Scenario) -> _Drawn:
    """Return the positions of the hands and the path of the TCP in one scenario."""
    arm = arm_model(scenario.robot)
    start = links_in_base(arm, start_joint_position(scenario, arm))[-1, :3, 3]
    desired = np.array(scenario.settings.cell.desired_tcp_position_in_base_m)
    hands = hands_at_start(scenario)
    steps = max(int(np.ceil(scenario.duration_s / STEP_S)), 1)
    places = [hands.state["position_in_base_m"][hands.state["present"]].copy()]
    for step in range(steps):
        tcp = start + step / steps * (desired - start)
        advance_hands(hands.state, hands.moves, hands.samples, tcp, step * STEP_S, STEP_S)
        places.append(hands.state["position_in_base_m"][hands.state["present"]].copy())
    return _Drawn(np.concatenate(places), start, desired)
