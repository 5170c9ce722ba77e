"""The region of questions that the draws of a scenario space can lead to, found without a run."""

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

DRAWS = 200
STEP_S = 0.1  # between two recorded positions of a hand


@dataclass(frozen=True, eq=False)
class _Drawn:
    """The positions (m, 3) of one draw's hands, and the ends of its TCP's path, in the base frame [m]."""

    hands_in_base_m: ArrayNx3
    start_in_base_m: Array3
    desired_in_base_m: Array3


def space_region(space: ScenarioSpace, seed: int, draws: int = DRAWS) -> QuestionRegion:
    """Return the region of questions that the admitted draws of a space can lead to.

    A hand moves by its program, which the function evaluates every 100 ms.  Meanwhile the TCP moves straight
    from its start to the desired position.  A pair joins a hand and a TCP of the same draw, at any two times.
    The TCP of a pair is anywhere on the path, or up to the repulsion radius beside it, as in a run that
    retreats.  Only pairs within the critical distance belong to the region.  The region ignores errors of
    perception.  The function executes no code of a user.

    Args:
        space: The space.
        seed: The seed of the draws.
        draws: The number of admitted draws.

    Raises:
        InadmissibleError: Admission refuses almost every draw.

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
        rows = rng.choice(np.flatnonzero(counts), count) if counts.any() else np.empty(0, np.int64)
        u = rng.random((len(rows), 3))
        aside = rng.normal(size=(len(rows), 3))
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
    """Return the positions of the hands and the path of the TCP in one draw."""
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
