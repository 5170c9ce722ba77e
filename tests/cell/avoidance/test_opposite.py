from __future__ import annotations

import numpy as np
import pytest

from safety_harness.base.exceptions import AvoiderError
from safety_harness.cell.avoidance.simple import OppositePose

RADIUS_M = 0.1
OPPOSITE = OppositePose(RADIUS_M)


def proposed(hand: np.ndarray, tcp: np.ndarray, seed: int = 0) -> np.ndarray:
    proposal = OPPOSITE.propose(hand_position_in_base_m=hand, tcp_position_in_base_m=tcp, seed=seed)
    return proposal.position_in_base_m


def pairs(count: int) -> list[np.ndarray]:
    return list(np.random.default_rng(1).uniform(-1.0, 1.0, (count, 2, 3)))


def test_opposite_pose_moves_away_from_the_hand_by_exactly_the_radius() -> None:
    for hand, tcp in pairs(300):
        position = proposed(hand, tcp)
        before, after = np.linalg.norm(tcp - hand), np.linalg.norm(position - hand)
        assert np.linalg.norm(position - tcp) == pytest.approx(RADIUS_M, abs=1e-14)
        assert after - before == pytest.approx(
            RADIUS_M, abs=1e-14
        )  # so it lies on their line, beyond the TCP


def test_opposite_pose_asks_for_the_direction_only() -> None:
    for hand, tcp in pairs(50):
        further = tcp + 3.0 * (hand - tcp)
        assert proposed(further, tcp) == pytest.approx(proposed(hand, tcp), abs=1e-13)


def test_opposite_pose_knows_no_chance_and_no_spread() -> None:
    hand, tcp = pairs(1)[0]
    assert np.array_equal(proposed(hand, tcp, seed=1), proposed(hand, tcp, seed=2))
    proposal = OPPOSITE.propose(hand_position_in_base_m=hand, tcp_position_in_base_m=tcp, seed=0)
    assert np.array_equal(proposal.spread_m, np.zeros(3))


@pytest.mark.parametrize("difference", [0.0, np.nan])
def test_a_hand_at_the_tcp_or_nowhere_has_no_opposite(difference: float) -> None:
    tcp = np.array([0.7, 0.1, 0.3])
    with pytest.raises(AvoiderError, match="no opposite direction"):
        proposed(tcp + difference, tcp)
