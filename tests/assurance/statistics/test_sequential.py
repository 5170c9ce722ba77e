"""Bounds at every time: useful, and wrong no more often than they say, whenever one stops."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np
import pytest
import scipy.integrate
import scipy.stats

from safety_harness.base.proportions import upper_bound
from safety_harness.extensions.assurance.statistics.sample import Floats, Ints
from safety_harness.extensions.assurance.statistics.sequential import (
    anytime_lower,
    anytime_upper,
    evidence_apart,
    evidence_below,
)

CHANCE = 0.05


@pytest.mark.parametrize(("count", "trials"), [(0, 40), (3, 40), (20, 40), (39, 40)])
@pytest.mark.parametrize("share", [0.02, 0.3, 0.99])
def test_the_evidence_is_the_mixture_of_likelihood_ratios(count: int, trials: int, share: float) -> None:
    """Oracle: the integral over the alternatives, numerically."""

    def ratio(alternative: float) -> float:
        logs = scipy.stats.binom.logpmf(count, trials, [alternative, share])
        return float(np.exp(logs[0] - logs[1]))

    below = scipy.integrate.quad(lambda v: ratio(share * v * v), 0.0, 1.0, epsabs=0.0)[0]  # u = v^2
    assert np.exp(evidence_below(share, count, trials)) == pytest.approx(below, rel=1e-6)
    apart = scipy.integrate.quad(lambda t: ratio(np.sin(t) ** 2), 0.0, np.pi / 2, epsabs=0.0, limit=200)[0]
    assert np.exp(evidence_apart(share, count, trials)) == pytest.approx(apart / (np.pi / 2), rel=1e-6)


@pytest.mark.parametrize("trials", [1, 50, 3000, 10**6])
def test_the_bounds_are_where_the_evidence_reaches_the_limit(trials: int) -> None:
    for count in {0, 1, trials // 100, trials // 2, trials}:
        low, high = anytime_lower(count, trials, CHANCE), anytime_upper(count, trials, CHANCE)
        assert low <= count / trials <= high
        if count < trials:
            assert evidence_below(high, count, trials) == pytest.approx(np.log(20.0), abs=1e-6)
        if count:
            assert evidence_apart(low, count, trials) == pytest.approx(np.log(20.0), abs=1e-6)


def test_more_runs_without_a_violation_bound_more_tightly_and_less_than_a_fixed_plan() -> None:
    bounds = [anytime_upper(0, n, CHANCE) for n in (10, 100, 1000, 10_000)]
    fixed = [upper_bound(0, n, CHANCE) for n in (10, 100, 1000, 10_000)]
    assert sorted(bounds, reverse=True) == bounds
    assert all(f < b < 1.3 * f for f, b in zip(fixed, bounds, strict=True))


def once(formula: Callable[..., Floats], counts: Ints, trials: Ints) -> Floats:
    """``formula`` of counts (streams, length), evaluated once where streams agree."""
    known, back = np.unique(counts * (len(trials) + 1) + trials, return_inverse=True)
    return formula(known // (len(trials) + 1), known % (len(trials) + 1))[back.reshape(counts.shape)]


def ever_wrong(share: float, streams: int, length: int, seed: int) -> tuple[int, int, int]:
    """Streams whose upper, lower, and fixed-length upper bound is wrong at some time."""
    draws = np.random.default_rng(seed).random((streams, length)) < share
    counts, trials = np.cumsum(draws, axis=1), np.arange(1, length + 1)
    limit = np.log(1.0 / CHANCE)
    above = (once(partial(evidence_below, share), counts, trials) >= limit) & (counts < trials)
    apart = (once(partial(evidence_apart, share), counts, trials) >= limit) & (counts > share * trials)
    peeking = once(lambda k, n: scipy.stats.binom.cdf(k, n, share), counts, trials) <= CHANCE
    return tuple(int(np.count_nonzero(wrong.any(axis=1))) for wrong in (above, apart, peeking))  # type: ignore[return-value]


@pytest.mark.parametrize("share", [0.5, 0.1, 0.01])
def test_the_adversary_who_stops_at_the_worst_time_finds_them_wrong_no_more_often_than_they_say(
    share: float,
) -> None:
    streams = 600
    above, apart, peeking = ever_wrong(share, streams, length=2000, seed=11)
    for wrong in (above, apart):
        assert scipy.stats.binomtest(wrong, streams, CHANCE, "greater").pvalue > 1e-3
    assert scipy.stats.binomtest(peeking, streams, CHANCE, "greater").pvalue < 1e-6, "fixed bounds, peeked at"


def test_stopping_as_soon_as_a_target_seems_shown_keeps_the_risk() -> None:
    """The truth is just above the target: every stop is an error."""
    target, streams = 0.02, 400
    draws = np.random.default_rng(12).random((streams, 1500)) < 1.02 * target
    counts, trials = np.cumsum(draws, axis=1), np.arange(1, 1501)
    shown = once(partial(evidence_below, target), counts, trials) >= np.log(1.0 / CHANCE)
    assert scipy.stats.binomtest(int(shown.any(axis=1).sum()), streams, CHANCE, "greater").pvalue > 1e-3
    assert shown.any(), "the test can fail"
