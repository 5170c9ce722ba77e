"""What a plan needs, against formulas by hand and against simulation."""

from __future__ import annotations

import math

import numpy as np
import pytest
import scipy.stats

from safety_harness.base.exceptions import InputError, Place, StatisticsError
from safety_harness.extensions.assurance.statistics.planning import (
    Aim,
    allowed_violations,
    power,
    refuse_if_impossible,
    runs_for_power,
    runs_needed,
)


@pytest.mark.parametrize("target", [0.3, 1e-2, 1e-3, 1e-4, 1e-6])
@pytest.mark.parametrize("family", [1, 12])
def test_without_a_violation_the_number_is_the_one_by_hand(target: float, family: int) -> None:
    by_hand = math.ceil(math.log(0.05 / family) / math.log1p(-target))
    assert runs_needed(Aim(target=target, family=family)) == by_hand


def test_a_thousandth_takes_2995_runs_and_a_ten_thousandth_29956() -> None:
    assert [runs_needed(Aim(target=target)) for target in (1e-3, 1e-4)] == [2995, 29956]


@pytest.mark.parametrize("stop_early", [False, True])
@pytest.mark.parametrize("allowed", [0, 1, 7])
def test_it_is_the_least_number_that_does(stop_early: bool, allowed: int) -> None:
    aim = Aim(target=0.01, confidence=0.99, stop_early=stop_early)
    runs = runs_needed(aim, allowed=allowed)
    assert aim.shown_by(allowed, runs)
    assert not aim.shown_by(allowed, runs - 1)
    assert not aim.shown_by(allowed + 1, runs)
    assert allowed_violations(aim, runs) == allowed
    assert allowed_violations(aim, runs - 1) == (None if allowed == 0 else allowed - 1)


def test_stopping_early_costs_a_quarter_more_at_most() -> None:
    fixed, early = (runs_needed(Aim(target=1e-3, stop_early=e)) for e in (False, True))
    assert fixed < early < 1.27 * fixed


def test_power_is_how_often_it_succeeds() -> None:
    """Oracle: the whole plan simulated, tested runs and violations drawn."""
    rng = np.random.default_rng(3)
    aim = Aim(target=0.05)
    tested = rng.binomial(400, 0.6, 20_000)
    violated = rng.binomial(tested, 0.02)
    succeeded = sum(aim.shown_by(int(k), int(n)) for k, n in zip(violated, tested, strict=True))
    expected = power(aim, 400, probability=0.02, tested=0.6)
    assert 0.2 < expected < 0.9
    assert scipy.stats.binomtest(succeeded, 20_000, expected).pvalue > 1e-3


def test_power_at_the_target_itself_is_the_risk_of_error() -> None:
    aim = Aim(target=0.02, confidence=0.9)
    assert 0.0 < power(aim, 500, probability=0.02) <= 0.1
    assert power(aim, 500, probability=0.0) == 1.0
    assert power(aim, 10, probability=0.0) == 0.0
    assert power(aim, 0, probability=0.0, tested=0.5) == 0.0


def test_runs_for_power_have_it() -> None:
    aim = Aim(target=2e-3)
    runs = runs_for_power(aim, probability=5e-4, wanted=0.9)
    assert power(aim, runs, probability=5e-4) >= 0.9
    assert power(aim, int(0.8 * runs), probability=5e-4) < 0.9
    assert runs_for_power(aim, probability=0.0) == runs_needed(aim)


@pytest.mark.parametrize("probability", [2e-3, 0.5])
def test_what_is_not_true_cannot_be_shown(probability: float) -> None:
    with pytest.raises(StatisticsError, match="clearly above the true probability"):
        runs_for_power(Aim(target=2e-3), probability=probability)


def test_a_plan_that_cannot_meet_its_target_is_told_the_number_that_would() -> None:
    aim, place = Aim(target=1e-3, family=8), Place(line=12, field="runs")
    with pytest.raises(InputError, match=r":12: runs: expected at least 5073 runs.*got 3000") as raised:
        refuse_if_impossible(aim, 3000, place=place)
    assert raised.value.place is place
    refuse_if_impossible(aim, 5073)
    with pytest.raises(StatisticsError, match="at least 10146 runs"):
        refuse_if_impossible(aim, 10145, tested=0.5)
    refuse_if_impossible(aim, 10146, tested=0.5)


@pytest.mark.parametrize("target", [0.0, 1.0, -1e-3, math.nan])
def test_a_target_that_is_none_is_refused(target: float) -> None:
    with pytest.raises(StatisticsError, match="a share between 0 and 1"):
        Aim(target=target)


def test_a_target_beyond_any_number_of_runs_is_refused() -> None:
    with pytest.raises(StatisticsError, match="runs can show"):
        runs_needed(Aim(target=1e-13))
