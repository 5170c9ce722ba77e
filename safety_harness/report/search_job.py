"""Provide ``safety_harness.fuzz``, which searches a space for violations, and write its result."""

from __future__ import annotations

import json
import shlex
from copy import copy
from dataclasses import asdict, dataclass, replace
from datetime import UTC, datetime
from math import isfinite
from pathlib import Path

from safety_harness.admission.admit import admit
from safety_harness.admission.agreement import measured_agreement
from safety_harness.admission.avoiders import one_of, option_of, told_avoider
from safety_harness.admission.comparison import reference_for
from safety_harness.base.exceptions import (
    InadmissibleError,
    InputError,
    OutputError,
    Place,
    ScenarioError,
    SimulationError,
)
from safety_harness.base.extension_points import ExtensionPoint, optional_part
from safety_harness.base.interrupts import one_more_ctrl_c
from safety_harness.base.output import AS_EXPECTED, BAD_INPUT, DIFFERS, INTERRUPTED, QUIET, Output
from safety_harness.base.whole_file import write_text
from safety_harness.cell.simulation.worlds import KINEMATIC, WorldEntry, world_named
from safety_harness.claims.properties.against import Against
from safety_harness.claims.properties.answered import fallback_words
from safety_harness.report.decisions import cost_words
from safety_harness.report.run_result import draw_page
from safety_harness.report.search_evidence import SearchEvidence
from safety_harness.scenario.files import display_path
from safety_harness.scenario.model import Driver
from safety_harness.search.against import Reference
from safety_harness.search.counterexample import unexplained
from safety_harness.search.explaining import SearchExplainer
from safety_harness.search.findings import Findings, Goal, Group
from safety_harness.search.result_lines import basis_of_search
from safety_harness.search.sampling import UniformSampling
from safety_harness.search.searchers import searcher_named
from safety_harness.search.session import FINDINGS, SearchSession, complaint_of, search_space
from safety_harness.search.trials import InWorld, Trials
from safety_harness.search.written import WrittenCounterexample
from safety_harness.space.read import read_space
from safety_harness.space.space import ScenarioSpace
from safety_harness.trace.provenance import provenance

PAGE, COVERAGE = "fuzz.html", "coverage.svg"
EXPLAIN = ("causes", "all")


def fuzz(
    space: str | Path | ScenarioSpace,
    *,
    avoider: str | None = None,
    controller: str | None = None,
    against: str | None = None,
    budget: int = 1000,
    seed: int = 0,
    searcher: str = "default",
    claims: tuple[str, ...] | list[str] = (),
    world: WorldEntry | str | None = None,
    baseline: bool = False,
    explain: str = "causes",
    out: str | Path | None = None,
    output: Output = QUIET,
) -> SearchResult:
    """Search a scenario space for violations, then shrink, confirm and attribute the violations.

    Args:
        space: A file, ``shipped:NAME``, or a ``ScenarioSpace``.
        avoider: The avoider that replaces the space's avoider.
        controller: The controller that replaces the visual servo.
        against: A reference. If there is a reference, a violation is a finding only if the reference avoids
            it in the same draw.
        budget: The number of runs of the search.  Shrinking uses further runs.
        seed: The seed from which every random number derives.
        searcher: The name of a search method that ``searcher_named`` knows.
        claims: Sentences of claims that replace the space's claims.
        world: The world in which to search, such as the user's simulator. The default is the kinematic world.
        baseline: Whether to compare the search with uniform sampling of the space, which gets the same
            budget.
        explain: If it is "causes", explain one example of each cause. The explanations then use at most as
            many runs as the search. If it is "all", explain every violation.
        out: The folder into which each finding is written at once. If it is None, no files are written.
        output: The ``Output`` that shows the progress.

    Ctrl-C ends the search, and the result then contains the findings so far.

    Raises:
        InputError: The space or an option cannot be used.

    """
    if budget < 1:
        raise ScenarioError.of_option("--budget", "at least 1 run", str(budget))
    if explain not in EXPLAIN:
        raise ScenarioError.of_option("--explain", " or ".join(EXPLAIN), repr(explain))
    make = searcher_named(searcher)
    if baseline and make is UniformSampling:
        expected = "another searcher, to compare with uniform sampling"
        raise ScenarioError.of_option("--compare-with-uniform", expected, "--searcher uniform")
    chosen = one_of(avoider, controller)
    reference = reference_for(chosen, against)
    read = space if isinstance(space, ScenarioSpace) else read_space(space)
    searched = world_named(world, "world") if isinstance(world, str) else world or KINEMATIC
    # Learn that a simulator does not start before the search, and not from its first run.
    if searched is not KINEMATIC:
        _refuse_unusable(searched, read)
    make_explainer = optional_part(ExtensionPoint.EXPLAINERS, "attribution", type)
    explainer: SearchExplainer | None = None if make_explainer is None else make_explainer(searched)
    session = search_space(
        Trials(
            read,
            InWorld(searched),
            seed=seed,
            avoider=chosen,
            sentences=tuple(claims),
            reference=None if reference is None else Reference(reference),
        ),
        make,
        out=None if out is None else Path(out),
        budget=budget,
        output=output,
        baseline=baseline,
        explain=unexplained if explainer is None else explainer.explain,
        explains_all=explain == "all",
        admitter=None if explainer is None else explainer.admitter,
        concluding=_write_interim,
    )
    if session.unwritable is not None:
        return SearchResult(session, None, session.interrupted, session.unwritable)
    evidence = evidence_of(session, explainer)
    if evidence.faults is not None:
        output.say(evidence.faults.summary)
    if session.trials.times.summary:
        output.say(f"computing time: {session.trials.times.summary}")
    for line in session.trials.limited.lines:
        output.say(f"limits: {line}")
    return SearchResult(session, evidence, session.interrupted)


def _refuse_unusable(world: WorldEntry, space: ScenarioSpace) -> None:
    """Check that ``world`` can open the simplest scenario of ``space``.

    The check starts a user's simulator. Raise InadmissibleError if the world cannot open a scenario that
    admission accepts.
    """
    world.opener()
    try:
        admitted = admit(space.simplest)
    except InputError:
        return
    if not world.makes_images_of(admitted.scenario):
        return
    try:
        with world.open(admitted.scenario, admitted.arm, admitted.joint_position_rad):
            pass
    except SimulationError as error:
        expected = "a simulator that begins an episode"
        raise InadmissibleError(place=Place(field="world"), expected=expected, got=str(error)) from error


@dataclass(frozen=True, eq=False, repr=False)
class SearchResult:
    """The result of a search.

    Args:
        session: The search with all its findings.
        evidence: The content of the page, or None if a full disk ended the search.
        interrupted: Whether Ctrl-C ended the search.
        unwritable: The error that prevented the writing of a file, or None if all files were written.

    """

    session: SearchSession
    evidence: SearchEvidence | None
    interrupted: bool
    unwritable: OutputError | None = None

    @property
    def findings(self) -> Findings:
        """Return the counts of the search, the groups of violations, and the smallest margins."""
        return self.session.findings

    @property
    def counterexamples(self) -> tuple[WrittenCounterexample, ...]:
        """Return the counterexamples, each with its scenario and the reasons for its violation."""
        return tuple(self.session.written)

    @property
    def exit_code(self) -> int:
        """Return the command's exit code."""
        if self.unwritable is not None:
            return BAD_INPUT
        if self.interrupted:
            return INTERRUPTED
        repeated = self.session.repeated
        alike = repeated is None or not repeated.problem
        return DIFFERS if self.session.differs or not alike else AS_EXPECTED

    def __repr__(self) -> str:
        basis = basis_of_search(self.findings, self.session.searched, self.session.confirmed_in)
        return f"<{self.session.trials.space.name}: {self.session.summary}. {basis}>"

    def data(self) -> dict[str, object]:
        """Return the content of findings.json, or an empty dictionary if a full disk ended the search."""
        return {} if self.evidence is None else as_json(self.session.trials, self.evidence)

    def write(self, folder: str | Path, output: Output = QUIET) -> SearchResult:
        """Write fuzz.html, findings.json, coverage.svg, and a file for each finding without a file.

        The method finishes writing even if the user has pressed Ctrl-C once.

        Args:
            folder: The folder to write into.
            output: The ``Output`` that shows the progress.

        Returns:
            This result, which now refers to the files in ``folder``.

        Raises:
            OutputError: The folder cannot be written.
            ScenarioError: A full disk ended the search, so there is no result to write.

        """
        out = Path(folder)
        session = self.session.moved_to(out)
        if session.unwritable is not None:
            raise session.unwritable
        if self.evidence is None:
            raise ScenarioError.of_option("write(folder)", "a search that came to its end", "a full disk")
        evidence = replace(self.evidence, command=fuzz_command(session), shown=tuple(session.written))
        made = replace(self, session=session, evidence=evidence)
        with one_more_ctrl_c(output.say, f"writing {out / PAGE}; Ctrl-C once more gives it up") as given_up:
            write_text(out / FINDINGS, json.dumps(made.data(), indent=1) + "\n")
            draw_page("coverage", out / COVERAGE, evidence)
            drawn = draw_page("fuzz", out / PAGE, evidence)
        output.say(
            f"page: {out / PAGE} (for programs: {FINDINGS})" if drawn else f"findings: {out / FINDINGS}"
        )
        return replace(made, interrupted=self.interrupted or given_up())

    def kept(self, folder: Path, output: Output) -> SearchResult:
        """Write the files, report any error, and print the command that runs the counterexamples."""
        made = self
        if self.unwritable is None:
            try:
                made = self.write(folder, output)
            except OutputError as error:
                made = replace(self, unwritable=error)
            except KeyboardInterrupt:
                made = replace(self, interrupted=True)
                output.say(f"no page was written; the files are in {folder}")
        output.say(*made.session.last_lines(made.unwritable))
        if made.evidence is not None and made.interrupted:
            output.say(f"next: {made.evidence.command}    (the whole search again)")
        elif made.evidence is not None and made.evidence.rest_command:
            output.say(f"next: {made.evidence.rest_command}    (explains the rest)")
        return made


def _write_interim(session: SearchSession) -> None:
    """Write a page with the present findings, because the explanations may take long or be interrupted."""
    if session.keeps and session.findings.found_any and session.unwritable is None:
        unfinished = copy(session.findings)
        unfinished.interrupted = True  # the page says so unless a later page replaces it
        try:
            evidence = replace(evidence_of(session), findings=unfinished)
            draw_page("fuzz", session.out / PAGE, evidence)
        except OutputError as error:
            session.unwritable = error


def evidence_of(session: SearchSession, explainer: SearchExplainer | None = None) -> SearchEvidence:
    """Return everything that the search's page shows."""
    trials = session.trials
    tested = trials.avoider or trials.space.simplest.under_test
    cost = cost_words(trials.space.simplest.settings.avoidance.decision_time, trials.declared_s)
    faults = None if explainer is None else explainer.of_search(session)
    return SearchEvidence(
        title=trials.space.title,
        space=trials.space.name,
        tested=f"{option_of(tested).removeprefix('--')} {tested}",
        computing_time="; ".join(filter(None, (cost, trials.times.summary))),
        seed=trials.seed,
        budget=session.budget,
        command=fuzz_command(session),
        generated_at=datetime.now(UTC),
        findings=session.findings,
        fallback=fallback_words(trials.unanswered, trials.decisions),
        overruling=trials.overruling,
        repeated=session.repeated,
        baseline=session.baseline,
        against=trials.against,
        flips=tuple(session.flips),
        worse=tuple(session.worse),
        causes=session.causes,
        coverage=trials.coverage,
        violations=trials.violations,
        shown=tuple(session.written),
        confirmed=session.confirmed,
        physical=session.physical,
        confirmed_in=tuple(map(str, session.references)),
        unconfirmed=tuple(session.unconfirmed),
        not_found=tuple(session.not_found),
        faults=faults,
        attributed={} if explainer is None else explainer.answers(session.written),
        nearest_hand_m=trials.nearest_hand_m,
        agreement=measured_agreement(),
        system=trials.system,
        provenance=provenance(
            ", repeated in ".join(world.name for world in (session.searched, *session.references)),
            tuple(library for world in session.references for library in world.libraries),
        ),
        searched=session.searched,
        unconfirmable=session.unconfirmable,
    )


def fuzz_command(session: SearchSession) -> str:
    """Return the command line that repeats the search with all its options."""
    trials = session.trials
    file = trials.space.file or Path(f"{trials.space.name}.yaml")
    command = ["safety-harness", "fuzz", str(display_path(file))]
    command += ["--searcher", session.findings.searcher, "--budget", str(session.budget)]
    command += ["--seed", str(trials.seed), "--out", str(display_path(session.out))]
    command += [] if trials.avoider is None else [option_of(trials.avoider), told_avoider(trials.avoider)]
    command += [] if trials.reference is None else ["--against", trials.reference.name]
    command += [part for sentence in trials.sentences for part in ("--claim", sentence)]
    command += [] if session.searched is KINEMATIC else ["--world", session.searched.label]
    command += ["--explain", "all"] if session.explains_all else []
    return shlex.join(command + ["--compare-with-uniform"] * (session.baseline is not None))


def as_json(trials: Trials, evidence: SearchEvidence) -> dict[str, object]:
    """Return the search as JSON.

    The data contain counts, least margins, coverage, and the groups of violations with their points. All
    values are in SI units.
    """
    findings, baseline = evidence.findings, evidence.baseline
    return {
        "space": evidence.space,
        "basis": basis_of_search(
            findings, evidence.searched, evidence.confirmed_in if evidence.confirmed else ()
        ),
        "avoider": None if isinstance(trials.avoider, Driver) else trials.avoider,
        "system": evidence.system.as_dict,
        "against": None if trials.against is None else _held(trials.against),
        "computing_time": evidence.computing_time,
        "searcher": findings.searcher,
        "seed": evidence.seed,
        "budget": evidence.budget,
        "tried": findings.tried,
        "refused": dict(findings.refused.most_common()),
        "interrupted": findings.interrupted,
        "nearest_hand_m": evidence.nearest_hand_m if isfinite(evidence.nearest_hand_m) else None,
        "runs_with_contact": evidence.coverage.touching,
        "expected_and_not_found": list(evidence.not_found),
        "decisions": trials.decisions,
        "unanswered": trials.unanswered,
        "overruling": evidence.overruling.named,
        "repeatability": None if evidence.repeated is None else asdict(evidence.repeated),
        "claims": _of_claims(findings),
        "baseline": None
        if baseline is None
        else {"searcher": baseline.searcher, "tried": baseline.tried, "claims": _of_claims(baseline)},
        "distinct": [
            _of_group(trials, group) | {"counterexample": _file_of(group, evidence)}
            for group in findings.groups
        ],
        "searched_in": str(evidence.searched),
        "confirmed_in": list(evidence.confirmed_in),
        "confirmed": evidence.confirmed,
        "physics_had_a_part": evidence.physical,
        "not_confirmed": [_of_group(trials, example.group) for example in evidence.unconfirmed],
        "counterexamples": [shown.path.name for shown in evidence.shown],
        "flips_near_the_limit": list(evidence.flips),
        "worse_than_the_reference": list(evidence.worse),
        "counted": evidence.causes.summary,
        "causes": evidence.causes.explained,
        "examples_not_explained": evidence.causes.not_explained,
        "attribution_of_counterexamples": evidence.attributed,
        "attribution": None if evidence.faults is None else evidence.faults.as_json(),
        "coverage": {str(cell): count for cell, count in sorted(trials.coverage.counts.items())},
        "violations_by_cell": {str(cell): count for cell, count in sorted(trials.violations.counts.items())},
    }


def _held(against: Against) -> dict[str, object]:
    """Return the comparison with the reference as JSON, but without the comparison's list of runs."""
    return {key: value for key, value in against.as_json().items() if key != "runs"}


def _leads(goal: Goal, margin: float) -> bool:
    """Return whether ``margin`` only guides the search and is no difference that counts as a finding."""
    return bool(goal.against) and margin >= 0.0


def _of_claims(findings: Findings) -> list[dict[str, object]]:
    return [
        {
            "sentence": goal.sentence,
            "with_a_verdict": int(findings.evidence[k]),
            "violated": int(findings.violated[k]),
            "first_violation_after": int(findings.first_violation[k]) or None,
            "least_margin_si": None
            if nearest is None or _leads(goal, nearest.margins[k])
            else float(nearest.margins[k]),
            "least_margins_so_far_si": [
                improvement for improvement in findings.improvements[k] if not _leads(goal, improvement[1])
            ],
        }
        for k, (goal, nearest) in enumerate(zip(findings.goals, findings.nearest, strict=True))
    ]


def _file_of(group: Group, evidence: SearchEvidence) -> str | None:
    """Return the name of the counterexample file for ``group``, or None if the group has no file."""
    return next((shown.path.name for shown in evidence.shown if group in shown.groups), None)


def _of_group(trials: Trials, group: Group) -> dict[str, object]:
    return {
        "complaint": complaint_of(trials, group).sentence,
        "kind": group.kind,
        "runs": group.count,
        "worst_margin_si": None if group.claim is None else group.worst_margin(),
        "worst_point": group.worst.point.tolist(),
        "number": group.worst.number,
    }
