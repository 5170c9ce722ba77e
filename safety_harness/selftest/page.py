"""One self-contained HTML page about a self-test, in the style of the reports."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from safety_harness.certification.tools import FaultState
from safety_harness.report.page_parts import render_page
from safety_harness.selftest.document import SelfTestRun
from safety_harness.selftest.outcome import FaultOutcome, tally_of
from safety_harness.selftest.table import HARMLESS_HEAD, HEAD, bad, harmless_row, in_table, row, summary
from safety_harness.whole_file import write_whole

STATE_CLASS = {
    FaultState.CAUGHT: "holds",
    FaultState.QUIET: "holds",
    FaultState.SURVIVES: "violated",
    FaultState.FALSE_ALARM: "violated",
    FaultState.LIMIT: "inconclusive",
    FaultState.TRUE_ALARM: "inconclusive",
    FaultState.UNTOUCHED: "none",
}


def write_page(path: Path, outcomes: Sequence[FaultOutcome], about: SelfTestRun) -> None:
    """Write the page whole or not at all; it asks nothing of the network.  Raises OSError."""
    write_whole(path, render(outcomes, about))


def render(outcomes: Sequence[FaultOutcome], about: SelfTestRun) -> str:
    """The page as text; the same arguments give the same bytes."""
    faults, harmless = in_table(outcomes)
    return render_page(
        "selftest.html.j2",
        style="tables.css",
        about=about,
        tally=tally_of(outcomes),
        summary=summary(tally_of(outcomes)),
        bad=bad(outcomes),
        faults=[(one, row(one)) for one in faults],
        harmless=[(one, harmless_row(one)) for one in harmless],
        head=HEAD,
        harmless_head=HARMLESS_HEAD,
        state_class=STATE_CLASS,
    )
