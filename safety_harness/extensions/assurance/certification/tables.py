"""Every table of the evidence report by its name, and those that are not of results."""

from __future__ import annotations

from collections.abc import Callable

from safety_harness.extensions.assurance.certification.evidence import Evidence
from safety_harness.extensions.assurance.certification.result_tables import (
    hazards,
    overruling,
    quantiles,
    rates,
    results,
    strata,
    verdicts,
)
from safety_harness.extensions.assurance.certification.standards import QUESTIONS, STANDARDS
from safety_harness.extensions.assurance.certification.stored import cells_of
from safety_harness.extensions.assurance.certification.table_cells import (
    DASH,
    CellTable,
    TableCell,
    count,
    millimetres,
    number,
    table_of,
    text_cell,
)
from safety_harness.extensions.assurance.certification.tools import (
    Credibility,
    RecordedCell,
    Rerun,
    SelfTest,
    WorldAgreement,
)
from safety_harness.extensions.assurance.certification.verdicts import percent
from safety_harness.extensions.field.recorded.words import world_lines
from safety_harness.report.words import count_words
from safety_harness.search.coverage import AXES, SEEN


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

    return table_of(
        f"Status as last looked up in {STANDARDS.checked}. Terms, so that an assessor finds the way; no "
        "statement of conformity.",
        STANDARDS.standards,
        {
            "Document": lambda one: text_cell(one.name, note=one.about),
            "Status": lambda one: text_cell(one.status),
            "Known from": lambda one: text_cell(one.source),
            "Traced to it": lambda one: text_cell(traced_to(one.name) or DASH),
        },
    )


_ASKED = [(standard.name, one) for standard in STANDARDS.standards for one in standard.requirements]


def missing(_: Evidence) -> CellTable:
    """By standard, what nothing in this report speaks to."""
    rows = [(name, one) for name, one in _ASKED if not one.here]
    return table_of(
        f"{len(rows)} of {len(_ASKED)} points are not covered here. "
        "The list has what could be sourced, no more.",
        rows,
        {
            "Document": lambda one: text_cell(one[0]),
            "Asks": lambda one: text_cell(one[1].asks),
            "What would cover it": lambda one: text_cell(one[1].means),
        },
    )


def spoken_to(_: Evidence) -> CellTable:
    """By standard, which part of this report speaks to what."""
    return table_of(
        "A part of this report that speaks to a requirement does not fulfil it.",
        [(name, one) for name, one in _ASKED if one.here],
        {
            "Document": lambda one: text_cell(one[0]),
            "Asks": lambda one: text_cell(one[1].asks),
            "Here": lambda one: text_cell(one[1].here, href=one[1].here),
            "What it says": lambda one: text_cell(one[1].means),
        },
    )


def questions(_: Evidence) -> CellTable:
    """What an assessor asks, and where it is answered."""
    return table_of(
        f"{len(QUESTIONS)} questions, {sum(not one.here for one in QUESTIONS)} of them not covered here.",
        QUESTIONS,
        {
            "Question": lambda one: text_cell(one.asks),
            "Drawn from": lambda one: text_cell(STANDARDS[one.of].name),
            "Answered in": lambda one: text_cell(one.here or "not covered here", href=one.here),
            "By what, or what would": lambda one: text_cell(one.means),
        },
    )


def training(evidence: Evidence) -> CellTable:
    """How far the strata lie from what the network was trained on."""
    return table_of(
        "All runs with a hand, by whether hand and TCP were where the training data are at the gravest "
        "decision; and of the hands in the decisions of the stored random runs how many were outside of the "
        "box of hands seen in training, and how far.",
        () if evidence.learned is None else evidence.learned.strata,
        {"Stratum": lambda one: text_cell(one.stratum)}
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
    return table_of(
        "The stored run with least to spare in each stratum, at its worst moment. S_p is the sum of "
        "its terms; the margin is the distance less S_p.",
        evidence.separation,
        {
            "Stratum": lambda one: text_cell(one.stratum),
            "Run": lambda one: text_cell(one.run),
            "At": lambda one: number(f"{one.time_s:.3f} s", one.time_s),
            "Distance": lambda one: millimetres(one.distance_m),
            "S_p": lambda one: millimetres(one.required_m),
            "Margin": lambda one: millimetres(one.distance_m - one.required_m),
            "Human": lambda one: number(f"{one.hand_speed_mps:.2f} m/s", one.hand_speed_mps),
            "Robot": lambda one: number(f"{one.robot_speed_mps:.2f} m/s", one.robot_speed_mps),
            "Terms": lambda one: text_cell(
                ", ".join(f"{term.symbol} {term.length_m * 1e3:.0f} mm" for term in one.terms)
            ),
        },
    )


def calibration(evidence: Evidence) -> CellTable:
    """How often the avoider's intervals held what they promise, by stratum."""
    return table_of(
        "The first answered decision of each declared random run whose trace is stored; a verdict "
        "takes a hundred of them. Each interval holds with 95 % confidence alone, and is none of the "
        "bounds that hold together.",
        evidence.calibration,
        {
            "Stratum": lambda one: text_cell(one.stratum),
            "Verdict": lambda one: TableCell(text=one.decided, state=one.decided),
            "Decisions": lambda one: count(one.decisions),
            "Claim": lambda one: text_cell(one.sentence),
            "Why": lambda one: text_cell(one.why),
        },
    )


def domain(evidence: Evidence) -> CellTable:
    """The operational domain: what is in, what of it was tried and what was not, and what is out."""
    cells, _ = cells_of(evidence.coverage)
    rows = [("stratum", one.name, one.made, "in, ") for one in evidence.strata]
    rows += [(axis, word, runs, "") for axis in AXES for word, runs in cells.along(axis).items()]
    inside = [
        (text_cell(of), text_cell(what), text_cell(where + ("tried" if runs else "untested")), count(runs))
        for of, what, runs, where in rows
    ]
    never = text_cell("what no run simulates", href="not-shown")
    return CellTable(
        "In are the plan's strata. Below them is where their runs came to, by the axes of the map; to some "
        "of what is untested no run can come. Out is what no run simulates.",
        ("Of", "What", "Standing", "Runs"),
        (*inside, (text_cell("simulation"), never, text_cell("out"), number(DASH))),
    )


def whose_fault(evidence: Evidence) -> CellTable:
    """Which single changes would have avoided how many violations."""
    return table_of(
        "What would have helped, changed alone",
        evidence.whose_fault.would_help,
        {"Change": lambda one: text_cell(one[0]), "Violations avoided": lambda one: count(one[1])},
    )


def counterexamples(evidence: Evidence) -> CellTable:
    """All of them, with where they came from."""
    return table_of(
        "Those of the declared runs are part of the bounds; those of the search are not, for it "
        "looks where violations are.",
        evidence.counterexamples,
        {
            "No.": lambda one: text_cell(str(one.number), href=f"counterexample-{one.number}"),
            "Violates": lambda one: text_cell(one.sentence),
            "Margin": lambda one: text_cell(one.margin),
            "Met by": lambda one: text_cell(one.origin),
            "Like it": lambda one: count(one.like_it),
            "Files": lambda one: text_cell(", ".join(filter(None, (one.scenario_file, one.trace_file)))),
        },
    )


def files(evidence: Evidence) -> CellTable:
    """Everything in the folder, with its hash."""
    return table_of(
        "Files of the report's folder beside this page; safety-harness verify checks them.",
        evidence.files,
        {
            "File": lambda one: text_cell(one.path),
            "Bytes": lambda one: count(one.bytes),
            "sha256": lambda one: text_cell(one.sha256),
        },
    )


def agreement(known: WorldAgreement) -> CellTable:
    """The largest differences between the two worlds."""
    present = "this very source" if known.present else f"another source, {known.source_hash}"
    return table_of(
        f"The two worlds on the same {known.scenarios} scenarios, measured with {present}: "
        f"{count_words(known.disagreements, 'verdict', 'verdicts')} of {known.verdicts} differ, "
        f"{known.optimistic} of them optimistic (the kinematic world sees a claim hold that PyBullet sees "
        "violated).",
        known.differences,
        {"What": lambda one: text_cell(one[0]), "Largest difference": lambda one: number(one[1])},
    )


def cell_lines(known: RecordedCell) -> CellTable:
    """How far both worlds lie from what was recorded in a cell."""
    found = known.comparison
    source = "this very source" if known.present else f"another source, {found.source_hash}"
    rows = [(world.world, line) for world in found.worlds for line in world_lines(world, found.usually)]
    return table_of(
        f"{found.log}, {found.title}, {found.duration_s:g} s: {found.tested} on "
        f"{found.system.robot if found.system else 'an arm that is not noted'} under the recorded hands, "
        f"simulated minus recorded, run with {source}. "
        f"{count_words(known.differing, 'verdict', 'verdicts')} of {known.decided} differ, "
        f"{known.optimistic} of them optimistic (a claim holds in simulation that was violated in the cell). "
        f"Intervals: {found.confidence:.0%} of the mean, by {found.blocks} stretches of it, approximate. "
        f"compare-worlds.json: sha256 {known.sha256}.",
        rows,
        {"World": lambda one: text_cell(one[0]), "What": lambda one: text_cell(one[1])},
    )


def rerun(known: Rerun) -> CellTable:
    """What changes when declared random runs are made again with something else."""
    return table_of(
        f"{count_words(known.runs, 'declared random run', 'declared random runs')} again "
        f"{known.how}: {known.changed} of {known.verdicts} verdicts change, "
        f"{known.optimistic} of them from holds to violated.",
        known.largest,
        {"Claim": lambda one: text_cell(one[0]), "Largest change of the margin": lambda one: number(one[1])},
    )


def oracles(known: Credibility) -> CellTable:
    """What was checked against software that we did not write."""
    return table_of(
        "Parts checked against software that is not ours, with the largest disagreement seen "
        f"({known.oracles_measured_with}).",
        known.oracles,
        {
            "Part": lambda one: text_cell(one.part),
            "Against": lambda one: text_cell(one.against),
            "Largest disagreement": lambda one: text_cell(one.largest),
        },
    )


def kills(test: SelfTest) -> CellTable:
    """Every seeded fault and what caught it."""
    survived = TableCell(text="survived", state="violated")
    return table_of(
        f"Faults seeded into the system, profile {test.profile}: {test.caught} of {len(test.faults)} "
        f"caught{'' if test.whole else '; not every fault of the catalogue was tried'}.",
        sorted(test.faults, key=lambda one: bool(one.caught_by)),
        {
            "Fault": lambda one: text_cell(one.name),
            "Part": lambda one: text_cell(one.part),
            "Hazard": lambda one: text_cell(one.hazard),
            "Caught by": lambda one: text_cell(one.caught_by) if one.caught_by else survived,
            "Smallest caught": lambda one: text_cell(one.smallest or DASH, note=one.known_limit),
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
        domain,
        counterexamples,
        whose_fault,
        calibration,
    ),
    *(agreement, cell_lines, rerun, oracles, kills, files),
)
TABLES = {make.__name__: make for make in _EVERY}  # as the page calls them
