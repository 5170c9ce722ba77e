"""What a search needs of the world, and what it found.

The claims are goals, and a batch of points has outcomes.  Kept as it goes are distinct violations, nearest
misses, and what could not be tried.
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

RUN_FAILED = "the run failed: "  # how the mishap of a world that broke begins


@dataclass(frozen=True)
class Goal:
    """A claim that a search tries to refute; margins are divided by ``scale`` (SI).

    With a reference, whose name is ``against``, margins are differences as of ``search.against``, which are
    for people only where they are negative.
    """

    sentence: str
    scale: float
    unit: Unit = Unit.COUNT
    against: str = ""

    @classmethod
    def of(cls, prop: Property, against: str = "") -> Goal:
        """The goal of a property, with the scale of its unit."""
        return cls(prop.sentence, SCALES[prop.unit], prop.unit, against)

    def margin_text(self, margin: float) -> str:
        """A margin [SI] in the unit that people read."""
        return "-" if self.against and margin >= 0.0 else self.unit.margin_text(margin)


@dataclass(frozen=True, eq=False)
class Outcomes:
    """What came of (n, d) points, row by row.

    ``margins`` (n, k) SI, negative where a claim is violated, NaN where there is none to give;
    ``conclusive`` (n, k) whether there is a verdict: a margin alone leads somewhere and is no evidence.
    ``refused`` says why a point was not tried at all (admission), ``mishaps`` what went wrong in a run
    besides: an avoider that gave no answer, a world that broke; both are empty elsewhere.
    ``kinds`` tells violations apart that have different causes; ``cells`` is for coverage.
    """

    margins: Scores
    conclusive: NDArray[np.bool_]
    refused: Sequence[str]
    mishaps: Sequence[str]
    kinds: Sequence[str]
    cells: Sequence[Hashable]

    @classmethod
    def of_margins(cls, margins: Scores) -> Outcomes:
        """Every point was tried, and nothing but margins is known."""
        none = ("",) * len(margins)
        return cls(margins, np.isfinite(margins), none, none, none, (None,) * len(margins))


class Evaluate(Protocol):
    """A world: points in, outcomes out."""

    def __call__(self, points: Points, first: int) -> Outcomes:
        """(n, d) points of the cube, numbered from ``first`` over the whole search: seeds come from these."""


APART = 0.25  # root mean square over the cube: violations that are nearer are taken for one
_MOST_OTHERS = 9  # runs of a mishap: of ten that meet it in a third of all runs one shows it, 98 times in 100
_MOST_GROUPS = 200  # of one claim; beyond them a violation joins its nearest


@dataclass(frozen=True, eq=False)
class TriedPoint:
    """One tried point (d,): ``number`` counts all points of the search, ``margins`` (k,) are SI."""

    number: int
    point: Point
    margins: NDArray[np.float64]


@dataclass(eq=False)
class Group:
    """Violations of one claim (or mishaps: ``claim`` is None) that are one thing to a reader.

    They have the same kind, the same alternatives, and lie near to ``first`` in the cube.  Mishaps may lie
    anywhere: ``others`` are a few more of them, to be tried where the world that confirms does not show one.
    """

    claim: int | None
    kind: str
    first: TriedPoint
    worst: TriedPoint
    leader: Point  # canonical point of the first
    count: int = 1
    others: list[TriedPoint] = field(default_factory=list)

    def worst_margin(self) -> float:
        """SI; NaN for a mishap."""
        return float("nan") if self.claim is None else float(self.worst.margins[self.claim])


@dataclass(eq=False)
class Findings:
    """``tried`` counts runs, ``asked`` points; ``evidence`` and ``violated`` (k,) runs for each claim.

    ``nearest`` is each claim's run with the least margin, ``improvements`` each claim's least margins [SI]
    so far and after how many runs.  ``first_violation`` (k,) is the number of runs that it took, 0 for none.
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
    def found(self) -> bool:
        """Whether there is anything that should not be."""
        return bool(self.groups)

    def of_claim(self, claim: int | None) -> list[Group]:
        """A claim's groups, or the mishaps, the worst first."""
        groups = [group for group in self.groups if group.claim == claim]
        return sorted(groups, key=lambda group: (group.worst_margin(), group.first.number))

    def sentence_of(self, group: Group) -> str:
        """What a group is about, for people."""
        return group.kind if group.claim is None else self.goals[group.claim].sentence

    def always_violated(self, claim: int, least: int = 20) -> bool:
        """Whether every run of at least ``least`` violated the claim: then it is no corner that is wrong."""
        return bool(self.tried >= least and self.violated[claim] == self.tried)

    def add(self, points: Points, outcomes: Outcomes) -> None:
        """Take in (n, d) points and what came of them."""
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
            wrong = np.flatnonzero(known & (margins < 0.0)).tolist()
            if not wrong and not outcomes.mishaps[k]:
                continue
            if canonical is None:
                canonical = self.cube.canonical(points)
            for claim in wrong:
                self.violated[claim] += 1
                self.first_violation[claim] = self.first_violation[claim] or self.tried
                self._join(claim, outcomes.kinds[k], episode, canonical[k])
            if outcomes.mishaps[k]:
                self.mishaps += 1
                self._join(None, outcomes.mishaps[k], episode, canonical[k])

    def _keep_nearest(self, episode: TriedPoint) -> None:
        for claim, margin in enumerate(episode.margins):
            before = self.nearest[claim]
            if np.isfinite(margin) and (before is None or margin < before.margins[claim]):
                self.nearest[claim] = episode
                self.improvements[claim].append((self.tried, float(margin)))

    def _join(self, claim: int | None, kind: str, episode: TriedPoint, canonical: Point) -> None:
        """Mishaps are told apart by their words alone."""
        rivals = [group for group in self.groups if group.claim == claim and group.kind == kind]
        if rivals:
            leaders = np.array([group.leader for group in rivals])
            apart = self.cube.distances(leaders, canonical)
            nearest = rivals[int(apart.argmin())]
            full = sum(group.claim == claim for group in self.groups) >= _MOST_GROUPS
            if claim is None or apart.min() <= APART or full:
                nearest.count += 1
                if claim is None and len(nearest.others) < _MOST_OTHERS:
                    nearest.others.append(episode)
                if claim is not None and episode.margins[claim] < nearest.worst.margins[claim]:
                    nearest.worst = episode
                return
        self.groups.append(Group(claim, kind, episode, episode, canonical.copy()))
