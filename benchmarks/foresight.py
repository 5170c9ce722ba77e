"""Arm motions with foresight: can any of them keep a hand-distance claim that is called unavoidable?

A motion is a way of the TCP at up to the controller's full speed, made of legs of equal duration; the
direction of a leg is given about the one away from the hand, so that a motion sees where the hand is at every
tick and knows beforehand where it will be.  Of the arm only what is certain to be there counts: a ball about
the TCP, kept within the arm's reach, and what no joint moves.  Any arm is in more places than that, and more
limited: who cannot keep the claim here cannot keep it.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from safety_harness.admission.admit import Checked
from safety_harness.base.compiled import compiled
from safety_harness.base.geometry.segments import point_segment_distance
from safety_harness.cell.robot.distance import hand_distance
from safety_harness.cell.simulation.hand_motion import HandRecords, MoveRecords, advance_hands
from safety_harness.cell.simulation.hand_programs import hands_at_start
from safety_harness.extensions.attribution.unavoidable import FreeArm

LEGS = 6
KEPT = 20  # motions that the second half of a search varies


def best_distance_m(checked: Checked, motions: int, seed: int = 0) -> float:
    """The largest least distance [m] from the scenario's hands that a search of so many motions finds.

    Half of them are drawn anew, the others vary the best ones so far.
    """
    rng, free = np.random.default_rng(seed), FreeArm.from_checked(checked)
    drawn = _drawn(rng, motions - motions // 2)
    drawn[0] = [0.0, 0.0, 1.0]  # straight away from the hand, all the time
    drawn[1] = [0.0, 0.0, 0.0]  # stay
    found = np.array([distance_m(checked, free, one) for one in drawn])
    for _ in range(motions // 2):
        best = np.argsort(-found)[:KEPT]
        parent = drawn[rng.choice(best)]
        child = parent + rng.normal(0.0, 0.3, parent.shape) * (rng.random(parent.shape) < 0.5)
        child[:, 2] = np.clip(child[:, 2], 0.0, 1.0)
        drawn = np.concatenate([drawn, child[None]])
        found = np.append(found, distance_m(checked, free, child))
    return float(found.max())


def _drawn(rng: np.random.Generator, count: int) -> NDArray[np.float64]:
    """(count, LEGS, 3): the angle from away, the angle about it, the share of the full speed."""
    motions = rng.uniform([-np.pi / 2, 0.0, 0.0], [np.pi / 2, np.pi, 1.0], (count, LEGS, 3))
    motions[:, :, 2] = np.sqrt(motions[:, :, 2])
    return motions


def distance_m(checked: Checked, free: FreeArm, motion: NDArray[np.float64]) -> float:
    """The least distance of any hand or forearm from the certain parts of the arm, with one motion."""
    scenario = checked.scenario
    hands, radii = hands_at_start(scenario), scenario.settings.hand
    return float(
        _least_m(
            hands.state,
            hands.moves,
            hands.samples,
            len(scenario.hands),
            motion,
            free.start_m,
            free.centre_m,
            free.reach_m,
            free.fastest_mps,
            free.tip_m,
            free.body.records,
            free.ends_m,
            radii.radius_m,
            radii.forearm_radius_m,
            scenario.ticks,
            scenario.settings.clock.control_period_s,
        )
    )


@compiled
def _least_m(
    hands: HandRecords,
    moves: MoveRecords,
    samples: NDArray[np.float64],  # (s, 7)
    count: int,
    motion: NDArray[np.float64],  # (legs, 3)
    start_m: NDArray[np.float64],  # (3,)
    centre_m: NDArray[np.float64],  # (3,)
    reach_m: float,
    fastest_mps: float,
    tip_m: float,
    body: NDArray[np.void],  # (n,) CAPSULE
    ends_m: NDArray[np.float64],  # (n, 2, 3)
    hand_radius_m: float,
    forearm_radius_m: float,
    ticks: int,
    period_s: float,
) -> float:
    tcp = start_m.copy()
    least = np.inf
    for tick in range(ticks + 1):
        nearest, which = np.inf, 0
        for k in range(count):
            hand, elbow = hands[k].position_in_base_m, hands[k].elbow_in_base_m
            to_hand = point_segment_distance(tcp, hand, hand) - hand_radius_m
            to_arm = point_segment_distance(tcp, hand, elbow) - forearm_radius_m
            there = min(to_hand, to_arm) - tip_m
            if there < nearest:
                nearest, which = there, k
            fixed, _ = hand_distance(body, ends_m, hand, elbow, hand_radius_m, forearm_radius_m)
            least = min(least, fixed)
        least = min(least, nearest)
        leg = motion[min(tick * motion.shape[0] // (ticks + 1), motion.shape[0] - 1)]
        away = tcp - hands[which].position_in_base_m
        length = np.sqrt((away**2).sum())
        away = away / length if length > 0.0 else np.array([0.0, 0.0, 1.0])
        side = np.array([-away[1], away[0], 0.0])
        flat = np.sqrt((side**2).sum())
        side = side / flat if flat > 1e-9 else np.array([1.0, 0.0, 0.0])
        up = np.array(
            [
                away[1] * side[2] - away[2] * side[1],
                away[2] * side[0] - away[0] * side[2],
                away[0] * side[1] - away[1] * side[0],
            ]
        )
        across = np.cos(leg[1]) * side + np.sin(leg[1]) * up
        direction = np.cos(leg[0]) * away + np.sin(leg[0]) * across
        advance_hands(hands, moves, samples, tcp, tick * period_s, period_s)
        tcp = tcp + leg[2] * fastest_mps * period_s * direction
        off = tcp - centre_m
        far = np.sqrt((off**2).sum())
        if far > reach_m:
            tcp = centre_m + off * (reach_m / far)
    return least
