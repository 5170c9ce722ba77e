"""Distribution and tolerance bounds of a margin: against hand-made numbers and measured coverage."""

from __future__ import annotations

import math

import numpy as np
import pytest
import scipy.stats
from acceptance import misses_are, misses_are_no_more_than
from streams import sample_of, with_margins

from safety_harness.base.exceptions import StatisticsError
from safety_harness.extensions.assurance.statistics.distances import (
    tolerance_bound,
)
from safety_harness.extensions.assurance.statistics.sample import EpisodeOutcome


def test_the_least_of_59_is_what_95_in_a_hundred_keep() -> None:
    """Wilks' classic number, at 95 % confidence."""
    margins = np.random.default_rng(1).normal(size=59)
    found = tolerance_bound(with_margins(margins), 0.95)
    assert (found.rank, found.at_least, found.trials) == (1, margins.min(), 59)
    too_few = tolerance_bound(with_margins(margins[:58]), 0.95)
    assert (too_few.rank, too_few.at_least) == (0, -math.inf)


def test_what_was_seen_is_the_least_margin_that_this_content_of_the_runs_kept() -> None:
    assert tolerance_bound(with_margins(np.arange(1.0, 121.0)), 0.9).seen == 13.0  # 12 of 120 are below


@pytest.mark.parametrize("n", [59, 300, 3000])
@pytest.mark.parametrize("content", [0.5, 0.9, 0.99])
def test_the_rank_is_the_greatest_that_keeps_the_confidence(n: int, content: float) -> None:
    rank = tolerance_bound(with_margins(np.arange(1.0, n + 1)), content).rank
    enough = scipy.stats.binom.sf(np.array([rank - 1, rank]), n, 1.0 - content) >= 0.95
    assert enough.tolist() == [True, False]


def test_a_tolerance_bound_misses_as_often_as_its_rank_says() -> None:
    rng, missed = np.random.default_rng(2), 0
    truth = scipy.stats.lognorm.ppf(0.1, 1.0)
    for _ in range(1500):
        found = tolerance_bound(with_margins(rng.lognormal(size=120)), 0.9)
        missed += found.at_least > truth
    assert misses_are(missed, 1500, float(scipy.stats.binom.cdf(found.rank - 1, 120, 0.1)))


def test_the_samples_own_quantile_is_no_bound() -> None:
    rng, missed = np.random.default_rng(3), 0
    for _ in range(300):
        missed += tolerance_bound(with_margins(rng.random(120)), 0.9).seen > 0.1
    assert not misses_are_no_more_than(missed, 300, 0.05)


def test_a_run_without_a_margin_may_have_had_any_and_untested_runs_are_left_out() -> None:
    unsaid = [EpisodeOutcome.FAILED, EpisodeOutcome.INCONCLUSIVE, EpisodeOutcome.FAILED]
    codes = [EpisodeOutcome.HOLDS] * 97 + unsaid + [EpisodeOutcome.UNTESTED]
    margins = [1.0] * 97 + [np.nan, 0.5, np.nan] + [0.1]
    sample = sample_of(codes, margins)
    assert tolerance_bound(sample, 0.9).at_least == 1.0
    assert tolerance_bound(sample, 0.97).at_least == -math.inf


def test_what_says_nothing_is_refused() -> None:
    with pytest.raises(StatisticsError, match="a tested run"):
        tolerance_bound(sample_of([EpisodeOutcome.UNTESTED] * 3), 0.9)
    with pytest.raises(StatisticsError, match="stop at any time"):
        tolerance_bound(with_margins([1.0, 2.0], stop_early=True), 0.9)
    for content in (0.0, 1.0, -0.5, math.nan):
        with pytest.raises(StatisticsError, match="between 0 and 1"):
            tolerance_bound(with_margins([1.0, 2.0]), content)
    with pytest.raises(TypeError, match="declared stream"):
        tolerance_bound(np.ones(3), 0.9)  # type: ignore[arg-type]
