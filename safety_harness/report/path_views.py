"""The paths of one run seen from above (x-y) and from the side (x-z), each whole and close to the TCP."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from markupsafe import Markup

from safety_harness.report.evidence import JudgedRun
from safety_harness.report.path_artists import (
    MM,
    Floats,
    Moment,
    close_up_mm,
    draw_arm,
    draw_cell,
    draw_close_up_frame,
    draw_decisions,
    draw_forearms,
    draw_hands,
    draw_tcp,
    name_table,
)
from safety_harness.report.svg import Ink, drawing, new_figure, to_svg

if TYPE_CHECKING:
    from matplotlib.axes import Axes

WIDTH_PX, HEIGHT_PX = 430.0, 390.0
MARGINS_PX = (46.0, 12.0, 40.0, 26.0)  # left, right, below, above


def shown_moment(run: JudgedRun) -> Moment | None:
    """The worst moment of ``run.shown_claim()``, else the nearest hand; None without either.

    Every picture, button and replay of a run takes its moment from here.
    """
    ticks = run.trace.ticks
    if len(ticks) == 0:
        return None
    claim = run.shown_claim()
    if claim is not None:
        worst_s = run.evaluations[claim].worst_time_s
        assert worst_s is not None  # shown_claim() only names claims with a moment
        return Moment(int(np.argmin(np.abs(run.trace.time_s - worst_s))), worst_s, claim)
    distance = np.where(ticks["hand_present"], ticks["hand_distance_m"], np.inf)
    distance = np.where(np.isnan(distance), np.inf, distance)
    if not np.isfinite(distance).any():
        return None
    tick = int(np.argmin(distance.min(axis=1)))
    return Moment(tick, float(run.trace.time_s[tick]), None)


def path_views(run: JudgedRun, *, prefix: str) -> tuple[Markup, ...]:
    """The paths as SVG from above and from the side, both again close to the TCP; needs at least one tick."""
    moment = shown_moment(run)
    with drawing():
        return tuple(
            Markup(_view(run, moment, axis, close_up=close_up, prefix=prefix))
            for close_up in (False, True)
            for axis in (1, 2)
        )


def _view(run: JudgedRun, moment: Moment | None, axis: int, *, close_up: bool, prefix: str) -> str:
    """One view: base x to the right, base ``axis`` (1: y, 2: z) upwards, in millimetres."""
    trace = run.trace
    figure = new_figure(WIDTH_PX, HEIGHT_PX)
    left, right, below, above = MARGINS_PX
    size = 1.0 - (left + right) / WIDTH_PX, 1.0 - (below + above) / HEIGHT_PX
    axes = figure.add_axes((left / WIDTH_PX, below / HEIGHT_PX, *size))
    axes.grid(True)
    draw_cell(axes, trace.scenario.settings, axis)
    if moment is not None:
        draw_forearms(axes, trace, moment, axis)
    draw_hands(axes, trace, moment, axis)
    draw_tcp(axes, trace, moment, axis)
    if close_up:
        draw_decisions(axes, trace, axis)
        low, high = close_up_mm(trace)
        _fit(axes, low[[0, axis]], high[[0, axis]])
    else:
        draw_close_up_frame(axes, trace, axis)
        if axis == 2:
            name_table(axes, trace.scenario.settings.cell)
        if moment is not None:
            draw_arm(axes, trace, moment, axis)
        low, high = np.array(axes.dataLim.min), np.array(axes.dataLim.max)
        _fit(axes, low - 0.06 * (high - low), high + 0.06 * (high - low))
    axes.locator_params(nbins=6)
    axes.set_xlabel("x forward, mm", loc="right")
    name = f"{'top' if axis == 1 else 'side'}-{'close-' if close_up else ''}"
    seen = ("from above" if axis == 1 else "from the side") + (", close to the TCP" if close_up else "")
    axes.set_title(seen.capitalize().replace("tcp", "TCP"), loc="right", fontsize=11, fontweight="bold")
    axes.set_title(
        ("y left" if axis == 1 else "z up") + ", mm", loc="left", fontsize=11, color=Ink.MUTED.sentinel
    )
    return to_svg(
        figure,
        prefix=prefix + name,
        title=f"{trace.scenario.name}: paths seen {seen}",
        description=_description(run, moment, axis),
    )


def _fit(axes: Axes, low: Floats, high: Floats) -> None:
    """Show at least the rectangle from ``low`` to ``high`` (2,), at the same scale in both directions."""
    left, right, below, above = MARGINS_PX
    room_px = np.array([WIDTH_PX - left - right, HEIGHT_PX - below - above])
    half = 0.5 * room_px * float(np.max((high - low) / room_px))
    centre = 0.5 * (low + high)
    axes.set_xlim(centre[0] - half[0], centre[0] + half[0])
    axes.set_ylim(centre[1] - half[1], centre[1] + half[1])


def _description(run: JudgedRun, moment: Moment | None, axis: int) -> str:
    start = run.trace.ticks["transform_tcp_to_base"][0, :3, 3] * MM
    end = run.trace.ticks["transform_tcp_to_base"][-1, :3, 3] * MM
    text = (
        f"Base frame, millimetres. The TCP goes from x {start[0]:.0f}, {'xyz'[axis]} {start[axis]:.0f} "
        f"to x {end[0]:.0f}, {'xyz'[axis]} {end[axis]:.0f} with {len(run.trace.decisions)} decisions."
    )
    return text + (f" Hands are drawn in full at {moment.time_s:.2f} s." if moment else "")
