"""The searches find planted bugs with fixed seeds, within budgets well below what chance needs."""

from __future__ import annotations

import numpy as np
import pytest

from safety_harness.search.search import find_violations
from safety_harness.search.searchers import SEARCHERS, MakesSearcher
from tests.search.planted import BUGS, BY_LOT, CUBE, FLAT, GOALS, SMOOTH, Bug, share_violated, world

SEEDS = range(3)
DEFAULT = SEARCHERS[0]
WRONG_OCTANT = SMOOTH[0]
# Chance needs more than 1,000 draws, the default search at most a fifth; see docs/results/search-power.md.
HARD = (SMOOTH[4], FLAT[0], BY_LOT[2])


def needed(make: MakesSearcher, bug: Bug, seed: int, budget: int) -> int:
    """Episodes to the first violation; budget + 1 without one."""
    searcher = make(CUBE, claims=len(GOALS), seed=seed)
    found = find_violations(
        CUBE,
        GOALS,
        world(bug),
        searcher,
        budget=budget,
        batch=16,
        enough=lambda findings: bool(findings.violated[0]),
    )
    return int(found.first_violation[0]) or budget + 1


@pytest.mark.parametrize("bug", BUGS, ids=lambda bug: bug.__name__)
def test_each_planted_bug_is_there_and_rare(bug: Bug) -> None:
    assert 0.0 < share_violated(bug, draws=100_000) < 2e-3


def test_three_bugs_are_flat_and_the_others_are_not() -> None:
    points = np.random.default_rng(0).random((2000, CUBE.dimension))
    for bug in BUGS:
        margins = world(bug)(points, 0).margins[:, 0]
        assert (len(np.unique(margins)) <= 2) == (bug in FLAT), bug.__name__
    assert len(FLAT) == 3


@pytest.mark.parametrize("bug", SMOOTH, ids=lambda bug: bug.__name__)
def test_the_default_finds_a_bug_with_slopes_within_a_thousand_episodes(bug: Bug) -> None:
    assert np.median([needed(DEFAULT, bug, seed, 1000) for seed in SEEDS]) <= 1000


@pytest.mark.parametrize("bug", FLAT, ids=lambda bug: bug.__name__)
def test_the_default_finds_a_flat_bug_within_six_thousand_episodes(bug: Bug) -> None:
    assert np.median([needed(DEFAULT, bug, seed, 6000) for seed in SEEDS]) <= 6000


@pytest.mark.parametrize("bug", HARD, ids=lambda bug: bug.__name__)
def test_chance_needs_more_than_five_times_as_many(bug: Bug) -> None:
    """The default against the median of independent draws, which the share of the space says by itself."""
    chance = np.log(2.0) / share_violated(bug, draws=200_000)
    assert chance > 1000
    assert 5.0 * np.median([needed(DEFAULT, bug, seed, 2000) for seed in range(5)]) < chance


@pytest.mark.parametrize("make", SEARCHERS, ids=lambda make: make.name)
def test_every_searcher_finds_a_bug_of_one_run_in_1700_within_6000(make: MakesSearcher) -> None:
    """The bug has slopes: the margin grows towards it."""
    assert all(needed(make, WRONG_OCTANT, seed, 6000) <= 6000 for seed in range(2))
