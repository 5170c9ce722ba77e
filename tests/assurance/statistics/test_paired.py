"""Paired comparison: scipy as oracle, measured coverage, and refusal of what is no pair."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
import scipy.stats
from acceptance import misses_are_no_more_than
from streams import sample_of, with_margins

from safety_harness.base.exceptions import StatisticsError
from safety_harness.cell.simulation.worlds import KINEMATIC, PYBULLET, WorldEntry
from safety_harness.extensions.assurance.statistics.paired import compare, compare_margins
from safety_harness.extensions.assurance.statistics.sample import EpisodeOutcome

H, V, U, I, F = (int(outcome) for outcome in EpisodeOutcome)  # noqa: E741


def pair(cells: dict[tuple[int, int], int]) -> Any:
    """Two samples with so many episodes of each pair of outcomes."""
    rows = np.array([key for key, times in cells.items() for _ in range(times)])
    return sample_of(rows[:, 0]), sample_of(rows[:, 1])


@pytest.mark.parametrize(("more", "fewer"), [(0, 0), (1, 0), (9, 2), (2, 9), (30, 30), (200, 100)])
def test_the_p_value_is_mcnemars(more: int, fewer: int) -> None:
    found = compare(*pair({(V, H): more, (H, V): fewer, (V, V): 5, (H, H): 50}))
    exact = scipy.stats.binomtest(more, more + fewer).pvalue if more + fewer else 1.0
    assert found.p_value == pytest.approx(exact)
    assert (found.only_first, found.only_second, found.both, found.unclear) == (more, fewer, 5, 0)
    assert found.seen == pytest.approx((more - fewer) / found.episodes)
    assert found.low <= found.seen <= found.high


def test_exchanging_the_two_changes_the_sign_and_nothing_else() -> None:
    first, second = pair({(V, H): 9, (H, V): 2, (H, F): 3, (I, V): 1, (H, H): 80})
    one, other = compare(first, second), compare(second, first)
    assert (one.low, one.high, one.seen) == (-other.high, -other.low, -other.seen)
    assert one.p_value == other.p_value


@pytest.mark.parametrize("chances", [(0.02, 0.0), (0.1, 0.1), (0.05, 0.01), (0.4, 0.4), (0.002, 0.001)])
def test_the_interval_holds_the_difference_at_least_as_often_as_it_says(chances: tuple[float, float]) -> None:
    rng, missed, difference = np.random.default_rng(7), 0, chances[0] - chances[1]
    for _ in range(600):
        drawn = rng.choice(3, 200, p=[*chances, 1.0 - sum(chances)])
        found = compare(sample_of(np.where(drawn == 0, V, H)), sample_of(np.where(drawn == 1, V, H)), 0.9)
        missed += not found.low <= difference <= found.high
    assert misses_are_no_more_than(missed, 600, 0.1)


def test_the_interval_narrows_to_the_truth() -> None:
    wide, narrow = (compare(*pair({(V, H): 4 * n, (H, V): n, (H, H): 95 * n})) for n in (1, 100))
    assert narrow.high - narrow.low < 0.02 < wide.high - wide.low
    assert narrow.low > 0.02


def test_an_unclear_run_speaks_for_neither() -> None:
    clear = compare(*pair({(V, H): 10, (H, V): 0, (H, H): 90}))
    unclear = compare(*pair({(V, H): 10, (H, F): 10, (H, H): 80}))
    assert clear.p_value < 0.01
    assert unclear.p_value == 1.0
    assert unclear.low < clear.low
    assert unclear.unclear == 10
    both = compare(*pair({(F, I): 20}))
    assert (both.p_value, both.low, both.high) == (1.0, -1.0, 1.0)
    assert math.isnan(both.seen)


def test_an_untested_episode_is_no_violation() -> None:
    found = compare(*pair({(V, U): 6, (U, U): 30, (U, H): 4}))
    assert (found.only_first, found.episodes, found.unclear) == (6, 40, 0)


def test_margins_are_compared_in_pairs() -> None:
    rng = np.random.default_rng(8)
    common, shift = rng.gamma(2.0, 1.0, 200), rng.normal(0.05, 0.01, 200)
    found = compare_margins(with_margins(common + shift), with_margins(common))
    t = scipy.stats.ttest_rel(common + shift, common).confidence_interval(0.95)
    assert (found.mean_low, found.mean_high) == pytest.approx((t.low, t.high), abs=0.2 * (t.high - t.low))
    assert 0.0 < found.median_low < found.median < found.median_high < 0.06
    assert (found.pairs, found.left_out) == (200, 0)


@pytest.mark.parametrize("n", [6, 25, 100])
def test_the_medians_interval_is_exact(n: int) -> None:
    """Its ranks are those of the sign test: one further in would miss too often."""
    found = compare_margins(with_margins(np.arange(1.0, n + 1)), with_margins(np.zeros(n)))
    rank = int(found.median_low)
    assert found.median_high == n + 1 - rank
    assert scipy.stats.binom.cdf(rank - 1, n, 0.5) <= 0.025 < scipy.stats.binom.cdf(rank, n, 0.5)


def test_five_pairs_say_nothing_certain_of_the_median() -> None:
    found = compare_margins(with_margins([1.0, 2.0, 3.0, 4.0, 5.0]), with_margins(np.zeros(5)))
    assert (found.median_low, found.median_high) == (-math.inf, math.inf)


def test_episodes_without_a_margin_are_left_out_and_counted() -> None:
    first = sample_of([H, H, F, H], [1.0, 2.0, np.nan, 3.0])
    found = compare_margins(first, with_margins(np.zeros(4)))
    assert (found.pairs, found.left_out, found.mean) == (3, 1, 2.0)


@pytest.mark.parametrize(
    "changes",
    [
        {"seed": 2},
        {"stratum": "unseen"},
        {"world": KINEMATIC},
        {"planned": 3},
        {"stop_early": True},
        {"draws_sha256": "2" * 64},
        {"seeds": [0, 1, 2, 7]},
    ],
)
def test_samples_of_other_episodes_are_refused(changes: dict[str, Any]) -> None:
    codes = [H] * changes.get("planned", 4)
    for comparison in (compare, compare_margins):
        with pytest.raises(StatisticsError):
            comparison(sample_of([H] * 4), sample_of(codes, **changes))


def test_two_plans_are_compared_only_where_episode_by_episode_they_draw_the_same() -> None:
    """Another avoider is another plan; another space, or other seeds, are other scenarios."""
    mine = sample_of([H, V, H, H])
    assert compare(mine, sample_of([H, H, V, H], plan_sha256="3" * 64)).episodes == 4
    with pytest.raises(StatisticsError, match="draws_sha256: expected two samples of the same episodes"):
        compare(mine, sample_of([H] * 4, draws_sha256="2" * 64))
    with pytest.raises(StatisticsError, match="seeds: expected the same seed of each episode") as refused:
        compare(mine, sample_of([H] * 4, seeds=[0, 1, 5, 3]))
    assert refused.value.got == "2 and 5 in episode 2"


def test_the_mean_s_interval_holds_as_often_as_it_says_where_students_does_not() -> None:
    rng, truth, missed, student = np.random.default_rng(15), math.exp(0.5), 0, 0
    for _ in range(400):
        drawn = rng.lognormal(size=30)
        found = compare_margins(with_margins(drawn), with_margins(np.zeros(30)))
        missed += not found.mean_low <= truth <= found.mean_high
        t = scipy.stats.ttest_1samp(drawn, 0.0).confidence_interval(0.95)
        student += not t.low <= truth <= t.high
    assert misses_are_no_more_than(missed, 400, 0.05)
    assert not misses_are_no_more_than(student, 400, 0.05)


def test_a_limit_makes_the_mean_s_interval_exact() -> None:
    """Nineteen of twenty differences are 0: hopeless for anything that looks at the spread alone."""
    rng, missed = np.random.default_rng(18), 0
    for _ in range(400):
        drawn = (rng.random(30) < 0.05).astype(float)
        found = compare_margins(with_margins(drawn), with_margins(np.zeros(30)), limit=1.0)
        missed += not found.mean_low <= 0.05 <= found.mean_high
    assert misses_are_no_more_than(missed, 400, 0.05)


def test_the_bounded_interval_is_maurer_and_pontils() -> None:
    drawn = np.random.default_rng(16).uniform(-0.1, 0.3, 2000)
    found = compare_margins(with_margins(drawn + 1.0), with_margins(np.ones(2000)), limit=0.5)
    v, log = float(np.var(drawn, ddof=1)), math.log(80.0)
    half = math.sqrt(2.0 * v * log / 2000) + 7.0 * 1.0 * log / (3.0 * 1999)
    assert found.mean_high - found.mean == pytest.approx(half)
    with pytest.raises(StatisticsError, match=r"at most 0\.2"):
        compare_margins(with_margins(drawn + 1.0), with_margins(np.ones(2000)), limit=0.2)


def test_differences_that_hardly_ever_differ_say_nothing_of_the_mean_without_a_limit() -> None:
    for lonely in (0, 1):
        differences = (np.arange(30) < lonely).astype(float)
        pair_of = (with_margins(1.0 + differences), with_margins(np.ones(30)))
        free, bounded = compare_margins(*pair_of), compare_margins(*pair_of, limit=1.0)
        assert (free.mean_low, free.mean_high) == (-math.inf, math.inf)
        assert -1.0 <= bounded.mean_low < bounded.mean_high <= 1.0


def test_a_margin_without_a_verdict_is_none() -> None:
    """Untested and inconclusive runs may come with a margin: it says how near something else came."""
    margins = [1.0, 2.0, 3.0, 400.0, 500.0, 600.0]
    found = compare_margins(sample_of([H, H, H, U, I, F], margins), with_margins(np.zeros(6)))
    assert (found.pairs, found.left_out, found.mean) == (3, 3, 2.0)
    other = compare_margins(with_margins(np.zeros(6)), sample_of([H, H, H, U, I, F], margins))
    assert (other.pairs, other.mean) == (3, -2.0)


@pytest.mark.parametrize(("world", "model_only"), [(KINEMATIC, True), (PYBULLET, False)])
def test_what_comes_of_a_simplified_world_says_so(world: WorldEntry, model_only: bool) -> None:
    samples = [with_margins([1.0, 2.0, 4.0], world=world) for _ in range(2)]
    assert compare(*samples).model_only is model_only
    assert compare_margins(*samples).model_only is model_only


def test_fewer_than_two_pairs_have_no_mean() -> None:
    with pytest.raises(StatisticsError, match="two judged episodes"):
        compare_margins(sample_of([F, H], [np.nan, 1.0]), with_margins([0.0, 0.0]))
