"""Tables of the plan's verdicts, hazards, hazard rates, results by stratum and overruled proposals."""

from __future__ import annotations

import math

from safety_harness.claims.properties.base import shown_margin, shown_unit
from safety_harness.extensions.assurance.campaign.risk_graph import band_of
from safety_harness.extensions.assurance.certification.evidence import (
    ClaimEvidence,
    ClaimResult,
    ClaimStatus,
    Evidence,
    HazardEvidence,
    HourlyBound,
    OverrulingResult,
    by_severity,
)
from safety_harness.extensions.assurance.certification.table_cells import (
    DASH,
    CellTable,
    TableCell,
    count,
    number,
    standing,
    table_of,
    text_cell,
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
    """Return ``margin_si`` (SI) with its sign and in the claim's unit, or a dash if it is None."""
    if margin_si is None:
        return DASH
    return with_minus(shown_margin(margin_si * claim.per_si, claim.unit))


def at_least_words(margin_si: float, claim: ClaimEvidence) -> str:
    """Return ``margin_si`` in the claim's unit, rounded down.

    The value is in SI and is a lower limit of a margin.
    """
    shown, unit = shown_unit(margin_si * claim.per_si, claim.unit)
    digit = 0.1 if abs(shown) >= 1.0 else 10.0 ** (math.floor(math.log10(max(abs(shown), 1e-300))) - 2)
    return with_minus(shown_margin(math.floor(shown / digit + 1e-9) * digit, unit))


def verdicts(evidence: Evidence) -> CellTable:
    """Return the table on the first page: each claim with its verdict, bound, number of tests, and hazard."""
    return table_of(
        "All claims, the gravest first, with the largest upper bound of all strata and the sums of their "
        "counts. Each number links to its rows. The report claims no performance level.",
        by_severity(evidence.claims),
        {
            "Claim": lambda row: text_cell(
                row.sentence, href=f"claim-{row.number}", row=f"claim-row-{row.number}"
            ),
            "Verdict": lambda row: standing(row.standing),
            "Violated at most": _upper,
            "Target": lambda row: number(DASH if row.target is None else percent(row.target), row.target),
            "Put to the test": _tested,
            "Without verdict": lambda row: count(
                sum(o.inconclusive + o.failed for o in row.outcomes), _row(row, 0)
            ),
            "Hazard": lambda row: text_cell(
                row.hazard, note="in the plan's own words" if row.hazard_is_authors else ""
            ),
        },
    )


def _row(claim: ClaimEvidence, stratum: int) -> str:
    """Return the id of the row for a claim and a stratum in the table of results."""
    return f"row-{claim.number}-{stratum + 1}"


def _upper(claim: ClaimEvidence) -> TableCell:
    """Return a cell with the largest upper bound of ``claim`` over the strata."""
    uppers = [outcome.bound.upper for outcome in claim.outcomes if outcome.bound is not None]
    if not uppers or len(uppers) < len(claim.outcomes):
        return number("not bounded")
    return number(at_most(max(uppers)), max(uppers), _row(claim, uppers.index(max(uppers))))


def _tested(claim: ClaimEvidence) -> TableCell:
    """Return a cell with the number of runs that test ``claim``."""
    tested = sum(outcome.tested for outcome in claim.outcomes)
    runs = sum(outcome.runs for outcome in claim.outcomes)
    return number(f"{tested} of {runs} runs", tested, _row(claim, 0) if runs else "")


def hazards(evidence: Evidence) -> CellTable:
    """Return the table of the plan's hazards, with the steps of the risk graph to the required rates."""
    return table_of(
        "The plan's hazards in its author's words, with the steps to the required rates.",
        evidence.hazards,
        {
            "Hazard": lambda row: text_cell(row.name, note=row.event),
            "Where": lambda row: text_cell(f"{row.task}; {row.zone}", note=row.body_region),
            "Step by step": lambda row: text_cell("; ".join(row.steps)),
            "Decided by": lambda row: text_cell(row.decided_by, note=row.because),
            "Claims": lambda row: text_cell(", ".join(map(str, row.claims)) or "none"),
        },
    )


def rates(evidence: Evidence) -> CellTable:
    """Return the table of the hourly bounds of all claims.

    A hazard appears in the table if it has a rate of approaches.
    """

    def asked_cell(row: HazardEvidence) -> TableCell:
        return number(DASH if row.asked_an_hour is None else f"{row.asked_an_hour:g}", row.asked_an_hour)

    def verdict(row: tuple[HazardEvidence, HourlyBound]) -> TableCell:
        limit = row[0].asked_an_hour
        if limit is None:
            return text_cell("no limit")
        if row[1].an_hour > limit:
            return TableCell(text="not shown", state="inconclusive")
        alone = ", in the model alone" if evidence.plan.model_only else ""
        if (
            next(claim for claim in evidence.claims if claim.number == row[1].claim).standing
            is ClaimStatus.UNTESTED
        ):
            alone += ", and never put to the test"
        return TableCell(text=f"at or below{alone}", state="none")

    return table_of(
        "Upper bounds of violations an hour. Each is the product of two upper bounds: approaches an hour, "
        "and violation probability per run.",
        [(row, rate) for row in evidence.hazards for rate in row.rates],
        {
            "Hazard": lambda row: text_cell(row[0].name),
            "Claim": lambda row: text_cell(str(row[1].claim)),
            "Approaches an hour": lambda row: number(
                hourly(row[0].approaches_an_hour or 0.0), row[0].approaches_an_hour
            ),
            "Known from": lambda row: text_cell(row[0].approaches),
            "In a run": lambda row: text_cell(at_most(row[1].per_run), note=row[1].stratum),
            "An hour": lambda row: number(hourly(row[1].an_hour), row[1].an_hour),
            "Limit": lambda row: asked_cell(row[0]),
            "Against the limit": verdict,
            "Beside PFH_D": lambda row: text_cell(band_of(row[1].an_hour)),
        },
    )


def results(evidence: Evidence) -> CellTable:
    """Return the table with a row for each claim in each stratum.

    The claim with the most severe status comes first.
    """
    known = confidence_alone(evidence)
    rows = [(row, k, part) for row in by_severity(evidence.claims) for k, part in enumerate(row.outcomes)]
    return table_of(
        "Trials are runs that exercise the claim. Runs without a verdict and runs that could not run count "
        "as violations in the upper bound only."
        + (f" Each interval holds with {known} confidence alone." if known else ""),
        rows,
        {
            "Claim": lambda row: text_cell(row[0].sentence, row=_row(row[0], row[1])),
            "Stratum": lambda row: text_cell(row[2].stratum),
            "Verdict": lambda row: standing(row[2].standing),
            "Runs": lambda row: count(row[2].runs),
            "Trials": lambda row: count(row[2].tested),
            "Violated": lambda row: count(row[2].violated, f"claim-{row[0].number}"),
            "No verdict": lambda row: count(row[2].inconclusive),
            "Could not run": lambda row: count(row[2].failed),
            "Bounds": lambda row: _bounds(row[2]),
            "Least margin": lambda row: number(
                margin_words(row[2].least_margin_si, row[0]), row[2].least_margin_si
            ),
        },
    )


def confidence_alone(evidence: Evidence) -> str:
    """Return the confidence with which each interval holds by itself.

    The error is divided equally among all intervals.
    """
    bounds = (outcome.bound for claim in evidence.claims for outcome in claim.outcomes)
    return next((confidence_words(bound.confidence) for bound in bounds if bound), "")


def _bounds(outcome: ClaimResult | OverrulingResult) -> TableCell:
    """Return a cell with both ends of a bound."""
    if outcome.bound is None:
        return number("none")
    return number(f"{at_least(outcome.bound.lower)} to {at_most(outcome.bound.upper)}", outcome.bound.upper)


def quantiles(claim: ClaimEvidence) -> CellTable:
    """Return the table of the margins of ``claim`` that most runs reach or exceed."""
    return table_of(
        "Margins that most runs keep.",
        [(outcome.stratum, quantile) for outcome in claim.outcomes for quantile in outcome.quantiles],
        {
            "Stratum": lambda row: text_cell(row[0]),
            "Share of runs": lambda row: number(percent(row[1].share), row[1].share),
            "Margin of at least": lambda row: number(
                at_least_words(row[1].at_least_si, claim), row[1].at_least_si
            ),
        },
    )


def strata(evidence: Evidence) -> CellTable:
    """Return the table of the operational domain, with a row for each stratum."""
    return table_of(
        "Each run draws from its space with its own seed. If a draw cannot run (for example, its start is "
        "out of reach), a new draw replaces it. The table counts refused draws."
        + "".join(f" {row[0].upper()}{row[1:]}." for row in evidence.shields),
        evidence.strata,
        {
            "Stratum": lambda row: text_cell(row.name, note=row.about),
            "Space": lambda row: text_cell(row.space, note=f"sha256 {row.space_sha256[:12]}\u2026"),
            "Runs made": lambda row: count(row.made),
            "Planned": lambda row: count(row.planned),
            "Could not run": lambda row: count(row.failed),
            "Draws refused": lambda row: count(row.refused_draws),
            "Decisions": lambda row: text_cell(
                ", ".join(f"{how_many} {kind}" for kind, how_many in row.decisions) or "none recorded"
            ),
            "Stored traces": lambda row: text_cell(
                f"{row.random_traces} at random, {row.violation_traces} of violations"
            ),
        },
    )


def overruling(evidence: Evidence) -> CellTable:
    """Return the table of how often the gate overruled the avoider."""
    return table_of(
        "Overruled proposals, and the share of runs with an overruled proposal among the runs with a "
        "proposal. The gate may have several reasons to overrule a proposal. Each interval has 95 % "
        "confidence alone, and is not among the bounds that hold together. Runs that could not run count as "
        "overruled in the upper end only.",
        evidence.overruling,
        {
            "Stratum": lambda row: text_cell(row.stratum),
            "Proposals": lambda row: text_cell(row.words or "none"),
            "Runs with a proposal": lambda row: count(row.runs),
            "Runs with one overruled": lambda row: count(row.runs_overruled),
            "Share of runs": _bounds,
        },
    )
