"""The search itself, on one page: ask, evaluate, tell, keep.

Ask and tell is the one way in which every searcher is used, with its order enforced.
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
    """Proposes points of the unit cube and learns from their scores.

    A score is a margin over a scale: negative where a claim is violated, NaN where nothing was learnt
    of it.  ``learn`` is called with the points that were proposed last, all of them.  The same seed and
    the same scores give the same points.
    """

    @property
    def name(self) -> str:
        """How the command line and reports call it."""

    def propose(self, count: int) -> Points:
        """(m, d) points of the unit cube, at least one and at most ``count``."""

    def learn(self, points: Points, scores: Scores, cells: Sequence[Hashable]) -> None:
        """(m, d) points, (m, k) scores, and in which cell of the coverage each run was (None: in none)."""


class AskTell:
    """A searcher in use: ``ask``, then ``tell``, in turns.

    SearchOrderError for the wrong turn, for scores that do not belong to what was asked, and for a
    searcher that proposes what is no point of the cube.
    """

    def __init__(self, searcher: Searcher, dimension: int, claims: int) -> None:
        self._searcher, self.name = searcher, searcher.name
        self._dimension, self._claims = dimension, claims
        self._asked: Points | None = None

    def ask(self, count: int) -> Points:
        """(m, d) points to try, 1 <= m <= ``count``; read-only."""
        if self._asked is not None:
            raise SearchOrderError(f"{self.name}: ask() before the last {len(self._asked)} points were told")
        if count < 1:
            raise SearchOrderError(f"{self.name}: ask() for {count} points; expected at least 1")
        points = np.array(self._searcher.propose(count), dtype=np.float64)
        right = points.ndim == 2 and points.shape[1] == self._dimension and 1 <= len(points) <= count
        if not right or not np.all((points >= 0.0) & (points <= 1.0)):
            raise SearchOrderError(
                f"{self.name} proposed no 1 to {count} points of a unit cube of {self._dimension} coordinates"
            )
        points.setflags(write=False)
        self._asked = points
        return points

    def tell(self, scores: Scores, cells: Sequence[Hashable] | None = None) -> None:
        """What came of the points that were asked for last: (m, k) scores, NaN where nothing did."""
        if self._asked is None:
            raise SearchOrderError(f"{self.name}: tell() before ask()")
        wanted = (len(self._asked), self._claims)
        cells = [None] * len(self._asked) if cells is None else cells
        if scores.shape != wanted or len(cells) != len(self._asked):
            raise SearchOrderError(
                f"{self.name}: tell() expects scores of shape {wanted}; got {scores.shape}"
            )
        told = scores.astype(np.float64)
        told[np.isinf(told)] = np.nan  # an infinite margin comes from nothing that can have happened
        points, self._asked = self._asked, None
        self._searcher.learn(points, told, cells)


def least(scores: Scores) -> NDArray[np.float64]:
    """(n, k) scores -> (n,) the least of each row, +inf for rows without any."""
    lowest: NDArray[np.float64] = np.where(np.isnan(scores), np.inf, scores).min(axis=1)
    return lowest


# Points of which not one could be tried; later, of which less than one in as many could.
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
    """Try ``budget`` points (those that admission refuses do not count), ``batch`` at a time.

    Ctrl-C ends it early, and what was found is kept.  InadmissibleError when next to no point can be
    tried.  ``on_progress`` sees the findings after each batch; ``enough`` may end the search.
    ValueError without goals, or for a budget or batch below 1.
    """
    if not goals or budget < 1 or batch < 1:
        raise ValueError("expected at least one goal, and a budget and a batch of at least 1")
    asking = AskTell(searcher, cube.dimension, len(goals))
    findings = Findings(tuple(goals), cube, searcher.name)
    scales = np.array([goal.scale for goal in goals])
    try:
        while findings.tried < budget and not (enough is not None and enough(findings)):
            points = asking.ask(min(batch, budget - findings.tried))
            outcomes = evaluate(points, findings.asked)
            asking.tell(outcomes.margins / scales, outcomes.cells)
            findings.add(points, outcomes)
            if on_progress is not None:
                on_progress(findings)
            _refuse_hopeless(findings)
    except KeyboardInterrupt:
        findings.interrupted = True
    return findings


def _refuse_hopeless(findings: Findings) -> None:
    if findings.asked < MAX_REJECTION_RATIO * (findings.tried + 1):
        return
    reason, count = findings.refused.most_common(1)[0]
    expected = f"a space of which at least one point in {MAX_REJECTION_RATIO} can be tried"
    got = f"{findings.tried} of {findings.asked} points"
    raise InadmissibleError.of_option("space", expected, got, f"{count} times it was {reason}")
