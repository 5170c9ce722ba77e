"""Compute the results of a report from its ledger: the bounds of each claim and the counts of each stratum.

For each claim in each stratum, the report has an interval with two ends. The error is divided among all these
ends, whose number ``ends_of`` returns. Therefore all ends hold simultaneously with the plan's confidence. The
status *shown* depends on the upper ends, and the status *refuted* on the lower ends. The bounds of margins
come from order statistics and use no part of this error. Each of these bounds holds by itself, with the
confidence of one interval.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from safety_harness.admission.claims import property_of
from safety_harness.base.exceptions import StatisticsError, described
from safety_harness.base.proportions import LEVEL
from safety_harness.claims.properties.answered import is_claimed
from safety_harness.claims.properties.catalogue import entry_claimed
from safety_harness.extensions.assurance.campaign.episodes import random_episodes
from safety_harness.extensions.assurance.campaign.ledger import Ledger
from safety_harness.extensions.assurance.campaign.overruled import overruled_episodes, overruling_in
from safety_harness.extensions.assurance.campaign.pilot import aim_of
from safety_harness.extensions.assurance.campaign.plan import Plan, PlannedClaim
from safety_harness.extensions.assurance.campaign.summary import fallback_of
from safety_harness.extensions.assurance.certification.evidence import (
    UNANSWERED,
    UNMADE,
    Bound,
    ClaimEvidence,
    ClaimResult,
    ClaimStatus,
    OverrulingResult,
    Quantile,
    StratumResult,
)
from safety_harness.extensions.assurance.certification.standards import traced
from safety_harness.extensions.assurance.certification.stored import Stored, came_nearest
from safety_harness.extensions.assurance.certification.verdicts import doubt_of, overall, standing_of
from safety_harness.extensions.assurance.statistics.binomial import (
    Sides,
    bounds_of,
    ends_of,
    violation_bounds,
)
from safety_harness.extensions.assurance.statistics.distances import tolerance_bound
from safety_harness.extensions.assurance.statistics.planning import refuse_if_impossible
from safety_harness.extensions.assurance.statistics.sample import EpisodeOutcome as Code
from safety_harness.extensions.assurance.statistics.sample import Floats, IndependentSample

CONTENTS = (0.9, 0.99, 0.999)  # shares of runs whose margin is bounded from below
MOST_POINTS = 240  # points of a curve


def refuse_hopeless(plan: Plan) -> None:
    """Raise InputError if the plan's runs cannot show a target.

    The error states the required number of runs.
    """
    for claim in plan.claims:
        if claim.target is not None:
            for stratum in plan.strata:
                refuse_if_impossible(aim_of(plan, claim.target), stratum.runs, place=claim.claim.place)


def bounds(plan: Plan) -> int:
    """Return the number of bounds in a report of ``plan``."""
    return ends_of(len(plan.claims), len(plan.strata))


def claims_of(plan: Plan, ledger: Ledger, stored: Sequence[Stored] = ()) -> tuple[ClaimEvidence, ...]:
    """Return every claim of ``plan`` with its results.

    Args:
        plan: The plan.
        ledger: The open ledger, complete or not.
        stored: The stored random runs, which explain why no run tested a claim.

    """
    return tuple(_claim(plan, ledger, stored, place, claim) for place, claim in enumerate(plan.claims))


def _claim(
    plan: Plan, ledger: Ledger, stored: Sequence[Stored], place: int, claim: PlannedClaim
) -> ClaimEvidence:
    """Return the evidence on ``claim``, whose position in the plan is ``place`` (from 0)."""
    entry, _ = entry_claimed(claim.sentence) or (None, None)
    tracing = traced(entry)
    prop = property_of(claim.claim, plan.strata[0].space.simplest)
    outcomes = tuple(_outcome(plan, ledger, stored, stratum, place) for stratum in range(len(plan.strata)))
    standing, why = overall(outcomes)
    return ClaimEvidence(
        number=place + 1,
        sentence=claim.sentence,
        target=claim.target,
        hazard=claim.hazard or tracing.hazard,
        hazard_is_authors=bool(claim.hazard),
        terms=tracing.terms,
        rationale=_sentence(entry.rationale if entry else f"A formula of its author's: {prop.sentence}"),
        exercised_when="" if entry is None else entry.exercised,
        unit=prop.unit.symbol,
        per_si=prop.unit.per_si,
        standing=standing,
        why=why,
        outcomes=outcomes,
    )


def _sentence(text: str) -> str:
    """Return ``text`` with a capital letter and a full stop."""
    return text[0].upper() + text[1:].rstrip(".") + "."


def _outcome(plan: Plan, ledger: Ledger, stored: Sequence[Stored], place: int, claim: int) -> ClaimResult:
    """Return the result of claim number ``claim`` in stratum number ``place``."""
    stratum, planned = plan.strata[place], plan.claims[claim]
    bound: Bound | None = None
    quantiles: tuple[Quantile, ...] = ()
    problem = ""
    try:
        sample = ledger.sample(stratum.name, planned.sentence)
    except StatisticsError as error:  # episodes are still missing, or rows contradict themselves
        problem = str(error)
        _, codes, margins = ledger.outcomes(place, claim)
    else:
        codes, margins, bound = sample.outcomes, sample.margins, _bound(sample, plan)
        quantiles = _quantiles(sample, bound.confidence) if bound else ()
    counts = {code: int(np.count_nonzero(codes == code)) for code in Code}
    without = counts[Code.INCONCLUSIVE] + counts[Code.FAILED]
    fallback, claimed = fallback_of(ledger, place), is_claimed(item.claim for item in plan.claims)
    standing, why = standing_of(
        target=planned.target,
        bound=bound,
        runs=len(codes),
        planned=stratum.runs,
        tested=len(codes) - counts[Code.UNTESTED],
        violated=counts[Code.VIOLATED],
        without_verdict=without,
        may_stop_early=plan.stop_early and not problem,
        problem=problem,
        world=plan.world,
        dependent=ledger.dependent,
        fallback=fallback.summary,
        doubt=doubt_of(fallback, overruling_in(ledger, place), ledger.times(place), claimed=claimed),
    )
    if standing is ClaimStatus.UNTESTED:
        try:
            why += f"; {came_nearest(plan, stored, place, claim)}"
        except Exception as error:  # a run that is judged again may fail
            why += f"; how near a hand came {UNMADE}: {described(error)}"
    sure = np.isin(codes, (Code.HOLDS, Code.VIOLATED)) & np.isfinite(margins)
    shown, shares = _curve(np.sort(margins[sure]), without)
    return ClaimResult(
        stratum=stratum.name,
        planned=stratum.runs,
        runs=len(codes),
        holds=counts[Code.HOLDS],
        violated=counts[Code.VIOLATED],
        inconclusive=counts[Code.INCONCLUSIVE],
        failed=counts[Code.FAILED],
        untested=counts[Code.UNTESTED],
        bound=bound,
        standing=standing,
        why=why,
        least_margin_si=float(margins[sure].min()) if sure.any() else None,
        margins_si=shown,
        shares=shares,
        quantiles=quantiles,
    )


def _bound(sample: IndependentSample, plan: Plan) -> Bound | None:
    """Return the bound from ``sample``, or None if there is no trial.

    The plan's error is divided among all bounds of ``plan``.
    """
    (raw,) = bounds_of([sample], plan.confidence, Sides.BOTH, family=bounds(plan))
    if not raw.trials:
        return None
    return Bound(lower=raw.low, upper=raw.high, confidence=raw.confidence, method=raw.method.value)


def _curve(margins: Floats, without: int) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Return ascending margins and, for each margin, the fraction of runs whose margin is not larger.

    A run without a verdict is treated as if it had the least margin. The function keeps at most
    ``MOST_POINTS`` margins, most of which are near the least margin.
    """
    n = len(margins)
    if n == 0:
        return (), ()
    few = np.arange(min(n, MOST_POINTS // 2))
    rest = np.geomspace(max(len(few), 1), n, MOST_POINTS // 2).astype(np.int64) - 1
    kept = np.unique(np.concatenate([few, rest, [n - 1]]))
    shares = (kept + 1 + without) / (n + without)
    return tuple(margins[kept].tolist()), tuple(shares.tolist())


def _quantiles(sample: IndependentSample, confidence: float) -> tuple[Quantile, ...]:
    """Return the margins that certain fractions of the runs keep.

    The result is empty if the plan may stop early.
    """
    if sample.declaration.stop_early:
        return ()
    limits = (tolerance_bound(sample, content, confidence) for content in CONTENTS)
    return tuple(
        Quantile(share=row.content, at_least_si=row.at_least) for row in limits if np.isfinite(row.at_least)
    )


_DECISIONS = ("proposed positions", "opposite poses", "protective stops", UNANSWERED)
_SUMS = (
    "SELECT count(*), coalesce(sum(draws - 1), 0), coalesce(sum(proposed), 0), coalesce(sum(opposite), 0), "
    "coalesce(sum(stopped), 0), coalesce(sum(faults), 0), coalesce(sum(failure IS NOT NULL), 0) "
    "FROM episode WHERE stratum = ?"
)


def strata_of(plan: Plan, ledger: Ledger) -> tuple[StratumResult, ...]:
    """Return the results that ``ledger`` has for each stratum of ``plan``."""
    hashes = {file.name: file.sha256 for file in ledger.files}
    return tuple(_stratum(plan, ledger, place, hashes) for place in range(len(plan.strata)))


def _stratum(plan: Plan, ledger: Ledger, place: int, hashes: dict[str, str]) -> StratumResult:
    """Return the results of stratum number ``place``.

    ``hashes`` maps the name of each file in the ledger to its hash.
    """
    stratum = plan.strata[place]
    ((made, again, *counts, failed),) = ledger.all(_SUMS, place)
    stored = {episode: violation for where, episode, violation in ledger.traces() if where == place}
    random = random_episodes(plan, place) & stored.keys()
    file = stratum.space.file
    name = "" if file is None else next((key for key in hashes if key.endswith(f"/{file.name}")), file.name)
    return StratumResult(
        name=stratum.name,
        space=name or stratum.space.name,
        about=stratum.space.name.replace("-", " "),
        space_sha256=hashes.get(name, ""),
        planned=stratum.runs,
        made=int(made),
        failed=int(failed),
        refused_draws=int(again),
        decisions=tuple((kind, int(many)) for kind, many in zip(_DECISIONS, counts, strict=True) if many),
        random_traces=len(random),
        violation_traces=sum(stored.values()),
    )


def overruling_of(ledger: Ledger) -> tuple[OverrulingResult, ...]:
    """Return how often the gate overruled the avoider in each stratum of ``ledger``.

    Each fraction has its own interval.
    """
    return tuple(_overruling(ledger, place, name) for place, name in enumerate(ledger.declared.strata))


def _overruling(ledger: Ledger, place: int, stratum: str) -> OverrulingResult:
    """Return how often the gate overruled the avoider in stratum number ``place``."""
    whole, bound = overruling_in(ledger, place), None
    some = (
        "SELECT count(*), coalesce(sum(overruled > 0), 0) FROM episodes WHERE stratum = ? AND proposals > 0"
    )
    ((runs, overruled),) = ledger.all(some, stratum)
    try:
        raw = violation_bounds(overruled_episodes(ledger, place), LEVEL, Sides.BOTH)
        if raw.trials and not ledger.dependent:
            bound = Bound(lower=raw.low, upper=raw.high, confidence=raw.confidence, method=raw.method.value)
    except StatisticsError:  # episodes are still missing
        pass
    return OverrulingResult(
        stratum=stratum,
        proposals=whole.proposals,
        overruled=whole.overruled,
        words=whole.summary,
        runs=int(runs),
        runs_overruled=int(overruled),
        bound=bound,
    )
