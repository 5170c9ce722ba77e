"""Our own drawings of figures 5 to 8, and the paper's figures beside ours: SVG with the page's colours.

Every series has a colour, and a dash pattern or a marker of its own, so that none is told by colour alone.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

from safety_harness.extensions.pages.axes import Axes, Picture, Share
from safety_harness.extensions.pages.svg import DASHES, Ink
from safety_harness_paper.result import FigureComparison, Panel, Plot

WIDTH_PX, PANEL_PX, TOP_PX, GAP_PX, LEFT_PX, RIGHT_PX = 760.0, 190.0, 40.0, 88.0, 76.0, 16.0
MAP_PX, ROW_PX = 330.0, 24.0
INKS = (Ink.TCP, Ink.HAND_1, Ink.GREEN, Ink.HAND_2, Ink.PREDICTED, Ink.SKY)
MARKERS = ("o", "X", "s", "D")


def svg(plot: Plot, *, prefix: str) -> str:
    """A plot as one ``<svg>``: panels below each other, or two maps side by side."""
    if all(panel.kind == "map" for panel in plot.panels):
        picture = Picture(WIDTH_PX, MAP_PX + TOP_PX + GAP_PX)
        width = (WIDTH_PX - 2.0 * LEFT_PX - RIGHT_PX) / len(plot.panels)
        for number, panel in enumerate(plot.panels):
            left = LEFT_PX + number * (width + LEFT_PX)
            _map(picture.axes(left, TOP_PX + 8.0, width, MAP_PX), panel)
    else:
        picture = Picture(WIDTH_PX, TOP_PX + len(plot.panels) * (PANEL_PX + GAP_PX))
        for number, panel in enumerate(plot.panels):
            top = TOP_PX + number * (PANEL_PX + GAP_PX)
            DRAW[panel.kind](picture.axes(LEFT_PX, top, WIDTH_PX - LEFT_PX - RIGHT_PX, PANEL_PX), panel)
    return picture.svg(prefix=prefix, title=plot.title, description=plot.caption)


def _decorate(axes: Axes, panel: Panel) -> None:
    axes.title(panel.title, lift=26.0, bold=False)
    axes.x.label, axes.y.label = panel.x_label, panel.y_label
    axes.x.steps, axes.y.steps, axes.y.grid = 8, 6, True
    axes.legend(anchor="start")
    for number, (x, words) in enumerate(panel.marks):
        axes.vline(x, Ink.MUTED, width=1.0, dashes=(3, 2))
        at = Share(0.93 - 0.09 * number)  # they may be close to each other
        axes.text(words, x, at, shift=(3.0, 0.0), size=9.5)


def _lines(axes: Axes, panel: Panel) -> None:
    for one, ink, dashes in zip(panel.series, INKS, DASHES, strict=False):
        axes.line(one.x, one.y, ink, dashes=dashes, name=one.name)
    axes.x.margin = 0.0
    _decorate(axes, panel)


def _intervals(axes: Axes, panel: Panel) -> None:
    """Intervals as upright strokes, the truth as crosses on them."""
    predicted, truth = panel.series
    places = [(x, x, math.nan) for x in predicted.x]
    ends = [(low, high, math.nan) for low, high in zip(predicted.low, predicted.high, strict=True)]
    axes.line(sum(places, ()), sum(ends, ()), Ink.SKY, width=2.0, name=predicted.name)
    outside = [
        not low <= y <= high for low, y, high in zip(predicted.low, truth.y, predicted.high, strict=True)
    ]
    for name, wanted, shape, size, ink in (
        (f"{truth.name}, inside", False, "o", 3.2, Ink.TEXT),
        (f"{truth.name}, outside", True, "X", 5.0, Ink.LIMIT),
    ):
        rows = [k for k, is_out in enumerate(outside) if is_out is wanted]
        axes.marks([truth.x[k] for k in rows], [truth.y[k] for k in rows], shape, size, fill=ink, name=name)
    axes.x.margin = 0.01
    _decorate(axes, panel)


def _map(axes: Axes, panel: Panel) -> None:
    """Places, to scale."""
    for number, one in enumerate(panel.series):
        many = len(one.x) > 1
        axes.marks(
            one.x,
            one.y,
            MARKERS[number],
            4.0 if many else 10.0,
            fill=INKS[number],
            edge=Ink.PAPER,
            width=0.4,
            opacity=0.75 if many else 1.0,
            name=one.name,
        )
    axes.fit(*zip(axes.x.view(), axes.y.view(), strict=True))
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
    picture = Picture(WIDTH_PX, TOP_PX + ROW_PX * len(rows) + 44.0)
    axes = picture.axes(0.40 * WIDTH_PX, TOP_PX, 0.57 * WIDTH_PX, ROW_PX * len(rows))
    for lane, one in enumerate(rows):
        paper = one.paper or 1.0
        value = one.scale * one.ours.value / paper
        low, high = (one.scale * end / paper for end in (one.ours.low, one.ours.high))
        if math.isfinite(low) and math.isfinite(high):
            axes.line([low, high], [lane, lane], Ink.TCP, width=2.4)
        axes.marks([value], [lane], "o", 6.5, fill=Ink.TCP)
    axes.vline(1.0, Ink.LIMIT, width=1.4, dashes=(4, 3))
    axes.text("the paper's figure", 1.0, Share(1.0), shift=(0.0, -8.0), anchor="middle")
    axes.y.ticks, axes.y.line = [(lane, one.label) for lane, one in enumerate(rows)], False
    axes.y.show(len(rows) - 0.3, -0.7)
    for end in (0.0, 1.2):
        axes.x.hold(end)
    axes.x.grid, axes.x.steps = True, 8
    axes.x.label = "ours, times the paper's"
    words = f"{title}: our means with 95 % intervals divided by the paper's figures, {len(rows)} rows."
    return picture.svg(prefix=prefix, title=f"{title}: ours and the paper's", description=words)
