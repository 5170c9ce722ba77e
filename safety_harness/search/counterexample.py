"""Confirm, shrink and explain a violation, and write it as a scenario file.

The comments in the file contain the evidence. An explanation has two sources: the replays with changes that
``extensions.attribution`` makes, and the decisions of the run.
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
    """Return the cost of simulating ``runs`` in ``world``.

    The unit is a simulated second [s] of the kinematic world.
    """
    factor = ENGINE_COSTS if world.reference else 1.0
    return sum(STARTS_S + factor * scenario.duration_s for scenario in runs)


@dataclass(frozen=True)
class Explanation:
    """The reasons why a scenario violates a claim.

    ``lines`` are sentences for people. Two explanations have the same cause if their ``causes`` have a text
    in common.
    """

    lines: tuple[str, ...] = ()
    causes: tuple[str, ...] = ()


@dataclass(eq=False)
class Allowance:
    """A limit on the simulated time [s] that all explanations may cost in total.

    Unlike a limit on wall-clock time, this limit has the same effect on any machine. During the work on the
    present example, the spent time ``spent_s`` must stay below ``until_s``.
    """

    total_s: float = inf
    spent_s: float = 0.0
    until_s: float = inf

    def share(self, *, last: bool, least_s: float = 0.0) -> None:
        """Give half of the remaining time to the next example.

        If this example is the ``last`` one, it gets all of the remaining time. The example gets at least
        ``least_s`` if so much time remains.
        """
        left_s = self.total_s - self.spent_s
        self.until_s = self.spent_s + (left_s if last else min(left_s, max(0.5 * left_s, least_s)))

    def has(self, cost_s: float = 0.0) -> bool:
        """Return whether the present example may use another ``cost_s`` [s]."""
        return self.spent_s + cost_s < self.until_s

    def spend(self, world: WorldEntry, runs: Sequence[Scenario]) -> None:
        """Add the cost of ``runs`` in ``world``.

        If the cost is too high, raise SpentError and add no cost.
        """
        runs_cost_s = cost_s(world, runs)
        if not self.has(runs_cost_s):
            raise SpentError
        self.spent_s += runs_cost_s

    def metered(self, runner: ScenarioRunner) -> ScenarioRunner:
        """Return a runner that adds the cost of the runs of ``runner``.

        The runner raises SpentError before a run whose cost is too high.
        """
        return _Metered(runner, self)


@dataclass(frozen=True, eq=False)
class _Metered:
    """A ScenarioRunner that charges its runs to an allowance."""

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
        """Return the explanation.

        If ``confirms`` is True and the allowance is sufficient, repeat the explanation in a reference world.

        Raises:
            SpentError: The allowance is too small for an explanation.

        """


def unexplained(
    scenario: Scenario, claim: Claim, allowance: Allowance, *, confirms: bool = True
) -> Explanation:
    """Return an empty explanation for any scenario and claim."""
    return Explanation()


def seen_of(scenario: Scenario) -> SeenRegions:
    """Return the regions that the training data of the scenario's avoider cover."""
    return seen_by(scenario.under_test, folder=folder_of(scenario), settings=scenario.settings)


def circumstances(trace: Trace) -> list[str]:
    """Return lines on the run's cell in the coverage, and on each decision.

    The lines include the decision's spread and failed checks.
    """
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
    """Find the accepted answer with the least spread among hands outside the training data.

    Return a line on this answer. The function considers an accepted answer only if its spread is above 0 and
    at most the threshold. The list is empty if there is no such answer.

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
    """Return a text that states whether a hand touches the arm.

    The text states that this is unknown if ``run`` failed, or if the bounds of the distance allow both
    answers.
    """
    return CONTACT[nearest_hand(run).verdict if isinstance(run, Trace) else Verdict.INCONCLUSIVE]


KEPT = 0.1  # least share of the first margin, so that the violation is not marginal
DRAWS = 10  # of the avoider's own randomness
_NUMBER = re.compile(r"(?<![\w.-])-?\d+(?:\.\d+)?(?:e[+-]?\d+)?(?![\w.])")  # no digits within names


@dataclass(frozen=True, eq=False)
class Counterexample:
    """A shrunk scenario. For each claim, the scenario expects the verdict of the confirming run.

    ``run`` is the confirming run, or an Exception if it could not be finished. The run was repeated DRAWS
    times with other random numbers of the avoider, and ``draws`` counts the repetitions with a violation.
    ``found_margin`` [SI] is the margin in the confirming world before shrinking, or None for a run error.
    ``found_contact`` and ``contact`` are the ``contact_words`` before and after shrinking. ``circumstances``
    and ``attribution`` are lines for people, and ``attribution`` describes the cause. Counterexamples share a
    cause if their ``causes`` have a text in common. ``is_cut`` states that the allowance was used up. In this
    case, ``attribution`` may be empty, and ``draws`` may be None. ``draws`` is also None after an
    interruption, or if the scenario has no avoider.
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
        """The lines that follow the attribution.

        These lines are on circumstances, decisions, and other draws of the avoider.
        """
        often = f"the avoider's own randomness: it happens in {self.draws} of {DRAWS} draws of it"
        return [*self.circumstances, *[often] * (self.draws is not None)]

    @property
    def evaluation(self) -> Evaluation | None:
        """The evaluation of the violated claim, or None for a run error."""
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
        """The text of the shrunk scenario without its name, seed, claims and numbers.

        It contains the avoider, the hands with their moves, the faults and the relevant settings.
        """
        plain = replace(self.shrunk.scenario, name="", title="-", about="", seed=0, claims=())
        return _NUMBER.sub("#", write_scenario(plain))

    def is_same_as(self, second: Counterexample) -> bool:
        """Return whether this and ``second`` violate the same claim with the same structure.

        If the avoider gave no answer, the texts of the failures must also be equal.
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

    Every shrunk scenario must violate the claim by at least a tenth of the first margin, so that the
    violation is not marginal. After Ctrl-C during shrinking, the result has the simplest scenario so far, and
    ``shrunk.interrupted`` is True.

    Args:
        scenario: The violating scenario.
        complaint: The claim or failure.
        world: The world that confirms.
        budget: The greatest number of runs for shrinking.
        sooner: A quicker world for shrinking, which is used if it shows the violation of ``scenario``. In
            this case, ``world`` runs only the shrunk scenario. The default is ``world``.
        explain: The function that explains a violation. For a missing answer, this function is not called.
        allowance: Limits explanation, shrinking and draws, but not the runs that confirm ``scenario`` and the
            shrunk scenario. The default sets no limit.
        admitter: The admitter of all runs. The default is a new admitter.
        on_step: A function that receives a description of each step.

    Returns:
        The counterexample, or None if ``world`` does not show the complaint.

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
        """Return the run of ``scenario``, or None if another scenario ran last."""
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
    """Return ``scenario`` after shrinking.

    Shrinking may use at most half of the allowance of the present example. The candidates run in ``sooner``,
    all with the same instance of a user's program. The confirming world runs only the result, with a new
    instance. If the result does not violate the claim in that world, shrinking starts again. In this second
    attempt, the confirming world tests each candidate that violates the claim in ``sooner``.
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
    """Return the explanation of a violation, or None if the ``allowance`` is too small for it."""
    try:
        return explain(scenario, claim, allowance)
    except SpentError:
        return None


def _explained(
    as_found: Explanation, shrunk: Shrunk, claim: Claim, explain: Explain, allowance: Allowance
) -> Explanation:
    """Return the explanation ``as_found``.

    If this explanation has no cause, add the explanation of the shrunk run. A shrunk run may end so early
    that a change which only delays the violation seems to avoid it. Such a change would wrongly appear as the
    cause.
    """
    first = replace(as_found, lines=_naming("run as found", as_found.lines))
    if first.causes or not first.lines or shrunk.interrupted:
        return first
    second = _affordable_explanation(allowance, explain, shrunk.scenario, claim) or Explanation()
    return Explanation((*first.lines, *_naming("shrunk run", second.lines)), second.causes)


def _naming(run: str, lines: tuple[str, ...]) -> tuple[str, ...]:
    """Return the lines of an explanation, after adding the name of its run to the first line."""
    return (f"{lines[0]} (of the {run})", *lines[1:]) if lines else ()


def text_of(case: Counterexample, origin: Sequence[str], trace_file: Path | None) -> str:
    """Return the text of a counterexample's file: comments with the evidence, then the scenario.

    Args:
        case: The counterexample.
        origin: Lines on the search that found the counterexample.
        trace_file: The file of the confirming run, or None if there is no trace.

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
    """Return lines with the verdict and the margin of an evaluation, and the same for each of its parts.

    Each margin appears twice: rounded and exact.
    """
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
    """Return lines on the search that found ``tried``.

    The lines include the exact value of every parameter at that point.

    Args:
        trials: The trials of the search.
        tried: The point.
        searcher: The name of the searcher.

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
