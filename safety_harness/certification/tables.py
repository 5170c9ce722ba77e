"""The tables of the evidence report, and their cells: one macro of the page draws them all."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import TypeVar

from safety_harness.campaign.risk_graph import band_of
from safety_harness.certification.argument import STATE
from safety_harness.certification.evidence import (
    ClaimEvidence,
    ClaimResult,
    ClaimStatus,
    Evidence,
    HazardEvidence,
    HourlyBound,
    OverrulingResult,
    by_gravity,
)
from safety_harness.certification.standards import QUESTIONS, STANDARDS
from safety_harness.certification.stored import cells_of
from safety_harness.certification.tools import (
    Credibility,
    RecordedCell,
    Rerun,
    SelfTest,
    WorldAgreement,
)
from safety_harness.certification.verdicts import at_least, at_most, confidence_words, percent
from safety_harness.properties.base import shown_margin
from safety_harness.recorded.words import world_lines
from safety_harness.report.words import count_words, rounded_up, with_minus
from safety_harness.search.coverage import AXES, SEEN

DASH = "\u2013"

T = TypeVar("T")


@dataclass(frozen=True, kw_only=True)
class TableCell:
    """One cell: ``sort`` is what a sorted column compares, ``state`` the class and icon of a verdict.

    ``href`` leads from it, ``row`` is the id of the row that it begins.
    """

    text: str
    sort: str = ""
    number: bool = False
    state: str = ""
    href: str = ""
    note: str = ""
    row: str = ""


@dataclass(frozen=True)
class CellTable:
    """``head`` names the columns; the first cell of each row names the row."""

    caption: str
    head: tuple[str, ...]
    rows: tuple[tuple[TableCell, ...], ...]


def _table(caption: str, things: Iterable[T], columns: Mapping[str, Callable[[T], TableCell]]) -> CellTable:
    """A row for each thing, with a cell for each of the named columns."""
    rows = tuple(tuple(cell(one) for cell in columns.values()) for one in things)
    return CellTable(caption, tuple(columns), rows)


def words(text: str, *, href: str = "", note: str = "", row: str = "") -> TableCell:
    """A cell of words."""
    return TableCell(text=text, href=href, note=note, row=row)


def number(text: str, sort: float | None = None, href: str = "") -> TableCell:
    """A cell of a number, sorted by ``sort``, that leads to what it counts."""
    return TableCell(text=text, number=True, sort="" if sort is None else repr(float(sort)), href=href)


def count(value: int, href: str = "") -> TableCell:
    """A cell of a whole number; zero leads nowhere."""
    return number(f"{value:,}".replace(",", "\u202f"), value, href if value else "")


def standing(value: ClaimStatus) -> TableCell:
    """A cell of a claim's standing."""
    return TableCell(text=value.value, state=STATE[value])


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
    return _table(
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
    return _table(
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
        return TableCell(text=f"at or below{alone}", state="none")

    def hourly(value: float) -> str:
        return f"{float(rounded_up(value)):.3g}"

    return _table(
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
    return _table(
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
    return _table(
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


def standards(evidence: Evidence) -> CellTable:
    """The documents with their status, and which claims are traced to which of their terms."""
    claims: dict[tuple[str, str], list[int]] = {}
    for claim in evidence.claims:
        for term in claim.terms:
            claims.setdefault((term.standard, term.term), []).append(claim.number)

    def traced_to(name: str) -> str:
        found = {term: numbers for (standard, term), numbers in claims.items() if standard == name}
        return "; ".join(
            f"{term}: {'claim' if len(numbers) == 1 else 'claims'} {', '.join(map(str, numbers))}"
            for term, numbers in found.items()
        )

    return _table(
        f"Status as last looked up in {STANDARDS.checked}. Terms, so that an assessor finds the way; no "
        "statement of conformity.",
        STANDARDS.standards,
        {
            "Document": lambda one: words(one.name, note=one.about),
            "Status": lambda one: words(one.status),
            "Known from": lambda one: words(one.source),
            "Traced to it": lambda one: words(traced_to(one.name) or DASH),
        },
    )


_ASKED = [(standard.name, one) for standard in STANDARDS.standards for one in standard.requirements]


def missing(_: Evidence) -> CellTable:
    """By standard, what nothing in this report speaks to."""
    rows = [(name, one) for name, one in _ASKED if not one.here]
    return _table(
        f"{len(rows)} of {len(_ASKED)} points are not covered here. "
        "The list has what could be sourced, no more.",
        rows,
        {
            "Document": lambda one: words(one[0]),
            "Asks": lambda one: words(one[1].asks),
            "What would cover it": lambda one: words(one[1].means),
        },
    )


def spoken_to(_: Evidence) -> CellTable:
    """By standard, which part of this report speaks to what."""
    return _table(
        "A part of this report that speaks to a requirement does not fulfil it.",
        [(name, one) for name, one in _ASKED if one.here],
        {
            "Document": lambda one: words(one[0]),
            "Asks": lambda one: words(one[1].asks),
            "Here": lambda one: words(one[1].here, href=one[1].here),
            "What it says": lambda one: words(one[1].means),
        },
    )


def questions(_: Evidence) -> CellTable:
    """What an assessor asks, and where it is answered."""
    return _table(
        f"{len(QUESTIONS)} questions, {sum(not one.here for one in QUESTIONS)} of them not covered here.",
        QUESTIONS,
        {
            "Question": lambda one: words(one.asks),
            "Drawn from": lambda one: words(STANDARDS[one.of].name),
            "Answered in": lambda one: words(one.here or "not covered here", href=one.here),
            "By what, or what would": lambda one: words(one.means),
        },
    )


def strata(evidence: Evidence) -> CellTable:
    """The operational domain, part by part."""
    return _table(
        "Each run draws from its space with a seed of its own; draws that cannot be tried (a start "
        "out of reach, ...) are drawn again and counted.",
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
    return _table(
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


def training(evidence: Evidence) -> CellTable:
    """How far the strata lie from what the network was trained on."""
    return _table(
        "All runs with a hand, by whether hand and TCP were where the training data are at the gravest "
        "decision; and of the hands in the decisions of the stored random runs how many were outside of the "
        "box of hands seen in training, and how far.",
        () if evidence.learned is None else evidence.learned.strata,
        {"Stratum": lambda one: words(one.stratum)}
        | {
            f"Runs, {name}": (lambda one, place=place: count(one.runs[place]))
            for place, name in enumerate(SEEN)
        }
        | {
            "Decisions": lambda one: count(one.decisions),
            "Hand outside": lambda one: number(
                DASH if one.share_outside is None else percent(one.share_outside), one.share_outside
            ),
            "Median distance": lambda one: _far(one.median_outside_m),
            "Largest distance": lambda one: _far(one.largest_outside_m),
        },
    )


def _far(distance_m: float | None) -> TableCell:
    return number(DASH if distance_m is None else f"{distance_m * 1e3:.0f} mm", distance_m)


def separation(evidence: Evidence) -> CellTable:
    """The cases of the figure, number by number."""
    return _table(
        "The stored run with least to spare in each stratum, at its worst moment. S_p is the sum of "
        "its terms; the margin is the distance less S_p.",
        evidence.separation,
        {
            "Stratum": lambda one: words(one.stratum),
            "Run": lambda one: words(one.run),
            "At": lambda one: number(f"{one.time_s:.3f} s", one.time_s),
            "Distance": lambda one: _mm(one.distance_m),
            "S_p": lambda one: _mm(one.required_m),
            "Margin": lambda one: _mm(one.distance_m - one.required_m),
            "Human": lambda one: number(f"{one.hand_speed_mps:.2f} m/s", one.hand_speed_mps),
            "Robot": lambda one: number(f"{one.robot_speed_mps:.2f} m/s", one.robot_speed_mps),
            "Terms": lambda one: words(
                ", ".join(f"{term.symbol} {term.length_m * 1e3:.0f} mm" for term in one.terms)
            ),
        },
    )


def _mm(length_m: float) -> TableCell:
    return number(with_minus(f"{length_m * 1e3:.0f} mm"), length_m)


def calibration(evidence: Evidence) -> CellTable:
    """How often the avoider's intervals held what they promise, by stratum."""
    return _table(
        "The first answered decision of each declared random run whose trace is stored; a verdict "
        "takes a hundred of them. Each interval holds with 95 % confidence alone, and is none of the "
        "bounds that hold together.",
        evidence.calibration,
        {
            "Stratum": lambda one: words(one.stratum),
            "Verdict": lambda one: TableCell(text=one.decided, state=one.decided),
            "Decisions": lambda one: count(one.decisions),
            "Claim": lambda one: words(one.sentence),
            "Why": lambda one: words(one.why),
        },
    )


def coverage(evidence: Evidence) -> tuple[CellTable, ...]:
    """Runs for each word of each axis of the coverage map, none left out."""
    cells, _ = cells_of(evidence.coverage)
    return tuple(
        _table(
            f"By {axis}",
            cells.along(axis).items(),
            {axis.capitalize(): lambda one: words(one[0]), "Runs": lambda one: count(one[1])},
        )
        for axis in AXES
    )


def whose_fault(evidence: Evidence) -> CellTable:
    """Which single changes would have avoided how many violations."""
    return _table(
        "What would have helped, changed alone",
        evidence.whose_fault.would_help,
        {"Change": lambda one: words(one[0]), "Violations avoided": lambda one: count(one[1])},
    )


def counterexamples(evidence: Evidence) -> CellTable:
    """All of them, with where they came from."""
    return _table(
        "Those of the declared runs are part of the bounds; those of the search are not, for it "
        "looks where violations are.",
        evidence.counterexamples,
        {
            "No.": lambda one: words(str(one.number), href=f"counterexample-{one.number}"),
            "Violates": lambda one: words(one.sentence),
            "Margin": lambda one: words(one.margin),
            "Met by": lambda one: words(one.origin),
            "Like it": lambda one: count(one.like_it),
            "Files": lambda one: words(", ".join(filter(None, (one.scenario_file, one.trace_file)))),
        },
    )


def files(evidence: Evidence) -> CellTable:
    """Everything in the folder, with its hash."""
    return _table(
        "Files of the report's folder beside this page; safety-harness verify checks them.",
        evidence.files,
        {
            "File": lambda one: words(one.path),
            "Bytes": lambda one: count(one.bytes),
            "sha256": lambda one: words(one.sha256),
        },
    )


def agreement(known: WorldAgreement) -> CellTable:
    """The largest differences between the two worlds."""
    present = "this very source" if known.present else f"another source, {known.source_hash}"
    return _table(
        f"The two worlds on the same {known.scenarios} scenarios, measured with {present}: "
        f"{count_words(known.disagreements, 'verdict', 'verdicts')} of {known.verdicts} differ, "
        f"{known.optimistic} of them optimistic (the kinematic world sees a claim hold that PyBullet sees "
        "violated).",
        known.differences,
        {"What": lambda one: words(one[0]), "Largest difference": lambda one: number(one[1])},
    )


def cell_lines(known: RecordedCell) -> CellTable:
    """How far both worlds lie from what was recorded in a cell."""
    found = known.comparison
    source = "this very source" if known.present else f"another source, {found.source_hash}"
    rows = [(world.world, line) for world in found.worlds for line in world_lines(world, found.usually)]
    return _table(
        f"{found.log}, {found.title}, {found.duration_s:g} s: {found.tested} under the recorded hands, "
        f"simulated minus recorded, run with {source}. "
        f"{count_words(known.differing, 'verdict', 'verdicts')} of {known.decided} differ, "
        f"{known.optimistic} of them optimistic (a claim holds in simulation that was violated in the cell). "
        f"Intervals: {found.confidence:.0%} of the mean, by {found.blocks} stretches of it, approximate. "
        f"compare-worlds.json: sha256 {known.sha256}.",
        rows,
        {"World": lambda one: words(one[0]), "What": lambda one: words(one[1])},
    )


def rerun(known: Rerun) -> CellTable:
    """What changes when declared random runs are made again with something else."""
    return _table(
        f"{count_words(known.runs, 'declared random run', 'declared random runs')} again "
        f"{known.how}: {known.changed} of {known.verdicts} verdicts change, "
        f"{known.optimistic} of them from holds to violated.",
        known.largest,
        {"Claim": lambda one: words(one[0]), "Largest change of the margin": lambda one: number(one[1])},
    )


def oracles(known: Credibility) -> CellTable:
    """What was checked against software that we did not write."""
    return _table(
        "Parts checked against software that is not ours, with the largest disagreement seen "
        f"({known.oracles_measured_with}).",
        known.oracles,
        {
            "Part": lambda one: words(one.part),
            "Against": lambda one: words(one.against),
            "Largest disagreement": lambda one: words(one.largest),
        },
    )


def kills(test: SelfTest) -> CellTable:
    """Every seeded fault and what caught it."""
    survived = TableCell(text="survived", state="violated")
    return _table(
        f"Faults seeded into the system, profile {test.profile}: {test.caught} of {len(test.faults)} "
        f"caught{'' if test.whole else '; not every fault of the catalogue was tried'}.",
        sorted(test.faults, key=lambda one: bool(one.caught_by)),
        {
            "Fault": lambda one: words(one.name),
            "Part": lambda one: words(one.part),
            "Hazard": lambda one: words(one.hazard),
            "Caught by": lambda one: words(one.caught_by) if one.caught_by else survived,
            "Smallest caught": lambda one: words(one.smallest or DASH, note=one.known_limit),
        },
    )


_EVERY: tuple[Callable[..., object], ...] = (
    *(
        verdicts,
        hazards,
        rates,
        results,
        quantiles,
        standards,
        missing,
        spoken_to,
        questions,
        strata,
        overruling,
        training,
        separation,
        coverage,
        counterexamples,
        whose_fault,
        calibration,
    ),
    *(agreement, cell_lines, rerun, oracles, kills, files),
)
TABLES = {make.__name__: make for make in _EVERY}  # as the page calls them
