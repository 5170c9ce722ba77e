"""The tables of the evidence report about the tools: worlds, reruns, oracles, seeded faults."""

from __future__ import annotations

from safety_harness.certification.cells import DASH, CellTable, TableCell, number, words
from safety_harness.certification.evidence import Evidence
from safety_harness.certification.tools import Rerun
from safety_harness.report.words import count_words


def agreement(evidence: Evidence) -> CellTable | None:
    """The largest differences between the two worlds."""
    known = evidence.credibility.agreement
    if known is None:
        return None
    present = "this very source" if known.present else f"another source, {known.source_hash}"
    return CellTable(
        caption=f"The two worlds on the same {known.scenarios} scenarios, measured with {present}: "
        f"{count_words(known.disagreements, 'verdict', 'verdicts')} of {known.verdicts} differ, "
        f"{known.optimistic} of them optimistic (the kinematic world sees a claim hold that PyBullet sees "
        "violated).",
        head=("What", "Largest difference"),
        rows=tuple((words(what), number(largest)) for what, largest in known.differences),
    )


def rerun(known: Rerun) -> CellTable:
    """What changes when declared random runs are made again with something else."""
    return CellTable(
        caption=f"{count_words(known.runs, 'declared random run', 'declared random runs')} again "
        f"{known.how}: {known.changed} of {known.verdicts} verdicts change, "
        f"{known.optimistic} of them from holds to violated.",
        head=("Claim", "Largest change of the margin"),
        rows=tuple((words(sentence), number(largest)) for sentence, largest in known.largest),
    )


def oracles(evidence: Evidence) -> CellTable | None:
    """What was checked against software that we did not write."""
    rows = evidence.credibility.oracles
    if not rows:
        return None
    return CellTable(
        caption="Parts checked against software that is not ours, with the largest disagreement seen "
        f"({evidence.credibility.oracles_measured_with}).",
        head=("Part", "Against", "Largest disagreement"),
        rows=tuple((words(row.part), words(row.against), words(row.largest)) for row in rows),
    )


def kills(evidence: Evidence) -> CellTable | None:
    """Every seeded fault and what caught it."""
    test = evidence.selftest
    if test is None:
        return None
    return CellTable(
        caption=f"Faults seeded into the system, profile {test.profile}: {test.caught} of {len(test.faults)} "
        f"caught{'' if test.whole else '; not every fault of the catalogue was tried'}.",
        head=("Fault", "Part", "Hazard", "Caught by", "Smallest caught"),
        rows=tuple(
            (
                words(fault.name),
                words(fault.part),
                words(fault.hazard),
                TableCell(text=fault.caught_by)
                if fault.caught_by
                else TableCell(text="survived", state="violated"),
                words(fault.smallest or DASH, note=fault.known_limit),
            )
            for fault in test.faults
        ),
    )
