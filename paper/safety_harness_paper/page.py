"""One self-contained HTML page about the reproduction, in the style of the reports."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from markupsafe import Markup

from safety_harness.base.whole_file import write_whole
from safety_harness.cell.simulation.worlds import PYBULLET
from safety_harness.claims.properties.tally import basis
from safety_harness.extensions.pages.page_parts import render_page
from safety_harness.extensions.pages.replay import Replays
from safety_harness.report.evidence import JudgedRun
from safety_harness.report.words import with_minus
from safety_harness_paper.choices import CHOICES
from safety_harness_paper.document import About, comparison_words
from safety_harness_paper.plots import side_by_side, svg
from safety_harness_paper.result import ClaimState, PaperVerdict, Result

WORD_CLASS = {
    PaperVerdict.REPRODUCED: "holds",
    PaperVerdict.DIRECTION_ONLY: "inconclusive",
    PaperVerdict.NOT_REPRODUCED: "violated",
    PaperVerdict.NO_VERDICT: "none",
}
STATE_CLASS = {
    ClaimState.HOLDS: "holds",
    ClaimState.CONTRADICTED: "violated",
    ClaimState.UNDECIDED: "inconclusive",
}


Runs = Sequence[tuple[str, JudgedRun]]  # what was measured, and one episode of it


def write_page(path: Path, results: Sequence[Result], about: About, runs: Runs = ()) -> None:
    """Write the page whole or not at all; it asks nothing of the network.  Raises OSError."""
    write_whole(path, render(results, about, runs))


def render(results: Sequence[Result], about: About, runs: Runs = ()) -> str:
    """The page as text; the same arguments give the same bytes.  ``runs`` are replayed in 3-D on it."""
    replays = Replays()
    return render_page(
        "reproduction.html.j2",
        package="safety_harness_paper",
        basis=basis([str(PYBULLET)], "in as many runs as each result states"),
        style="tables.css",
        results=results,
        about=about,
        choices=CHOICES,
        counts=[
            (word.value, WORD_CLASS[word], sum(r.word is word for r in results)) for word in PaperVerdict
        ],
        word_class=WORD_CLASS,
        state_class=STATE_CLASS,
        words=comparison_words,
        minus=with_minus,
        replays=bool(runs),
        seen=[
            (words, run, replays.arguments(run, f"seen-{number}"))
            for number, (words, run) in enumerate(runs, start=1)
        ],
        drawings={result.name: _drawings(result) for result in results},
    )


def _drawings(result: Result) -> list[tuple[Markup, str]]:
    """Each with its caption."""
    drawn = []
    beside = side_by_side(result.comparisons, prefix=f"{result.name}-beside-", title=result.title)
    if beside:
        caption = (
            "Our means with 95 % intervals, divided by the paper's figures. On the line, both are equal."
        )
        drawn.append((Markup(beside), caption))
    for number, plot in enumerate(result.plots):
        drawn.append((Markup(svg(plot, prefix=f"{result.name}-{number}-")), f"{plot.title}. {plot.caption}"))
    return drawn
