"""``findings.json``: everything that a search found, for programs."""

from __future__ import annotations

from safety_harness.report.search_page import SearchEvidence
from safety_harness.search.confirm import Complaint
from safety_harness.search.findings import Findings, Group
from safety_harness.search.outcomes import RUN_FAILED
from safety_harness.search.trials import Trials


def complaint_of(trials: Trials, group: Group) -> Complaint:
    """What a group of violations or mishaps is about: a claim, what the avoider did, or why a run failed."""
    if group.claim is not None:
        return Complaint(trials.claims[group.claim])
    return Complaint(None if group.kind.startswith(RUN_FAILED) else trials.answered, group.kind)


def as_json(trials: Trials, evidence: SearchEvidence) -> dict[str, object]:
    """Counts, the nearest margins, distinct violations with their points, and the coverage; SI throughout."""
    findings, baseline = evidence.findings, evidence.baseline
    return {
        "space": evidence.space,
        "avoider": trials.avoider,
        "computing time": evidence.computing_time,
        "searcher": findings.searcher,
        "seed": evidence.seed,
        "budget": evidence.budget,
        "tried": findings.tried,
        "refused": dict(findings.refused.most_common()),
        "interrupted": findings.interrupted,
        "decisions": trials.decisions,
        "unanswered": trials.unanswered,
        "claims": _of_claims(findings),
        "baseline": None
        if baseline is None
        else {"searcher": baseline.searcher, "tried": baseline.tried, "claims": _of_claims(baseline)},
        "distinct": [
            _of_group(trials, group) | {"counterexample": _file_of(group, evidence)}
            for group in findings.groups
        ],
        "confirmed in PyBullet": evidence.confirmed,
        "not confirmed in PyBullet": [_of_group(trials, one.group) for one in evidence.unconfirmed],
        "counterexamples": [shown.file for shown in evidence.shown],
        "coverage": {str(cell): count for cell, count in sorted(trials.coverage.counts.items())},
        "violations by cell": {str(cell): count for cell, count in sorted(trials.violations.counts.items())},
    }


def _of_claims(findings: Findings) -> list[dict[str, object]]:
    return [
        {
            "sentence": goal.sentence,
            "with a verdict": int(findings.evidence[k]),
            "violated": int(findings.violated[k]),
            "first violation after": int(findings.first_violation[k]) or None,
            "least margin": None if near is None else float(near.margins[k]),
            "least margins so far": findings.improvements[k],
        }
        for k, (goal, near) in enumerate(zip(findings.goals, findings.nearest, strict=True))
    ]


def _file_of(group: Group, evidence: SearchEvidence) -> str | None:
    """The counterexample that it shrank to; None for what was not shrunk, or not confirmed."""
    return next((shown.file for shown in evidence.shown if group in shown.groups), None)


def _of_group(trials: Trials, group: Group) -> dict[str, object]:
    return {
        "complaint": complaint_of(trials, group).sentence,
        "kind": group.kind,
        "runs": group.count,
        "worst margin": None if group.claim is None else group.worst_margin(),
        "worst point": group.worst.point.tolist(),
        "number": group.worst.number,
    }
