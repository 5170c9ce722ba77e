"""A space's points tried in a world: scenario, admission, run, margins.

The world is a function from admitted scenarios to traces, so that searching in one and confirming in
another is the same code.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Protocol

import numpy as np

from safety_harness.admission.admit import Admitted, admit
from safety_harness.admission.avoiders import with_avoider
from safety_harness.admission.claims import property_of
from safety_harness.admission.kinematic import late_by_the_clock, run_kinematic, run_many
from safety_harness.admission.spaces import why_refused
from safety_harness.admission.trial import run_trial
from safety_harness.avoidance.avoider import Avoider, described
from safety_harness.exceptions import InadmissibleError, InputError, Place, ScenarioError
from safety_harness.properties.base import Property
from safety_harness.scenario.faults import AvoiderFault
from safety_harness.scenario.model import Claim, Scenario, Verdict
from safety_harness.search.coverage import Cell, Coverage, cell_of
from safety_harness.search.cube import Points
from safety_harness.search.draws import OtherDraws
from safety_harness.search.outcomes import Goal, Outcomes
from safety_harness.seeds import Branch
from safety_harness.seeds import seed as leaf
from safety_harness.simulation.simulate import INTERRUPTED
from safety_harness.space.regions import Seen, seen_by
from safety_harness.space.space import ScenarioSpace
from safety_harness.trace.trace import Trace

WITHOUT_FILE = ("opposite pose", "nearest candidate")
_NUMBER = re.compile(r"-?\d+\.\d+(?:e[+-]?\d+)?")


class World(Protocol):
    """Runs admitted scenarios; an Exception stands for a run that could not be carried on."""

    def __call__(self, admitted: Sequence[Admitted]) -> Sequence[Trace | Exception]:
        """One for each, in their order."""
        ...


def in_pybullet(admitted: Sequence[Admitted]) -> list[Trace | Exception]:
    """One after another, in the reference world.  Ctrl-C raises KeyboardInterrupt.

    Avoiders that the kinematic world waits for are waited for here too: a busy machine makes no finding.
    """
    found: list[Trace | Exception] = []
    for one in admitted:
        try:
            asked = one.avoider.avoider if isinstance(one.avoider, OtherDraws) else one.avoider
            trace = run_trial(one, by_the_clock=late_by_the_clock(asked))
        except Exception as error:  # one run's failure is a finding
            found.append(error)
            continue
        if trace.ended == INTERRUPTED:
            raise KeyboardInterrupt
        found.append(trace)
    return found


def in_kinematic(admitted: Sequence[Admitted]) -> list[Trace | Exception]:
    """All together in the kinematic world; one by one if any breaks; rendered images in PyBullet."""
    try:
        return list(run_many(admitted))
    except Exception:
        return [_alone(one) for one in admitted]


def _alone(admitted: Admitted) -> Trace | Exception:
    try:
        trace = run_kinematic(admitted)
    except InadmissibleError:
        return in_pybullet([admitted])[0]
    except Exception as error:
        return error
    if trace.ended == INTERRUPTED:
        raise KeyboardInterrupt
    return trace


@dataclass(eq=False)
class Trials:
    """The points of ``space`` in ``world``: an Evaluate for a search.

    ``avoider`` takes the place of the one that the space names (a relative file from the working
    directory), ``sentences`` that of its claims.  Each point's scenario has a seed of its own, from
    ``seed`` and the point's number, unless the file fixes it.  What names a file is loaded once, so that
    an avoider with a memory of its own keeps it from run to run.
    """

    space: ScenarioSpace
    world: World
    seed: int = 0
    avoider: str | None = None
    sentences: tuple[str, ...] = ()
    coverage: Coverage = field(default_factory=Coverage)
    violations: Coverage = field(default_factory=Coverage)  # those runs alone that violated a claim
    _avoiders: dict[str, Avoider] = field(default_factory=dict)
    _seen: dict[str, Seen] = field(default_factory=dict)

    def __post_init__(self) -> None:
        simplest = self._completed(self.space.simplest)
        self.claims = tuple(claim for claim in simplest.claims if claim.expected is Verdict.HOLDS)
        if not self.claims:
            raise ScenarioError(
                place=Place(file=self.space.file, field="claims"),
                expected="a claim that should hold, for a search to refute",
                got="none",
                hint="write one below claims, or give --claim",
            )
        self.properties: tuple[Property, ...] = tuple(property_of(claim, simplest) for claim in self.claims)
        self.goals = tuple(Goal.of(prop) for prop in self.properties)

    def scenario(self, point: Points, number: int) -> Scenario:
        """The scenario of a point (d,); InputError where the reader refuses it."""
        own = leaf(self.seed, Branch.SEARCH, 4, number)
        return self._completed(self.space.at(point, seed=own, name=f"{self.space.name}-{number}"))

    def _completed(self, scenario: Scenario) -> Scenario:
        if self.sentences:
            place = Place(field="--claim")
            claims = (Claim(sentence=s, expected=Verdict.HOLDS, place=place) for s in self.sentences)
            scenario = replace(scenario, claims=tuple(claims))
        return scenario if self.avoider is None else with_avoider(scenario, self.avoider)

    def __call__(self, points: Points, first: int) -> Outcomes:
        """Admit and run; what admission refuses is not run."""
        refused, admitted = [""] * len(points), {}
        for k, point in enumerate(points):
            try:
                admitted[k] = self._admit(self.scenario(point, first + k))
            except InputError as error:
                refused[k] = why_refused(error)
        traces = self.world(list(admitted.values()))
        margins = np.full((len(points), len(self.goals)), np.nan)
        conclusive = np.zeros(margins.shape, bool)
        mishaps, kinds = [""] * len(points), [""] * len(points)
        cells: list[Cell | None] = [None] * len(points)
        for k, trace in zip(admitted, traces, strict=True):
            if isinstance(trace, Exception):
                mishaps[k] = f"the run failed: {described(trace)}"
                continue
            margins[k], conclusive[k] = judged_by(self.properties, trace)
            mishaps[k] = mishap_of(trace)
            cells[k] = cell = cell_of(trace, self._seen_of(trace))
            kinds[k] = "" if cell is None else f"{cell.direction}, {cell.outcome}"
        self.coverage.add(cells[k] for k in admitted)
        self.violations.add(cells[k] for k in admitted if np.any(margins[k] < 0.0))
        return Outcomes(margins, conclusive, refused, mishaps, kinds, cells)

    def _admit(self, scenario: Scenario) -> Admitted:
        known = self._avoiders.get(scenario.avoider)
        admitted = admit(scenario, avoider=known, rehearsed=known is not None)
        if scenario.avoider not in WITHOUT_FILE:  # those depend on settings, which may vary
            self._avoiders[scenario.avoider] = admitted.avoider
        return admitted

    def _seen_of(self, trace: Trace) -> Seen:
        scenario = trace.scenario
        known = self._seen.get(scenario.avoider)
        if known is None:
            folder = scenario.file.parent if scenario.file else None
            known = seen_by(scenario.avoider, folder=folder, settings=scenario.settings)
            self._seen[scenario.avoider] = known
        return known


def judged_by(properties: Sequence[Property], trace: Trace) -> tuple[Points, Points]:
    """(k,) margins in SI, NaN for none, and (k,) whether there is a verdict."""
    evaluations = [prop.evaluate(trace) for prop in properties]
    margins = [np.nan if e.margin is None else e.margin for e in evaluations]
    return np.array(margins), np.array([e.verdict is not Verdict.INCONCLUSIVE for e in evaluations])


def mishap_of(trace: Trace) -> str:
    """What the avoider did instead of answering, without its numbers; empty if the scenario asked for it."""
    if any(isinstance(fault, AvoiderFault) for fault in trace.scenario.faults):
        return ""
    faults = [str(fault) for fault in trace.decisions["fault"] if fault]
    return f"the avoider gave no answer: {_NUMBER.sub('...', faults[0])}" if faults else ""
