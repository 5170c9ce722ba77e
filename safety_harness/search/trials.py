"""Convert points of a space to scenarios, admit and run the scenarios in a world, and judge the runs.

The world is a function from admitted scenarios to traces. Therefore, the search and the confirmation can use
the same code.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from safety_harness.admission.admit import Admitted, Admitter
from safety_harness.admission.avoiders import told_avoider, with_avoider
from safety_harness.admission.claims import property_of
from safety_harness.admission.comparison import refuse_same
from safety_harness.admission.repeatability import Repeatability
from safety_harness.admission.spaces import why_refused
from safety_harness.admission.trial import run_all
from safety_harness.base.exceptions import (
    InadmissibleError,
    InputError,
    Place,
    ScenarioError,
    described,
    refuse_other_type,
)
from safety_harness.base.seeds import Branch
from safety_harness.base.seeds import seed as leaf
from safety_harness.base.settings import Settings
from safety_harness.cell.avoidance.avoider import decision_time_of
from safety_harness.cell.simulation.simulate import INTERRUPTED
from safety_harness.cell.simulation.worlds import KINEMATIC, PYBULLET, WorldEntry, confirming_world
from safety_harness.claims.properties.against import Against, RunDifference
from safety_harness.claims.properties.answered import (
    DEFAULT_CLAIM,
    fault_of,
    is_claimed,
    unanswered,
    with_expectation,
    without_numbers,
)
from safety_harness.claims.properties.base import Evaluation, Property
from safety_harness.claims.properties.tried import TriedParts
from safety_harness.scenario.model import Claim, Scenario, Verdict
from safety_harness.search.against import Reference, difference_of
from safety_harness.search.coverage import Coverage, CoverageCell, cell_of
from safety_harness.search.cube import Point, Points
from safety_harness.search.findings import RUN_FAILED, Goal, Outcomes
from safety_harness.space.space import ScenarioSpace, each_to_hold
from safety_harness.trace.answer_times import AnswersTook
from safety_harness.trace.limiting import LimitTally
from safety_harness.trace.overruling import Overruling
from safety_harness.trace.system import NOT_NOTED, SystemUnderTest
from safety_harness.trace.trace import Trace
from safety_harness.trace.unmeasured import as_measured


class PartingAnswers(NamedTuple):
    """The answers to the last query that both runs of a pair share.

    Each answer is a decision (1,) of one run. Both runs are equal until an answer leads to different actions
    of the arm.
    """

    mine: NDArray[np.void]
    theirs: NDArray[np.void]
    settings: Settings

    @classmethod
    def of_pair(cls, mine: Trace, theirs: Trace) -> list[PartingAnswers]:
        """Return the answers, or an empty list if the runs share no query."""
        count = min(len(mine.decisions), len(theirs.decisions))
        ticks, their_ticks = (run.decisions["asked_tick"][:count] for run in (mine, theirs))
        arm_rad = mine.ticks["joint_position_rad"][ticks]
        their_arm_rad = theirs.ticks["joint_position_rad"][their_ticks]
        same = (ticks == their_ticks) & (arm_rad == their_arm_rad).all(axis=1)
        shared = int(np.logical_and.accumulate(same).sum())
        last = slice(shared - 1, shared)
        own = cls(mine.decisions[last].copy(), theirs.decisions[last].copy(), mine.scenario.settings)
        return [own] if shared else []


class ScenarioRunner(Protocol):
    """A function that runs admitted scenarios.

    If a run cannot be finished, the function returns an Exception instead of its trace.
    """

    def __call__(self, admitted: Sequence[Admitted]) -> Sequence[Trace | Exception]:
        """Return one run for each scenario, in their order."""


@dataclass(frozen=True)
class InWorld:
    """A ScenarioRunner in ``world``.

    If ``world`` cannot render a run's images, the confirming world runs the scenario. Ctrl-C raises
    KeyboardInterrupt.
    """

    world: WorldEntry

    def __call__(self, admitted: Sequence[Admitted]) -> list[Trace | Exception]:
        """Run all scenarios, in one batch if the world supports it."""
        runs: list[Trace | Exception] = []
        for scenario, run in zip(admitted, run_all(admitted, self.world), strict=True):
            if isinstance(run, InadmissibleError) and not self.world.makes_images_of(scenario.scenario):
                run = next(run_all([scenario], confirming_world()))
            if isinstance(run, Trace) and run.ended == INTERRUPTED:
                raise KeyboardInterrupt
            runs.append(run)
        return runs


in_pybullet = InWorld(PYBULLET)
"""The runner of the first reference world."""


def world_of(runner: object) -> WorldEntry:
    """Return the world of a runner, or the kinematic world if the runner has no attribute ``world``."""
    world: WorldEntry = getattr(runner, "world", KINEMATIC)
    return world


in_kinematic = InWorld(KINEMATIC)
"""The runner of the kinematic world."""


@dataclass(eq=False)
class Trials:
    """The trials of points of ``space`` in ``world``, as an ``Evaluate`` for a search.

    ``avoider`` replaces the space's avoider. A relative path of an avoider is relative to the working
    directory. ``sentences`` replace the space's claims. The trials add the claim "the avoider answered",
    unless the claims already cover it. If the space expects a claim to be violated, the search treats this
    claim like any other claim. ``to_be_found`` lists the claims that the space expects to be violated.

    If there is a ``reference``, every point also runs with that avoider. The search then looks for claims
    that the avoider violates and the reference keeps. ``differences`` holds all pairs.

    ``parting_answers`` holds the answers to the last query that each pair shares.

    The other fields summarise all runs. ``nearest_hand_m`` is the least distance between hand and arm.
    ``decisions`` counts all decisions, and ``unanswered`` counts the decisions without an answer.
    ``overruling`` counts proposals that the gate overruled, and ``repeatability`` stores the avoider's
    queries. ``tried`` records which parts of the space were exercised, and ``times`` holds the answer times.

    The seed of each scenario derives from ``seed`` and the number of the point, unless the file fixes the
    seed. If an avoider has a memory, it keeps this memory from run to run, as ``Admitter`` describes.
    """

    space: ScenarioSpace
    world: ScenarioRunner
    seed: int = 0
    avoider: str | None = None
    sentences: tuple[str, ...] = ()
    reference: Reference | None = None
    coverage: Coverage = field(default_factory=Coverage)
    violations: Coverage = field(default_factory=Coverage)  # runs that violated a claim
    declared_s: float = 0.0  # the decision time that the avoider declares
    nearest_hand_m: float = field(default=np.inf, init=False)
    decisions: int = field(default=0, init=False)
    unanswered: int = field(default=0, init=False)
    system: SystemUnderTest = field(default=NOT_NOTED, init=False)  # of the first run
    overruling: Overruling = field(default_factory=Overruling, init=False)
    differences: list[RunDifference] = field(default_factory=list, init=False)
    parting_answers: list[PartingAnswers] = field(default_factory=list, init=False)
    repeatability: Repeatability = field(default_factory=Repeatability, init=False)
    tried: TriedParts = field(default_factory=TriedParts, init=False)
    times: AnswersTook = field(default_factory=AnswersTook, init=False)
    limited: LimitTally = field(default_factory=LimitTally, init=False)
    _admitter: Admitter = field(default_factory=Admitter, init=False)

    def __post_init__(self) -> None:
        refuse_other_type("Trials(space)", self.space, ScenarioSpace)
        simplest = self._completed(self.space.simplest)
        own = not self.sentences and self.reference is None
        given = self.space.simplest.claims if own else ()
        self.to_be_found = frozenset(c.sentence for c in given if c.expected is Verdict.VIOLATED)
        expected = [claim for claim in simplest.claims if claim.expected is Verdict.HOLDS]
        claims = tuple(claim for claim in expected if not is_claimed([claim]))
        self.claims = claims or tuple(claim for claim in expected if claim is not DEFAULT_CLAIM)
        if not self.claims:
            raise ScenarioError(
                place=Place(file=self.space.file, field="claims"),
                expected="a claim that holds or is violated, for a search to refute",
                got="none",
                hint="write one below claims, or give --claim",
            )
        self.properties: tuple[Property, ...] = tuple(property_of(claim, simplest) for claim in self.claims)
        name = "" if self.reference is None else self.reference.name
        self.of_others = np.zeros(len(self.properties), bool)  # claims that do not apply to the controller
        self.goals = tuple(Goal.from_property(prop, name) for prop in self.properties)
        # "the avoider answered" leads a search only without another claim.
        self.answered = next((claim for claim in expected if claim not in self.claims), None)

    @property
    def against(self) -> Against | None:
        """The differences from the reference, or None if there is no reference."""
        if self.reference is None:
            return None
        mine = told_avoider(self.avoider or self.space.simplest.under_test)
        return Against(mine=mine, reference=self.reference.name, runs=self.differences, drawn=False)

    def scenario(self, point: Point, number: int) -> Scenario:
        """Return the scenario of a point.

        Args:
            point: (d,) the point of the cube.
            number: The number of the point in the search. It determines the seed.

        Raises:
            InputError: The reader refuses the scenario.

        """
        own = leaf(self.seed, Branch.SEARCH, 4, number)
        return self._completed(self.space.at(point, seed=own, name=f"{self.space.name}-{number}"))

    def _completed(self, scenario: Scenario) -> Scenario:
        """Return the scenario with the avoider and the claims of the trials."""
        claims = each_to_hold(scenario.claims)
        if self.sentences:
            place = Place(field="--claim")
            claims = tuple(Claim(sentence=s, expected=Verdict.HOLDS, place=place) for s in self.sentences)
        claims = with_expectation(claims, scenario)
        if self.avoider is not None:
            scenario = with_avoider(scenario, self.avoider)
        if not (scenario.driven or is_claimed(claims)):
            claims = (*claims, DEFAULT_CLAIM)
        return replace(scenario, claims=claims)

    def __call__(self, points: Points, first: int) -> Outcomes:
        """Admit and run points, and return their outcomes.

        A refused point has no run.

        Args:
            points: (n, d) points of the cube.
            first: The number of the first point.

        """
        refused, admitted, paired = [""] * len(points), {}, {}
        for k, point in enumerate(points):
            try:
                each = self._admitter.admit(self.scenario(point, first + k))
                if self.reference is not None:
                    refuse_same(each.scenario, replaced := self.reference.in_place(each.scenario))
                    paired[k] = self._admitter.admit(replaced)
                admitted[k] = each
                self.declared_s = decision_time_of(admitted[k].avoider)
            except InputError as error:
                refused[k] = why_refused(error)
        # One call for both avoiders, so that a world with batches runs them together.
        traces = self.world([*admitted.values(), *paired.values()])
        references = dict(zip(paired, traces[len(admitted) :], strict=True))
        margins = np.full((len(points), len(self.goals)), np.nan)
        conclusive = np.zeros(margins.shape, bool)
        mishaps, kinds = [""] * len(points), [""] * len(points)
        cells: list[CoverageCell | None] = [None] * len(points)
        judged: list[int] = []
        for k, trace in zip(admitted, traces, strict=False):
            reference = references.get(k)
            if isinstance(reference, Exception):
                refused[k] = f"the run with {self.goals[0].against} failed: {described(reference)}"
                continue
            if isinstance(trace, Exception):
                mishaps[k] = f"{RUN_FAILED}{without_numbers(described(trace))}"
                continue
            judged.append(k)
            evaluations = [prop.evaluate(trace) for prop in self.properties]
            margins[k] = [np.nan if each.margin is None else each.margin for each in evaluations]
            self.of_others |= [not each.applicable for each in evaluations]
            conclusive[k] = [each.verdict is not Verdict.INCONCLUSIVE for each in evaluations]
            if reference is not None:
                self._hold_against(reference, trace, evaluations, margins[k], conclusive[k])
            self.system = trace.system if self.system is NOT_NOTED else self.system
            self.decisions += len(trace.decisions)
            self.repeatability.add(trace)
            self.tried.add(trace)
            self.times += AnswersTook.from_trace(trace)
            self.limited.add(trace)
            self.unanswered += int(np.count_nonzero(unanswered(trace)))
            self.overruling += Overruling.from_traces([trace])
            own = reference is None or not fault_of(reference)
            mishaps[k] = without_numbers(fault_of(trace)) if self.answered and own else ""
            self.nearest_hand_m = min(self.nearest_hand_m, least_hand_distance_m(trace))
            cells[k] = cell = cell_of(trace, self._admitter.seen_of(trace.scenario))
            kinds[k] = "" if cell is None else f"{cell.direction}, {cell.outcome}"
        self.coverage.add(cells[k] for k in judged)
        self.violations.add(cells[k] for k in judged if np.any(margins[k] < 0.0))
        return Outcomes(margins, conclusive, refused, mishaps, kinds, cells)

    def _hold_against(
        self,
        reference: Trace,
        mine: Trace,
        evaluations: Sequence[Evaluation],
        margins: NDArray[np.float64],  # (k,)
        conclusive: NDArray[np.bool_],  # (k,)
    ) -> None:
        """Replace ``margins`` by differences from the reference.

        Set ``conclusive`` to False unless both verdicts are conclusive. However, a difference below zero is
        always conclusive.
        """
        theirs = [prop.evaluate(reference) for prop in self.properties]
        self.differences.append(
            RunDifference.from_traces(mine, reference, zip(evaluations, theirs, strict=True))
        )
        self.parting_answers += PartingAnswers.of_pair(mine, reference)
        for claim, (my_evaluation, their_evaluation) in enumerate(zip(evaluations, theirs, strict=True)):
            margins[claim] = difference_of(my_evaluation, their_evaluation)
            conclusive[claim] &= their_evaluation.verdict is not Verdict.INCONCLUSIVE
        conclusive |= margins < 0.0


def least_hand_distance_m(trace: Trace) -> float:
    """Return the least distance between the surfaces of the arm and of any present hand.

    If no hand is present, the distance is inf.
    """
    ticks = as_measured(trace).ticks
    there = ticks["hand_distance_m"][ticks["hand_present"]]
    return float(np.fmin.reduce(there, initial=np.inf))
