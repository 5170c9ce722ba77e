"""What a proposal is worth before the gate: against brute force and against the oracle of eq. 13."""

import numpy as np

from safety_harness.base.settings import DEFAULTS
from safety_harness.cell.avoidance.measures import gained_m, is_sure, off_m, optimum_in_base_m
from safety_harness.cell.avoidance.simple import NearestCandidate, OppositePose


def questions(n: int) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(4)
    tcps = np.array(DEFAULTS.cell.desired_tcp_position_in_base_m) + rng.uniform(-0.1, 0.1, (n, 3))
    return tcps + rng.uniform(-0.4, 0.4, (n, 3)), tcps


def test_no_candidate_of_the_paper_is_nearer_to_the_desired_tcp_than_the_optimum() -> None:
    hands, tcps = questions(200)
    desired = np.array(DEFAULTS.cell.desired_tcp_position_in_base_m)
    pull = DEFAULTS.avoidance.hand_pull * (tcps - hands)
    optimum = optimum_in_base_m(DEFAULTS, hands, tcps) - pull
    labels, _ = NearestCandidate.for_cell(DEFAULTS).propose_many(hands, tcps, np.arange(200, dtype=np.uint64))
    nearer = off_m(labels - pull, np.tile(desired, (200, 1))) - off_m(optimum, np.tile(desired, (200, 1)))
    assert nearer.min() >= -1e-12
    assert nearer.max() > 0.005  # the noise of the labels


def test_a_gain_is_that_of_the_distance_at_the_start_of_the_way() -> None:
    hands, tcps = questions(100)
    proposed = tcps + np.random.default_rng(1).normal(0.0, 0.1, (100, 3))
    step = 1e-7
    before = np.linalg.norm(tcps - hands, axis=1)
    after = np.linalg.norm(tcps + step * (proposed - tcps) - hands, axis=1)
    assert np.allclose(gained_m(hands, tcps, proposed), (after - before) / step, atol=1e-6)


def test_the_opposite_pose_gains_its_whole_radius() -> None:
    hands, tcps = questions(50)
    proposed, _ = OppositePose(0.1).propose_many(hands, tcps, np.zeros(50, np.uint64))
    assert np.allclose(gained_m(hands, tcps, proposed), 0.1)


def test_from_a_hand_at_the_tcp_every_way_leads_away() -> None:
    tcps = np.zeros((1, 3))
    assert gained_m(tcps, tcps, np.array([[0.03, 0.0, 0.04]])).tolist() == [0.05]


def test_what_is_no_position_gains_no_number() -> None:
    hands, tcps = questions(1)
    assert np.isnan(gained_m(hands, tcps, np.full((1, 3), np.nan))).all()


def test_an_answer_is_sure_up_to_its_threshold_and_always_without_one() -> None:
    spreads = np.array([[0.01, 0.02, 0.0], [0.01, 0.021, 0.0]])
    assert is_sure(spreads, 0.02).tolist() == [True, False]
    assert is_sure(spreads, np.nan).tolist() == [True, True]
