"""Search for questions with bad answers of an avoider, by the algorithms of the package ``search``.

A search selects its questions according to earlier answers, so its results are not part of any estimate.
They have a separate ledger.  A point in the cube of the search defines the TCP, the hand relative to the TCP,
and one of a few seeds.  Random questions in the region determine the bounds of both positions.  The search
skips a pair if it lies outside the region or if no run can begin with it.  The seed of a question is the seed
of the first decision in a run with a known scenario seed.  A scenario file can therefore repeat the question.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from enum import Enum

import numpy as np
from numpy.typing import NDArray

from safety_harness.base.exceptions import InadmissibleError
from safety_harness.base.geometry.arrays import Array3
from safety_harness.base.seeds import Branch, generator
from safety_harness.base.seeds import seed as leaf
from safety_harness.cell.avoidance.avoider import Avoider
from safety_harness.cell.avoidance.measures import WRONG_M, gained_m, is_sure, off_m, optimum_in_base_m
from safety_harness.extensions.lab.scoring.asking import asked_together
from safety_harness.extensions.lab.scoring.question_file import begins_clear, seed_of
from safety_harness.extensions.lab.scoring.questions import Questions
from safety_harness.extensions.lab.scoring.regions import QuestionRegion
from safety_harness.search.cube import Column, Cube, Points
from safety_harness.search.findings import Findings, Goal, Outcomes
from safety_harness.search.search import find_violations
from safety_harness.search.searchers import searcher_named

SEARCHER, BATCH = "diverse", 64  # points in a batch; a choice
# Seeds per region.  The seed is a coordinate, because a random avoider would otherwise look like noise.
SEEDS = 8
DRAWS = 500  # draws of the region, which bound the positions in the search
TOLERANCE_M = 0.010  # the accepted step towards the hand
APART_M = 0.05  # the least distance of hands or TCPs between two listed questions
# Added to margins to keep them above zero: a descent ends at a violation, but should go on to the worst.
_FAR_M = 10.0


class Objective(Enum):
    """The objectives of the search; the value is a text that describes the worst answers for an objective."""

    TOWARDS = "leads least away from the hand"
    SURE_AND_OFF = "sure, and farthest from the optimum"

    @property
    def limit_m(self) -> float:
        """The limit [m] of the badness above which a question is reported.

        The claims in the scenario files have the same limit.
        """
        return TOLERANCE_M if self is Objective.TOWARDS else WRONG_M


OBJECTIVES = tuple(Objective)


@dataclass(frozen=True, eq=False)
class Tried:
    """A question of the search and its answer.

    ``gained_m`` is the component of the step in the direction away from the hand. ``off_m`` is the distance
    of the answer from the optimum.

    ``optimum_gained_m`` is the same component for the step to the closed-form optimum.
    """

    region: str
    scenario_seed: int
    hand_in_base_m: Array3
    tcp_in_base_m: Array3
    proposed_in_base_m: Array3
    largest_spread_m: float
    gained_m: float
    off_m: float
    optimum_gained_m: float
    sure: bool

    def badness_m(self, objective: Objective) -> float:
        """Return the badness of the answer for ``objective`` [m], or -inf if the objective does not apply."""
        if objective is Objective.TOWARDS:
            return -self.gained_m
        return self.off_m if self.sure else -np.inf

    def apart_m(self, second: Tried) -> float:
        """Return the distance to the question ``second``.

        It is the distance between the hands or the distance between the TCPs, whichever is larger.
        """
        hands = np.linalg.norm(self.hand_in_base_m - second.hand_in_base_m)
        return float(max(hands, np.linalg.norm(self.tcp_in_base_m - second.tcp_in_base_m)))


@dataclass(eq=False)
class QuestionSearch:
    """The ledger of the search in one region.

    ``tried`` lists the answered questions, and ``asked`` is the number of all questions.
    """

    region: str
    budget: int
    asked: int = 0
    unanswered: int = 0
    interrupted: bool = False
    tried: list[Tried] = field(default_factory=list)


@dataclass(eq=False)
class _Searching:
    """The function that a search evaluates: it asks the avoider and adds the answers to ``ledger``."""

    avoider: Avoider
    region: QuestionRegion
    drawn: Questions
    scenario_seeds: tuple[int, ...]
    ledger: QuestionSearch

    def __post_init__(self) -> None:
        self.which = Column(tuple(np.linspace(0.0, 1.0, SEEDS + 1).tolist()), flat=True)
        self.cube = Cube((*(Column() for _ in range(6)), self.which))
        # The last three coordinates are the hand's offset from the TCP, because a region limits their
        # distance.
        tcps = self.drawn.tcps_in_base_m
        self._low, self._high = (
            np.concatenate([end(tcps, axis=0), end(self.drawn.hands_in_base_m - tcps, axis=0)])
            for end in (np.min, np.max)
        )

    def __call__(self, points: Points, first: int) -> Outcomes:
        """Ask the questions at ``points``, shape (n, 7), and return the outcomes.

        The function refuses a point whose question does not belong to the region or cannot be the first in a
        run.
        """
        at = self._low + points[:, :6] * (self._high - self._low)
        tcps, hands = at[:, :3], at[:, :3] + at[:, 3:]
        held = self.region.holds(hands, tcps)
        held[held] = [
            begins_clear(self.region.settings, hand, tcp, self.region.robot)
            for hand, tcp in zip(hands[held], tcps[held], strict=True)
        ]
        numbers = self.which.interval_of(points[:, 6])[held]
        margins = np.full((len(points), len(OBJECTIVES)), np.nan)
        if held.any():
            seeds = np.array([seed_of(seed) for seed in self.scenario_seeds], np.uint64)[numbers]
            margins[held] = self._margins_of(Questions(hands[held], tcps[held], seeds), numbers)
        known = Outcomes.of_margins(margins)
        refused = ["" if is_held else "no run begins so" for is_held in held]
        return Outcomes(margins, known.conclusive, refused, known.mishaps, known.kinds, known.cells)

    def _margins_of(self, questions: Questions, numbers: NDArray[np.int64]) -> NDArray[np.float64]:
        """Ask n questions, and return their margins for both objectives, shape (n, 2).

        The margins of an unanswered question are NaN.  ``numbers`` contains the index of each question's
        scenario seed, shape (n,).
        """
        hands, tcps = questions.hands_in_base_m, questions.tcps_in_base_m
        answers = asked_together(self.avoider, questions)
        proposed, optimum = answers.positions_in_base_m, optimum_in_base_m(self.region.settings, hands, tcps)
        away_m, error_m = gained_m(hands, tcps, proposed), off_m(proposed, optimum)
        best_m, sure = gained_m(hands, tcps, optimum), is_sure(answers.spreads_m, answers.thresholds_m)
        given = answers.given
        self.ledger.asked += len(questions)
        self.ledger.unanswered += int(np.count_nonzero(~given))
        self.ledger.tried += [
            Tried(
                region=self.region.name,
                scenario_seed=self.scenario_seeds[numbers[k]],
                hand_in_base_m=hands[k],
                tcp_in_base_m=tcps[k],
                proposed_in_base_m=proposed[k],
                largest_spread_m=float(answers.spreads_m[k].max()),
                gained_m=float(away_m[k]),
                off_m=float(error_m[k]),
                optimum_gained_m=float(best_m[k]),
                sure=bool(sure[k]),
            )
            for k in np.flatnonzero(given).tolist()
        ]
        margins = np.stack([away_m, np.where(sure, -error_m, np.nan)], axis=1)
        # Even an answer that is farther off than _FAR_M keeps a margin above zero.
        return np.where(given[:, None], np.maximum(_FAR_M + margins, 1e-3), np.nan)


def search_region(
    avoider: Avoider,
    region: QuestionRegion,
    *,
    budget: int,
    seed: int,
    number: int,
    on_progress: Callable[[Findings], None] | None = None,
) -> QuestionSearch:
    """Search for the worst questions in one region, and return the ledger.

    Ctrl-C ends the search early.

    Args:
        avoider: The avoider.
        region: The region.
        budget: The number of questions.
        seed: The root of all random numbers.
        number: The region's number, which gives each region its own random numbers.
        on_progress: A function that receives the findings after each batch.

    """
    ledger = QuestionSearch(region.name, budget)
    drawn = region.draw(generator(seed, Branch.SEARCH, 5, number), DRAWS)
    if len(drawn) < 2 or budget < 1:
        return ledger
    own = tuple(leaf(seed, Branch.SEARCH, 6, number, k) for k in range(SEEDS))
    searching = _Searching(avoider, region, drawn, own, ledger)
    goals = [Goal(objective.value, 0.1) for objective in OBJECTIVES]
    make = searcher_named(SEARCHER)(
        searching.cube, claims=len(goals), seed=leaf(seed, Branch.SEARCH, 7, number)
    )
    try:
        findings = find_violations(
            searching.cube, goals, searching, make, budget=budget, batch=BATCH, on_progress=on_progress
        )
        ledger.interrupted = findings.interrupted
    except InadmissibleError:  # the region holds almost no point of the cube; the ledger keeps its questions
        pass
    return ledger


def worst_questions(searches: Sequence[QuestionSearch], most: int) -> list[tuple[Objective, Tried]]:
    """Return the worst questions of all regions; the two objectives alternate.

    The function skips a question that is close to a question in the result.

    Args:
        searches: The ledgers of the searches.
        most: The largest number of questions to return.

    """
    queues = [_by_badness(searches, objective) for objective in OBJECTIVES]
    chosen: list[tuple[Objective, Tried]] = []
    while queues and len(chosen) < most:
        queue = queues.pop(0)
        for objective, tried in queue:
            if all(tried.apart_m(earlier) > APART_M for _, earlier in chosen):
                chosen.append((objective, tried))
                queues.append(queue)
                break
    return chosen


def _by_badness(
    searches: Sequence[QuestionSearch], objective: Objective
) -> Iterator[tuple[Objective, Tried]]:
    """Yield the questions that exceed the limit of ``objective``, beginning with the worst."""
    tried = (question for ledger in searches for question in ledger.tried)
    every = [question for question in tried if question.badness_m(objective) > objective.limit_m]
    for question in sorted(every, key=lambda question: -question.badness_m(objective)):
        yield objective, question
