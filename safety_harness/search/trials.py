"""A space's points tried in a world: scenario, admission, run, margins.

The world is a function from admitted scenarios to traces, so that searching in one and confirming in
another is the same code.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from safety_harness.admission.admit import Admitted, Admitter
from safety_harness.admission.avoiders import refuse_same, told_avoider, with_avoider
from safety_harness.admission.claims import property_of
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
from safety_harness.cell.avoidance.avoider import decision_time_of
from safety_harness.cell.simulation.simulate import INTERRUPTED
from safety_harness.cell.simulation.worlds import KINEMATIC, PYBULLET, WorldEntry
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
from safety_harness.trace.overruling import Overruling
from safety_harness.trace.system import NOT_NOTED, SystemUnderTest
from safety_harness.trace.trace import Trace
from safety_harness.trace.unmeasured import as_measured


class ScenarioRunner(Protocol):
    """Runs admitted scenarios; an Exception stands for a run that could not be carried on."""

    def __call__(self, admitted: Sequence[Admitted]) -> Sequence[Trace | Exception]:
        """One for each, in their order."""


@dataclass(frozen=True)
class InWorld:
    """A ScenarioRunner: in ``world``, but rendered images that it has not in the one that confirms it.

    Ctrl-C raises KeyboardInterrupt.
    """

    world: WorldEntry

    def __call__(self, admitted: Sequence[Admitted]) -> list[Trace | Exception]:
        """All together where the world takes many."""
        found: list[Trace | Exception] = []
        for one, run in zip(admitted, run_all(admitted, self.world), strict=True):
            if isinstance(run, InadmissibleError) and self.world.confirmed_by is not None:
                run = next(run_all([one], self.world.confirmed_by))
            if isinstance(run, Trace) and run.ended == INTERRUPTED:
                raise KeyboardInterrupt
            found.append(run)
        return found


in_pybullet = InWorld(PYBULLET)
"""The runner of the reference world."""
in_kinematic = InWorld(KINEMATIC)
"""The runner of the kinematic world."""


@dataclass(eq=False)
class Trials:
    """The points of ``space`` in ``world``: an Evaluate for a search.

    ``avoider`` takes the place of the one that the space names (a relative file from the working
    directory), ``sentences`` that of its claims; that the avoider answered is claimed besides, unless they
    say something of it.  A claim that the space expects to be violated is searched like the others, and
    ``to_be_found`` names it: of a single scenario it is claimed that it holds.  With a ``reference`` every
    point is run with that avoider as well, and what leads the search is what the one violates and the
    reference keeps; ``differences`` has them all.  Of all runs, ``nearest_hand_m`` is the least distance
    between a hand and the arm, ``decisions`` their number, ``unanswered`` those without an answer,
    ``overruling`` what the gate did; ``repeatability`` takes their questions in, and ``tried``
    what of the space they tried, and ``times`` how long answers took.  Each point's scenario has a
    seed of its own, from ``seed`` and the point's number, unless the file fixes it.  An avoider with a memory
    of its own keeps it from run to run, as ``Admitter`` says.
    """

    space: ScenarioSpace
    world: ScenarioRunner
    seed: int = 0
    avoider: str | None = None
    sentences: tuple[str, ...] = ()
    reference: Reference | None = None
    coverage: Coverage = field(default_factory=Coverage)
    violations: Coverage = field(default_factory=Coverage)  # those runs alone that violated a claim
    declared_s: float = 0.0  # what a decision costs by the avoider's own words
    nearest_hand_m: float = field(default=np.inf, init=False)
    decisions: int = field(default=0, init=False)
    unanswered: int = field(default=0, init=False)
    system: SystemUnderTest = field(default=NOT_NOTED, init=False)  # of the first run
    overruling: Overruling = field(default_factory=Overruling, init=False)
    differences: list[RunDifference] = field(default_factory=list, init=False)
    repeatability: Repeatability = field(default_factory=Repeatability, init=False)
    tried: TriedParts = field(default_factory=TriedParts, init=False)
    times: AnswersTook = field(default_factory=AnswersTook, init=False)
    _admitter: Admitter = field(default_factory=Admitter, init=False)

    def __post_init__(self) -> None:
        refuse_other_type("Trials(space)", self.space, ScenarioSpace)
        simplest = self._completed(self.space.simplest)
        own = not self.sentences and self.reference is None
        given = self.space.simplest.claims if own else ()
        self.to_be_found = frozenset(c.sentence for c in given if c.expected is Verdict.VIOLATED)
        expected = [claim for claim in simplest.claims if claim.expected is Verdict.HOLDS]
        others = tuple(claim for claim in expected if not is_claimed([claim]))
        self.claims = others or tuple(claim for claim in expected if claim is not DEFAULT_CLAIM)
        if not self.claims:
            raise ScenarioError(
                place=Place(file=self.space.file, field="claims"),
                expected="a claim that holds or is violated, for a search to refute",
                got="none",
                hint="write one below claims, or give --claim",
            )
        self.properties: tuple[Property, ...] = tuple(property_of(claim, simplest) for claim in self.claims)
        name = "" if self.reference is None else self.reference.name
        self.of_others = np.zeros(len(self.properties), bool)  # claims that the controller does not concern
        self.goals = tuple(Goal.of(prop, name) for prop in self.properties)
        # That the avoider answered leads a search only where nothing else is claimed.
        self.answered = next((claim for claim in expected if claim not in self.claims), None)

    @property
    def against(self) -> Against | None:
        """How the runs differ from the reference's; None without one."""
        if self.reference is None:
            return None
        mine = told_avoider(self.avoider or self.space.simplest.under_test)
        return Against(mine=mine, reference=self.reference.name, runs=self.differences, drawn=False)

    def scenario(self, point: Point, number: int) -> Scenario:
        """The scenario of a point; InputError where the reader refuses it."""
        own = leaf(self.seed, Branch.SEARCH, 4, number)
        return self._completed(self.space.at(point, seed=own, name=f"{self.space.name}-{number}"))

    def _completed(self, scenario: Scenario) -> Scenario:
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
        """Admit and run; what admission refuses is not run."""
        refused, admitted, others = [""] * len(points), {}, {}
        for k, point in enumerate(points):
            try:
                one = self._admitter.admit(self.scenario(point, first + k))
                if self.reference is not None:
                    refuse_same(one.scenario, other := self.reference.in_place(one.scenario))
                    others[k] = self._admitter.admit(other)
                admitted[k] = one
                self.declared_s = decision_time_of(admitted[k].avoider)
            except InputError as error:
                refused[k] = why_refused(error)
        traces = self.world([*admitted.values(), *others.values()])
        references = dict(zip(others, traces[len(admitted) :], strict=True))
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
            margins[k] = [np.nan if one.margin is None else one.margin for one in evaluations]
            self.of_others |= [not one.applicable for one in evaluations]
            conclusive[k] = [one.verdict is not Verdict.INCONCLUSIVE for one in evaluations]
            if reference is not None:
                self._hold_against(reference, trace, evaluations, margins[k], conclusive[k])
            self.system = trace.system if self.system is NOT_NOTED else self.system
            self.decisions += len(trace.decisions)
            self.repeatability.add(trace)
            self.tried.add(trace)
            self.times += AnswersTook.of(trace)
            self.unanswered += int(np.count_nonzero(unanswered(trace)))
            self.overruling += Overruling.of([trace])
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
        """Put differences in the place of ``margins``, and verdicts of both in that of ``conclusive``."""
        others = [prop.evaluate(reference) for prop in self.properties]
        self.differences.append(RunDifference.of(mine, reference, zip(evaluations, others, strict=True)))
        for claim, (one, other) in enumerate(zip(evaluations, others, strict=True)):
            margins[claim] = difference_of(one, other)
            conclusive[claim] &= other.verdict is not Verdict.INCONCLUSIVE
        conclusive |= margins < 0.0


def least_hand_distance_m(trace: Trace) -> float:
    """The least distance of a hand that is there from the arm, surface to surface; infinite without one."""
    ticks = as_measured(trace).ticks
    there = ticks["hand_distance_m"][ticks["hand_present"]]
    return float(np.fmin.reduce(there, initial=np.inf))
