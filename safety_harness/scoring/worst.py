"""The search for an avoider's worst questions, with the searchers of ``search``, in a ledger of its own.

A search chooses its questions, so nothing that comes of them enters an estimate.  The questions of a region are
a unit cube, which ``InRegion`` maps to hands and TCPs; every question's seed is the first decision's of a
scenario seed that descends from the root seed, the region and the question's number, so that a scenario file
can ask it again.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from enum import Enum

import numpy as np
from numpy.typing import NDArray

from safety_harness.avoidance.asking import Answer, Question
from safety_harness.avoidance.measures import gained_m, is_sure, off_m, optimum_in_base_m
from safety_harness.geometry.arrays import Array3, ArrayNx3
from safety_harness.geometry.regions import Region
from safety_harness.scoring.question_file import seed_of
from safety_harness.search.cube import Column, Cube, Points, Scores
from safety_harness.search.findings import Findings, Goal, Outcomes
from safety_harness.search.search import find_violations
from safety_harness.search.searchers import searcher_named
from safety_harness.seeds import Branch
from safety_harness.seeds import seed as leaf
from safety_harness.settings import Settings
from safety_harness.space.distributions import InRegion

BATCH = 64
SEEDS = 8  # of a region's questions: a coordinate of the search, or a random avoider would be all noise to it
MOST_SHOWN = 10
APART_M = 0.05  # of hands and TCPs: worst questions that are nearer are one place
# Goals keep their margins above zero, or a descent would end at the first violation: it is to find the worst.
_FAR_M = 10.0


class Objective(Enum):
    """What is searched for; the value is how people call it."""

    TOWARDS = "leads least away from the hand"
    SURE_AND_OFF = "sure, and farthest from the optimum"


OBJECTIVES = tuple(Objective)
Ask = Callable[[Sequence[Question]], Sequence[Answer]]


@dataclass(frozen=True, eq=False)
class Tried:
    """A question of the search, and what was answered: ``gained_m`` and ``off_m`` are of its proposal.

    ``optimum_gained_m`` is what the closed-form optimum of the question gains, a yardstick.
    """

    region: str
    number: int
    scenario_seed: int
    hand_in_base_m: Array3
    tcp_in_base_m: Array3
    proposed_in_base_m: Array3
    spread_m: Array3
    gained_m: float
    off_m: float
    optimum_gained_m: float
    sure: bool

    def badness_m(self, objective: Objective) -> float:
        """The larger the worse; -inf where the objective does not ask for it."""
        if objective is Objective.TOWARDS:
            return -self.gained_m
        return self.off_m if self.sure else -np.inf

    def apart_m(self, other: Tried) -> float:
        """How far the two questions are from each other: the larger of hand's and TCP's distance."""
        hands = np.linalg.norm(self.hand_in_base_m - other.hand_in_base_m)
        return float(max(hands, np.linalg.norm(self.tcp_in_base_m - other.tcp_in_base_m)))


@dataclass(eq=False)
class Searched:
    """The ledger of one region's search: ``tried`` has every question with an answer, ``asked`` counts all."""

    region: str
    budget: int
    asked: int = 0
    unanswered: int = 0
    interrupted: bool = False
    tried: list[Tried] = field(default_factory=list)

    def worst(self, objective: Objective) -> Tried | None:
        """The worst question of an objective."""
        found = [one for one in self.tried if one.badness_m(objective) > -np.inf]
        return max(found, key=lambda one: one.badness_m(objective), default=None)


def search_region(
    name: str,
    hands: Region,
    tcps: Region,
    ask: Ask,
    settings: Settings,
    *,
    budget: int,
    seed: int,
    region_number: int,
    on_progress: Callable[[Findings], None] | None = None,
    searcher: str = "default",
) -> Searched:
    """Search one region with ``budget`` questions; Ctrl-C ends it early and keeps what was asked."""
    maps = InRegion(name, hands), InRegion(name, tcps)
    places = [Column(tuple(edges)) for one in maps for edges in (one.edges, (0.0, 1.0), (0.0, 1.0))]
    which = Column(tuple(np.linspace(0.0, 1.0, SEEDS + 1)), flat=True)
    cube = Cube((*places, which))
    own = [leaf(seed, Branch.SEARCH, 5, region_number, k) for k in range(SEEDS)]
    ledger = Searched(name, budget)

    def evaluate(points: Points, first: int) -> Outcomes:
        at = maps[0].values_at(points[:, :3]), maps[1].values_at(points[:, 3:6])
        seeds = [own[k] for k in which.interval_of(points[:, 6])]
        return Outcomes.of_margins(_entered(ledger, at, seeds, first, ask, settings))

    goals = [Goal(one.value, 0.1) for one in OBJECTIVES]
    make = searcher_named(searcher)
    found = find_violations(
        cube,
        goals,
        evaluate,
        make(cube, claims=len(goals), seed=leaf(seed, Branch.SEARCH, 6, region_number)),
        budget=budget,
        batch=BATCH,
        on_progress=on_progress,
    )
    ledger.interrupted = found.interrupted
    return ledger


def _entered(
    ledger: Searched,
    at: tuple[ArrayNx3, ArrayNx3],
    seeds: Sequence[int],
    first: int,
    ask: Ask,
    settings: Settings,
) -> Scores:
    """Ask (n,) questions, enter them into the ledger, and give their margins (n, 2)."""
    hands, tcps = at
    answers = ask([Question(*one, seed_of(own)) for *one, own in zip(hands, tcps, seeds, strict=True)])
    positions = np.array([answer.proposal.position_in_base_m for answer in answers])
    spreads = np.array([answer.proposal.spread_m for answer in answers])
    thresholds_m = np.array([answer.spread_threshold_m for answer in answers])
    away_m = gained_m(hands, tcps, positions)
    optimum = optimum_in_base_m(settings, hands, tcps)
    error_m, best_m = off_m(positions, optimum), gained_m(hands, tcps, optimum)
    sure = is_sure(spreads, thresholds_m)
    ledger.asked += len(answers)
    answered = [not answer.fault for answer in answers]
    ledger.unanswered += answered.count(False)
    for k in np.flatnonzero(answered):
        ledger.tried.append(
            Tried(
                ledger.region,
                first + int(k),
                seeds[k],
                hands[k],
                tcps[k],
                positions[k],
                spreads[k],
                float(away_m[k]),
                float(error_m[k]),
                float(best_m[k]),
                bool(sure[k]),
            )
        )
    margins = np.stack([away_m, np.where(sure, -error_m, np.nan)], axis=1)
    return np.maximum(_FAR_M + margins, 1e-3)


def worst_questions(searches: Sequence[Searched], most: int = MOST_SHOWN) -> list[tuple[Objective, Tried]]:
    """The worst of all regions: each objective's worst in turn, no two of them near to each other."""
    queues = [_by_badness(searches, objective) for objective in OBJECTIVES]
    found: list[tuple[Objective, Tried]] = []
    while queues and len(found) < most:
        queue = queues.pop(0)
        for objective, one in queue:
            if all(one.apart_m(other) > APART_M for _, other in found):
                found.append((objective, one))
                queues.append(queue)
                break
    return found


def _by_badness(
    searches: Sequence[Searched], objective: Objective
) -> Iterator[tuple[Objective, Tried]]:
    every = [one for ledger in searches for one in ledger.tried if one.badness_m(objective) > -np.inf]
    for one in sorted(every, key=lambda one: -one.badness_m(objective)):
        yield objective, one
