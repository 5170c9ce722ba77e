"""Ask, then tell: any other order is refused, and so is what is no point and no score."""

from __future__ import annotations

from collections.abc import Hashable, Sequence

import numpy as np
import pytest

from safety_harness.base.exceptions import SearchOrderError
from safety_harness.search.cube import Column, Cube, Points
from safety_harness.search.sampling import UniformSampling
from safety_harness.search.search import AskTell, least

SQUARE = Cube((Column(), Column()))


def asking() -> AskTell:
    return AskTell(UniformSampling(SQUARE, claims=1, seed=0), dimension=2, claims=1)


class Proposes:
    """A searcher that always proposes the same, and keeps what it is told."""

    name = "same"

    def __init__(self, points: object) -> None:
        self.points = points
        self.told: Points | None = None

    def propose(self, count: int) -> Points:
        return self.points  # type: ignore[return-value]

    def learn(self, points: Points, scores: Points, cells: Sequence[Hashable]) -> None:
        self.told = scores


def test_asking_and_telling_in_turns_is_right() -> None:
    search = asking()
    for _ in range(3):
        points = search.ask(4)
        assert points.shape == (4, 2)
        search.tell_scores(np.zeros((4, 1)))


def test_asking_twice_is_refused() -> None:
    search = asking()
    search.ask(2)
    with pytest.raises(SearchOrderError, match=r"before tell_scores\(\) of the last 2 points"):
        search.ask(2)


def test_telling_first_is_refused() -> None:
    with pytest.raises(SearchOrderError, match="before ask"):
        asking().tell_scores(np.zeros((2, 1)))


@pytest.mark.parametrize("shape", [(3, 1), (2, 2), (2,)])
def test_scores_that_belong_to_other_points_are_refused(shape: tuple[int, ...]) -> None:
    search = asking()
    search.ask(2)
    with pytest.raises(SearchOrderError, match=r"expects scores of shape \(2, 1\)"):
        search.tell_scores(np.zeros(shape))


@pytest.mark.parametrize(
    "points",
    [
        [[0.5, 1.1]],
        [[-0.1, 0.5]],
        [[np.nan, 0.5]],
        [[0.5]],
        np.zeros((0, 2)),
        np.zeros((3, 2)),
    ],
)
def test_a_searcher_that_proposes_no_points_of_the_cube_is_refused(points: object) -> None:
    with pytest.raises(SearchOrderError, match="no 1 to 2 points of a unit cube of 2 coordinates"):
        AskTell(Proposes(points), dimension=2, claims=1).ask(2)


def test_what_was_asked_cannot_be_changed_afterwards() -> None:
    points = asking().ask(2)
    with pytest.raises(ValueError, match="read-only"):
        points[0, 0] = 0.0


def test_an_infinite_score_teaches_nothing_whatever_its_sign() -> None:
    searcher = Proposes([[0.5, 0.5]])
    search = AskTell(searcher, dimension=2, claims=3)
    search.ask(1)
    search.tell_scores(np.array([[np.inf, -np.inf, 0.25]]))
    assert searcher.told is not None
    assert np.array_equal(searcher.told, [[np.nan, np.nan, 0.25]], equal_nan=True)


def test_the_least_score_of_a_row_passes_over_what_is_unknown() -> None:
    scores = np.array([[1.0, np.nan], [np.nan, np.nan], [2.0, -3.0]])
    assert least(scores).tolist() == [1.0, np.inf, -3.0]
