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
from safety_harness.extensions.assurance.statistics.paired import compare
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
    drawn, times = np.unique(
        rng.multinomial(200, [*chances, 1.0 - sum(chances)], 150), axis=0, return_counts=True
    )
    for (first, second, neither), many in zip(drawn, times, strict=True):
        found = compare(*pair({(V, H): first, (H, V): second, (H, H): neither}), 0.9)
        missed += many * (not found.low <= difference <= found.high)
    assert misses_are_no_more_than(missed, 150, 0.1)


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
    with pytest.raises(StatisticsError):
        compare(sample_of([H] * 4), sample_of(codes, **changes))


def test_two_plans_are_compared_only_where_episode_by_episode_they_draw_the_same() -> None:
    """Another avoider is another plan; another space, or other seeds, are other scenarios."""
    mine = sample_of([H, V, H, H])
    assert compare(mine, sample_of([H, H, V, H], plan_sha256="3" * 64)).episodes == 4
    with pytest.raises(StatisticsError, match="draws_sha256: expected two samples of the same episodes"):
        compare(mine, sample_of([H] * 4, draws_sha256="2" * 64))
    with pytest.raises(StatisticsError, match="seeds: expected the same seed of each episode") as refused:
        compare(mine, sample_of([H] * 4, seeds=[0, 1, 5, 3]))
    assert refused.value.got == "2 and 5 in episode 2"


@pytest.mark.parametrize(("world", "model_only"), [(KINEMATIC, True), (PYBULLET, False)])
def test_what_comes_of_a_simplified_world_says_so(world: WorldEntry, model_only: bool) -> None:
    samples = [with_margins([1.0, 2.0, 4.0], world=world) for _ in range(2)]
    assert compare(*samples).model_only is model_only
