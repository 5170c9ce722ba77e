"""Metrics against independent formulas: scipy, brute force, and what they promise on fresh data."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest
import scipy.stats
from disagreement import noted
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from safety_harness.extensions.lab.learning import metrics

Floats = NDArray[np.float64]


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(20)


def test_errors_are_those_of_a_loop_over_numbers(rng: np.random.Generator) -> None:
    predictions, targets = rng.normal(size=(2, 7, 3))
    errors = metrics.errors(predictions, targets)
    by_axis = [[p - t for p, t in zip(predictions[:, k], targets[:, k], strict=True)] for k in range(3)]
    for k, axis in enumerate(by_axis):
        assert errors.rmse[k] == pytest.approx((sum(e * e for e in axis) / 7) ** 0.5)
        assert errors.mae[k] == pytest.approx(sum(abs(e) for e in axis) / 7)
    every = [e for axis in by_axis for e in axis]
    assert errors.overall_rmse == pytest.approx((sum(e * e for e in every) / 21) ** 0.5)
    assert errors.overall_mae == pytest.approx(sum(abs(e) for e in every) / 21)


def test_intervals_of_the_true_normal_distribution_cover_95_percent(rng: np.random.Generator) -> None:
    means, stds = rng.normal(size=(20_000, 3)), rng.uniform(0.5, 2.0, (20_000, 3))
    covered = metrics.coverage(means, rng.normal(means, stds), metrics.half_width_of_spread(stds))
    assert covered.picp == pytest.approx(0.95, abs=0.006)  # four standard errors
    assert covered.joint == pytest.approx(0.95**3, abs=0.01)
    assert covered.mean_width == pytest.approx(2 * 1.96 * stds.mean(axis=0))


def test_coverage_counts_the_ends_of_an_interval_and_nothing_beyond() -> None:
    targets = np.array([[1.0, 1.0, 1.0], [-1.0, 1.5, 0.0]])
    covered = metrics.coverage(np.zeros((2, 3)), targets, np.ones((2, 3)))
    assert covered.picp.tolist() == [1.0, 0.5, 1.0]
    assert covered.joint == 0.5


def test_eq_11_as_printed_is_the_mean_of_the_squared_passes(rng: np.random.Generator) -> None:
    passes = rng.normal(3.0, 1.0, (10, 5, 3))
    half = metrics.half_width_with(passes.std(axis=0), passes.mean(axis=0) ** 2)
    assert half == pytest.approx(1.96 * np.sqrt((passes**2).sum(axis=0) / 10))


def test_precision_and_residuals_are_variances_that_add(rng: np.random.Generator) -> None:
    spreads = rng.uniform(1.0, 2.0, (4, 3))
    noise_std = np.array([3.0, 4.0, 5.0])
    assert metrics.half_width_with(spreads, noise_std**2) == pytest.approx(
        1.96 * np.hypot(spreads, noise_std)
    )
    assert metrics.half_width_with(spreads, 9.0) == pytest.approx(1.96 * np.hypot(spreads, 3.0))


def test_variants_of_the_picp_differ_as_their_intervals_do(rng: np.random.Generator) -> None:
    """A network that knows its own doubt of 1 mm, but not the labels' noise of 10 mm, in metres."""
    doubt, noise = 1e-3, 10e-3
    predictions = rng.normal([0.7, 0.1, 0.4], 0.05, (5_000, 3))
    targets = rng.normal(predictions, noise)
    variants = metrics.picp_variants(
        predictions, targets, np.full((5_000, 3), doubt), precision=1.0, residual_std=np.full(3, noise)
    )
    inside = scipy.stats.norm.cdf(1.96 * doubt / noise) * 2 - 1
    assert variants["spread"].picp == pytest.approx(inside, abs=0.03)
    assert variants["spread and residuals"].picp == pytest.approx(0.95, abs=0.02)
    assert variants["spread and 1/tau"].picp.tolist() == [1.0, 1.0, 1.0]
    assert variants["eq. 11 as printed"].picp[0] == 1.0


@pytest.mark.parametrize("factor", [0.5, 1.0, 2.0])
def test_calibration_curve_is_the_normal_distribution_s(rng: np.random.Generator, factor: float) -> None:
    stds = rng.uniform(0.5, 2.0, (20_000, 3))
    levels = np.array([0.1, 0.5, 0.9, 0.99])
    shares = metrics.calibration_curve(np.zeros_like(stds), rng.normal(0.0, stds), factor * stds, levels)
    ends = factor * scipy.stats.norm.ppf((1 + levels) / 2)
    expected = scipy.stats.norm.cdf(ends) - scipy.stats.norm.cdf(-ends)
    assert shares == pytest.approx(np.repeat(expected[:, None], 3, axis=1), abs=0.015)


scores = st.lists(st.integers(0, 5), min_size=1, max_size=12)


@given(scores, scores)
def test_auroc_is_the_share_of_pairs_in_order_ties_half(without: list[int], having: list[int]) -> None:
    pairs = [1.0 if b > a else 0.5 if b == a else 0.0 for a, b in product(without, having)]
    area = metrics.auroc(np.array(without, float), np.array(having, float))
    assert area == pytest.approx(sum(pairs) / len(pairs))


def test_auroc_agrees_with_scipy_s_rank_sum(rng: np.random.Generator) -> None:
    without, having = rng.normal(0.0, 1.0, 300).round(1), rng.normal(0.7, 1.0, 200).round(1)
    u = scipy.stats.mannwhitneyu(having, without).statistic
    noted("scipy", "AUROC by rank sums", "", metrics.auroc(without, having), u / (300 * 200))
    assert metrics.auroc(without, having) == pytest.approx(u / (300 * 200))


@given(st.integers(1, 400), st.sampled_from([0.5, 0.9, 0.95, 0.99]))
def test_conformal_quantile_has_the_rank_of_its_formula(count: int, level: float) -> None:
    """The scores are their own ranks; the smallest rank k with k / (n + 1) >= level, in whole numbers."""
    hundredths = round(100 * level)
    fitting = [k for k in range(1, count + 1) if 100 * k >= hundredths * (count + 1)]
    shuffled = np.random.default_rng(count).permutation(np.arange(1.0, count + 1.0))
    if fitting:
        assert metrics.conformal_quantile(shuffled, level) == fitting[0]
    else:
        with pytest.raises(ValueError, match="too few"):
            metrics.conformal_quantile(shuffled, level)


def test_conformal_intervals_cover_all_axes_of_fresh_data_at_the_level(rng: np.random.Generator) -> None:
    """Mean coverage over many small calibrations: k/(n+1) exactly for continuous scores, here 0.95."""
    shares = []
    for _ in range(2_000):
        targets = rng.standard_t(3, (39 + 50, 3))
        scales = np.array([1.0, 2.0, 0.5])
        multiplier = metrics.conformal_multiplier(np.zeros((39, 3)), targets[:39], scales)
        shares.append(np.all(np.abs(targets[39:]) <= multiplier * scales, axis=1).mean())
    assert np.mean(shares) == pytest.approx(0.95, abs=4 * np.std(shares) / np.sqrt(2_000))


def test_spread_threshold_is_exceeded_by_one_fresh_decision_in_a_hundred(rng: np.random.Generator) -> None:
    shares = []
    for _ in range(500):
        spreads = rng.gamma(2.0, 1.0, (199 + 100, 3))
        threshold = metrics.spread_threshold(spreads[:199])
        shares.append((spreads[199:].max(axis=1) > threshold).mean())
    assert np.mean(shares) == pytest.approx(0.01, abs=4 * np.std(shares) / np.sqrt(500))


def test_nothing_that_is_not_finite_is_measured() -> None:
    good, bad = np.ones((3, 3)), np.ones((3, 3))
    bad[1, 1] = np.nan
    for measure in (
        lambda: metrics.errors(bad, good),
        lambda: metrics.coverage(bad, good, good),
        lambda: metrics.coverage(good, good, bad),
        lambda: metrics.calibration_curve(good, good, bad, np.array([0.5])),
        lambda: metrics.auroc(bad[1], good[0]),
        lambda: metrics.conformal_quantile(np.full(30, np.nan), 0.5),
        lambda: metrics.conformal_multiplier(good, good, bad),
        lambda: metrics.spread_threshold(bad, 0.5),
    ):
        with pytest.raises(ValueError, match="finite"):
            measure()


def test_impossible_levels_scales_and_empty_sets_are_refused() -> None:
    with pytest.raises(ValueError, match="between 0 and 1"):
        metrics.conformal_quantile(np.arange(30.0), 1.0)
    with pytest.raises(ValueError, match="positive"):
        metrics.conformal_multiplier(np.zeros((30, 3)), np.ones((30, 3)), np.array([1.0, 0.0, 1.0]))
    with pytest.raises(ValueError, match="at least one"):
        metrics.auroc(np.empty(0), np.ones(3))
