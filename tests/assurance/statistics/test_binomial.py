"""Exact bounds: against scipy, and against how often they contain the truth, by enumeration."""

from __future__ import annotations

import math

import numpy as np
import pytest
import scipy.stats
from streams import sample_of, violations

from safety_harness.base.exceptions import StatisticsError
from safety_harness.base.proportions import lower_bound, upper_bound
from safety_harness.cell.simulation.worlds import KINEMATIC
from safety_harness.extensions.assurance.statistics.binomial import Method, Sides, bounds_of, violation_bounds
from safety_harness.extensions.assurance.statistics.sample import EpisodeOutcome


@pytest.mark.parametrize("chance", [0.05, 0.025, 1e-4])
@pytest.mark.parametrize("trials", [1, 7, 59, 3_000, 1_000_000])
def test_the_bounds_are_scipys(trials: int, chance: float) -> None:
    for count in {0, 1, trials // 100, trials // 2, trials - 1, trials}:
        sided = {
            side: scipy.stats.binomtest(count, trials, alternative=side).proportion_ci(1.0 - chance, "exact")
            for side in ("less", "greater")
        }
        upper, lower = upper_bound(count, trials, chance), lower_bound(count, trials, chance)
        assert (lower, upper) == pytest.approx((sided["greater"].low, sided["less"].high), rel=1e-6, abs=1e-9)
        if count < trials:
            assert scipy.stats.binom.cdf(count, trials, upper) == pytest.approx(chance, rel=1e-6)
        if count > 0:
            assert scipy.stats.binom.sf(count - 1, trials, lower) == pytest.approx(chance, rel=1e-6)


def test_no_violation_in_2995_runs_shows_a_thousandth_and_in_2994_does_not() -> None:
    assert violation_bounds(violations(0, 2995), 0.95).shows(1e-3)
    assert not violation_bounds(violations(0, 2994), 0.95).shows(1e-3)


def coverage(low: np.ndarray, high: np.ndarray, shares: np.ndarray) -> np.ndarray:
    """How often intervals of each count, (n + 1,) each, hold each share (m,): every count enumerated."""
    trials, truth = len(high) - 1, shares[:, None]
    chances = scipy.stats.binom.pmf(np.arange(trials + 1), trials, truth)
    return np.asarray(np.where((low <= truth) & (truth <= high), chances, 0.0).sum(axis=1))


def wald(count: int, trials: int, chance: float) -> float:
    share = count / trials
    return share + scipy.stats.norm.isf(chance) * math.sqrt(share * (1.0 - share) / trials)


@pytest.mark.parametrize("trials", [20, 120])
def test_the_upper_bound_covers_as_often_as_it_says_whatever_the_truth(trials: int) -> None:
    upper = np.array([upper_bound(k, trials, 0.05) for k in range(trials + 1)])
    shares = np.concatenate([np.linspace(0.0, 1.0, 101), np.geomspace(1e-5, 0.1, 60), upper - 1e-12])
    assert coverage(np.zeros_like(upper), upper, shares).min() >= 0.95 - 1e-9


def test_the_two_bounds_together_cover_as_often_as_they_say() -> None:
    trials = 80
    ends = [violation_bounds(violations(k, trials), 0.9, Sides.BOTH) for k in range(trials + 1)]
    low, high = (np.array([getattr(one, end) for one in ends]) for end in ("low", "high"))
    assert coverage(low, high, np.linspace(0.001, 0.999, 333)).min() >= 0.9 - 1e-9


def test_a_broken_interval_fails_the_same_test() -> None:
    upper = np.array([wald(k, 300, 0.05) for k in range(301)])
    assert coverage(np.zeros_like(upper), upper, np.array([0.01])) < 0.83  # nominal: 0.95


def test_upper_bounds_count_what_may_have_been_a_violation_and_lower_bounds_do_not() -> None:
    codes = (
        [EpisodeOutcome.HOLDS] * 90
        + [EpisodeOutcome.VIOLATED] * 4
        + [EpisodeOutcome.INCONCLUSIVE] * 3
        + [EpisodeOutcome.FAILED] * 3
    )
    found = violation_bounds(sample_of(codes + [EpisodeOutcome.UNTESTED] * 50), 0.9, Sides.BOTH)
    assert (found.trials, found.violations, found.inconclusive, found.failed, found.untested) == (
        100,
        4,
        3,
        3,
        50,
    )
    assert found.high == pytest.approx(upper_bound(10, 100, 0.05))
    assert found.low == pytest.approx(lower_bound(4, 100, 0.05))
    assert found.share == 0.04


def test_a_claim_that_was_never_tested_shows_nothing() -> None:
    found = violation_bounds(sample_of([EpisodeOutcome.UNTESTED] * 5000), 0.95, Sides.BOTH)
    assert (found.low, found.high, found.share, found.trials) == (0.0, 1.0, None, 0)
    assert not found.shows(1.0)


def test_bonferroni_shares_the_error_among_all_bounds() -> None:
    found = bounds_of([violations(0, 100), violations(2, 200)], 0.95)
    assert [bound.confidence for bound in found] == pytest.approx([0.975, 0.975])
    assert found[0].high == pytest.approx(1 - 0.025 ** (1 / 100))
    assert found[1].high == pytest.approx(upper_bound(2, 200, 0.025))
    both = bounds_of([violations(0, 100), violations(2, 200)], 0.95, Sides.BOTH)
    assert (both[0].family, both[0].joint_confidence) == (4, 0.95)
    assert both[0].high == pytest.approx(1 - 0.0125 ** (1 / 100))


@pytest.mark.parametrize(("sides", "least"), [(Sides.UPPER, 10), (Sides.BOTH, 20)])
def test_a_family_smaller_than_the_bounds_that_are_made_is_refused(sides: Sides, least: int) -> None:
    samples = [violations(0, 100)] * 10
    for family in (1, least - 1):
        with pytest.raises(
            StatisticsError, match=f"family: expected a family of at least {least}"
        ) as refused:
            bounds_of(samples, 0.95, sides, family=family)
        assert refused.value.got == str(family)
    more = bounds_of(samples, 0.95, sides, family=2 * least)
    assert more[0].high > bounds_of(samples, 0.95, sides)[0].high


@pytest.mark.parametrize(("sides", "confidence"), [(Sides.UPPER, 0.9), (Sides.BOTH, 0.9), (Sides.BOTH, 0.5)])
@pytest.mark.parametrize("family", [1, 3])
def test_an_interval_alone_covers_as_often_as_its_confidence_says(
    sides: Sides, confidence: float, family: int
) -> None:
    """Every count of 60 trials enumerated, whatever the truth; the family's errors are the plan's."""
    made = [
        bounds_of([violations(k, 60)], confidence, sides, family=family * sides.value)[0] for k in range(61)
    ]
    single = made[0].confidence
    assert family * (1.0 - single) == pytest.approx(1.0 - confidence)
    low, high = (np.array([getattr(one, end) for one in made]) for end in ("low", "high"))
    shares = np.concatenate([np.linspace(0.001, 0.999, 333), low + 1e-12, high - 1e-12])
    assert coverage(low, high, shares).min() >= single - 1e-9


def test_all_bounds_hold_together_as_often_as_they_say_even_of_dependent_claims() -> None:
    """Four claims of the same 60 runs, nested in each other."""
    rng, shares, missed = np.random.default_rng(5), np.array([0.02, 0.05, 0.1, 0.2]), 0
    upper = np.array([upper_bound(k, 60, 0.05 / 4) for k in range(61)])
    for _ in range(4000):
        counts = (rng.random((60, 1)) < shares).sum(axis=0)
        missed += bool((upper[counts] < shares).any())
    assert scipy.stats.binomtest(missed, 4000, 0.05, "greater").pvalue > 1e-3


def test_a_stream_that_may_stop_early_has_bounds_of_its_own_kind() -> None:
    fixed, early = (violation_bounds(violations(0, 3000, stop_early=e), 0.95) for e in (False, True))
    assert (fixed.method, early.method) == (Method.EXACT, Method.ANYTIME)
    assert early.high > fixed.high


def test_a_bound_of_another_world_is_model_only_and_shows_nothing() -> None:
    found = violation_bounds(violations(0, 5000, world=KINEMATIC), 0.95)
    assert found.model_only
    assert found.high < 1e-3
    assert not found.shows(1e-3)


@pytest.mark.parametrize("confidence", [0.0, 1.0, 95.0, math.nan])
def test_an_impossible_confidence_is_refused(confidence: float) -> None:
    with pytest.raises(StatisticsError, match="between 0 and 1"):
        violation_bounds(violations(0, 3), confidence)


def test_no_sample_has_no_bounds() -> None:
    with pytest.raises(StatisticsError, match="at least one sample"):
        bounds_of([], 0.95)
