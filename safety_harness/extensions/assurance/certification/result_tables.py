"""Tables of what came of the plan: verdicts, hazards with their rates, results by stratum, overruling."""

from __future__ import annotations

import math

from safety_harness.claims.properties.base import shown_margin
from safety_harness.extensions.assurance.campaign.risk_graph import band_of
from safety_harness.extensions.assurance.certification.evidence import (
    ClaimEvidence,
    ClaimResult,
    ClaimStatus,
    Evidence,
    HazardEvidence,
    HourlyBound,
    OverrulingResult,
    by_gravity,
)
from safety_harness.extensions.assurance.certification.table_cells import (
    DASH,
    CellTable,
    TableCell,
    count,
    number,
    standing,
    table_of,
    words,
)
from safety_harness.extensions.assurance.certification.verdicts import (
    at_least,
    at_most,
    confidence_words,
    hourly,
    percent,
)
from safety_harness.report.words import with_minus


def margin_words(margin_si: float | None, claim: ClaimEvidence) -> str:
    """A margin with its sign, in the claim's unit."""
    if margin_si is None:
        return DASH
    return with_minus(shown_margin(margin_si * claim.per_si, claim.unit))


def at_least_words(margin_si: float, claim: ClaimEvidence) -> str:
    """A margin that is kept at least: no digit makes it look larger than it is."""
    shown = margin_si * claim.per_si
    digit = 0.1 if abs(shown) >= 1.0 else 10.0 ** (math.floor(math.log10(max(abs(shown), 1e-300))) - 2)
    return with_minus(shown_margin(math.floor(shown / digit + 1e-9) * digit, claim.unit))


def verdicts(evidence: Evidence) -> CellTable:
    """The first page: every claim with its verdict, bound, how often it was exercised, and its hazard."""
    return table_of(
        "The gravest claim first, over all strata of the plan: the largest upper bound, and the counts of "
        "all strata together; each number leads to its rows. Performance level: none claimed.",
        by_gravity(evidence.claims),
        {
            "Claim": lambda one: words(
                one.sentence, href=f"claim-{one.number}", row=f"claim-row-{one.number}"
            ),
            "Verdict": lambda one: standing(one.standing),
            "May be violated in up to": _upper,
            "Target": lambda one: number(DASH if one.target is None else percent(one.target), one.target),
            "Put to the test": _tested,
            "Without verdict": lambda one: count(
                sum(o.inconclusive + o.failed for o in one.outcomes), _row(one, 0)
            ),
            "Hazard": lambda one: words(
                one.hazard, note="in the plan's own words" if one.hazard_is_authors else ""
            ),
        },
    )


def _row(claim: ClaimEvidence, stratum: int) -> str:
    """The id of a claim's row of a stratum among the results."""
    return f"row-{claim.number}-{stratum + 1}"


def _upper(claim: ClaimEvidence) -> TableCell:
    uppers = [outcome.bound.upper for outcome in claim.outcomes if outcome.bound is not None]
    if not uppers or len(uppers) < len(claim.outcomes):
        return number("not bounded")
    return number(at_most(max(uppers)), max(uppers), _row(claim, uppers.index(max(uppers))))


def _tested(claim: ClaimEvidence) -> TableCell:
    tested = sum(outcome.tested for outcome in claim.outcomes)
    runs = sum(outcome.runs for outcome in claim.outcomes)
    return number(f"{tested} of {runs} runs", tested, _row(claim, 0) if runs else "")


def hazards(evidence: Evidence) -> CellTable:
    """The plan's hazards, and how the risk graph leads to what is asked."""
    return table_of(
        "The plan's hazards in its author's words, and the steps from them to what is asked.",
        evidence.hazards,
        {
            "Hazard": lambda one: words(one.name, note=one.event),
            "Where": lambda one: words(f"{one.task}; {one.zone}", note=one.body_region),
            "Step by step": lambda one: words("; ".join(one.steps)),
            "Decided by": lambda one: words(one.decided_by, note=one.because),
            "Claims": lambda one: words(", ".join(map(str, one.claims)) or "none"),
        },
    )


def rates(evidence: Evidence) -> CellTable:
    """A bound an hour for each claim under each hazard of which approaches are known."""

    def asked(one: HazardEvidence) -> TableCell:
        return number(DASH if one.asked_an_hour is None else f"{one.asked_an_hour:g}", one.asked_an_hour)

    def verdict(one: tuple[HazardEvidence, HourlyBound]) -> TableCell:
        limit = one[0].asked_an_hour
        if limit is None:
            return words("nothing is asked")
        if one[1].an_hour > limit:
            return TableCell(text="not shown", state="inconclusive")
        alone = ", in the model alone" if evidence.plan.model_only else ""
        if (
            next(claim for claim in evidence.claims if claim.number == one[1].claim).standing
            is ClaimStatus.UNTESTED
        ):
            alone += ", and never put to the test"
        return TableCell(text=f"at or below{alone}", state="none")

    return table_of(
        "Violations an hour, at most: approaches an hour times the bound per run, each at its upper end.",
        [(one, rate) for one in evidence.hazards for rate in one.rates],
        {
            "Hazard": lambda one: words(one[0].name),
            "Claim": lambda one: words(str(one[1].claim)),
            "Approaches an hour": lambda one: number(
                hourly(one[0].approaches_an_hour or 0.0), one[0].approaches_an_hour
            ),
            "Known from": lambda one: words(one[0].approaches),
            "In a run": lambda one: words(at_most(one[1].per_run), note=one[1].stratum),
            "An hour": lambda one: number(hourly(one[1].an_hour), one[1].an_hour),
            "Asked": lambda one: asked(one[0]),
            "Against what is asked": verdict,
            "Beside PFH_D": lambda one: words(band_of(one[1].an_hour)),
        },
    )


def results(evidence: Evidence) -> CellTable:
    """Every claim in every stratum, the gravest claim first."""
    known = confidence_alone(evidence)
    rows = [(one, k, what) for one in by_gravity(evidence.claims) for k, what in enumerate(one.outcomes)]
    return table_of(
        "Trials are the runs that put the claim to the test. The upper bound counts runs without a "
        "verdict and runs that could not be carried on as violations, the lower bound counts none of them."
        + (f" Each interval holds with {known} confidence alone." if known else ""),
        rows,
        {
            "Claim": lambda one: words(one[0].sentence, row=_row(one[0], one[1])),
            "Stratum": lambda one: words(one[2].stratum),
            "Verdict": lambda one: standing(one[2].standing),
            "Runs": lambda one: count(one[2].runs),
            "Trials": lambda one: count(one[2].tested),
            "Violated": lambda one: count(one[2].violated, f"claim-{one[0].number}"),
            "No verdict": lambda one: count(one[2].inconclusive),
            "Could not run": lambda one: count(one[2].failed),
            "Bounds": lambda one: _bounds(one[2]),
            "Least margin": lambda one: number(
                margin_words(one[2].least_margin_si, one[0]), one[2].least_margin_si
            ),
        },
    )


def confidence_alone(evidence: Evidence) -> str:
    """Of each interval alone: the error is shared equally."""
    bounds = (outcome.bound for claim in evidence.claims for outcome in claim.outcomes)
    return next((confidence_words(one.confidence) for one in bounds if one), "")


def _bounds(outcome: ClaimResult | OverrulingResult) -> TableCell:
    if outcome.bound is None:
        return number("none")
    return number(f"{at_least(outcome.bound.lower)} to {at_most(outcome.bound.upper)}", outcome.bound.upper)


def quantiles(claim: ClaimEvidence) -> CellTable:
    """How much at least most runs keep."""
    return table_of(
        "Margins that most runs keep.",
        [(outcome.stratum, quantile) for outcome in claim.outcomes for quantile in outcome.quantiles],
        {
            "Stratum": lambda one: words(one[0]),
            "Share of runs": lambda one: number(percent(one[1].share), one[1].share),
            "Margin of at least": lambda one: number(
                at_least_words(one[1].at_least_si, claim), one[1].at_least_si
            ),
        },
    )


def strata(evidence: Evidence) -> CellTable:
    """The operational domain, part by part."""
    return table_of(
        "Each run draws from its space with a seed of its own; draws that cannot be tried (a start "
        "out of reach, ...) are drawn again and counted."
        + "".join(f" {one[0].upper()}{one[1:]}." for one in evidence.shields),
        evidence.strata,
        {
            "Stratum": lambda one: words(one.name, note=one.about),
            "Space": lambda one: words(one.space, note=f"sha256 {one.space_sha256[:12]}\u2026"),
            "Runs made": lambda one: count(one.made),
            "Planned": lambda one: count(one.planned),
            "Could not run": lambda one: count(one.failed),
            "Draws refused": lambda one: count(one.refused_draws),
            "Decisions": lambda one: words(
                ", ".join(f"{how_many} {what}" for what, how_many in one.decisions) or "none recorded"
            ),
            "Stored traces": lambda one: words(
                f"{one.random_traces} at random, {one.violation_traces} of violations"
            ),
        },
    )


def overruling(evidence: Evidence) -> CellTable:
    """How often the gate did not let the arm do what the avoider proposed."""
    return table_of(
        "What the gate overruled: of all proposals, and of the runs with a proposal those in which at least "
        "one was overruled. A proposal may be overruled for several reasons. Each interval holds with 95 % "
        "confidence alone, and is none of the bounds that hold together; its upper end counts runs that "
        "could not be carried on as overruled, its lower end counts none of them.",
        evidence.overruling,
        {
            "Stratum": lambda one: words(one.stratum),
            "Proposals": lambda one: words(one.words or "none"),
            "Runs with a proposal": lambda one: count(one.runs),
            "Runs with one overruled": lambda one: count(one.runs_overruled),
            "Share of runs": _bounds,
        },
    )
