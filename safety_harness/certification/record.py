"""What a report can be held to: the root over its rows, and what was declared."""

from __future__ import annotations

from importlib import metadata

from safety_harness.campaign.ledger import Ledger
from safety_harness.campaign.merkle import root_of
from safety_harness.certification.evidence import OpenFinding, Record


def record_of(ledger: Ledger, declaration_sha256: str) -> Record:
    """With the root as the ledger is now."""
    return Record(rows_sha256=root_of(ledger), declaration_sha256=declaration_sha256, drawn_with=drawn_with())


def drawn_with() -> str:
    """What draws the plots of the page, whose lines another version may put elsewhere."""
    return f"matplotlib {metadata.version('matplotlib')}"


def of_record(record: Record) -> tuple[OpenFinding, ...]:
    """What nothing proves."""
    if record.declaration_sha256:
        return ()
    return (
        OpenFinding(text="nothing proves that the plan was declared before its runs were made", place="plan"),
    )
