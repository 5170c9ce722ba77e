"""Our own drawings of figures 5 to 8, and the paper's figures beside ours: SVG with the page's colours.

Every series has a colour, and a dash pattern or a marker of its own, so that none is told by colour alone.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

from safety_harness.report.svg import DASHES, Ink, drawing, new_figure, to_svg
from safety_harness_paper.result import FigureComparison, Panel, Plot

if TYPE_CHECKING:
    from matplotlib.axes import Axes

WIDTH_PX, PANEL_PX, TOP_PX, GAP_PX, LEFT_PX, RIGHT_PX = 760.0, 190.0, 40.0, 88.0, 76.0, 16.0
MAP_PX, ROW_PX = 330.0, 24.0
INKS = (Ink.TCP, Ink.HAND_1, Ink.GREEN, Ink.HAND_2, Ink.PREDICTED, Ink.SKY)
MARKERS = ("o", "X", "P", "D")


def svg(plot: Plot, *, prefix: str) -> str:
    """A plot as one ``<svg>``: panels below each other, or two maps side by side."""
    with drawing():
        if all(panel.kind == "map" for panel in plot.panels):
            height = MAP_PX + TOP_PX + GAP_PX
            figure = new_figure(WIDTH_PX, height)
            width = (WIDTH_PX - 2.0 * LEFT_PX - RIGHT_PX) / len(plot.panels)
            for number, panel in enumerate(plot.panels):
                left = LEFT_PX + number * (width + LEFT_PX)
                axes = figure.add_axes(
                    (left / WIDTH_PX, 0.5 * GAP_PX / height + 0.02, width / WIDTH_PX, MAP_PX / height)
                )
                _map(axes, panel)
        else:
            height = TOP_PX + len(plot.panels) * (PANEL_PX + GAP_PX)
            figure = new_figure(WIDTH_PX, height)
            for number, panel in enumerate(plot.panels):
                bottom = height - TOP_PX - (number + 1) * PANEL_PX - number * GAP_PX
                axes = figure.add_axes(
                    (
                        LEFT_PX / WIDTH_PX,
                        bottom / height,
                        1.0 - (LEFT_PX + RIGHT_PX) / WIDTH_PX,
                        PANEL_PX / height,
                    )
                )
                DRAW[panel.kind](axes, panel)
        return to_svg(figure, prefix=prefix, title=plot.title, description=plot.caption)


def _decorate(axes: Axes, panel: Panel) -> None:
    axes.set_title(panel.title, loc="left", fontsize=11, color=Ink.TEXT.sentinel, pad=24)
    axes.set_xlabel(panel.x_label, loc="right")
    axes.set_ylabel(panel.y_label)
    axes.grid(True, axis="y")
    handles, _ = axes.get_legend_handles_labels()
    lines = panel.kind == "lines"
    axes.legend(
        frameon=False,
        ncols=len(handles),
        loc="lower left",
        bbox_to_anchor=(-0.01, 0.99),
        fontsize=9.5 if panel.kind != "map" else 9.0,
        handlelength=2.2 if lines else 1.0,
        handletextpad=0.4,
        columnspacing=1.0,
        borderaxespad=0.2,
    )
    for number, (x, words) in enumerate(panel.marks):
        axes.axvline(x, color=Ink.MUTED.sentinel, linewidth=1.0, linestyle=(0, (3, 2)))
        axes.annotate(
            words,
            (x, 0.98 - 0.09 * number),  # they may be close to each other
            xycoords=("data", "axes fraction"),
            xytext=(3, 0),
            textcoords="offset points",
            va="top",
            fontsize=9.5,
        )


def _lines(axes: Axes, panel: Panel) -> None:
    for one, ink, dashes in zip(panel.series, INKS, DASHES, strict=False):
        axes.plot(one.x, one.y, label=one.name, color=ink.sentinel, linestyle=dashes, linewidth=1.5)
    axes.margins(x=0.0)
    _decorate(axes, panel)


def _intervals(axes: Axes, panel: Panel) -> None:
    """Intervals as upright strokes, the truth as crosses on them."""
    predicted, truth = panel.series
    axes.vlines(
        predicted.x,
        predicted.low,
        predicted.high,
        color=Ink.SKY.sentinel,
        linewidth=2.0,
        label=predicted.name,
    )
    outside = [
        not low <= y <= high for low, y, high in zip(predicted.low, truth.y, predicted.high, strict=True)
    ]
    for name, wanted, marker, ink in (
        (f"{truth.name}, inside", False, "o", Ink.TEXT),
        (f"{truth.name}, outside", True, "X", Ink.LIMIT),
    ):
        rows = [k for k, is_out in enumerate(outside) if is_out is wanted]
        axes.plot(
            [truth.x[k] for k in rows],
            [truth.y[k] for k in rows],
            linestyle="none",
            marker=marker,
            markersize=3.2 if marker == "o" else 5.0,
            markeredgewidth=0.0,
            color=ink.sentinel,
            label=name,
        )
    axes.margins(x=0.01)
    _decorate(axes, panel)


def _map(axes: Axes, panel: Panel) -> None:
    """Places, to scale."""
    for number, one in enumerate(panel.series):
        many = len(one.x) > 1
        axes.plot(
            one.x,
            one.y,
            linestyle="none",
            marker=MARKERS[number],
            markersize=4.0 if many else 10.0,
            markeredgecolor=Ink.PAPER.sentinel,
            markeredgewidth=0.4,
            color=INKS[number].sentinel,
            alpha=0.75 if many else 1.0,
            label=one.name,
        )
    axes.set_aspect("equal", adjustable="datalim")
    _decorate(axes, panel)


DRAW: dict[str, Callable[[Axes, Panel], None]] = {"lines": _lines, "intervals": _intervals, "map": _map}


def side_by_side(comparisons: Sequence[FigureComparison], *, prefix: str, title: str) -> str:
    """Ours with its interval against the paper's figure, one row each, in units of the paper's figure.

    Rows without a figure of the paper that is compared, or with one that is 0, are left out; empty if none is
    left.
    """
    rows = [one for one in comparisons if one.paper and one.counts]
    if not rows:
        return ""
    height = TOP_PX + ROW_PX * len(rows) + 44.0
    with drawing():
        figure = new_figure(WIDTH_PX, height)
        axes = figure.add_axes((0.40, 44.0 / height, 0.57, ROW_PX * len(rows) / height))
        for place, one in enumerate(reversed(rows)):
            paper = one.paper or 1.0
            value = one.scale * one.ours.value / paper
            low, high = (one.scale * end / paper for end in (one.ours.low, one.ours.high))
            if math.isfinite(low) and math.isfinite(high):
                axes.plot([low, high], [place, place], color=Ink.TCP.sentinel, linewidth=2.4)
            axes.plot([value], [place], marker="o", markersize=6.5, color=Ink.TCP.sentinel, linestyle="none")
        axes.axvline(1.0, color=Ink.LIMIT.sentinel, linewidth=1.4, linestyle=(0, (4, 3)))
        axes.annotate(
            "the paper's figure",
            (1.0, 1.0),
            xycoords=("data", "axes fraction"),
            xytext=(0, 6),
            textcoords="offset points",
            ha="center",
        )
        axes.set_yticks(range(len(rows)), [one.label for one in reversed(rows)])
        axes.tick_params(axis="y", length=0)
        axes.set_ylim(-0.7, len(rows) - 0.3)
        axes.set_xlim(min(0.0, axes.get_xlim()[0]), max(1.2, axes.get_xlim()[1]))
        axes.grid(True, axis="x")
        axes.set_xlabel("ours, times the paper's", loc="right")
        words = f"{title}: our means with 95 % intervals divided by the paper's figures, {len(rows)} rows."
        return to_svg(figure, prefix=prefix, title=f"{title}: ours and the paper's", description=words)
