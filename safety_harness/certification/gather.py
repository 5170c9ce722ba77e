"""A plan's ledger, searches and measurements put together into the evidence."""

from __future__ import annotations

import os
import platform
import shlex
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import TypeVar

from safety_harness.campaign.ledger import Ledger
from safety_harness.campaign.plan import Plan
from safety_harness.campaign.summary import root_of
from safety_harness.certification.argument_files import read_notes
from safety_harness.certification.counterexamples import (
    MOST,
    Example,
    declared_counterexamples,
    numbered,
    search_evidence,
    searched_counterexamples,
    searches_of,
    told_whose_fault,
)
from safety_harness.certification.credibility import credibility_of
from safety_harness.certification.evidence import (
    FORMAT,
    ArgumentNote,
    CertifiedProofs,
    ClaimStatus,
    Evidence,
    Record,
    WhoseFault,
)
from safety_harness.certification.evidence import DeclaredPlan as PlanEvidence
from safety_harness.certification.evidence import EvidenceProvenance as Origin
from safety_harness.certification.findings import findings_of
from safety_harness.certification.hazards import hazards_of
from safety_harness.certification.learned import learned_of
from safety_harness.certification.proofs import stored_proof
from safety_harness.certification.results import bounds, claims_of, overruling_of, strata_of
from safety_harness.certification.stored import (
    Stored,
    calibration_of,
    coverage_of,
    random_traces,
    separation_of,
    untried_in,
)
from safety_harness.certification.system import system_of
from safety_harness.certification.tools import NO_TRIALS, Credibility, HarnessTrials
from safety_harness.certification.verdicts import gravest
from safety_harness.certification.whose_fault import whose_fault
from safety_harness.exceptions import described
from safety_harness.properties.tally import ASSUMPTIONS, EXCLUSIONS
from safety_harness.report.evidence import JudgedRun
from safety_harness.report.page_parts import in_words
from safety_harness.trace.provenance import provenance

T = TypeVar("T")

Explains = Callable[[Plan, Sequence[Example | str]], Iterable[Example | str]]
NO_SELFTEST = (
    "The harness was not put on trial for this report: no table of seeded faults was given (safety-harness "
    "selftest writes one, certify --selftest FILE takes it in)."
)


@dataclass(frozen=True, kw_only=True, eq=False)
class GatheredEvidence:
    """The evidence, and the counterexamples in it with their runs."""

    evidence: Evidence
    examples: tuple[Example, ...]

    @property
    def runs(self) -> dict[int, JudgedRun]:
        """Of the counterexamples that have pictures, by their numbers."""
        return {one.shown.number: one.run for one in self.examples if one.shown.number <= MOST}


def gather(
    plan: Plan,
    ledger: Ledger,
    folder: Path,
    *,
    command: str,
    trials: HarnessTrials = NO_TRIALS,
    declaration: str = "",
) -> GatheredEvidence:
    """From the ledger, the searches below ``folder``, and some runs that are made again here.

    ``declaration`` is the hash of what was declared of this very plan.
    """
    origin = _origin(plan, ledger, folder, command)
    return put_together(
        plan,
        ledger,
        folder,
        trials,
        declaration=declaration,
        origin=origin,
        proven=stored_proof(folder, plan),
        notes=read_notes(folder),
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
) -> GatheredEvidence:
    """All that follows from the ledger and the searches, around what does not: the last seven."""
    stored, damaged = random_traces(plan, ledger)
    claims, strata = claims_of(plan, ledger, stored), strata_of(plan, ledger)
    searches = searches_of(plan, folder)
    guard = _Guard()
    declared = explain(plan, tuple(declared_counterexamples(plan, ledger)))
    met = [*declared, *searched_counterexamples(plan, searches, folder)]
    examples = numbered(met)
    evidence = Evidence(
        format=FORMAT,
        interrupted=any(next(ledger.missing(k), None) is not None for k in range(len(strata)))
        or any(claim.standing is ClaimStatus.INCOMPLETE for claim in claims),
        plan=_plan(plan, ledger),
        standing=gravest(claim.standing for claim in claims),
        strata=strata,
        overruling=overruling_of(ledger),
        claims=claims,
        system=system_of(plan, ledger.opened),
        assumptions=ASSUMPTIONS,
        exclusions=(*EXCLUSIONS, *ledger.wrists),
        separation=guard.of("the separation of the runs", lambda: tuple(separation_of(plan, stored)), ()),
        calibration=guard.of("the calibration of the runs", lambda: tuple(calibration_of(plan, stored)), ()),
        coverage=coverage_of(ledger),
        counterexamples=tuple(one.shown for one in examples),
        whose_fault=blame(plan, ledger),
        search=search_evidence(searches),
        credibility=believe(stored, trials),
        selftest=trials.selftest,
        selftest_absent="" if trials.selftest else NO_SELFTEST,
        record=Record(rows_sha256=root_of(ledger), declaration_sha256=declaration),
        findings=(),
        provenance=replace(origin, libraries=origin.libraries + _files(stored)),
        files=(),
        proven=proven,
        hazards=hazards_of(plan, ledger),
        notes=notes,
        learned=guard.of("the account of the learned part", lambda: learned_of(plan, ledger, stored), None),
    )
    untried: tuple[str, ...] = guard.of(
        "the list of what no run tried", lambda: tuple(untried_in(plan, stored)), ()
    )
    findings = tuple(findings_of(evidence, ledger, met, searches, [*damaged, *untried, *guard.open]))
    return GatheredEvidence(evidence=replace(evidence, findings=findings), examples=examples)


@dataclass(frozen=True, eq=False)
class _Guard:
    """Around what is made after the runs: what fails is ``open``, and no reason to lose the report."""

    open: list[str] = field(default_factory=list)

    def of(self, what: str, make: Callable[[], T], otherwise: T) -> T:
        """What ``make`` gives; ``otherwise`` if it fails, which is noted down."""
        try:
            return make()
        except Exception as error:  # also of a user's program, whatever it raises
            self.open.append(f"{what} cannot be made: {described(error)}")
            return otherwise


def _files(stored: Sequence[Stored]) -> tuple[tuple[str, str], ...]:
    """The compiled files that the stored runs were made with, and their hashes."""
    files = dict.fromkeys(file for one in stored for file in one.trace.provenance.files)
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
    """The libraries of the declared runs and their versions."""
    prefix = "the library "
    parts = ledger.declared.identity.parts
    return tuple((name.removeprefix(prefix), text) for name, text in parts if name.startswith(prefix))


def sessions_of(ledger: Ledger) -> tuple[str, str, float]:
    """When the first began, on which machines they were, and the seconds spent in runs."""
    sessions = list(ledger.all("SELECT began, machine, workers FROM session ORDER BY id"))
    ((spent_s,),) = ledger.all("SELECT coalesce(sum(seconds), 0.0) FROM episode")
    machines = dict.fromkeys(f"{machine}; {workers} workers" for _, machine, workers in sessions)
    began_at = in_words(datetime.fromisoformat(sessions[0][0])) if sessions else ""
    return began_at, "; ".join(machines), float(spent_s)
