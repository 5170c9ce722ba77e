from __future__ import annotations

import numpy as np
import pytest
import scipy.stats
from disagreement import noted

from safety_harness.base.proportions import Proportion, share_words, sign_test


@pytest.mark.parametrize("trials", [1, 2, 7, 59, 1_000, 30_000])
def test_the_interval_is_clopper_and_pearson_s(trials: int) -> None:
    for count in {0, 1, trials // 100, trials // 2, trials - 1, trials}:
        found = Proportion.from_rows(np.arange(trials) < count)
        exact = scipy.stats.binomtest(count, trials).proportion_ci(0.95, method="exact")
        assert (found.count, found.trials, found.share) == (count, trials, count / trials)
        noted("scipy", "exact intervals of a share", "", (found.low, found.high), (exact.low, exact.high))
        assert (found.low, found.high) == pytest.approx((exact.low, exact.high), rel=1e-9, abs=1e-12)


def test_no_failure_in_fifty_still_leaves_seven_in_a_hundred() -> None:
    """1 - 0.025^(1/50), by hand."""
    assert Proportion.from_rows(np.zeros(50, bool)).high == pytest.approx(1 - 0.025 ** (1 / 50))


def test_no_trial_is_no_share() -> None:
    with pytest.raises(ValueError, match="at least one"):
        Proportion.from_rows(np.empty(0, bool))


@pytest.mark.parametrize(("more", "fewer"), [(0, 0), (1, 0), (0, 22), (3, 3), (10, 1), (400, 300)])
def test_the_sign_test_is_the_binomial_one(more: int, fewer: int) -> None:
    exact = scipy.stats.binomtest(more, more + fewer).pvalue if more + fewer else 1.0
    assert sign_test(more, fewer) == pytest.approx(exact)
    assert sign_test(more, fewer) == sign_test(fewer, more)


@pytest.mark.parametrize(
    ("count", "total", "words"),
    [
        (0, 7, "0 %"),
        (7, 7, "100 %"),
        (1, 7, "14.3 %"),
        (1, 8126, "under 0.1 %"),
        (8125, 8126, "over 99.9 %"),
        (0, 0, "\u2013"),
    ],
)
def test_a_share_is_never_nothing_of_something_nor_all_of_less(count: int, total: int, words: str) -> None:
    assert share_words(count, total) == words
