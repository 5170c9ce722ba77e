"""Jumps between near questions are found, however small the region, and steep slopes are none."""

import numpy as np
import pytest
from doubted import Array, Change, Changed

from safety_harness.scoring.asking import asked_together
from safety_harness.scoring.jumps import NEAR_M, jumps_of
from safety_harness.scoring.regions import named_regions
from safety_harness.scoring.scorecard import Jumps, Moved
from safety_harness.settings import DEFAULTS
from safety_harness.space.regions import paper_seen

REGION = named_regions(paper_seen(DEFAULTS), DEFAULTS)[0]
HAND = np.array([0.805, -0.265, 0.255])


def jumps(change: Change, moved: Moved, count: int = 6000, segments: int = 400) -> Jumps:
    avoider = Changed(change)
    questions = REGION.draw(np.random.default_rng(1), count)
    answers = asked_together(avoider, questions)
    rng = np.random.default_rng(2)
    return jumps_of(
        lambda asked: asked_together(avoider, asked), REGION, moved, questions, answers, rng, segments
    )


@pytest.mark.parametrize("moved", Moved)
def test_the_closed_form_has_no_jump(moved: Moved) -> None:
    found = jumps(lambda optimum, hands, tcps: (optimum, 0.0 * optimum), moved)
    assert found.largest is None
    assert found.jumped is not None
    assert found.jumped.count == 0
    assert found.segments >= 400


def test_a_ball_of_30_mm_among_the_hands_is_found_with_its_jump() -> None:
    def hole(optimum: Array, hands: Array, tcps: Array) -> tuple[Array, Array]:
        inside = np.linalg.norm(hands - HAND, axis=1, keepdims=True) < 0.030
        return np.where(inside, optimum + [0.0, 0.03, 0.0], optimum), 0.0 * optimum

    found = jumps(hole, Moved.HAND).largest
    assert found is not None
    assert found.change_m == pytest.approx(0.03, abs=1e-6)
    assert found.apart_m <= NEAR_M
    ends = [one.hand_position_in_base_m for one in (found.before, found.after)]
    assert np.allclose([np.linalg.norm(end - HAND) for end in ends], 0.030, atol=1e-8)
    assert found.before.seed == found.after.seed
    assert np.array_equal(found.before.tcp_position_in_base_m, found.after.tcp_position_in_base_m)


def test_a_step_of_the_spread_is_a_jump_too() -> None:
    def step(optimum: Array, hands: Array, tcps: Array) -> tuple[Array, Array]:
        return optimum, np.where(tcps[:, :1] > 0.7, 0.001, 0.01) * np.ones((1, 3))

    found = jumps(step, Moved.TCP)
    assert found.largest is not None
    assert found.largest.change_m == pytest.approx(0.009 * np.sqrt(3.0), abs=1e-6)
    assert jumps(step, Moved.HAND).largest is None


def test_answers_on_a_grid_of_a_millimetre_jump() -> None:
    found = jumps(lambda optimum, hands, tcps: (np.round(optimum, 3), 0.0 * optimum), Moved.TCP, 400, 100)
    assert found.largest is not None
    assert found.largest.change_m >= 0.001


def test_a_steep_slope_is_no_jump_and_its_size_is_told() -> None:
    def slope(optimum: Array, hands: Array, tcps: Array) -> tuple[Array, Array]:
        return optimum + np.clip(30.0 * (hands[:, :1] - 0.8), 0.0, 0.06) * [0.0, 1.0, 0.0], 0.0 * optimum

    found = jumps(slope, Moved.HAND)
    assert found.largest is None
    assert found.steepest is not None
    assert 20.0 < found.steepest.change_m / found.steepest.apart_m < 32.0
