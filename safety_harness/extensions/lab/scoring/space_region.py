"""The questions that the draws of a scenario space can lead to, without running any of them."""

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
from safety_harness.extensions.lab.scoring.regions import Pairs, QuestionRegion, near
from safety_harness.scenario.model import Scenario
from safety_harness.space.space import ScenarioSpace

DRAWS = 200
STEP_S = 0.1  # between two places of a hand


@dataclass(frozen=True, eq=False)
class _Drawn:
    """Where one draw's hands go (m, 3), and from where to where its TCP does, in the base frame [m]."""

    hands_in_base_m: ArrayNx3
    start_in_base_m: Array3
    desired_in_base_m: Array3


def space_region(space: ScenarioSpace, seed: int, draws: int = DRAWS) -> QuestionRegion:
    """What the first ``draws`` draws of the stream ``seed`` that admission lets through can lead to.

    A hand is where its program has it at any time, every 100 ms, while the TCP goes straight from its start
    to the desired position.  The TCP is anywhere on that way, and up to the repulsion radius beside it: a
    run that gives way is there.  A pair is a hand and a TCP of the same draw, at any two times, within the
    critical distance.  What perception adds to a hand's place is left out.

    InadmissibleError if hardly any draw can be tried.  Nothing of a user's is executed.
    """
    found = [_places(scenario) for scenario in draw_admissible(space, seed, draws).scenarios]
    settings = space.simplest.settings
    near_m, radius_m = settings.avoidance.critical_distance_m, settings.avoidance.radius_m
    counts = np.array([len(one.hands_in_base_m) for one in found])
    hands = np.concatenate([one.hands_in_base_m for one in found])
    starts = np.array([one.start_in_base_m for one in found])
    ways = np.array([one.desired_in_base_m for one in found]) - starts
    firsts = np.cumsum(counts) - counts

    def pairs(rng: np.random.Generator, count: int) -> Pairs:
        of = rng.choice(np.flatnonzero(counts), count) if counts.any() else np.empty(0, np.int64)
        u = rng.random((len(of), 3))
        aside = rng.normal(size=(len(of), 3))
        aside *= radius_m * np.cbrt(u[:, :1]) / np.linalg.norm(aside, axis=1, keepdims=True)
        tcps = starts[of] + u[:, 1:2] * ways[of] + aside
        return hands[firsts[of] + (u[:, 2] * counts[of]).astype(np.int64)], tcps

    return QuestionRegion(
        name=space.name,
        about=f"{space.name}: what {draws} draws of the space lead to; hands within {near_m * 1e3:g} mm",
        pairs=pairs,
        holds=lambda hand, tcp: near(hand, tcp, near_m),
        asked_in_runs=True,
        settings=settings,
        robot=space.simplest.robot,
    )


def _places(scenario: Scenario) -> _Drawn:
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
