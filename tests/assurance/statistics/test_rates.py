from __future__ import annotations

import numpy as np
import pytest
import scipy.stats
from whole_shifts import (
    CONFIDENCE,
    EVERY,
    EVERYDAY,
    FEW,
    Formula,
    Shifts,
    ours,
    point_by_point,
    rate_as_counted,
)

from safety_harness.extensions.assurance.statistics.rates import SharedError, most_an_hour


@pytest.mark.parametrize("count", [0, 1, 37, 5000])
def test_the_rate_under_which_so_few_events_or_fewer_have_the_chance_is_the_bound(count: int) -> None:
    most = most_an_hour(count, 12.0, 0.0125)
    assert scipy.stats.poisson.cdf(count, most * 12.0) == pytest.approx(0.0125, rel=1e-9)


def test_all_chances_together_are_what_the_confidence_leaves() -> None:
    error = SharedError(0.95, 3)
    assert 3 * error.of_each_rate + (1.0 - error.confidence_of_runs) == pytest.approx(0.05)


@pytest.mark.parametrize("shifts", EVERY, ids=lambda one: one.name)
def test_in_whole_shifts_the_bound_an_hour_is_above_the_truth_as_often_as_it_says(shifts: Shifts) -> None:
    assert shifts.coverage(ours, 100, seed=1) >= CONFIDENCE


@pytest.mark.long
@pytest.mark.parametrize("shifts", EVERY, ids=lambda one: one.name)
def test_in_a_thousand_simulations_too(shifts: Shifts) -> None:
    assert shifts.coverage(ours, 1000, seed=2) >= CONFIDENCE


@pytest.mark.parametrize("wrong", [point_by_point, rate_as_counted])
def test_a_formula_that_forgets_an_uncertainty_fails_the_same_check(wrong: Formula) -> None:
    assert FEW.coverage(wrong, 100, seed=1) < CONFIDENCE


def test_the_truth_is_what_simulated_shifts_meet() -> None:
    shifts = 300
    met = EVERYDAY.met(shifts, np.random.default_rng(3))
    spread = (EVERYDAY.truth / (shifts * 8.0)) ** 0.5
    assert abs(met - EVERYDAY.truth) < 4.0 * spread


def test_no_time_of_observation_bounds_no_rate() -> None:
    """Nobody looked: whatever the count, any rate may be."""
    assert most_an_hour(0, 0.0, 0.05) == float("inf")
