"""Define all tables of the evidence report. Each table has a name.

This module defines the tables that show no results.
"""

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
    """Return the table of standards, each with its status and the claims that refer to its terms."""
    claims: dict[tuple[str, str], list[int]] = {}
    for claim in evidence.claims:
        for term in claim.terms:
            claims.setdefault((term.standard, term.term), []).append(claim.number)

    def traced_to(name: str) -> str:
        numbers_of_term = {term: numbers for (standard, term), numbers in claims.items() if standard == name}
        return "; ".join(
            f"{term}: {'claim' if len(numbers) == 1 else 'claims'} {', '.join(map(str, numbers))}"
            for term, numbers in numbers_of_term.items()
        )

    return table_of(
        f"Status in {STANDARDS.checked}. The terms guide an assessor; they are no statement of conformity.",
        STANDARDS.standards,
        {
            "Document": lambda row: text_cell(row.name, note=row.about),
            "Status": lambda row: text_cell(row.status),
            "Known from": lambda row: text_cell(row.source),
            "Claims by term": lambda row: text_cell(traced_to(row.name) or DASH),
        },
    )


_REQUIREMENTS = [(standard.name, item) for standard in STANDARDS.standards for item in standard.requirements]


def missing(_: Evidence) -> CellTable:
    """Return the table of requirements that no part of this report addresses, sorted by standard."""
    rows = [(name, row) for name, row in _REQUIREMENTS if not row.here]
    return table_of(
        f"{len(rows)} of {len(_REQUIREMENTS)} points are not covered here. "
        "The list has only points with a source.",
        rows,
        {
            "Document": lambda row: text_cell(row[0]),
            "Requirement": lambda row: text_cell(row[1].asks),
            "Needed to cover it": lambda row: text_cell(row[1].means),
        },
    )


def spoken_to(_: Evidence) -> CellTable:
    """Return the table of requirements that some part of this report addresses, sorted by standard."""
    return table_of(
        "Parts of this report address these requirements. This alone does not fulfil a requirement.",
        [(name, row) for name, row in _REQUIREMENTS if row.here],
        {
            "Document": lambda row: text_cell(row[0]),
            "Requirement": lambda row: text_cell(row[1].asks),
            "Section": lambda row: text_cell(row[1].here, href=row[1].here),
            "Content": lambda row: text_cell(row[1].means),
        },
    )


def questions(_: Evidence) -> CellTable:
    """Return the table of an assessor's questions, with a link to each answer."""
    return table_of(
        f"{len(QUESTIONS)} questions, {sum(not row.here for row in QUESTIONS)} of them not covered here.",
        QUESTIONS,
        {
            "Question": lambda row: text_cell(row.asks),
            "Source": lambda row: text_cell(STANDARDS[row.of].name),
            "Answered in": lambda row: text_cell(row.here or "not covered here", href=row.here),
            "Means, present or needed": lambda row: text_cell(row.means),
        },
    )


def training(evidence: Evidence) -> CellTable:
    """Return the table of the distances of the strata from the network's training data."""
    return table_of(
        "Runs with a hand, counted by the place of hand and TCP at the gravest decision: in the training "
        "data or outside. The other columns concern the decisions of the stored random runs. They state the "
        "share of hands outside the box of hands seen in training, and their distance from the box.",
        () if evidence.learned is None else evidence.learned.strata,
        {"Stratum": lambda row: text_cell(row.stratum)}
        | {
            f"Runs, {name}": (lambda row, place=place: count(row.runs[place]))
            for place, name in enumerate(SEEN)
        }
        | {
            "Decisions": lambda row: count(row.decisions),
            "Hand outside": lambda row: number(
                DASH if row.share_outside is None else percent(row.share_outside), row.share_outside
            ),
            "Median distance": lambda row: _far(row.median_outside_m),
            "Largest distance": lambda row: _far(row.largest_outside_m),
        },
    )


def _far(distance_m: float | None) -> TableCell:
    return number(DASH if distance_m is None else f"{distance_m * 1e3:.0f} mm", distance_m)


def separation(evidence: Evidence) -> CellTable:
    """Return the table of the cases that the figure of protective separation shows."""
    return table_of(
        "The stored run with the least margin in each stratum, at its worst moment. S_p is the sum of its "
        "terms; the margin is the distance minus S_p.",
        evidence.separation,
        {
            "Stratum": lambda row: text_cell(row.stratum),
            "Run": lambda row: text_cell(row.run),
            "At": lambda row: number(f"{row.time_s:.3f} s", row.time_s),
            "Distance": lambda row: millimetres(row.distance_m),
            "S_p": lambda row: millimetres(row.required_m),
            "Margin": lambda row: millimetres(row.distance_m - row.required_m),
            "Human": lambda row: number(f"{row.hand_speed_mps:.2f} m/s", row.hand_speed_mps),
            "Robot": lambda row: number(f"{row.robot_speed_mps:.2f} m/s", row.robot_speed_mps),
            "Terms": lambda row: text_cell(
                ", ".join(f"{term.symbol} {term.length_m * 1e3:.0f} mm" for term in row.terms)
            ),
        },
    )


def calibration(evidence: Evidence) -> CellTable:
    """Return the table of the verdicts on the avoider's intervals, by stratum."""
    return table_of(
        "The first answered decision in every declared random run with a stored trace. A verdict needs a "
        "hundred decisions. Each interval has 95 % confidence alone, apart from the bounds that hold "
        "together.",
        evidence.calibration,
        {
            "Stratum": lambda row: text_cell(row.stratum),
            "Verdict": lambda row: TableCell(text=row.decided, state=row.decided),
            "Decisions": lambda row: count(row.decisions),
            "Claim": lambda row: text_cell(row.sentence),
            "Why": lambda row: text_cell(row.why),
        },
    )


def domain(evidence: Evidence) -> CellTable:
    """Return the table of the operational domain.

    The rows are the tried and the untested parts of the domain, and the parts outside of it.
    """
    cells, _ = cells_of(evidence.coverage)
    rows = [("stratum", stratum.name, stratum.made, "in, ") for stratum in evidence.strata]
    rows += [(axis, label, runs, "") for axis in AXES for label, runs in cells.along(axis).items()]
    inside = [
        (text_cell(group), text_cell(name), text_cell(where + ("tried" if runs else "untested")), count(runs))
        for group, name, runs, where in rows
    ]
    never = text_cell("limits of the simulation", href="not-shown")
    return CellTable(
        "The plan's strata are in the domain. The rows below count their runs along the axes of the map. "
        "No run can reach some untested values. The last row is out, because no run simulates it.",
        ("Group", "Part", "Standing", "Runs"),
        (*inside, (text_cell("simulation"), never, text_cell("out"), number(DASH))),
    )


def whose_fault(evidence: Evidence) -> CellTable:
    """Return the table of single changes, with the number of violations that each change would avoid."""
    return table_of(
        "Single changes that would have avoided violations.",
        evidence.whose_fault.would_help,
        {"Change": lambda row: text_cell(row[0]), "Violations avoided": lambda row: count(row[1])},
    )


def counterexamples(evidence: Evidence) -> CellTable:
    """Return the table of all counterexamples with their origin."""
    return table_of(
        "The bounds include counterexamples of the declared runs. They exclude counterexamples of the "
        "search, because it looks for violations.",
        evidence.counterexamples,
        {
            "No.": lambda row: text_cell(str(row.number), href=f"counterexample-{row.number}"),
            "Violates": lambda row: text_cell(row.sentence),
            "Margin": lambda row: text_cell(row.margin),
            "Found by": lambda row: text_cell(row.origin),
            "Similar": lambda row: count(row.like_it),
            "Files": lambda row: text_cell(", ".join(filter(None, (row.scenario_file, row.trace_file)))),
        },
    )


def files(evidence: Evidence) -> CellTable:
    """Return the table of the folder's files with their hashes."""
    return table_of(
        "Files of the report's folder beside this page; safety-harness verify checks them.",
        evidence.files,
        {
            "File": lambda row: text_cell(row.path),
            "Bytes": lambda row: count(row.bytes),
            "sha256": lambda row: text_cell(row.sha256),
        },
    )


def agreement(known: WorldAgreement) -> CellTable:
    """Return the table of the largest differences between the two worlds.

    ``known`` is the measured agreement of the worlds.
    """
    present = "this source" if known.present else f"another source, {known.source_hash}"
    return table_of(
        f"Both worlds ran the same {known.scenarios} scenarios with {present}. "
        f"{count_words(known.disagreements, 'verdict', 'verdicts')} of {known.verdicts} differ, "
        f"{known.optimistic} of them optimistic (the claim holds in the kinematic world and is violated in "
        "PyBullet).",
        known.differences,
        {"Quantity": lambda row: text_cell(row[0]), "Largest difference": lambda row: number(row[1])},
    )


def cell_lines(known: RecordedCell) -> CellTable:
    """Return the table of the differences between the log of the recorded cell ``known`` and both worlds."""
    cell = known.comparison
    source = "this source" if known.present else f"another source, {cell.source_hash}"
    rows = [(world.world, line) for world in cell.worlds for line in world_lines(world, cell.usually)]
    return table_of(
        f"{cell.log}, {cell.title}, {cell.duration_s:g} s. The worlds ran {cell.tested} on "
        f"{cell.system.robot if cell.system else 'an unknown arm'} with the recorded hands and {source}. "
        "Differences are simulated minus recorded. "
        f"{count_words(known.differing, 'verdict', 'verdicts')} of {known.decided} differ, "
        f"{known.optimistic} of them optimistic (the claim holds in simulation and was violated in the "
        f"cell). Intervals: {cell.confidence:.0%} for the mean, from {cell.blocks} stretches of the log, "
        "approximate. "
        f"compare-worlds.json: sha256 {known.sha256}.",
        rows,
        {"World": lambda row: text_cell(row[0]), "Result": lambda row: text_cell(row[1])},
    )


def rerun(known: Rerun) -> CellTable:
    """Return the table of the changes that appear when declared random runs are repeated.

    The repetition uses smaller physics steps or another world. ``known`` has its results.
    """
    return table_of(
        f"{count_words(known.runs, 'declared random run', 'declared random runs')}, repeated "
        f"{known.how}: {known.changed} of {known.verdicts} verdicts change, "
        f"{known.optimistic} of them from holds to violated.",
        known.largest,
        {"Claim": lambda row: text_cell(row[0]), "Largest change": lambda row: number(row[1])},
    )


def oracles(known: Credibility) -> CellTable:
    """Return the table of the parts in ``known`` that were compared with independent software."""
    return table_of(
        "Parts checked against independent software, with the largest disagreement seen "
        f"({known.oracles_measured_with}).",
        known.oracles,
        {
            "Part": lambda row: text_cell(row.part),
            "Against": lambda row: text_cell(row.against),
            "Largest disagreement": lambda row: text_cell(row.largest),
        },
    )


def kills(test: SelfTest) -> CellTable:
    """Return the table of every seeded fault in ``test``, with the claim that caught it."""
    survived = TableCell(text="survived", state="violated")
    return table_of(
        f"Seeded faults of the system, profile {test.profile}: {test.caught} of {len(test.faults)} "
        f"caught{'' if test.whole else '; the trial skipped some faults of the catalogue'}.",
        sorted(test.faults, key=lambda row: bool(row.caught_by)),
        {
            "Fault": lambda row: text_cell(row.name),
            "Part": lambda row: text_cell(row.part),
            "Hazard": lambda row: text_cell(row.hazard),
            "Caught by": lambda row: text_cell(row.caught_by) if row.caught_by else survived,
            "Smallest caught": lambda row: text_cell(row.smallest or DASH, note=row.known_limit),
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
TABLES = {make.__name__: make for make in _EVERY}  # the names that the page uses
