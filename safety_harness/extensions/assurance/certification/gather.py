"""Gather the evidence of a plan from its ledger, its searches and measurements."""

from __future__ import annotations

import os
import platform
import shlex
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path

from safety_harness.claims.properties.tally import ASSUMPTIONS, EXCLUSIONS
from safety_harness.extensions.assurance.campaign.identity import SIMULATOR
from safety_harness.extensions.assurance.campaign.ledger import Ledger
from safety_harness.extensions.assurance.campaign.plan import Plan
from safety_harness.extensions.assurance.campaign.summary import root_of, shields_in
from safety_harness.extensions.assurance.certification.argument_files import read_notes
from safety_harness.extensions.assurance.certification.counterexamples import (
    MOST,
    Example,
    declared_counterexamples,
    numbered,
    search_evidence,
    searched_counterexamples,
    searches_of,
    told_whose_fault,
)
from safety_harness.extensions.assurance.certification.credibility import credibility_of
from safety_harness.extensions.assurance.certification.evidence import (
    FORMAT,
    ArgumentNote,
    CertifiedProofs,
    ClaimStatus,
    Evidence,
    Record,
    SystemDescription,
    WhoseFault,
)
from safety_harness.extensions.assurance.certification.evidence import DeclaredPlan as PlanEvidence
from safety_harness.extensions.assurance.certification.evidence import EvidenceProvenance as Origin
from safety_harness.extensions.assurance.certification.findings import findings_of
from safety_harness.extensions.assurance.certification.guard import ReportGuard
from safety_harness.extensions.assurance.certification.hazards import hazards_of
from safety_harness.extensions.assurance.certification.learned import learned_of
from safety_harness.extensions.assurance.certification.proofs import stored_proof
from safety_harness.extensions.assurance.certification.results import (
    bounds,
    claims_of,
    overruling_of,
    strata_of,
)
from safety_harness.extensions.assurance.certification.stored import (
    Stored,
    calibration_of,
    coverage_of,
    limited_in,
    random_traces,
    separation_of,
    untried_in,
)
from safety_harness.extensions.assurance.certification.system import system_of
from safety_harness.extensions.assurance.certification.tools import (
    NO_TRIALS,
    CoverageOfRuns,
    Credibility,
    HarnessTrials,
)
from safety_harness.extensions.assurance.certification.verdicts import worst_status
from safety_harness.extensions.assurance.certification.whose_fault import whose_fault
from safety_harness.extensions.pages.page_parts import in_words
from safety_harness.report.evidence import JudgedRun
from safety_harness.trace.limiting import AS_MEANT
from safety_harness.trace.provenance import provenance

NO_SYSTEM = SystemDescription(under_test=(), card=(), limits=(), gate=(), settings=(), changed=())
NO_COVERAGE = CoverageOfRuns(runs=0, without_hand=0, cells=(), about="")
NOT_BLAMED = WhoseFault(about="the attribution of the violations failed", groups=(), would_help=())
NOT_BELIEVED = Credibility(
    agreement=None,
    reruns=(),
    oracles=(),
    oracles_measured_with="",
    absent=("the account of credibility failed",),
)
Explains = Callable[[Plan, Sequence[Example | str]], Iterable[Example | str]]
NO_SELFTEST = (
    "This report has no trial of the harness, which is a table of seeded faults (safety-harness selftest "
    "writes it, certify --selftest FILE adds it)."
)


@dataclass(frozen=True, kw_only=True, eq=False)
class GatheredEvidence:
    """The evidence of a plan, and its counterexamples with their runs."""

    evidence: Evidence
    examples: tuple[Example, ...]

    @property
    def runs(self) -> dict[int, JudgedRun]:
        """The runs of the counterexamples that have pictures.

        The key of a run is the number of its counterexample.
        """
        return {item.shown.number: item.run for item in self.examples if item.shown.number <= MOST}


def gather(
    plan: Plan,
    ledger: Ledger,
    folder: Path,
    *,
    command: str,
    trials: HarnessTrials = NO_TRIALS,
    declaration: str = "",
    guard: ReportGuard | None = None,
) -> GatheredEvidence:
    """Return the evidence of a plan.

    The function reads the ledger and the searches, and repeats some runs.

    Args:
        plan: The plan.
        ledger: The open ledger of the plan's runs.
        folder: The report's folder, with the searches below it.
        command: The command that makes the report again.
        trials: The self-test, oracles and recorded cells. The default has no such files.
        declaration: The hash of the plan's declaration, or an empty string if the plan was not declared.
        guard: A guard with the findings of earlier failures. The default guard has no findings.

    """
    guard = guard or ReportGuard()
    origin = _origin(plan, ledger, folder, command)
    return put_together(
        plan,
        ledger,
        folder,
        trials,
        declaration=declaration,
        origin=origin,
        proven=guard.run("the account of what is proven", lambda: stored_proof(folder, plan), None),
        notes=guard.run("the list of the author's notes", lambda: read_notes(folder), ()),
        guard=guard,
    )


def put_together(
    plan: Plan,
    ledger: Ledger,
    folder: Path,
    trials: HarnessTrials,
    *,
    declaration: str,
    origin: Origin,
    believe: Callable[[Sequence[Stored], HarnessTrials], Credibility] = credibility_of,
    blame: Callable[[Plan, Ledger], WhoseFault] = whose_fault,
    proven: CertifiedProofs | None = None,
    notes: tuple[ArgumentNote, ...] = (),
    explain: Explains = told_whose_fault,
    guard: ReportGuard | None = None,
) -> GatheredEvidence:
    """Return the evidence that follows from the ledger, the searches, and the given parts.

    Only ``certify`` knows some of the given parts. For these parts, ``verify`` passes the values that the
    report states.

    Args:
        plan: The plan.
        ledger: The open ledger of the plan's runs.
        folder: The report's folder, with the searches below it.
        trials: The self-test, oracles and recorded cells.
        declaration: The hash of the plan's declaration, or an empty string if the plan was not declared.
        origin: The origin of the report.
        believe: A function that returns the evidence on the simulator.
        blame: A function that returns the causes of the violations.
        proven: The confirmed proofs, or None without a certificate.
        notes: The author's notes.
        explain: A function that adds an attribution to the counterexamples.
        guard: A guard whose findings become findings of the report. The default is a new guard.

    """
    guard = guard or ReportGuard()
    stored, damaged = guard.run("the stored random runs", lambda: random_traces(plan, ledger), ([], []))
    claims, strata = claims_of(plan, ledger, stored), strata_of(plan, ledger)
    searches = guard.run("the account of searches", lambda: searches_of(plan, folder), ())
    own = guard.run("the table of counterexamples", lambda: tuple(declared_counterexamples(plan, ledger)), ())
    searched = guard.run(
        "the table of the search's counterexamples",
        lambda: tuple(searched_counterexamples(plan, searches, folder)),
        (),
    )
    attributed = guard.run("the attribution of counterexamples", lambda: tuple(explain(plan, own)), own)
    met = [*attributed, *searched]
    examples = numbered(met)
    evidence = Evidence(
        format=FORMAT,
        interrupted=any(next(ledger.missing(k), None) is not None for k in range(len(strata)))
        or any(claim.standing is ClaimStatus.INCOMPLETE for claim in claims),
        plan=_plan(plan, ledger),
        standing=worst_status(claim.standing for claim in claims),
        strata=strata,
        overruling=guard.run("the account of overruled proposals", lambda: overruling_of(ledger), ()),
        shields=guard.run("the runs behind a shield", lambda: shields_in(ledger), ()),
        claims=claims,
        system=guard.run("the description of the system", lambda: system_of(plan, ledger.opened), NO_SYSTEM),
        assumptions=ASSUMPTIONS,
        exclusions=(*EXCLUSIONS, *ledger.wrists),
        separation=guard.run("the separation of the runs", lambda: tuple(separation_of(plan, stored)), ()),
        calibration=guard.run("the calibration of the runs", lambda: tuple(calibration_of(plan, stored)), ()),
        coverage=guard.run("the coverage of the runs", lambda: coverage_of(ledger), NO_COVERAGE),
        counterexamples=tuple(example.shown for example in examples),
        whose_fault=guard.run("the attribution", lambda: blame(plan, ledger), NOT_BLAMED),
        search=guard.run("the summary of searches", lambda: search_evidence(searches), None),
        credibility=guard.run("the account of credibility", lambda: believe(stored, trials), NOT_BELIEVED),
        selftest=trials.selftest,
        selftest_absent="" if trials.selftest else NO_SELFTEST,
        record=Record(rows_sha256=root_of(ledger), declaration_sha256=declaration),
        findings=(),
        provenance=replace(origin, libraries=origin.libraries + _files(stored)),
        files=(),
        proven=proven,
        hazards=guard.run("the account of hazards", lambda: hazards_of(plan, ledger), ()),
        notes=notes,
        learned=guard.run("the account of the learned part", lambda: learned_of(plan, ledger, stored), None),
    )
    # Findings may concern any part of the evidence, so they are added last.
    untried = guard.run("the list of what no run tried", lambda: untried_in(plan, stored), [])
    limited = guard.run("the count of limited commands", lambda: limited_in(plan, stored), [])
    doubted = [line for line in limited if AS_MEANT in line]
    findings = guard.run(
        "the list of findings",
        lambda: tuple(findings_of(evidence, ledger, met, searches, [*damaged, *untried, *doubted])),
        (),
    )
    return GatheredEvidence(
        evidence=replace(evidence, findings=(*findings, *guard.findings)), examples=examples
    )


def _files(stored: Sequence[Stored]) -> tuple[tuple[str, str], ...]:
    """Return the compiled files that were executed in the stored runs, with their hashes."""
    files = dict.fromkeys(file for item in stored for file in item.trace.provenance.files)
    return tuple((name, f"sha256 {sha256}") for name, sha256 in files)


def _plan(plan: Plan, ledger: Ledger) -> PlanEvidence:
    m = bounds(plan)
    own = ledger.files[0]
    return PlanEvidence(
        name=plan.title,
        about=plan.about,
        file=own.name,
        sha256=ledger.declared.identity.sha256,
        text=own.data.decode("utf-8", "replace"),
        world=plan.world.label,
        model_only=plan.world.model_only,
        confidence=plan.confidence,
        per_bound_confidence=1.0 - (1.0 - plan.confidence) / m,
        bounds=m,
        seed=plan.seed,
        stop_early=plan.stop_early,
        search_runs=plan.search_runs,
    )


def _origin(plan: Plan, ledger: Ledger, folder: Path, command: str) -> Origin:
    made = provenance(plan.world.label)
    began_at, machine, spent_s = sessions_of(ledger)
    return Origin(
        package_version=made.package_version,
        source_hash=made.source_hash,
        python=made.python,
        platform=made.platform,
        machine=machine or f"{platform.machine()}, {os.cpu_count()} cores",
        libraries=libraries_of(ledger),
        command=command,
        commands=(
            command,
            shlex.join(["safety-harness", "verify", folder.name]),
            shlex.join(["safety-harness", "campaign", "status", f"{folder.name}/{ledger.path.name}"]),
        ),
        began_at=began_at,
        ended_at=in_words(datetime.now(UTC)),
        run_seconds_s=spent_s,
    )


def libraries_of(ledger: Ledger) -> tuple[tuple[str, str], ...]:
    """Return the libraries and their versions, as used for the declared runs in ``ledger``."""
    prefix = "the library "
    parts = ledger.declared.identity.parts
    named = ((name.removeprefix(prefix), text) for name, text in parts if name.startswith(prefix))
    return (*named, *((name.removeprefix("the "), text) for name, text in parts if name == SIMULATOR))


def sessions_of(ledger: Ledger) -> tuple[str, str, float]:
    """Return the start of the first session in ``ledger``, the machines, and the total run time [s]."""
    sessions = list(ledger.all("SELECT began, machine, workers FROM session ORDER BY id"))
    ((spent_s,),) = ledger.all("SELECT coalesce(sum(seconds), 0.0) FROM episode")
    machines = dict.fromkeys(f"{machine}; {workers} workers" for _, machine, workers in sessions)
    began_at = in_words(datetime.fromisoformat(sessions[0][0])) if sessions else ""
    return began_at, "; ".join(machines), float(spent_s)
