"""Write one self-contained page with the 3-D replay of one run, or of two synchronous runs side by side."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from markupsafe import Markup

from safety_harness.base.whole_file import write_whole
from safety_harness.extensions.pages.page_parts import render_page
from safety_harness.extensions.pages.replay import Replays, start_s
from safety_harness.extensions.pages.run_page import claim_rows, notes
from safety_harness.extensions.pages.timeline import timeline
from safety_harness.report.evidence import JudgedRun, basis_of
from safety_harness.report.knowledge import measured_lines

LANES = ("one", "two")


def write_view(path: Path, runs: Sequence[tuple[str, JudgedRun]]) -> None:
    """Write the page of one or two runs.

    Each item of ``runs`` is a pair (name, run), and each run has at least one tick. Raise OSError if the page
    cannot be written.
    """
    replays = Replays()
    lanes = LANES if len(runs) == len(LANES) else ("",)
    sections = [
        {
            "id": f"view-{number}",
            "name": name,
            "run": run,
            "lane": lane,
            "replay": replays.arguments(run, f"view-{number}", from_s=start_s(runs[0][1])),
            "claims": claim_rows(run),
            "measured": measured_lines(run.trace),
            "notes": notes(run),
            "timeline": Markup(timeline(run, prefix=f"view-{number}-time-")),
        }
        for number, ((name, run), lane) in enumerate(zip(runs, lanes, strict=True), start=1)
    ]
    title = " beside ".join(name for name, _ in runs)
    basis = basis_of([run for _, run in runs])
    write_whole(path, render_page("view.html.j2", basis=basis, replays=True, title=title, sections=sections))
