"""How near a search came to each claim: the least margin so far over the runs, one panel a claim."""

from __future__ import annotations

from typing import TYPE_CHECKING

from safety_harness.report.palette import Ink
from safety_harness.report.panels import DASHES
from safety_harness.report.svg import drawing, new_figure, plain, to_svg
from safety_harness.search.findings import Findings

if TYPE_CHECKING:
    from matplotlib.axes import Axes

WIDTH_PX, PANEL_PX, TOP_PX, GAP_PX, LEFT_PX, RIGHT_PX = 960.0, 130.0, 30.0, 62.0, 76.0, 20.0
INKS = (Ink.TCP, Ink.HAND_2)  # the search, the baseline


def progress_figure(searches: list[Findings], *, prefix: str) -> str:
    """An ``<svg>``; of the one or two searches the second is the baseline.  Runs on a logarithmic axis.

    A cross is the first violation.  Empty text where no claim has a margin yet.
    """
    claims = [k for k in range(len(searches[0].goals)) if any(one.improvements[k] for one in searches)]
    if not claims:
        return ""
    height = TOP_PX + len(claims) * (PANEL_PX + GAP_PX)
    with drawing():
        figure = new_figure(WIDTH_PX, height)
        for row, claim in enumerate(claims):
            bottom = height - TOP_PX - row * (PANEL_PX + GAP_PX) - PANEL_PX
            size = (1.0 - (LEFT_PX + RIGHT_PX) / WIDTH_PX, PANEL_PX / height)
            axes = figure.add_axes((LEFT_PX / WIDTH_PX, bottom / height, *size))
            for findings, ink, dashes in zip(searches, INKS, DASHES, strict=False):
                _curve(axes, findings, claim, ink, dashes)
            _decorate(axes, searches, claim)
        names = " and ".join(one.searcher for one in searches)
        return to_svg(
            figure,
            prefix=prefix,
            title="Least margin so far, over the runs",
            description=f"One panel for each claim, searched by {names}; the table has the numbers.",
        )


def _curve(axes: Axes, findings: Findings, claim: int, ink: Ink, dashes: object) -> None:
    steps = findings.improvements[claim]
    if not steps:
        return
    per_si = findings.goals[claim].unit.per_si
    runs = [run for run, _ in steps] + [findings.tried]
    margins = [margin * per_si for _, margin in steps]
    axes.plot(
        runs,
        [*margins, margins[-1]],
        drawstyle="steps-post",
        color=ink.sentinel,
        linestyle=dashes,
        linewidth=1.6,
    )
    first = int(findings.first_violation[claim])
    if first:
        margin = next(margin for run, margin in reversed(steps) if run <= first) * per_si
        axes.plot([first], [margin], marker="X", markersize=8.0, markeredgewidth=0.0, color=ink.sentinel)


def _decorate(axes: Axes, searches: list[Findings], claim: int) -> None:
    goal = searches[0].goals[claim]
    axes.set_xscale("log")
    axes.set_xlim(1.0, max(2, *(one.tried for one in searches)))
    axes.axhline(0.0, color=Ink.LIMIT.sentinel, linewidth=1.2, linestyle=(0, (4, 3)))
    axes.margins(y=0.12)
    axes.grid(True, axis="y")
    axes.locator_params(axis="y", nbins=5)
    axes.minorticks_off()
    ticks = [10**k for k in range(12) if 10**k <= axes.get_xlim()[1]]
    axes.set_xticks(ticks, [f"{tick:,}" for tick in ticks])
    axes.set_title(
        plain(f"{claim + 1}  {goal.sentence}", longest=110),
        loc="left",
        fontsize=11,
        color=Ink.TEXT.sentinel,
        pad=8,
    )
    axes.set_ylabel(f"margin, {goal.unit.symbol}" if goal.unit.symbol else "margin")
    axes.set_xlabel("runs", loc="right")
