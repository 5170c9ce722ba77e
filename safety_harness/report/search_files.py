"""What a search found, for its page, and for programs as findings.json."""

from __future__ import annotations

import shlex
from dataclasses import asdict
from datetime import UTC, datetime
from math import isfinite
from pathlib import Path

from safety_harness.admission.agreement import measured_agreement
from safety_harness.admission.avoiders import option_of, told_avoider
from safety_harness.cell.simulation.worlds import KINEMATIC, PYBULLET
from safety_harness.claims.properties.against import Against
from safety_harness.claims.properties.answered import fallback_words
from safety_harness.report.decisions import cost_words
from safety_harness.report.search_attribution import SearchAttribution
from safety_harness.report.search_page import SearchEvidence
from safety_harness.scenario.files import told
from safety_harness.scenario.model import Driver
from safety_harness.search.attribution.tally import as_json_of
from safety_harness.search.findings import Findings, Goal, Group
from safety_harness.search.session import NO_REFERENCE, SearchSession, basis_of_search, complaint_of
from safety_harness.search.trials import Trials
from safety_harness.trace.provenance import provenance


def evidence_of(session: SearchSession, attribution: SearchAttribution | None = None) -> SearchEvidence:
    """Everything that the page shows."""
    trials = session.trials
    tested = trials.avoider or trials.space.simplest.under_test
    cost = cost_words(trials.space.simplest.settings.avoidance.decision_time, trials.declared_s)
    faults = None if attribution is None else attribution.of_search(session)
    each = {} if attribution is None else attribution.found
    return SearchEvidence(
        title=trials.space.title,
        space=trials.space.name,
        tested=f"{option_of(tested).removeprefix('--')} {tested}",
        computing_time="; ".join(filter(None, (cost, trials.times.words))),
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
        overruled=session.overruled,
        causes={} if attribution is None else attribution.causes(session),
        coverage=trials.coverage,
        violations=trials.violations,
        shown=tuple(session.written),
        confirmed=session.confirmed,
        unconfirmed=tuple(session.unconfirmed),
        not_found=tuple(session.not_found),
        faults=faults,
        attributed={
            shown.path.name: each[shown.path.stem] for shown in session.written if shown.path.stem in each
        },
        nearest_hand_m=trials.nearest_hand_m,
        agreement=measured_agreement(),
        system=trials.system,
        provenance=provenance(
            KINEMATIC.name + (f", confirmed in {PYBULLET.name}" if session.reference else ""),
            PYBULLET.libraries if session.reference else (),
        ),
        unconfirmable="" if session.reference else NO_REFERENCE,
    )


def fuzz_command(session: SearchSession) -> str:
    """Return the command line that makes all of this again."""
    trials = session.trials
    file = trials.space.file or Path(f"{trials.space.name}.yaml")
    command = ["safety-harness", "fuzz", str(told(file))]
    command += ["--searcher", session.findings.searcher, "--budget", str(session.budget)]
    command += ["--seed", str(trials.seed), "--out", str(told(session.out))]
    command += [] if trials.avoider is None else [option_of(trials.avoider), told_avoider(trials.avoider)]
    command += [] if trials.reference is None else ["--against", trials.reference.name]
    command += [word for sentence in trials.sentences for word in ("--claim", sentence)]
    return shlex.join(command + ["--baseline"] * (session.baseline is not None))


def as_json(trials: Trials, evidence: SearchEvidence) -> dict[str, object]:
    """Counts, the nearest margins, distinct violations with their points, and the coverage; SI throughout."""
    findings, baseline = evidence.findings, evidence.baseline
    return {
        "space": evidence.space,
        "basis": basis_of_search(findings, evidence.confirmed),
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
        "confirmed_in_pybullet": evidence.confirmed,
        "not_confirmed_in_pybullet": [_of_group(trials, one.group) for one in evidence.unconfirmed],
        "counterexamples": [shown.path.name for shown in evidence.shown],
        "flips_near_the_limit": list(evidence.flips),
        "more_overruled_than_the_reference": evidence.overruled,
        "causes": evidence.causes,
        "attribution_of_counterexamples": {
            name: as_json_of(one) for name, one in evidence.attributed.items()
        },
        "attribution": None if evidence.faults is None else evidence.faults.as_json(),
        "coverage": {str(cell): count for cell, count in sorted(trials.coverage.counts.items())},
        "violations_by_cell": {str(cell): count for cell, count in sorted(trials.violations.counts.items())},
    }


def _held(against: Against) -> dict[str, object]:
    """The summary alone: the runs are too many."""
    return {key: value for key, value in against.as_json().items() if key != "runs"}


def _leads(goal: Goal, margin: float) -> bool:
    """Is it no margin, but what led to a difference that was not found?"""
    return bool(goal.against) and margin >= 0.0


def _of_claims(findings: Findings) -> list[dict[str, object]]:
    return [
        {
            "sentence": goal.sentence,
            "with_a_verdict": int(findings.evidence[k]),
            "violated": int(findings.violated[k]),
            "first_violation_after": int(findings.first_violation[k]) or None,
            "least_margin_si": None
            if near is None or _leads(goal, near.margins[k])
            else float(near.margins[k]),
            "least_margins_so_far_si": [one for one in findings.improvements[k] if not _leads(goal, one[1])],
        }
        for k, (goal, near) in enumerate(zip(findings.goals, findings.nearest, strict=True))
    ]


def _file_of(group: Group, evidence: SearchEvidence) -> str | None:
    """The counterexample that it shrank to; None for what was not shrunk, or not confirmed."""
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
