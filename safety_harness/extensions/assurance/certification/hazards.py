"""The plan's hazards with hourly bounds.

There is a rate of violations for each claim under each hazard. A rate is the product of two upper bounds. The
first bound is for the number of approaches in an hour, and the second bound is for the violation probability
per run. Every approach is treated as a run that tests the claim. The product uses the largest bound per run
of all strata. Therefore the rate holds for every mixture of strata in an hour.
``extensions.assurance.statistics.rates`` explains how the error is divided among the bounds.
"""

from __future__ import annotations

from safety_harness.base.exceptions import StatisticsError
from safety_harness.extensions.assurance.campaign.hazards import Hazard
from safety_harness.extensions.assurance.campaign.ledger import Ledger
from safety_harness.extensions.assurance.campaign.plan import Plan
from safety_harness.extensions.assurance.certification.evidence import HazardEvidence, HourlyBound


def hazards_of(plan: Plan, ledger: Ledger) -> tuple[HazardEvidence, ...]:
    """Return every hazard of ``plan`` with its rates from ``ledger``.

    There are no rates while runs are missing, or if the plan has no rate of approaches.
    """
    rated = {hazard.name for hazard in plan.risks.hazards if hazard.approaches is not None}
    worst = [_worst(plan, ledger, k, rated) for k in range(len(plan.claims))]
    return tuple(_hazard(plan, hazard, worst) for hazard in plan.risks.hazards)


def _worst(plan: Plan, ledger: Ledger, claim: int, rated: set[str]) -> tuple[float, str] | None:
    """Return the largest upper bound of ``claim`` over the strata, and its stratum.

    Return None if there is no bound.
    """
    rated_claims = [item for item in plan.claims if rated & set(item.hazards)]
    if plan.claims[claim] not in rated_claims or ledger.dependent:
        return None
    try:
        samples = [ledger.sample(item.name, plan.claims[claim].sentence) for item in plan.strata]
    except StatisticsError:  # episodes are still missing
        return None
    largest = plan.risks.error.worst_run(samples, len(rated_claims))
    return largest.high, largest.stratum


def _hazard(plan: Plan, hazard: Hazard, worst: list[tuple[float, str] | None]) -> HazardEvidence:
    required, error, known = hazard.derived(plan.risks.graph), plan.risks.error, hazard.approaches
    claims = tuple(k for k, planned in enumerate(plan.claims) if hazard.name in planned.hazards)
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
        steps=required.steps,
        level=required.level,
        asked_an_hour=required.an_hour,
        claims=tuple(claim + 1 for claim in claims),
        approaches="" if known is None else known.summary,
        approaches_an_hour=most,
        rate_confidence=None if most is None else 1.0 - error.of_each_rate,
        rates=tuple(rates),
    )
