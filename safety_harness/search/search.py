"""Define the loop of a search.

The loop asks the searcher for points, runs the points, reports their scores to the searcher, and stores the
findings. It uses every searcher through ``AskTell``, which checks that ``ask`` and ``tell_scores`` alternate.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Sequence
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from safety_harness.base.exceptions import InadmissibleError, SearchOrderError
from safety_harness.search.cube import Cube, Points, Scores
from safety_harness.search.findings import Evaluate, Findings, Goal


class Searcher(Protocol):
    """A source of points of the unit cube that learns from their scores.

    A score is a margin divided by its scale. A score is negative if the claim is violated, and NaN if the
    margin is unknown. The method ``learn`` receives all points that the searcher proposed last. With the same
    seed and the same scores, a searcher proposes the same points.
    """

    @property
    def name(self) -> str:
        """The searcher's name on the command line and in reports."""

    def propose(self, count: int) -> Points:
        """Return m points (m, d) of the unit cube, with 1 <= m <= ``count``."""

    def learn(self, points: Points, scores: Scores, cells: Sequence[Hashable]) -> None:
        """Learn the scores of the points that the searcher proposed last.

        Args:
            points: (m, d) the points.
            scores: (m, k) their scores.
            cells: The cells of the points in the coverage. A run without a cell has None.

        """


class AskTell:
    """A wrapper of a searcher, which checks the order and the arguments of the calls.

    The methods ``ask`` and ``tell_scores`` must be called alternately.

    Args:
        searcher: The searcher.
        dimension: The number of coordinates d.
        claims: The number of claims k.

    Raises:
        SearchOrderError: The calls do not alternate, the scores have a wrong shape, or a proposed point lies
            outside the cube.

    """

    def __init__(self, searcher: Searcher, dimension: int, claims: int) -> None:
        self._searcher, self.name = searcher, searcher.name
        self._dimension, self._claims = dimension, claims
        self._asked: Points | None = None

    def ask(self, count: int) -> Points:
        """Return m points (m, d) to try, with 1 <= m <= ``count``.

        The array is read-only.

        Raises:
            SearchOrderError: ``ask`` was called twice without ``tell_scores``, ``count`` is below 1, or the
                searcher proposes invalid points.

        """
        if self._asked is not None:
            raise SearchOrderError(
                f"{self.name}: ask() before tell_scores() of the last {len(self._asked)} points"
            )
        if count < 1:
            raise SearchOrderError(f"{self.name}: ask() for {count} points; expected at least 1")
        points = np.array(self._searcher.propose(count), dtype=np.float64)
        right = points.ndim == 2 and points.shape[1] == self._dimension and 1 <= len(points) <= count
        if not right or not np.all((points >= 0.0) & (points <= 1.0)):
            raise SearchOrderError(
                f"{self.name} proposed no 1 to {count} points of a unit cube of {self._dimension} coordinates"
            )
        # The searcher also receives these points with their scores, so nobody may change them in between.
        points.setflags(write=False)
        self._asked = points
        return points

    def tell_scores(self, scores: Scores, cells: Sequence[Hashable] | None = None) -> None:
        """Give the searcher the scores of the points that ``ask`` returned last.

        Args:
            scores: (m, k) the scores. An unknown score is NaN.
            cells: The cells of the coverage. The default is that no point has a cell.

        Raises:
            SearchOrderError: ``tell_scores`` was called without ``ask``, or an array has a wrong shape.

        """
        if self._asked is None:
            raise SearchOrderError(f"{self.name}: tell_scores() before ask()")
        wanted = (len(self._asked), self._claims)
        cells = [None] * len(self._asked) if cells is None else cells
        if scores.shape != wanted or len(cells) != len(self._asked):
            raise SearchOrderError(
                f"{self.name}: tell_scores() expects scores of shape {wanted}; got {scores.shape}"
            )
        finite = scores.astype(np.float64)
        finite[np.isinf(finite)] = np.nan  # an infinite margin cannot guide a search
        points, self._asked = self._asked, None
        self._searcher.learn(points, finite, cells)


def least(scores: Scores) -> NDArray[np.float64]:
    """Return the least score in each row of ``scores`` (n, k), shape (n,).

    If a row has no score, the result for this row is +inf.
    """
    lowest: NDArray[np.float64] = np.where(np.isnan(scores), np.inf, scores).min(axis=1)
    return lowest


# A search ends if so many points give no run, or later if fewer than one in so many points gives a run.
MAX_REJECTION_RATIO = 200


def find_violations(
    cube: Cube,
    goals: Sequence[Goal],
    evaluate: Evaluate,
    searcher: Searcher,
    *,
    budget: int,
    batch: int = 1,
    on_progress: Callable[[Findings], None] | None = None,
    enough: Callable[[Findings], bool] | None = None,
) -> Findings:
    """Search ``cube`` for violations of ``goals``.

    Ctrl-C ends the search early, and the function then returns the findings so far.

    Args:
        cube: The unit cube of the space.
        goals: The claims to refute.
        evaluate: The function that runs points and returns their outcomes.
        searcher: The searcher that proposes the points.
        budget: The number of points to try. Points that admission refuses are not included in this number.
        batch: The greatest number of points that run in one batch.
        on_progress: A function that receives the findings after each batch.
        enough: A function that receives the findings. If it returns True, the search ends early.

    Returns:
        The findings.

    Raises:
        InadmissibleError: Admission refuses almost every point.
        ValueError: There is no goal, or ``budget`` or ``batch`` is below 1.

    """
    if not goals or budget < 1 or batch < 1:
        raise ValueError("expected at least one goal, and a budget and a batch of at least 1")
    ask_tell = AskTell(searcher, cube.dimension, len(goals))
    findings = Findings(tuple(goals), cube, searcher.name)
    scales = np.array([goal.scale for goal in goals])
    try:
        while findings.tried < budget and not (enough is not None and enough(findings)):
            points = ask_tell.ask(min(batch, budget - findings.tried))
            outcomes = evaluate(points, findings.asked)
            ask_tell.tell_scores(outcomes.margins / scales, outcomes.cells)
            findings.add(points, outcomes)
            if on_progress is not None:
                on_progress(findings)
            _refuse_hopeless(findings)
    except KeyboardInterrupt:
        findings.interrupted = True
    return findings


def _refuse_hopeless(findings: Findings) -> None:
    """Raise InadmissibleError if admission has refused almost every point."""
    if findings.asked < MAX_REJECTION_RATIO * (findings.tried + 1):
        return
    reason, count = findings.refused.most_common(1)[0]
    expected = f"a space in which at least one point in {MAX_REJECTION_RATIO} can run"
    got = f"{findings.tried} of {findings.asked} points"
    raise InadmissibleError.of_option("space", expected, got, f"{count} times it was {reason}")
