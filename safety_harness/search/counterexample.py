"""A counterexample: shrunk, confirmed, explained, and as a scenario file with its evidence in comments.

Why it violates is known as far as other runs tell, which another part makes, and by what was decided.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import count
from pathlib import Path

import numpy as np

from safety_harness.admission.admit import admit
from safety_harness.admission.avoiders import folder_of
from safety_harness.claims.properties.base import Evaluation
from safety_harness.scenario.model import Claim, Scenario, Verdict
from safety_harness.scenario.write import write_scenario
from safety_harness.search.confirm import Complaint, Confirm, in_one_world
from safety_harness.search.coverage import cell_of
from safety_harness.search.findings import TriedPoint
from safety_harness.search.shrink import Shrunk, shrink
from safety_harness.search.trials import ScenarioRunner, Trials
from safety_harness.space.regions import SeenRegions, seen_by
from safety_harness.trace.records import Check, DecisionOutcome
from safety_harness.trace.trace import Trace
from safety_harness.trace.unmeasured import decided

Explain = Callable[[Scenario, Claim], Sequence[str]]
"""Lines for people on why a scenario violates a claim."""


def unexplained(scenario: Scenario, claim: Claim) -> Sequence[str]:
    """An Explain that says nothing."""
    return ()


def seen_of(scenario: Scenario) -> SeenRegions:
    """What the scenario's avoider was trained on."""
    return seen_by(scenario.under_test, folder=folder_of(scenario), settings=scenario.settings)


def circumstances(trace: Trace) -> list[str]:
    """Where the run lies relative to the seen space, and what was decided in it."""
    seen = seen_of(trace.scenario)
    cell = cell_of(trace, seen)
    lines = [] if cell is None else [f"the run: {cell} (seen by {seen.source})"]
    if not decided(trace):
        return [*lines, "what was decided was not measured"]
    lines += sure_about_unseen(trace, seen)
    for k, decision in enumerate(trace.decisions):
        spread_m = decision["proposed_spread_m"]
        words = [f"decision {k + 1} at {decision['time_s']:.3f} s"]
        words.append(DecisionOutcome(int(decision["outcome"])).name.lower())
        if decision["fault"]:
            words.append(f"the avoider: {decision['fault']}")
        elif np.any(spread_m > 0.0):
            words.append(f"largest spread {spread_m.max() * 1e3:.3g} mm")
            if np.isfinite(decision["spread_threshold_m"]):
                words[-1] += f" (threshold {decision['spread_threshold_m'] * 1e3:.3g} mm)"
        failed = Check(int(decision["proposed_failed"]))
        if failed:
            names = (str(check.name).lower().replace("_", " ") for check in failed)
            words.append("the proposal failed: " + ", ".join(names))
        inside = seen.hand.contains(decision["hand_position_in_base_m"])
        words.append("hand seen in training" if inside else "hand where none was in training")
        lines.append("; ".join(words))
    return lines


def sure_about_unseen(trace: Trace, seen: SeenRegions) -> list[str]:
    """Of the answers about a hand that training never had, the surest one that the gate took for certain."""
    asked = trace.decisions
    spread_m = np.max(asked["proposed_spread_m"], axis=-1, initial=0.0)
    unseen = ~seen.hand.contains(asked["hand_position_in_base_m"])
    taken = asked["outcome"] == DecisionOutcome.PROPOSED
    sure = np.flatnonzero(unseen & taken & (spread_m > 0.0) & (spread_m <= asked["spread_threshold_m"]))
    if not len(sure):
        return []
    surest = sure[np.argmin(spread_m[sure])]
    beyond_m = float(seen.hand.outside_m(asked["hand_position_in_base_m"][surest]))
    words = f"sure ({spread_m[surest] * 1e3:.1f} mm) about a hand never seen in training"
    where = f"{beyond_m * 1e3:.0f} mm from the nearest that was, in decision {surest + 1}"
    return [f"{words}, {where}; {len(sure)} of {len(asked)} decisions are so"]


KEPT = 0.1  # of the margin, when shrinking
DRAWS = 10  # of the avoider's own randomness
_NUMBER = re.compile(r"(?<![\w.-])-?\d+(?:\.\d+)?(?:e[+-]?\d+)?(?![\w.])")  # not those within names


@dataclass(frozen=True, eq=False)
class Counterexample:
    """``shrunk.scenario`` with the verdicts of the confirming run as what its claims expect.

    ``run`` is that run (an Exception for one that could not be carried on), ``draws`` in how many of
    DRAWS draws of the avoider's own randomness it happens.  ``found_margin`` is the margin in the confirming
    world before shrinking [SI], None for a mishap.  ``circumstances`` and ``attribution``, whose fault
    it is, are lines for people.  Where shrinking was interrupted there are neither attribution nor draws, and
    no draws where there is no avoider.
    """

    complaint: Complaint
    shrunk: Shrunk
    run: Trace | Exception
    evaluations: tuple[Evaluation, ...]
    found_margin: float | None
    circumstances: tuple[str, ...]
    attribution: tuple[str, ...]
    draws: int | None

    @property
    def explanation(self) -> list[str]:
        """Lines for people."""
        return [*self.attribution, *self.further]

    @property
    def further(self) -> list[str]:
        """Lines beside whose fault it is: circumstances, decisions, and other draws of the avoider."""
        often = f"the avoider's own randomness: it happens in {self.draws} of {DRAWS} draws of it"
        return [*self.circumstances, *[often] * (self.draws is not None)]

    @property
    def evaluation(self) -> Evaluation | None:
        """Of the claim that is violated; None for a mishap."""
        claims = self.shrunk.scenario.claims
        pairs = zip(claims, self.evaluations, strict=False)
        return next((evaluation for claim, evaluation in pairs if claim == self.complaint.claim), None)

    @property
    def scenario(self) -> Scenario:
        """What is written."""
        shrunk = self.shrunk.scenario
        claims = shrunk.claims
        if self.evaluations:
            pairs = zip(claims, self.evaluations, strict=True)
            claims = tuple(replace(claim, expected=evaluation.verdict) for claim, evaluation in pairs)
        title = "the run fails" if self.complaint.claim is None else self.complaint.sentence
        return replace(shrunk, title=f"counterexample: {title}", about="", claims=claims)

    @cached_property
    def structure(self) -> str:
        """The file that it shrank to, without name, seed, claims and numbers.

        What is left are the avoider, the hands with their moves, the faults, and the settings that matter.
        """
        plain = replace(self.shrunk.scenario, name="", title="-", about="", seed=0, claims=())
        return _NUMBER.sub("#", write_scenario(plain))

    def is_same_as(self, other: Counterexample) -> bool:
        """Whether they violate the same claim (the avoider fails in the same words) with one structure."""
        return self.complaint == other.complaint and self.structure == other.structure


def counterexample_of(
    found: Scenario,
    complaint: Complaint,
    world: ScenarioRunner,
    *,
    budget: int,
    sooner: ScenarioRunner | None = None,
    explain: Explain = unexplained,
    on_step: Callable[[str], None] = lambda words: None,
) -> Counterexample | None:
    """Confirm, shrink and explain; None if ``world`` does not show the complaint.

    What it shrinks to is violated by a tenth of the first margin at least, so that it is not on the edge.
    A quicker world, asked ``sooner``, has to show it too, if it shows what was found: it refuses most of what
    is not violated.
    ``explain`` is asked about a violation, and not where the avoider gave no answer.
    Ctrl-C while it shrinks keeps the simplest so far; ``shrunk.interrupted`` then says so.
    ``on_step`` is told what comes next.
    """
    on_step("confirming")
    first = world([admit(found)])[0]
    if not complaint.is_in(first):
        return None
    margin = complaint.margin_in(first)
    confirm = Confirm(complaint, world, by=-KEPT * (margin or 0.0))
    confirms, runs = [confirm], count(1)
    if sooner is not None and not complaint.kind and (quick := replace(confirm, world=sooner))(found):
        confirms = [quick, confirm]  # an avoider that hangs would be waited for twice

    def violates(simpler: Scenario) -> bool:
        on_step(f"shrinking, run {next(runs)} of at most {budget}")
        return all(shows(simpler) for shows in confirms)

    shrunk = shrink(found, violates, budget=budget)
    on_step("asking whose fault it is")
    last = in_one_world(world, admit(shrunk.scenario))
    whole = not shrunk.interrupted
    return Counterexample(
        complaint,
        shrunk,
        last.run,
        last.evaluations,
        margin,
        tuple(filter(None, (complaint.reference_words(last.run), *circumstances(last.run))))
        if isinstance(last.run, Trace)
        else (),
        tuple(explain(shrunk.scenario, complaint.claim))
        if whole and complaint.claim is not None and not complaint.kind
        else (),
        confirm.share_of_draws(shrunk.scenario, DRAWS) if whole and not shrunk.scenario.driven else None,
    )


def text_of(one: Counterexample, origin: Sequence[str], trace_file: Path | None) -> str:
    """The file: the scenario below what is known of it, as comments."""
    head = [f"A counterexample to: {one.complaint.sentence}", *origin]
    if one.complaint.words != one.complaint.sentence:
        head.insert(1, one.complaint.kind)
    head.append(f"Shrunk in {one.shrunk.used} runs{'' if one.shrunk.settled else ', not to the end'}.")
    for evaluation in one.evaluations:
        head += _margins(evaluation, "")
    if isinstance(one.run, Trace):
        head += _evidence(one.run)
    if trace_file is not None:
        head.append(f"confirming run: {trace_file.name} (safety-harness replay)")
    head += ["", *one.explanation]
    comments = "".join(f"# {line}".rstrip() + "\n" for line in head)
    return comments + "\n" + write_scenario(one.scenario)


def _margins(evaluation: Evaluation, indent: str) -> list[str]:
    """The verdict, the margin as it is shown and exactly, and those of the parts."""
    exact = "" if evaluation.margin is None else f" ({evaluation.margin!r} in SI)"
    when = "" if evaluation.worst_time_s is None else f" at {evaluation.worst_time_s:.3f} s"
    verdict = "VIOLATED" if evaluation.verdict is Verdict.VIOLATED else evaluation.verdict.value
    line = f"{indent}{verdict} {evaluation.margin_text()}{exact}{when}: {evaluation.sentence}"
    return [line, *(inner for part in evaluation.parts for inner in _margins(part, indent + "  "))]


def _evidence(trace: Trace) -> list[str]:
    made, scenario = trace.provenance, trace.scenario
    claims = "\n".join(claim.sentence for claim in scenario.claims)
    libraries = ", ".join(f"{name} {version}" for name, version in made.libraries)
    seeds = ", ".join(str(int(seed)) for seed in trace.decisions["seed"]) or "none was asked for"
    return [
        f"world {made.world}, safety-harness {made.package_version}, Python {made.python}, {made.platform}",
        f"libraries: {libraries}",
        f"source {made.source_hash}",
        f"{trace.system.words}, file {trace.system.tested.sha256 or 'none'}",
        f"robot {trace.system.robot.sha256}",
        f"claims {hashlib.sha256(claims.encode()).hexdigest()}",
        f"seed {scenario.seed} (hands and sensors); seeds of the decisions: {seeds}",
    ]


def origin_of(trials: Trials, tried: TriedPoint, searcher: str) -> list[str]:
    """How it was found: the search, and every value of the space, exactly."""
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
