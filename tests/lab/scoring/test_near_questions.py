"""Jumps between near questions are found, however small the region, and steep slopes are none."""

import numpy as np
import pytest
from doubted import Array, Change, Changed

from safety_harness.base.settings import DEFAULTS
from safety_harness.extensions.lab.scoring.asking import asked_together
from safety_harness.extensions.lab.scoring.jumps import NEAR_M, jumps_of
from safety_harness.extensions.lab.scoring.regions import named_regions
from safety_harness.extensions.lab.scoring.scorecard import Jumps, Moved
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


def on_grid(step_m: float) -> Change:
    return lambda optimum, hands, tcps: (np.round(optimum / step_m) * step_m, 0.0 * optimum)


def test_a_grid_of_a_millimetre_is_a_number_format_and_one_of_30_mm_jumps() -> None:
    assert jumps(on_grid(0.001), Moved.TCP, 40, 20).largest is None
    found = jumps(on_grid(0.030), Moved.TCP, 400, 100)
    assert found.largest is not None
    assert found.largest.change_m >= 0.030


def steep(questions: Array) -> Array:
    """A way of 40 mm a millimetre, as the network's is near the desired TCP."""
    return 0.2 * np.sin(200.0 * questions @ [[0.0, 1.0, 0.0], [0.3, 0.0, 0.1], [0.0, 0.2, 0.0]])


def of_rounded(step_m: float, planted_m: float = 0.0) -> Change:
    """An avoider that rounds the TCP, is steep in it, and has one planted jump."""

    def answer(optimum: Array, hands: Array, tcps: Array) -> tuple[Array, Array]:
        rounded = np.round(tcps / step_m) * step_m
        beyond = np.where(hands[:, :1] > 0.8, planted_m, 0.0) * [1.0, 0.0, 0.0]
        beyond = beyond + np.where(rounded[:, :1] > 0.7, planted_m, 0.0) * [0.0, 0.0, 1.0]
        return hands * [0.1, 0.1, 0.1] + steep(rounded) + beyond, 0.0 * optimum

    return answer


@pytest.mark.parametrize("step_m", [1e-4, 2.0**-11])
def test_an_avoider_that_rounds_its_question_does_not_jump(step_m: float) -> None:
    assert jumps(of_rounded(step_m), Moved.TCP, 400, 100).largest is None


@pytest.mark.parametrize("moved", Moved)
def test_a_planted_jump_is_found_in_an_avoider_that_rounds_its_question(moved: Moved) -> None:
    found = jumps(of_rounded(1e-4, 0.15), moved, 400, 100)
    assert found.largest is not None
    assert found.largest.change_m == pytest.approx(0.15, abs=0.01)


def in_steps(size_m: float) -> Change:
    """A network in int8, about: cells of 7 mm, between which the answers move a little too."""

    def answer(optimum: Array, hands: Array, tcps: Array) -> tuple[Array, Array]:
        return optimum + size_m * (np.floor(hands / 0.007) % 2.0), 0.0 * optimum

    return answer


def test_an_avoider_that_answers_in_steps_everywhere_jumps_beyond_20_mm() -> None:
    fine, coarse = jumps(in_steps(0.008), Moved.HAND), jumps(in_steps(0.025), Moved.HAND)
    assert (fine.largest, fine.limit_m) == (None, 0.020)
    assert coarse.jumped is not None
    assert coarse.jumped.count > 100


def test_a_small_jump_in_a_tenth_of_all_places_is_no_step() -> None:
    def planted(optimum: Array, hands: Array, tcps: Array) -> tuple[Array, Array]:
        where = (np.floor(hands[:, :1] * 10.0) + 3.0 * np.floor(hands[:, 1:2] * 10.0)) % 10.0 == 0.0
        return optimum + np.where(where, 0.008, 0.0), 0.0 * optimum

    found = jumps(planted, Moved.HAND, segments=1500)
    assert found.jumped is not None
    assert (found.limit_m, found.jumped.count > 100) == (0.0005, True)


def test_a_steep_slope_is_no_jump_and_its_size_is_told() -> None:
    def slope(optimum: Array, hands: Array, tcps: Array) -> tuple[Array, Array]:
        return optimum + np.clip(30.0 * (hands[:, :1] - 0.8), 0.0, 0.06) * [0.0, 1.0, 0.0], 0.0 * optimum

    found = jumps(slope, Moved.HAND)
    assert found.largest is None
    assert found.steepest is not None
    assert 20.0 < found.steepest.change_m / found.steepest.apart_m < 32.0
