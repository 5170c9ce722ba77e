"""Intervals against scipy and against how often they contain what they should."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy import stats

from safety_harness_paper.intervals import (
    Paired,
    bootstrap_of,
    differences,
    mean_of,
    median_of,
    median_rank,
    share_of,
)


@pytest.mark.parametrize("size", [2, 5, 200])
def test_the_interval_of_a_mean_is_scipys(size: int) -> None:
    values = np.random.default_rng(1).normal(3.0, 2.0, size)
    low, high = stats.t.interval(0.95, size - 1, loc=values.mean(), scale=stats.sem(values))
    found = mean_of(values)
    assert (found.low, found.high) == pytest.approx((low, high))
    assert found.value == pytest.approx(values.mean())


def test_one_more_training_lies_in_the_prediction_interval_95_times_in_a_hundred() -> None:
    rng = np.random.default_rng(2)
    inside = 0
    for _ in range(4000):
        *five, another = rng.normal(size=6)
        found = mean_of(five)
        inside += found.next_low <= another <= found.next_high
    assert 0.94 < inside / 4000 < 0.96


def test_a_single_training_says_nothing_about_the_next() -> None:
    found = mean_of([1.0])
    assert (found.low, found.high) == (-math.inf, math.inf)
    assert (found.next_low, found.next_high) == (-math.inf, math.inf)


@pytest.mark.parametrize("values", [[], [1.0, math.nan], [math.inf]])
def test_what_is_no_number_is_refused_everywhere(values: list[float]) -> None:
    for function in (mean_of, median_of):
        with pytest.raises(ValueError, match="finite"):
            function(values)
    with pytest.raises(ValueError, match="finite"):
        bootstrap_of(values, "mean", seed=1)


def test_a_share_of_none_in_fifty_may_be_seven_per_cent() -> None:
    found = share_of([False] * 50)
    assert (found.value, found.low) == (0.0, 0.0)
    assert found.high == pytest.approx(0.0711, abs=1e-4)


def test_the_bootstrap_of_a_mean_is_close_to_the_normal_interval() -> None:
    values = np.random.default_rng(3).exponential(2.0, 500)
    found = bootstrap_of(values, "mean", seed=4)
    half = 1.96 * values.std() / math.sqrt(500)
    assert (found.low, found.high) == pytest.approx((values.mean() - half, values.mean() + half), abs=0.03)
    assert found == bootstrap_of(values, "mean", seed=4)


def test_the_bootstrap_of_a_ratio_redraws_pairs() -> None:
    first = np.random.default_rng(5).uniform(1.0, 3.0, 200)
    found = bootstrap_of(np.column_stack([3.0 * first, first]), "ratio of means", seed=6)
    assert (found.value, found.low, found.high) == pytest.approx((3.0, 3.0, 3.0))


def test_a_ratio_to_zeros_is_infinite_and_no_warning() -> None:
    found = bootstrap_of([[1.0, 0.0], [2.0, 0.0]], "ratio of means", seed=1)
    assert found.value == math.inf


@pytest.mark.parametrize(("rows", "statistic"), [([2.0], "mean"), ([[2.0, 1.0]], "ratio of means")])
def test_one_row_alone_says_nothing_of_the_others(rows: list[float], statistic: str) -> None:
    found = bootstrap_of(rows, statistic, seed=1)
    assert (found.value, found.low, found.high) == (2.0, -math.inf, math.inf)


@pytest.mark.parametrize(("shape", "statistic"), [((3, 2), "mean"), ((3,), "ratio of means"), ((3,), "mode")])
def test_a_statistic_that_does_not_fit_is_refused(shape: tuple[int, ...], statistic: str) -> None:
    with pytest.raises(ValueError, match="statistic"):
        bootstrap_of(np.ones(shape), statistic, seed=1)


@pytest.mark.parametrize("size", [11, 60, 2000])
def test_the_interval_of_a_median_contains_it_95_times_in_a_hundred_at_least(size: int) -> None:
    rng = np.random.default_rng(size)
    inside = 0
    for _ in range(1500):
        found = median_of(rng.exponential(size=size))
        inside += found.low <= math.log(2.0) <= found.high
    assert 0.94 < inside / 1500 <= 0.995


def test_too_few_calls_leave_the_median_open() -> None:
    assert median_of([1.0, 2.0, 3.0]).high == math.inf


@pytest.mark.parametrize(("first", "second"), [(0, 22), (3, 3), (5, 9), (0, 0), (10, 1)])
def test_mcnemars_test_is_the_binomial_one_of_the_discordant_pairs(first: int, second: int) -> None:
    a = [True] * first + [False] * second + [True] * 4 + [False] * 7
    b = [False] * first + [True] * second + [True] * 4 + [False] * 7
    pairs = Paired.of(a, b)
    assert (pairs.first_only, pairs.second_only, pairs.trials) == (first, second, len(a))
    expected = stats.binomtest(first, first + second).pvalue if first + second else 1.0
    assert pairs.p_value == pytest.approx(expected)


def test_pairs_that_do_not_fit_are_refused() -> None:
    with pytest.raises(ValueError, match="same trials"):
        Paired.of([True], [True, False])
    with pytest.raises(ValueError, match="as many"):
        differences([1.0], [1.0, 2.0])


@pytest.mark.parametrize("n", [1, 5, 6, 25, 100, 5000])
def test_the_rank_of_a_median_is_the_greatest_that_misses_seldom_enough(n: int) -> None:
    rank = median_rank(n, 0.025)
    assert stats.binom.cdf(rank - 1, n, 0.5) <= 0.025 < stats.binom.cdf(rank, n, 0.5)
