"""The tables of the evidence report."""

from __future__ import annotations

import math

from safety_harness.certification.cells import DASH, CellTable, TableCell, count, number, standing, words
from safety_harness.certification.evidence import ClaimEvidence, ClaimResult, Evidence
from safety_harness.certification.verdicts import at_least, at_most, confidence_words, percent
from safety_harness.properties.base import shown_margin
from safety_harness.report.words import with_minus
from safety_harness.search.coverage import AXES


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
    """The first page: every claim with its verdict, bound and how often it was exercised."""
    return CellTable(
        caption="One row for each claim over all strata of the plan: the largest upper bound, and the counts "
        "of all strata together; each in full under the claim.",
        head=(
            "Claim",
            "Verdict",
            "May be violated in up to",
            "Target",
            "Put to the test",
            "Without verdict",
            "Why",
        ),
        rows=tuple(_verdict_row(claim) for claim in evidence.claims),
    )


def _verdict_row(claim: ClaimEvidence) -> tuple[TableCell, ...]:
    uppers = [outcome.bound.upper for outcome in claim.outcomes if outcome.bound is not None]
    upper = max(uppers) if uppers and len(uppers) == len(claim.outcomes) else None
    runs = sum(outcome.runs for outcome in claim.outcomes)
    tested = sum(outcome.tested for outcome in claim.outcomes)
    without = sum(outcome.inconclusive + outcome.failed for outcome in claim.outcomes)
    return (
        words(claim.sentence, href=f"claim-{claim.number}"),
        standing(claim.standing),
        number("not bounded" if upper is None else at_most(upper), upper),
        number(DASH if claim.target is None else percent(claim.target), claim.target),
        number(f"{tested} of {runs} runs", tested),
        count(without),
        words(claim.why),
    )


def outcomes(claim: ClaimEvidence) -> CellTable:
    """One claim by stratum."""
    return CellTable(
        caption="Trials are the runs that put the claim to the test. The upper bound counts runs without a "
        "verdict and runs that could not be carried on as violations, the lower bound counts none of them."
        + _alone(claim),
        head=(
            "Stratum",
            "Verdict",
            "Runs",
            "Trials",
            "Violated",
            "No verdict",
            "Could not run",
            "Untested",
            "Bounds",
            "Least margin",
        ),
        rows=tuple(
            (
                words(outcome.stratum),
                standing(outcome.standing),
                count(outcome.runs),
                count(outcome.tested),
                count(outcome.violated),
                count(outcome.inconclusive),
                count(outcome.failed),
                count(outcome.untested),
                _bounds(outcome),
                number(margin_words(outcome.least_margin_si, claim), outcome.least_margin_si),
            )
            for outcome in claim.outcomes
        ),
    )


def _confidence(claim: ClaimEvidence) -> str:
    """Of each interval of the claim alone: the error is shared equally."""
    return next((confidence_words(one.bound.confidence) for one in claim.outcomes if one.bound), "")


def _alone(claim: ClaimEvidence) -> str:
    return f" Each interval holds with {known} confidence alone." if (known := _confidence(claim)) else ""


def _bounds(outcome: ClaimResult) -> TableCell:
    if outcome.bound is None:
        return number("none")
    return number(f"{at_least(outcome.bound.lower)} to {at_most(outcome.bound.upper)}", outcome.bound.upper)


def quantiles(claim: ClaimEvidence) -> CellTable | None:
    """How much at least most runs keep; None where no stratum has any."""
    rows = tuple(
        (
            words(outcome.stratum),
            number(percent(quantile.share), quantile.share),
            number(at_least_words(quantile.at_least_si, claim), quantile.at_least_si),
        )
        for outcome in claim.outcomes
        for quantile in outcome.quantiles
    )
    if not rows:
        return None
    return CellTable(
        caption="At least this share of the runs that test the claim keeps at least this margin (order "
        f"statistics, whatever the distribution). Each line holds with {_confidence(claim)} confidence "
        "alone; none is among the bounds that hold together.",
        head=("Stratum", "Share of runs", "Margin of at least"),
        rows=rows,
    )


def hazards(evidence: Evidence) -> CellTable:
    """What each claim is about, in the terms of the standards."""
    return CellTable(
        caption="Terms of the standards, so that an assessor finds the way; no statement of conformity. The "
        "performance level that ISO 13849-1 would ask of a safety function is claimed for none of them.",
        head=("Claim", "Hazard", "Traced to", "Performance level"),
        rows=tuple(
            (
                words(claim.sentence, href=f"claim-{claim.number}"),
                words(claim.hazard, note="in the plan's own words" if claim.hazard_is_authors else ""),
                words("; ".join(f"{term.standard}: {term.term}" for term in claim.terms) or "nothing"),
                words("none claimed"),
            )
            for claim in evidence.claims
        ),
    )


def strata(evidence: Evidence) -> CellTable:
    """The operational domain, part by part."""
    return CellTable(
        caption="Each run draws from its space with a seed of its own; draws that cannot be tried (a start "
        "out of reach, ...) are drawn again and counted.",
        head=(
            "Stratum",
            "Space",
            "Runs made",
            "Planned",
            "Could not run",
            "Draws refused",
            "Decisions",
            "Stored traces",
        ),
        rows=tuple(
            (
                words(stratum.name, note=stratum.about),
                words(stratum.space, note=f"sha256 {stratum.space_sha256[:12]}\u2026"),
                count(stratum.made),
                count(stratum.planned),
                count(stratum.failed),
                count(stratum.refused_draws),
                words(
                    ", ".join(f"{how_many} {what}" for what, how_many in stratum.decisions) or "none recorded"
                ),
                words(f"{stratum.random_traces} at random, {stratum.violation_traces} of violations"),
            )
            for stratum in evidence.strata
        ),
    )


def separation(evidence: Evidence) -> CellTable:
    """The cases of the figure, number by number."""
    return CellTable(
        caption="The stored run with least to spare in each stratum, at its worst moment. S_p is the sum of "
        "its terms; the margin is the distance less S_p.",
        head=("Stratum", "Run", "At", "Distance", "S_p", "Margin", "Human", "Robot", "Terms"),
        rows=tuple(
            (
                words(case.stratum),
                words(case.run),
                number(f"{case.time_s:.3f} s", case.time_s),
                _mm(case.distance_m),
                _mm(case.required_m),
                _mm(case.distance_m - case.required_m),
                number(f"{case.hand_speed_mps:.2f} m/s", case.hand_speed_mps),
                number(f"{case.robot_speed_mps:.2f} m/s", case.robot_speed_mps),
                words(", ".join(f"{term.symbol} {term.length_m * 1e3:.0f} mm" for term in case.terms)),
            )
            for case in evidence.separation
        ),
    )


def _mm(length_m: float) -> TableCell:
    return number(with_minus(f"{length_m * 1e3:.0f} mm"), length_m)


def calibration(evidence: Evidence) -> CellTable:
    """How often the avoider's intervals held what they promise, by stratum."""
    return CellTable(
        caption="The first answered decision of each declared random run whose trace is stored; a verdict "
        "takes a hundred of them. Each interval holds with 95 % confidence alone, and is none of the "
        "bounds that hold together.",
        head=("Stratum", "Verdict", "Decisions", "Claim", "Why"),
        rows=tuple(
            (
                words(one.stratum),
                TableCell(text=one.decided, state=one.decided),
                count(one.decisions),
                words(one.sentence),
                words(one.why),
            )
            for one in evidence.calibration
        ),
    )


def coverage(evidence: Evidence) -> tuple[CellTable, ...]:
    """Runs for each word of each axis of the coverage map, none left out."""
    tables = []
    for axis, known in AXES.items():
        counts = dict.fromkeys(known, 0)
        for cell in evidence.coverage.cells:
            counts[getattr(cell, axis)] = counts.get(getattr(cell, axis), 0) + cell.runs
        rows = tuple((words(word), count(runs)) for word, runs in counts.items())
        tables.append(CellTable(caption=f"By {axis}", head=(axis.capitalize(), "Runs"), rows=rows))
    return tuple(tables)


def counterexamples(evidence: Evidence) -> CellTable:
    """All of them, with where they came from."""
    return CellTable(
        caption="Those of the declared runs are part of the bounds; those of the search are not, for it "
        "looks where violations are.",
        head=("No.", "Violates", "Margin", "Met by", "Like it", "Files"),
        rows=tuple(
            (
                words(str(one.number), href=f"counterexample-{one.number}"),
                words(one.sentence),
                words(one.margin),
                words(one.origin),
                count(one.like_it),
                words(", ".join(file for file in (one.scenario_file, one.trace_file) if file)),
            )
            for one in evidence.counterexamples
        ),
    )


def files(evidence: Evidence) -> CellTable:
    """Everything in the folder, with its hash."""
    return CellTable(
        caption="Files of the report's folder beside this page; safety-harness verify checks them.",
        head=("File", "Bytes", "sha256"),
        rows=tuple((words(file.path), count(file.bytes), words(file.sha256)) for file in evidence.files),
    )
