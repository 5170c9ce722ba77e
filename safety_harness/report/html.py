"""One self-contained HTML file about one or many runs."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import datetime
from pathlib import Path

from markupsafe import Markup

from safety_harness.properties.tally import ClaimTally
from safety_harness.report.decisions import (
    MOST_DECISION_ROWS,
    DecisionTally,
    decision_rows,
    failed_checks,
    fault_notes,
    latency_words,
)
from safety_harness.report.evidence import JudgedRun, tallies
from safety_harness.report.page_parts import in_words, render_page
from safety_harness.report.path_artists import MOST_NUMBERS
from safety_harness.report.path_views import path_views, shown_moment
from safety_harness.report.timeline import thinning, timeline
from safety_harness.report.view import (
    changes,
    claim_rows,
    coverage_rows,
    file_name,
    limit_rows,
    mode_rows,
    notes,
    summarise,
)
from safety_harness.report.words import count_words, share_words
from safety_harness.scenario.write import write_scenario
from safety_harness.whole_file import write_whole


def write_report(
    path: Path,
    runs: Sequence[JudgedRun],
    *,
    title: str,
    command: str,
    interrupted: bool,
    generated_at: datetime,
    coverage: Sequence[ClaimTally] | None = None,
) -> None:
    """Write the report on ``runs`` to ``path``, whole or not at all; it asks nothing of the network.

    ``command`` is the command line that made the report; ``interrupted`` says that more runs were
    planned than are here.  ``coverage`` is how often each claim was put to the test, where that was in
    more runs than are shown.  Folders that are missing are made.  Raises OSError.
    """
    page = render(
        runs,
        title=title,
        command=command,
        interrupted=interrupted,
        generated_at=generated_at,
        coverage=coverage,
    )
    write_whole(path, page)


def render(
    runs: Sequence[JudgedRun],
    *,
    title: str,
    command: str,
    interrupted: bool,
    generated_at: datetime,
    coverage: Sequence[ClaimTally] | None = None,
) -> str:
    """The page as text; the same arguments give the same bytes."""
    summary = summarise(runs, interrupted=interrupted)
    fallback = summary.decisions.fallback
    return render_page(
        "report.html.j2",
        title=f"{title}; {fallback}" if fallback else title,
        command=command,
        generated=in_words(generated_at),
        generated_iso=generated_at.isoformat(),
        summary=summary,
        sections=[_section(run, number) for number, run in enumerate(runs, start=1)],
        coverage=coverage_rows(tallies(runs) if coverage is None else coverage),
        most_decisions=MOST_DECISION_ROWS,
        share=share_words,
        count=count_words,
        most_numbers=MOST_NUMBERS,
    )


def _section(run: JudgedRun, number: int) -> dict[str, object]:
    """Everything that the page shows about one run."""
    section, trace = f"run-{number}", run.trace
    drawn = len(trace.ticks) > 0
    moment = shown_moment(run)
    return {
        "id": section,
        "run": run,
        "claims": claim_rows(run, section),
        "views": path_views(run, prefix=f"{section}-") if drawn else (),
        "timeline": Markup(timeline(run, prefix=f"{section}-time-") if drawn else ""),
        "moment_time": f"{moment.time_s:.3f} s" if moment else "",
        "moment_claim": moment.claim + 1 if moment and moment.claim is not None else None,  # counted from 1
        "thinned": thinning(trace),
        "file": file_name(run),
        "tally": DecisionTally.of([trace]),
        "decisions": decision_rows(trace),
        "failed_checks": failed_checks(trace),  # name, meaning
        "faults": fault_notes(trace),
        "latency": latency_words(trace),
        "limits": limit_rows(trace),
        "modes": mode_rows(trace),
        "notes": notes(run),
        "changes": changes(run),
        "text": write_scenario(trace.scenario),
    }
