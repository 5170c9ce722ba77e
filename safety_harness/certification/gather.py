"""A plan's ledger, searches and measurements put together into the evidence."""

from __future__ import annotations

import os
import platform
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

from safety_harness.campaign.ledger import Ledger
from safety_harness.campaign.plan import Plan, PlannedWorld
from safety_harness.certification.counterexamples import (
    MOST,
    declared_counterexamples,
    kinds_without_trace,
    numbered,
    search_evidence,
    search_results,
    searched_counterexamples,
)
from safety_harness.certification.credibility import credibility_of
from safety_harness.certification.evidence import (
    FORMAT,
    ClaimEvidence,
    CounterexampleEvidence,
    Evidence,
    Finding,
    Standing,
    Stratum,
)
from safety_harness.certification.evidence import Plan as PlanEvidence
from safety_harness.certification.evidence import Provenance as Origin
from safety_harness.certification.results import bounds, claims_of, strata_of
from safety_harness.certification.standards import ASSUMPTIONS, EXCLUSIONS
from safety_harness.certification.stored import calibration_of, coverage_of, readable, separation_of
from safety_harness.certification.system import system_of
from safety_harness.certification.tools import Credibility, Oracle, SelfTest
from safety_harness.certification.verdicts import gravest
from safety_harness.report.evidence import JudgedRun
from safety_harness.report.page_parts import in_words
from safety_harness.trace.provenance import provenance

NO_SELFTEST = (
    "The harness was not put on trial for this report: no table of seeded faults was given (safety-harness "
    "selftest writes one, certify --selftest FILE takes it in)."
)


@dataclass(frozen=True, kw_only=True)
class Trials:
    """What is known of the harness itself, where files of it were given."""

    selftest: SelfTest | None = None
    oracles: tuple[Oracle, ...] = ()
    oracles_with: str = ""


def gather(
    plan: Plan, ledger: Ledger, folder: Path, *, command: str, trials: Trials | None = None
) -> tuple[Evidence, dict[int, JudgedRun]]:
    """The evidence and the runs of its counterexamples; files of these are written below ``folder``."""
    trials = trials or Trials()
    claims, strata = claims_of(plan, ledger), strata_of(plan, ledger)
    stored, damaged = readable(plan, ledger)
    met = [*declared_counterexamples(plan, ledger, folder), *searched_counterexamples(plan, folder)]
    examples, runs = numbered(met)
    credibility = credibility_of(plan, stored, oracles=trials.oracles, oracles_with=trials.oracles_with)
    findings = [
        *_of_claims(claims),
        *_of_strata(ledger, strata),
        *(Finding(text=text, place="strata") for text in damaged),
        *_of_kinds(kinds_without_trace(plan, ledger)),
        *_of_searches(plan, folder, examples),
        *_of_tools(credibility, trials.selftest),
    ]
    interrupted = any(stratum.made < stratum.planned for stratum in strata) and not plan.stop_early
    return (
        Evidence(
            format=FORMAT,
            interrupted=interrupted or any(claim.standing is Standing.INCOMPLETE for claim in claims),
            plan=_plan(plan, ledger),
            standing=gravest(claim.standing for claim in claims),
            strata=strata,
            claims=claims,
            system=system_of(plan),
            assumptions=ASSUMPTIONS,
            exclusions=EXCLUSIONS,
            separation=separation_of(plan, stored),
            calibration=calibration_of(plan, stored),
            coverage=coverage_of(ledger),
            counterexamples=examples,
            search=search_evidence(plan, folder),
            credibility=credibility,
            selftest=trials.selftest,
            selftest_absent="" if trials.selftest else NO_SELFTEST,
            findings=tuple(findings),
            provenance=_origin(plan, ledger, folder, command),
            files=(),
        ),
        runs,
    )


def _plan(plan: Plan, ledger: Ledger) -> PlanEvidence:
    m = bounds(plan)
    own = ledger.files[0]
    return PlanEvidence(
        name=plan.title,
        about=plan.about,
        file=own.name,
        sha256=plan.sha256,
        text=own.data.decode("utf-8", "replace"),
        world=plan.world.value,
        model_only=plan.world is not PlannedWorld.PYBULLET,
        confidence=plan.confidence,
        per_bound_confidence=1.0 - (1.0 - plan.confidence) / m,
        bounds=m,
        seed=plan.seed,
        stop_early=plan.stop_early,
        search_runs=plan.search_runs,
    )


def _origin(plan: Plan, ledger: Ledger, folder: Path, command: str) -> Origin:
    made = provenance(plan.world.value, "")
    sessions = list(ledger.all("SELECT began, machine, workers FROM session ORDER BY id"))
    ((spent,),) = ledger.all("SELECT coalesce(sum(seconds), 0.0) FROM episode")
    machines = list(dict.fromkeys(f"{machine}; {workers} workers" for _, machine, workers in sessions))
    here = f"{platform.machine()}, {os.cpu_count()} cores"
    return Origin(
        package_version=made.package_version,
        source_hash=made.source_hash,
        python=made.python,
        platform=made.platform,
        machine="; ".join(machines) or here,
        libraries=made.libraries,
        command=command,
        commands=(
            command,
            f"safety-harness verify {folder.name}",
            f"safety-harness campaign status {folder.name}/{ledger.path.name}",
        ),
        began_at=in_words(datetime.fromisoformat(sessions[0][0])) if sessions else "",
        ended_at=in_words(datetime.now(UTC)),
        run_seconds_s=float(spent),
        changes=(),
    )


_PLAIN = {
    Standing.REFUTED: "is refuted",
    Standing.UNTESTED: "was never put to the test",
    Standing.INCOMPLETE: "has runs missing",
    Standing.NOT_SHOWN: "is not shown",
    Standing.DOUBTED: "is shown with doubt only",
    Standing.ESTIMATED: "is estimated only: the plan sets no target",
}


def _of_claims(claims: tuple[ClaimEvidence, ...]) -> list[Finding]:
    return [
        Finding(text=f"{claim.sentence} {_PLAIN[claim.standing]}: {claim.why}", place=f"claim-{claim.number}")
        for claim in claims
        if claim.standing in _PLAIN
    ]


def _of_strata(ledger: Ledger, strata: tuple[Stratum, ...]) -> list[Finding]:
    found = []
    for place, stratum in enumerate(strata):
        if stratum.failed:
            reasons = ledger.all(
                "SELECT failure, count(*) FROM episode WHERE stratum = ? AND failure IS NOT NULL "
                "GROUP BY failure ORDER BY 2 DESC LIMIT 1",
                place,
            )
            most = next((f", most often: {reason}" for reason, _ in reasons), "")
            text = f"{stratum.name}: {stratum.failed} of {stratum.made} runs could not be carried on{most}"
            found.append(Finding(text=text, place="strata"))
        faults = dict(stratum.decisions).get("decision faults", 0)
        if faults:
            text = f"{stratum.name}: the avoider gave no usable answer to {faults} questions"
            found.append(Finding(text=text, place="strata"))
    return found


def _of_kinds(untraced: int) -> list[Finding]:
    text = f"{untraced} kinds of violation have no kept trace, and are counted only: keep more violations"
    return [Finding(text=text, place="counterexamples")] if untraced else []


def _of_searches(plan: Plan, folder: Path, examples: tuple[CounterexampleEvidence, ...]) -> list[Finding]:
    place, found = "counterexamples", []
    if plan.search_runs and not any(True for _ in search_results(plan, folder)):
        found.append(Finding(text="the search that the plan asks for was not made", place=place))
    for stratum, result in search_results(plan, folder):
        unconfirmed = len(result.get("not confirmed in PyBullet", []))
        if unconfirmed:
            text = f"{stratum}: {unconfirmed} findings of the search were not confirmed in PyBullet"
            found.append(Finding(text=text, place=place))
        if result.get("interrupted"):
            found.append(Finding(text=f"{stratum}: the search was interrupted", place=place))
    searched = [one for one in examples if not one.independent]
    if searched:
        text = f"the search found {len(searched)} counterexamples that the declared runs are no measure of"
        found.append(Finding(text=text, place=place))
    if len(examples) > MOST:
        text = f"{len(examples) - MOST} of {len(examples)} counterexamples have files but no pictures here"
        found.append(Finding(text=text, place=place))
    return found


def _of_tools(credibility: Credibility, selftest: SelfTest | None) -> list[Finding]:
    found = []
    agreement = credibility.agreement
    if agreement is None or not agreement.present:
        text = "the agreement of the two worlds was not measured with this source"
        found.append(Finding(text=text, place="credibility"))
    if agreement is not None and agreement.optimistic:
        text = f"{agreement.optimistic} optimistic disagreements of the kinematic world with PyBullet"
        found.append(Finding(text=text, place="agreement"))
    for rerun in credibility.reruns:
        if rerun.changed:
            text = f"{rerun.title}: {rerun.changed} of {rerun.verdicts} verdicts change"
            found.append(Finding(text=text, place=rerun.place))
    if selftest is None:
        found.append(Finding(text="nothing is said of how well the harness notices faults", place="tools"))
    else:
        for fault in selftest.faults:
            if not fault.caught_by:
                found.append(Finding(text=f"the seeded fault {fault.name!r} survived", place="tools"))
    return found
