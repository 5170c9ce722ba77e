"""Every searcher keeps to the cube, repeats itself from its seed, and copes with scores that say nothing."""

from __future__ import annotations

import operator
from collections.abc import Callable

import numpy as np
import pytest

from safety_harness.search.cma_es import CmaEs
from safety_harness.search.cube import Column, Cube, Points
from safety_harness.search.default import Default
from safety_harness.search.diverse import Diverse
from safety_harness.search.sampling import UniformSampling
from safety_harness.search.search import AskTell
from safety_harness.search.searchers import SEARCHERS, MakesSearcher
from tests.search.planted import CUBE

MIXED = Cube((Column(), Column((0.0, 0.9, 1.0), flat=True), Column((0.0, 0.5, 1.0)), Column()))
NAME = operator.attrgetter("name")
every = pytest.mark.parametrize("make", SEARCHERS, ids=NAME)


def bowl(points: Points) -> Points:
    """Least, and below 0, within about 0.1 of one point; two claims, the other far from violated."""
    way = np.linalg.norm(points[:, [0, 2, 3]] - [0.8, 0.3, 0.6], axis=1)
    return np.column_stack([way - 0.05, 2.0 - points[:, 0]])


def tried(make: MakesSearcher, scores_of: Callable[[Points], Points], count: int, seed: int = 1) -> Points:
    search = AskTell(make(MIXED, claims=2, seed=seed), MIXED.dimension, 2)
    found: list[Points] = []
    while sum(map(len, found)) < count:
        points = search.ask(8)
        search.tell_scores(scores_of(points))
        found.append(points)
    return np.concatenate(found)[:count]


@every
def test_the_same_seed_gives_the_same_points_whatever_the_global_generator_did(make: MakesSearcher) -> None:
    first = tried(make, bowl, 100)
    np.random.seed(7)  # noqa: NPY002
    assert np.array_equal(tried(make, bowl, 100), first)
    assert not np.array_equal(tried(make, bowl, 100, seed=2), first)


@every
def test_the_global_generator_is_left_alone(make: MakesSearcher) -> None:
    before = np.random.get_state()[1].copy()  # noqa: NPY002
    tried(make, bowl, 100)
    assert np.array_equal(np.random.get_state()[1], before)  # noqa: NPY002


@every
@pytest.mark.parametrize("value", [np.nan, np.inf, 0.0, 0.3, -1.0])
def test_scores_that_are_all_alike_do_not_stop_a_search(make: MakesSearcher, value: float) -> None:
    points = tried(make, lambda points: np.full((len(points), 2), value), 120)
    assert len(np.unique(points, axis=0)) > 40


@every
def test_both_alternatives_are_tried_and_every_interval(make: MakesSearcher) -> None:
    points = tried(make, bowl, 600)  # a descent from some beginnings takes 300 in one of them
    for column in (1, 2):
        assert set(MIXED.columns[column].interval_of(points[:, column]).tolist()) == {0, 1}


@pytest.mark.parametrize("make", [Default, CmaEs], ids=NAME)
def test_it_goes_where_scores_fall_before_anything_is_violated(make: MakesSearcher) -> None:
    points, by_chance = (
        tried(one, lambda points: bowl(points) + 1.0, 600) for one in (make, UniformSampling)
    )
    assert np.median(bowl(points[300:])[:, 0]) < 0.7 * np.median(bowl(by_chance[300:])[:, 0])


def test_the_diverse_one_visits_cells_that_chance_seldom_does() -> None:
    """Cells are shells about one point, each a tenth of the radius of the one before."""

    def cells(points: Points) -> list[int]:
        way = np.linalg.norm(points[:, [0, 2, 3]] - [0.8, 0.3, 0.6], axis=1)
        return np.floor(-np.log2(way)).astype(int).tolist()

    visited = []
    for make in (Diverse, UniformSampling):
        search = AskTell(make(MIXED, claims=1, seed=1), MIXED.dimension, 1)
        seen: list[int] = []
        while len(seen) < 600:
            points = search.ask(8)
            search.tell_scores(np.zeros((len(points), 1)), cells(points))
            seen += cells(points)
        visited.append(sum(cell >= 4 for cell in seen))
    assert visited[0] > 3 * visited[1]


@every
def test_one_row_in_three_that_says_nothing_is_no_attraction(make: MakesSearcher) -> None:
    def scores(points: Points) -> Points:
        found = bowl(points)
        found[points[:, 0] < 1 / 3] = np.nan
        return found

    points = tried(make, scores, 300)
    assert np.mean(points[:, 0] < 1 / 3) < 0.45


def test_the_canonical_point_of_a_space_gives_the_same_scenario_and_is_its_own() -> None:
    points = np.random.default_rng(0).random((200, CUBE.dimension))
    canonical = CUBE.canonical(points)
    assert not np.array_equal(canonical, points)
    assert np.array_equal(CUBE.canonical(canonical), canonical)
    assert np.array_equal(CUBE.used(canonical), CUBE.used(points))


def test_what_a_scenario_does_not_use_makes_no_distance_and_another_alternative_counts_whole() -> None:
    rare, ideal = np.full((2, CUBE.dimension), 0.5)
    rare[CUBE.flat_columns[0]] = 0.99
    both = CUBE.canonical(np.array([rare, ideal]))
    expected = np.sqrt(1.0 / CUBE.dimension)
    assert CUBE.distances(both[:1], both[1]) == pytest.approx(expected, rel=1e-12)
    ideal_elsewhere = ideal.copy()
    ideal_elsewhere[CUBE.flat_columns[0] + 1] = 0.1  # the noise, which an ideal sensor has none of
    both = CUBE.canonical(np.array([ideal_elsewhere, ideal]))
    assert CUBE.distances(both[:1], both[1]) == 0.0
