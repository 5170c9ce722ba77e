"""Confirm, shrink and explain a violation, and write it as a scenario file with its evidence in comments.

An explanation has two sources: replays with changes (``search.attribution``), and the decisions of the run.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import count
from math import inf
from pathlib import Path
from typing import Protocol

import numpy as np

from safety_harness.admission.admit import Admitted, Admitter
from safety_harness.admission.avoiders import folder_of
from safety_harness.cell.simulation.worlds import REFERENCE, WorldEntry
from safety_harness.claims.properties.base import Evaluation
from safety_harness.claims.properties.hand_distance import nearest_hand
from safety_harness.scenario.model import Claim, Scenario, Verdict
from safety_harness.scenario.write import write_scenario
from safety_harness.search.confirm import Complaint, Confirm, in_one_world
from safety_harness.search.coverage import cell_of
from safety_harness.search.findings import TriedPoint
from safety_harness.search.shrink import Shrunk, SpentError, shrink
from safety_harness.search.trials import ScenarioRunner, Trials, world_of
from safety_harness.space.regions import SeenRegions, seen_by
from safety_harness.trace.records import Check, DecisionOutcome
from safety_harness.trace.trace import Trace
from safety_harness.trace.unmeasured import decided

# Measured on two processors: a run of a search takes 0.7 to 1 ms for each of STARTS_S + duration_s, and an
# engine 25 ms for each simulated second.
STARTS_S, ENGINE_COSTS = 5.0, 30.0


def cost_s(world: WorldEntry, runs: Sequence[Scenario]) -> float:
    """Return what ``runs`` in ``world`` cost, as simulated seconds [s] of the kinematic world."""
    factor = ENGINE_COSTS if world.reference else 1.0
    return sum(STARTS_S + factor * scenario.duration_s for scenario in runs)


@dataclass(frozen=True)
class Explanation:
    """The reasons why a scenario violates a claim.

    ``lines`` are text for people. Two explanations have the same cause if they share a text in ``causes``.
    """

    lines: tuple[str, ...] = ()
    causes: tuple[str, ...] = ()


@dataclass(eq=False)
class Allowance:
    """The simulated time [s] that all explanations together may cost.

    Unlike a limit by the wall's clock, it has the same effect on any machine. The present example must end
    before ``spent_s`` reaches ``until_s``.
    """

    total_s: float = inf
    spent_s: float = 0.0
    until_s: float = inf

    def share(self, *, last: bool, least_s: float = 0.0) -> None:
        """Give the next example half of the time that is left, or all of it if it is the ``last``.

        An example that costs ``least_s`` gets as much, if so much is left.
        """
        left_s = self.total_s - self.spent_s
        self.until_s = self.spent_s + (left_s if last else min(left_s, max(0.5 * left_s, least_s)))

    def has(self, cost_s: float = 0.0) -> bool:
        """Return whether the present example may cost another ``cost_s``."""
        return self.spent_s + cost_s < self.until_s

    def spend(self, world: WorldEntry, runs: Sequence[Scenario]) -> None:
        """Add the cost of ``runs`` in ``world``; raise SpentError without a change if it is too high."""
        runs_cost_s = cost_s(world, runs)
        if not self.has(runs_cost_s):
            raise SpentError
        self.spent_s += runs_cost_s

    def metered(self, runner: ScenarioRunner) -> ScenarioRunner:
        """Return ``runner`` that adds the cost of its runs, and raises SpentError before a cost too high."""
        return _Metered(runner, self)


@dataclass(frozen=True, eq=False)
class _Metered:
    """A ScenarioRunner whose runs an allowance pays."""

    runner: ScenarioRunner
    allowance: Allowance

    @property
    def world(self) -> WorldEntry:
        """The world of the runs."""
        return world_of(self.runner)

    def __call__(self, admitted: Sequence[Admitted]) -> Sequence[Trace | Exception]:
        """Return one run for each scenario, in their order."""
        self.allowance.spend(self.world, [run.scenario for run in admitted])
        return self.runner(admitted)


class Explain(Protocol):
    """A function that explains why a scenario violates a claim."""

    def __call__(
        self, scenario: Scenario, claim: Claim, allowance: Allowance, *, confirms: bool = True
    ) -> Explanation:
        """Return the explanation; with ``confirms``, repeat it in a reference if the allowance has so much.

        Raises:
            SpentError: The allowance is too small for an explanation.

        """


def unexplained(
    scenario: Scenario, claim: Claim, allowance: Allowance, *, confirms: bool = True
) -> Explanation:
    """Return an empty explanation of any scenario and claim."""
    return Explanation()


def seen_of(scenario: Scenario) -> SeenRegions:
    """Return the regions that the training data of the scenario's avoider cover."""
    return seen_by(scenario.under_test, folder=folder_of(scenario), settings=scenario.settings)


def circumstances(trace: Trace) -> list[str]:
    """Return lines on the run's cell in the coverage, and on each decision with its spread and checks."""
    seen = seen_of(trace.scenario)
    cell = cell_of(trace, seen)
    lines = [] if cell is None else [f"the run: {cell} (seen by {seen.source})"]
    if not decided(trace):
        return [*lines, "what was decided was not measured"]
    lines += sure_about_unseen(trace, seen)
    for k, decision in enumerate(trace.decisions):
        spread_m = decision["proposed_spread_m"]
        parts = [f"decision {k + 1} at {decision['time_s']:.3f} s"]
        parts.append(DecisionOutcome(int(decision["outcome"])).name.lower())
        if decision["fault"]:
            parts.append(f"the avoider: {decision['fault']}")
        elif np.any(spread_m > 0.0):
            parts.append(f"largest spread {spread_m.max() * 1e3:.3g} mm")
            if np.isfinite(decision["spread_threshold_m"]):
                parts[-1] += f" (threshold {decision['spread_threshold_m'] * 1e3:.3g} mm)"
        failed = Check(int(decision["proposed_failed"]))
        if failed:
            names = (str(check.name).lower().replace("_", " ") for check in failed)
            parts.append("the proposal failed: " + ", ".join(names))
        inside = seen.hand.contains(decision["hand_position_in_base_m"])
        parts.append("hand seen in training" if inside else "hand not seen in training")
        lines.append("; ".join(parts))
    return lines


def sure_about_unseen(trace: Trace, seen: SeenRegions) -> list[str]:
    """Return a line on the accepted answer of least spread about a hand outside the training data.

    Only answers count that the gate accepted and whose spread is above 0 and at most the threshold. The list
    is empty without such an answer.

    Args:
        trace: The run.
        seen: The regions of the avoider's training data.

    """
    rows = trace.decisions
    spread_m = np.max(rows["proposed_spread_m"], axis=-1, initial=0.0)
    unseen = ~seen.hand.contains(rows["hand_position_in_base_m"])
    used = rows["outcome"] == DecisionOutcome.PROPOSED
    sure = np.flatnonzero(unseen & used & (spread_m > 0.0) & (spread_m <= rows["spread_threshold_m"]))
    if not len(sure):
        return []
    surest = sure[np.argmin(spread_m[sure])]
    beyond_m = float(seen.hand.outside_m(rows["hand_position_in_base_m"][surest]))
    text = f"sure ({spread_m[surest] * 1e3:.1f} mm) about a hand never seen in training"
    where = f"{beyond_m * 1e3:.0f} mm from the nearest that was, in decision {surest + 1}"
    return [f"{text}, {where}; {len(sure)} of {len(rows)} decisions are so"]


CONTACT = {
    Verdict.VIOLATED: "contact",
    Verdict.HOLDS: "no contact",
    Verdict.INCONCLUSIVE: "contact unknown",
}


def contact_words(run: Trace | Exception) -> str:
    """Return whether a hand touches the arm, in words; unknown if ``run`` failed or its bounds allow both."""
    return CONTACT[nearest_hand(run).verdict if isinstance(run, Trace) else Verdict.INCONCLUSIVE]


KEPT = 0.1  # least share of the first margin, so that the violation is not marginal
DRAWS = 10  # of the avoider's own randomness
_NUMBER = re.compile(r"(?<![\w.-])-?\d+(?:\.\d+)?(?:e[+-]?\d+)?(?![\w.])")  # no digits within names


@dataclass(frozen=True, eq=False)
class Counterexample:
    """A shrunk scenario whose claims expect the verdicts of the confirming run.

    ``run`` is the confirming run, or an Exception if it could not be finished. ``draws`` counts the
    violations among DRAWS draws of the avoider's own randomness. ``found_margin`` [SI] is the margin in the
    confirming world before shrinking; None for a run error. ``found_contact`` and ``contact`` are the
    ``contact_words`` before and after shrinking. ``circumstances`` and ``attribution`` (the cause) are lines
    for people; counterexamples with a common text in ``causes`` share a cause. A spent allowance (``is_cut``)
    may leave ``attribution`` and ``draws`` empty. After an interruption, and in a scenario without an
    avoider, ``draws`` is None.
    """

    complaint: Complaint
    shrunk: Shrunk
    run: Trace | Exception
    evaluations: tuple[Evaluation, ...]
    found_margin: float | None
    found_contact: str
    circumstances: tuple[str, ...]
    attribution: tuple[str, ...]
    draws: int | None
    causes: tuple[str, ...] = ()
    is_cut: bool = False

    @cached_property
    def contact(self) -> str:
        """The ``contact_words`` of ``run``."""
        return contact_words(self.run)

    @property
    def explanation(self) -> list[str]:
        """The explanation, as lines for people."""
        return [*self.attribution, *self.further]

    @property
    def further(self) -> list[str]:
        """Lines that follow the attribution: circumstances, decisions, and other draws of the avoider."""
        often = f"the avoider's own randomness: it happens in {self.draws} of {DRAWS} draws of it"
        return [*self.circumstances, *[often] * (self.draws is not None)]

    @property
    def evaluation(self) -> Evaluation | None:
        """The evaluation of the violated claim; None for a run error."""
        claims = self.shrunk.scenario.claims
        pairs = zip(claims, self.evaluations, strict=False)
        return next((evaluation for claim, evaluation in pairs if claim == self.complaint.claim), None)

    @property
    def scenario(self) -> Scenario:
        """The scenario that is written to the file."""
        shrunk = self.shrunk.scenario
        claims = shrunk.claims
        if self.evaluations:
            pairs = zip(claims, self.evaluations, strict=True)
            claims = tuple(replace(claim, expected=evaluation.verdict) for claim, evaluation in pairs)
        title = "the run fails" if self.complaint.claim is None else self.complaint.sentence
        return replace(shrunk, title=f"counterexample: {title}", about="", claims=claims)

    @cached_property
    def structure(self) -> str:
        """The shrunk file without its name, seed, claims and numbers.

        The avoider, the hands with their moves, the faults and the relevant settings remain.
        """
        plain = replace(self.shrunk.scenario, name="", title="-", about="", seed=0, claims=())
        return _NUMBER.sub("#", write_scenario(plain))

    def is_same_as(self, second: Counterexample) -> bool:
        """Return whether this and ``second`` violate the same claim with the same structure.

        If the avoider gave no answer, the texts of the failures must agree too.
        """
        return self.complaint == second.complaint and self.structure == second.structure


def counterexample_of(
    scenario: Scenario,
    complaint: Complaint,
    world: ScenarioRunner,
    *,
    budget: int,
    sooner: ScenarioRunner | None = None,
    explain: Explain = unexplained,
    allowance: Allowance | None = None,
    admitter: Admitter | None = None,
    on_step: Callable[[str], None] = lambda step: None,
) -> Counterexample | None:
    """Confirm, explain and shrink the violation ``complaint`` of ``scenario``.

    Every shrunk scenario must violate by at least a tenth of the first margin, so that its violation is not
    marginal. After Ctrl-C during shrinking, the result has the simplest scenario so far and
    ``shrunk.interrupted``.

    Args:
        scenario: The violating scenario.
        complaint: The claim or failure.
        world: The world that confirms.
        budget: The greatest number of runs for shrinking.
        sooner: A quicker world for shrinking, if it shows the violation of ``scenario``; ``world`` then runs
            the shrunk scenario. None: ``world``.
        explain: The function that explains a violation; it is not called for missing answers.
        allowance: Limits explanation, shrinking and draws; the confirmations of ``scenario`` and of the
            shrunk one are free. None: no limit.
        admitter: The admitter of all runs. None: a new one.
        on_step: Receives the description of each step.

    Returns:
        The counterexample; None if ``world`` does not show the complaint.

    """
    allowance, admitter = allowance or Allowance(), admitter or Admitter()
    on_step("confirming")
    last = world([admitter.admit_afresh(scenario)])[0]
    if not complaint.is_in(last):
        return None
    margin, contact = complaint.margin_in(last), contact_words(last)
    claim = None if complaint.kind else complaint.claim
    on_step("asking whose fault it is")
    explanation = (
        Explanation() if claim is None else _affordable_explanation(allowance, explain, scenario, claim)
    )
    runs = _Remembering(allowance.metered(world))
    confirm = Confirm(complaint, runs, by=-KEPT * (margin or 0.0), admit=admitter.admit_afresh)
    shrunk = _shrunk(scenario, confirm, sooner or world, admitter, budget, allowance, on_step)
    if shrunk.scenario != scenario:
        last = runs.run_of(shrunk.scenario) or world([admitter.admit_afresh(shrunk.scenario)])[0]
        if claim is not None and explanation is not None:
            explanation = _explained(explanation, shrunk, claim, explain, allowance)
    judged = in_one_world(world, admitter.admit(shrunk.scenario), last)
    draws = not (shrunk.interrupted or shrunk.scenario.driven)
    drawn = draws and allowance.has(cost_s(REFERENCE, [shrunk.scenario] * DRAWS))
    is_cut = explanation is None or draws is not drawn or (not shrunk.settled and shrunk.used < budget)
    explanation = explanation or Explanation()
    return Counterexample(
        complaint,
        shrunk,
        judged.run,
        judged.evaluations,
        margin,
        contact,
        tuple(filter(None, (complaint.reference_words(last), *circumstances(last))))
        if isinstance(last, Trace)
        else (),
        explanation.lines,
        confirm.share_of_draws(shrunk.scenario, DRAWS) if drawn else None,
        explanation.causes or (complaint.kind,) * bool(complaint.kind),
        is_cut and not shrunk.interrupted,
    )


class _Remembering:
    """A ScenarioRunner that remembers the run of the last scenario."""

    def __init__(self, runner: ScenarioRunner) -> None:
        self._runner, self._last = runner, list[tuple[Scenario, Trace | Exception]]()

    def __call__(self, admitted: Sequence[Admitted]) -> Sequence[Trace | Exception]:
        """Return one run for each scenario, in their order."""
        runs = self._runner(admitted)
        self._last = [(admitted[-1].scenario, runs[-1])]
        return runs

    def run_of(self, scenario: Scenario) -> Trace | Exception | None:
        """Return the run of ``scenario`` if that was the last one; else None."""
        return next((run for known, run in self._last if known == scenario), None)


def _shrunk(
    scenario: Scenario,
    confirm: Confirm,
    sooner: ScenarioRunner,
    admitter: Admitter,
    budget: int,
    allowance: Allowance,
    on_step: Callable[[str], None],
) -> Shrunk:
    """Return ``scenario`` shrunk for at most half of the allowance's present share.

    The candidates run in ``sooner``, with one instance of a user's program for all. The confirming world
    runs only the result, with a fresh instance. If that does not violate, shrinking starts again, and the
    confirming world tests each candidate that violates in ``sooner``.
    """

    def shrunk_while(*confirms: Confirm) -> Shrunk:
        runs = count(1)

        def violates(simpler: Scenario) -> bool:
            on_step(f"shrinking, run {next(runs)} of at most {budget}")
            return all(shows(simpler) for shows in confirms)

        until_s = allowance.until_s
        allowance.until_s = (allowance.spent_s + until_s) / 2.0
        shrunk = shrink(scenario, violates, budget=budget)
        allowance.until_s = until_s
        return shrunk

    interrupted = False
    try:
        quick = replace(confirm, world=allowance.metered(sooner), admit=admitter.admit)
        if confirm.complaint.kind or not quick(scenario):  # never two worlds for an avoider that hangs
            return shrunk_while(confirm)
        shrunk = shrunk_while(quick)
        interrupted = shrunk.interrupted
        if shrunk.scenario == scenario or confirm(shrunk.scenario):
            return shrunk
        if interrupted:
            return replace(shrunk, scenario=scenario, steps=())
        return shrunk_while(quick, confirm)
    except SpentError:
        return Shrunk(scenario, (), 0, settled=False, interrupted=interrupted)


def _affordable_explanation(
    allowance: Allowance, explain: Explain, scenario: Scenario, claim: Claim
) -> Explanation | None:
    """Return the explanation of a violation; None if the ``allowance`` is too small for it."""
    try:
        return explain(scenario, claim, allowance)
    except SpentError:
        return None


def _explained(
    as_found: Explanation, shrunk: Shrunk, claim: Claim, explain: Explain, allowance: Allowance
) -> Explanation:
    """Return the explanation ``as_found``, and if it has no cause, with that of the shrunk run.

    A shrunk run may end before a change fails, so a change that only gains time would count as its cause.
    """
    first = replace(as_found, lines=_naming("run as found", as_found.lines))
    if first.causes or not first.lines or shrunk.interrupted:
        return first
    second = _affordable_explanation(allowance, explain, shrunk.scenario, claim) or Explanation()
    return Explanation((*first.lines, *_naming("shrunk run", second.lines)), second.causes)


def _naming(run: str, lines: tuple[str, ...]) -> tuple[str, ...]:
    """Return the lines of an explanation, of which the first one names its run."""
    return (f"{lines[0]} (of the {run})", *lines[1:]) if lines else ()


def text_of(case: Counterexample, origin: Sequence[str], trace_file: Path | None) -> str:
    """Return the text of a counterexample's file: comments with the evidence, then the scenario.

    Args:
        case: The counterexample.
        origin: Lines on the search that found it.
        trace_file: The file of the confirming run; None if there is no trace.

    """
    head = [f"A counterexample to: {case.complaint.sentence}", *origin]
    if case.complaint.summary != case.complaint.sentence:
        head.insert(1, case.complaint.kind)
    head.append(f"{case.shrunk.summary}.".capitalize())
    for evaluation in case.evaluations:
        head += _margins(evaluation, "")
    if isinstance(case.run, Trace):
        head += _evidence(case.run)
    if trace_file is not None:
        head.append(f"confirming run: {trace_file.name} (safety-harness replay)")
    head += ["", *case.explanation]
    comments = "".join(f"# {line}".rstrip() + "\n" for line in head)
    return comments + "\n" + write_scenario(case.scenario)


def _margins(evaluation: Evaluation, indent: str) -> list[str]:
    """Return a line with the verdict and the margin, rounded and exact, and such a line for each part."""
    exact = "" if evaluation.margin is None else f" ({evaluation.margin!r} in SI)"
    when = "" if evaluation.worst_time_s is None else f" at {evaluation.worst_time_s:.3f} s"
    verdict = "VIOLATED" if evaluation.verdict is Verdict.VIOLATED else evaluation.verdict.value
    line = f"{indent}{verdict} {evaluation.margin_text()}{exact}{when}: {evaluation.sentence}"
    return [line, *(inner for part in evaluation.parts for inner in _margins(part, indent + "  "))]


def _evidence(trace: Trace) -> list[str]:
    """Return lines on the versions, hashes and seeds of a run."""
    made, scenario = trace.provenance, trace.scenario
    claims = "\n".join(claim.sentence for claim in scenario.claims)
    libraries = ", ".join(f"{name} {version}" for name, version in made.libraries)
    seeds = ", ".join(str(int(seed)) for seed in trace.decisions["seed"]) or "no decisions"
    return [
        f"world {made.world}, safety-harness {made.package_version}, Python {made.python}, {made.platform}",
        f"libraries: {libraries}",
        f"source {made.source_hash}",
        f"{trace.system.label}, file {trace.system.tested.sha256 or 'none'}",
        f"robot {trace.system.robot.sha256}",
        f"claims {hashlib.sha256(claims.encode()).hexdigest()}",
        f"seed {scenario.seed} (hands and sensors); seeds of the decisions: {seeds}",
    ]


def origin_of(trials: Trials, tried: TriedPoint, searcher: str) -> list[str]:
    """Return lines on the search that found ``tried``, and the exact value there of every parameter.

    Args:
        trials: The trials of the search.
        tried: The point.
        searcher: The searcher's name.

    """
    space = trials.space
    search = f"point {tried.number} of searcher {searcher}, seed {trials.seed}"
    search += f", against {trials.reference.name}" if trials.reference is not None else ""
    lines = [f"Found in the space {space.name}: {search}; as found:"]
    values = space.values_at(tried.point[None])[0]
    for parameter in space.parameters:
        own = values[parameter.columns]
        if np.any(np.isnan(own)):
            continue
        labels = getattr(parameter.distribution, "labels", None)
        shown = repr(labels[int(own[0])]) if labels else " ".join(f"{float(value)!r}" for value in own)
        lines.append(f"  {parameter.name} = {shown} {parameter.distribution.unit}".rstrip())
    return lines
