"""Figures of a region against brute force, and their intervals against repetition."""

import numpy as np
import pytest
from doubted import Array, Change, Changed, near_questions

from safety_harness.base.settings import DEFAULTS
from safety_harness.extensions.lab.scoring.asking import asked_together
from safety_harness.extensions.lab.scoring.figures import quantile, rank_correlation, region_score
from safety_harness.extensions.lab.scoring.regions import named_regions
from safety_harness.extensions.lab.scoring.scorecard import RegionScore
from safety_harness.space.regions import paper_seen

REGION = named_regions(paper_seen(DEFAULTS), DEFAULTS)[0]


def scored(change: Change, count: int = 2000, threshold_m: float | None = None) -> RegionScore:
    questions = near_questions(count)
    avoider = Changed(change, spread_threshold_m=threshold_m)
    return region_score(REGION, questions, asked_together(avoider, questions), DEFAULTS)


def test_the_interval_of_a_quantile_contains_it_with_the_chance_that_is_said() -> None:
    rng = np.random.default_rng(0)
    for share in (0.05, 0.5, 0.99):
        found = [quantile(rng.random(400), share) for _ in range(600)]
        assert np.mean([one.low <= share <= one.high for one in found]) >= 0.93
    assert quantile(np.arange(5.0), 0.99).high == np.inf


def test_ranks_agree_with_brute_force_also_with_ties() -> None:
    one = np.array([3.0, 1.0, 1.0, 2.0, 5.0, 4.0, 4.0, 0.0, 7.0, 6.0])
    other = np.arange(10.0)
    ranks = np.array([(one < value).sum() + ((one == value).sum() + 1) / 2 for value in one])
    found = rank_correlation(one, other)
    assert found is not None
    assert found.value == pytest.approx(np.corrcoef(ranks, other)[0, 1])
    assert found.low < found.value < found.high
    width = np.arctanh(found.high) - np.arctanh(found.low)
    assert width == pytest.approx(2.0 * 1.959964 * np.sqrt(1.06 / 7))  # Fieller, Hartley and Pearson, 1957
    assert rank_correlation(np.ones(20), np.arange(20.0)) is None


def test_the_closed_form_is_off_by_nothing() -> None:
    score = scored(lambda optimum, hands, tcps: (optimum, 0.0 * optimum))
    assert score.off_most_m == 0.0
    assert score.spreads is None
    assert score.above_threshold is None
    assert score.answered is not None
    assert score.answered.share == 1.0


def test_a_bias_a_pull_and_a_scale_are_told_apart() -> None:
    desired = np.array(DEFAULTS.cell.desired_tcp_position_in_base_m)
    score = scored(
        lambda optimum, hands, tcps: (
            optimum + [0.0, 0.02, 0.0] + 0.05 * (hands - tcps) + 0.2 * (tcps - desired),
            0.0 * optimum,
        )
    )
    assert score.pull is not None
    assert score.scale is not None
    assert score.bias_in_base_m is not None
    assert np.allclose(score.pull, 0.05 * np.eye(3), atol=1e-9)
    assert np.allclose(score.scale, 0.15 * np.eye(3), atol=1e-9)
    assert score.bias_in_base_m[1].low < 0.02 < score.bias_in_base_m[1].high


def test_honest_spreads_cover_as_a_normal_distribution_does() -> None:
    rng = np.random.default_rng(2)

    def noisy(optimum: Array, hands: Array, tcps: Array) -> tuple[Array, Array]:
        spreads = rng.uniform(0.002, 0.02, (len(optimum), 1)) * np.ones(3)
        return optimum + spreads * rng.normal(size=optimum.shape), spreads

    score = scored(noisy, 4000, threshold_m=0.011)
    spreads = score.spreads
    assert spreads is not None
    for k, share in enumerate((0.683, 0.954, 0.997)):
        assert all(one.low - 0.01 < share < one.high + 0.01 for one in spreads.within[k])
    assert spreads.error_to_spread.low < 1.0 < spreads.error_to_spread.high
    assert spreads.rank is not None
    assert spreads.rank.low - 0.03 < spreads.honest_rank < spreads.rank.high + 0.03
    assert score.above_threshold is not None
    assert score.above_threshold.low < 0.5 < score.above_threshold.high


def test_wrong_and_sure_are_the_wrong_ones_below_their_threshold() -> None:
    def wrong(optimum: Array, hands: Array, tcps: Array) -> tuple[Array, Array]:
        far = (np.arange(len(optimum)) % 4 == 0)[:, None]
        unsure = (np.arange(len(optimum)) % 8 == 0)[:, None]
        return optimum + np.where(far, 0.1, 0.0), np.where(unsure, 0.05, 0.001) * np.ones((1, 3))

    score = scored(wrong, 800, threshold_m=0.02)
    assert score.wrong_and_sure is not None
    assert score.wrong_and_sure.count == 100


def test_the_worst_come_first_and_no_answer_is_worse_than_any() -> None:
    questions = near_questions(50)
    bad = questions.hands_in_base_m[7]
    score = scored(
        lambda optimum, hands, tcps: (
            np.where((hands == bad).all(axis=1)[:, None], np.nan, optimum + hands[:, :1] * 0.1),
            0.0 * optimum,
        ),
        50,
    )
    assert score.answered is not None
    assert score.answered.count == 49
    assert score.worst_off[0].fault
    offs = [one.off_m for one in score.worst_off[1:]]
    assert offs == sorted(offs, reverse=True)
    assert offs[0] == score.off_most_m


def test_without_questions_there_is_no_figure() -> None:
    score = scored(lambda optimum, hands, tcps: (optimum, 0.0 * optimum), 0)
    assert score.answered is None
    assert score.off_m is None
    assert not score.asked_in_runs
    assert "no pair" in score.about


def test_out_of_reach_and_into_the_table_are_told() -> None:
    score = scored(lambda optimum, hands, tcps: (optimum * [1.0, 1.0, -1.0], 0.0 * optimum), 100)
    assert score.in_reach is not None
    assert score.in_reach.count == 0
