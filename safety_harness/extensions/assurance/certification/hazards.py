"""The plan's hazards with what the ledger bounds of them: a rate an hour for each claim under each.

The upper bound of the approaches an hour, times that of a violation in a run.  Every approach counts as a run
that puts the claim to the test, and whatever mixture of the strata an hour's approaches are, the largest
bound per run is no smaller.  ``extensions.assurance.statistics.rates`` has how the error is shared.
"""

from __future__ import annotations

from safety_harness.base.exceptions import StatisticsError
from safety_harness.extensions.assurance.campaign.hazards import Hazard
from safety_harness.extensions.assurance.campaign.ledger import Ledger
from safety_harness.extensions.assurance.campaign.plan import Plan
from safety_harness.extensions.assurance.certification.evidence import HazardEvidence, HourlyBound


def hazards_of(plan: Plan, ledger: Ledger) -> tuple[HazardEvidence, ...]:
    """Every hazard that the plan names; without a rate of approaches, or while runs are missing, no rate."""
    rated = {one.name for one in plan.risks.hazards if one.approaches is not None}
    worst = [_worst(plan, ledger, k, rated) for k in range(len(plan.claims))]
    return tuple(_hazard(plan, one, worst) for one in plan.risks.hazards)


def _worst(plan: Plan, ledger: Ledger, claim: int, rated: set[str]) -> tuple[float, str] | None:
    """The largest upper bound of a claim over the strata, and where; None where there is none."""
    under = [one for one in plan.claims if rated & set(one.hazards)]
    if plan.claims[claim] not in under or ledger.dependent:
        return None
    try:
        samples = [ledger.sample(one.name, plan.claims[claim].sentence) for one in plan.strata]
    except StatisticsError:  # episodes are missing yet
        return None
    found = plan.risks.error.worst_run(samples, len(under))
    return found.high, found.stratum


def _hazard(plan: Plan, hazard: Hazard, worst: list[tuple[float, str] | None]) -> HazardEvidence:
    found, error, known = hazard.derived(plan.risks.graph), plan.risks.error, hazard.approaches
    claims = tuple(k for k, one in enumerate(plan.claims) if hazard.name in one.hazards)
    most = None if known is None else known.most_an_hour(error.of_each_rate)
    rates = []
    for claim in claims:
        if most is not None and (bound := worst[claim]) is not None:
            per_run, stratum = bound
            rates.append(
                HourlyBound(claim=claim + 1, stratum=stratum, per_run=per_run, an_hour=most * per_run)
            )
    return HazardEvidence(
        name=hazard.name,
        task=hazard.task,
        zone=hazard.zone,
        body_region=hazard.body_region,
        event=hazard.event,
        severity=hazard.severity,
        exposure=hazard.exposure,
        avoidance=hazard.avoidance,
        decided_by=hazard.decided_by,
        because=hazard.because,
        steps=found.steps,
        level=found.level,
        asked_an_hour=found.an_hour,
        claims=tuple(claim + 1 for claim in claims),
        approaches="" if known is None else known.words,
        approaches_an_hour=most,
        rate_confidence=None if most is None else 1.0 - error.of_each_rate,
        rates=tuple(rates),
    )
