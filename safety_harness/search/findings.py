"""Define the interface between a search and a world, and the findings of a search.

Each claim of a search is a ``Goal``, and each batch of points results in ``Outcomes``. ``Findings`` has the
distinct violations, the refused points and, for each claim, the run that comes nearest to a violation.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Hashable, Sequence
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from safety_harness.claims.properties.against import SCALES
from safety_harness.claims.properties.base import Property, Unit
from safety_harness.search.cube import Cube, Point, Points, Scores

RUN_FAILED = "the run failed: "  # the beginning of a run error's text, if the world failed


@dataclass(frozen=True)
class Goal:
    """A claim that a search tries to refute.

    The score of the claim is the margin divided by ``scale`` (SI). If there is a reference, its name is
    ``against``, and differences from ``search.against`` replace the margins. Users see only negative
    differences.
    """

    sentence: str
    scale: float
    unit: Unit = Unit.COUNT
    against: str = ""

    @classmethod
    def from_property(cls, prop: Property, against: str = "") -> Goal:
        """Return the goal to refute a property.

        The goal has the scale of the property's unit.

        Args:
            prop: The property.
            against: The name of the reference, or an empty text if there is no reference.

        """
        return cls(prop.sentence, SCALES[prop.unit], prop.unit, against)

    of = from_property  # deprecated: the old name, for one release

    def margin_text(self, margin: float) -> str:
        """Return ``margin`` [SI] as text in its display unit.

        A difference that is no finding becomes a dash.
        """
        return "-" if self.against and margin >= 0.0 else self.unit.margin_text(margin)


@dataclass(frozen=True, eq=False)
class Outcomes:
    """The outcomes of n points, with a row for each point.

    ``margins`` (n, k) [SI] has the margin of each claim at each point. A margin is negative if the claim is
    violated, and NaN if the margin is unknown. ``conclusive`` (n, k) states whether the claim has a verdict.
    A margin without a verdict only guides the search. ``refused`` gives the reason why admission refused each
    point, or an empty text. ``mishaps`` gives the run error of each point, or an empty text if there was no
    error. A run error is an avoider without an answer, or a failed run. ``kinds`` distinguishes violations
    with different causes. ``cells`` are the runs' cells in the coverage.
    """

    margins: Scores
    conclusive: NDArray[np.bool_]
    refused: Sequence[str]
    mishaps: Sequence[str]
    kinds: Sequence[str]
    cells: Sequence[Hashable]

    @classmethod
    def of_margins(cls, margins: Scores) -> Outcomes:
        """Return the outcomes of points of which only the ``margins`` are known.

        All points are treated as points that ran.
        """
        none = ("",) * len(margins)
        return cls(margins, np.isfinite(margins), none, none, none, (None,) * len(margins))


class Evaluate(Protocol):
    """A function that runs points in a world and returns the outcomes of the points."""

    def __call__(self, points: Points, first: int) -> Outcomes:
        """Return the outcomes of points (n, d) of the cube.

        Args:
            points: The points.
            first: The number of the first point within the whole search. The numbers of the points determine
                the seeds.

        """


LEAST_APART = 0.25  # root mean square over the cube: nearer violations form one group (random points: 0.41)
_MOST_OTHERS = 9  # if a run error occurs in a third of runs, one of ten shows it with 98 %
_MOST_GROUPS = 200  # of one claim; then a further violation joins the nearest group


@dataclass(frozen=True, eq=False)
class TriedPoint:
    """A point that the search tried.

    The object has the coordinates ``point`` (d,), the ``number`` among all points of the search, and the
    ``margins`` (k,) in SI.
    """

    number: int
    point: Point
    margins: NDArray[np.float64]


@dataclass(eq=False)
class Group:
    """A group of similar violations of one claim, or a group of similar run errors if ``claim`` is None.

    The violations of a group have the same kind and the same alternatives, and lie near ``first`` in the
    cube. A run error may occur anywhere in the cube. ``others`` holds a few more run errors. They are used if
    the confirming world does not show the first error.
    """

    claim: int | None
    kind: str
    first: TriedPoint
    worst: TriedPoint
    leader: Point  # canonical point of ``first``
    count: int = 1
    others: list[TriedPoint] = field(default_factory=list)

    def worst_margin(self) -> float:
        """Return the worst margin [SI], or NaN for a run error."""
        return float("nan") if self.claim is None else float(self.worst.margins[self.claim])


@dataclass(eq=False)
class Findings:
    """The findings of one search, which grow while it runs.

    ``tried`` counts the points that were run. ``asked`` also counts the points that admission refused.
    ``evidence`` (k,) counts the runs with a verdict on each claim, and ``violated`` (k,) counts the runs that
    violate it. ``nearest`` holds the run with the least margin for each claim. Whenever a run lowers the
    least margin [SI] of a claim, ``improvements`` stores this margin and the number of runs so far.
    ``first_violation`` (k,) is the number of runs up to each claim's first violation, or 0 if there is no
    violation.
    """

    goals: tuple[Goal, ...]
    cube: Cube
    searcher: str
    asked: int = 0
    tried: int = 0
    refused: Counter[str] = field(default_factory=Counter)
    groups: list[Group] = field(default_factory=list)
    interrupted: bool = False

    def __post_init__(self) -> None:
        self.evidence = np.zeros(len(self.goals), np.int64)
        self.violated = np.zeros(len(self.goals), np.int64)
        self.first_violation = np.zeros(len(self.goals), np.int64)
        self.mishaps = 0
        self.nearest: list[TriedPoint | None] = [None] * len(self.goals)
        self.improvements: list[list[tuple[int, float]]] = [[] for _ in self.goals]

    @property
    def found_any(self) -> bool:
        """Whether there is any violation or run error."""
        return bool(self.groups)

    found = found_any  # deprecated: the old name, for one release

    def of_claim(self, claim: int | None) -> list[Group]:
        """Return the groups of violations of ``claim``, or the groups of run errors if ``claim`` is None.

        The worst group comes first.
        """
        groups = [group for group in self.groups if group.claim == claim]
        return sorted(groups, key=lambda group: (group.worst_margin(), group.first.number))

    def sentence_of(self, group: Group) -> str:
        """Return a text that states the claim or the run error of a group."""
        return group.kind if group.claim is None else self.goals[group.claim].sentence

    def always_violated(self, claim: int, least: int = 20) -> bool:
        """Return whether every run violated ``claim``.

        If so, the claim or the whole space is probably wrong.

        Args:
            claim: The claim's number.
            least: If fewer runs were made, the result is False.

        """
        return bool(self.tried >= least and self.violated[claim] == self.tried)

    def add(self, points: Points, outcomes: Outcomes) -> None:
        """Add the outcomes of points to the findings.

        Args:
            points: (n, d) points of the cube.
            outcomes: Their outcomes, row by row.

        """
        canonical: Points | None = None
        for k, point in enumerate(points):
            number = self.asked
            self.asked += 1
            if outcomes.refused[k]:
                self.refused[outcomes.refused[k]] += 1
                continue
            self.tried += 1
            margins = outcomes.margins[k]
            known = np.isfinite(margins)
            self.evidence += known & outcomes.conclusive[k]
            episode = TriedPoint(number, point.copy(), margins.copy())
            self._keep_nearest(episode)
            violated = np.flatnonzero(known & (margins < 0.0)).tolist()
            if not violated and not outcomes.mishaps[k]:
                continue
            if canonical is None:
                canonical = self.cube.canonical(points)
            for claim in violated:
                self.violated[claim] += 1
                self.first_violation[claim] = self.first_violation[claim] or self.tried
                self._join(claim, outcomes.kinds[k], episode, canonical[k])
            if outcomes.mishaps[k]:
                self.mishaps += 1
                self._join(None, outcomes.mishaps[k], episode, canonical[k])

    def _keep_nearest(self, episode: TriedPoint) -> None:
        """For each claim, store ``episode`` as the nearest run if its margin is the least so far."""
        for claim, margin in enumerate(episode.margins):
            best = self.nearest[claim]
            if np.isfinite(margin) and (best is None or margin < best.margins[claim]):
                self.nearest[claim] = episode
                self.improvements[claim].append((self.tried, float(margin)))

    def _join(self, claim: int | None, kind: str, episode: TriedPoint, canonical: Point) -> None:
        """Add the violation ``episode`` to the nearest group of its kind, or begin a new group.

        Run errors with the same text join one group.
        """
        rivals = [group for group in self.groups if group.claim == claim and group.kind == kind]
        if rivals:
            leaders = np.array([group.leader for group in rivals])
            distances = self.cube.distances(leaders, canonical)
            nearest = rivals[int(distances.argmin())]
            full = sum(group.claim == claim for group in self.groups) >= _MOST_GROUPS
            if claim is None or distances.min() <= LEAST_APART or full:
                nearest.count += 1
                if claim is None and len(nearest.others) < _MOST_OTHERS:
                    nearest.others.append(episode)
                if claim is not None and episode.margins[claim] < nearest.worst.margins[claim]:
                    nearest.worst = episode
                return
        self.groups.append(Group(claim, kind, episode, episode, canonical.copy()))
