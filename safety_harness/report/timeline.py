"""What happened over time in one run: eight panels on one time axis, and what lies behind them all."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from safety_harness.report.evidence import JudgedRun
from safety_harness.report.panels import (
    COLUMNS,
    PANEL_PX,
    distance_panel,
    joint_panel,
    length_error_panel,
    predicted_panel,
    shape_error_panel,
    speed_panel,
    sse_panel,
)
from safety_harness.report.svg import Ink, drawing, new_figure, plain, spans, ticks_per_column, to_svg
from safety_harness.report.words import MODE_WORDS, OUTCOME_WORDS, share_words
from safety_harness.scenario.model import Verdict
from safety_harness.trace.records import DecisionOutcome, Mode
from safety_harness.trace.trace import Trace

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

LEFT_PX, RIGHT_PX, TOP_PX, BOTTOM_PX, GAP_PX = 104.0, 14.0, 22.0, 42.0, 34.0
WIDTH_PX = LEFT_PX + PANEL_PX + RIGHT_PX
HEIGHTS_PX = (112.0, 116.0, 92.0, 92.0, 92.0, 92.0, 92.0, 116.0)
MODE_INK = {
    Mode.SERVOING: Ink.SERVOING,
    Mode.REPULSING: Ink.REPULSING,
    Mode.PROTECTIVE_STOP: Ink.STOPPED,
    Mode.OBJECT_LOST: Ink.LOST,
}
OUTCOME_MARKER = {  # shape, size, fill, edge, and the edge's width
    DecisionOutcome.PROPOSED: ("o", 7.5, Ink.TEXT.sentinel, Ink.PAPER.sentinel, 0.8),
    DecisionOutcome.OPPOSITE: ("D", 7.5, Ink.PAPER.sentinel, Ink.TEXT.sentinel, 2.0),
    DecisionOutcome.STOP: ("X", 10.0, Ink.TEXT.sentinel, Ink.PAPER.sentinel, 0.8),
}
FAULT_MARKER = "o", 16.0, "none", Ink.LIMIT.sentinel, 1.8
DECISION_LANE = len(Mode)
FAULT_LANE = DECISION_LANE + 1  # only where the scenario has faults


def thinning(trace: Trace) -> int:
    """How many consecutive ticks one drawn column stands for."""
    return ticks_per_column(len(trace.ticks), COLUMNS)


def timeline(run: JudgedRun, *, prefix: str) -> str:
    """All panels as one SVG; needs at least one tick."""
    trace = run.trace
    with drawing():
        height = TOP_PX + BOTTOM_PX + sum(HEIGHTS_PX) + GAP_PX * (len(HEIGHTS_PX) - 1)
        figure = new_figure(WIDTH_PX, height)
        end_s = max(trace.scenario.duration_s, float(trace.time_s[-1]))
        backdrop = _add_axes(figure, height, TOP_PX, height - TOP_PX - BOTTOM_PX, end_s)
        backdrop.set_axis_off()
        backdrop.set_ylim(0.0, 1.0)
        _shade(backdrop, trace, end_s)
        _mark_moments(backdrop, run)
        panels = []
        top = TOP_PX
        for panel_height in HEIGHTS_PX:
            panels.append(_add_axes(figure, height, top, panel_height, end_s))
            top += panel_height + GAP_PX
        _mode_panel(panels[0], trace, end_s)
        distance_panel(panels[1], run)
        predicted_panel(panels[2], trace)
        length_error_panel(panels[3], trace)
        shape_error_panel(panels[4], trace)
        sse_panel(panels[5], trace)
        speed_panel(panels[6], run)
        joint_panel(panels[7], trace)
        for panel in panels[:-1]:
            panel.tick_params(labelbottom=False)
        panels[-1].set_xlabel("time, s", loc="right")
        return to_svg(
            figure,
            prefix=prefix,
            title=f"{trace.scenario.name}: what happened over time",
            description=_description(run),
        )


def _description(run: JudgedRun) -> str:
    trace = run.trace
    modes = trace.ticks["mode"]
    shares = [
        f"{words} {share_words(int(np.count_nonzero(modes == mode)), len(modes))}"
        for mode, words in MODE_WORDS.items()
    ]
    outcomes = trace.decisions["outcome"]
    counts = [
        f"{int(np.count_nonzero(outcomes == outcome))} {words}" for outcome, words in OUTCOME_WORDS.items()
    ]
    return (
        f"Panels from {trace.time_s[0]:.2f} to {trace.time_s[-1]:.2f} s: controller mode, distance of hands, "
        f"distance of the predicted hand, feature errors, squared image error, TCP speed, joint angles. "
        f"Share of the ticks: {', '.join(shares)}. Outcomes of decisions: {', '.join(counts)}."
    )


def _add_axes(figure: Figure, height: float, top: float, panel_height: float, end_s: float) -> Axes:
    axes = figure.add_axes(
        (LEFT_PX / WIDTH_PX, 1.0 - (top + panel_height) / height, PANEL_PX / WIDTH_PX, panel_height / height)
    )
    axes.set_xlim(0.0, end_s)
    return axes


def _shade(backdrop: Axes, trace: Trace, end_s: float) -> None:
    """Every mode but servoing as a tint behind all panels, and the part that was never run."""
    ticks_end_s = min(end_s, float(trace.time_s[-1]) + trace.scenario.settings.clock.control_period_s)
    for mode in (Mode.REPULSING, Mode.PROTECTIVE_STOP, Mode.OBJECT_LOST):
        found = spans(trace.time_s, trace.ticks["mode"] == mode, ticks_end_s, COLUMNS)
        backdrop.broken_barh(
            found, (0.0, 1.0), facecolor=MODE_INK[mode].sentinel, edgecolor="none", alpha=0.13
        )
    if not trace.complete and ticks_end_s < end_s:
        backdrop.axvspan(
            ticks_end_s, end_s, facecolor="none", edgecolor=Ink.MISSING.sentinel, hatch="///", linewidth=0.0
        )
        backdrop.axvline(ticks_end_s, color=Ink.TEXT.sentinel, linewidth=1.2)


def _mark_moments(backdrop: Axes, run: JudgedRun) -> None:
    """Decisions as thin lines; each claim's worst moment, solid when it is violated."""
    asked_s = run.trace.decisions["time_s"]
    backdrop.plot(
        np.repeat(asked_s, 3),
        np.tile([0.0, 1.0, np.nan], len(asked_s)),
        color=Ink.TEXT.sentinel,
        linewidth=0.6,
        alpha=0.45,
    )
    labelled: dict[float, list[str]] = {}
    for number, evaluation in enumerate(run.evaluations, start=1):
        if evaluation.worst_time_s is None or not np.isfinite(evaluation.worst_time_s):
            continue
        violated = evaluation.verdict is Verdict.VIOLATED
        backdrop.axvline(
            evaluation.worst_time_s,
            color=Ink.LIMIT.sentinel if violated else Ink.MUTED.sentinel,
            linewidth=1.8 if violated else 1.0,
            linestyle="solid" if violated else (0, (1, 2)),
        )
        labelled.setdefault(round(evaluation.worst_time_s, 2), []).append(str(number))
    last_s = -np.inf
    for time_s, numbers in sorted(labelled.items()):
        if time_s - last_s < 0.035 * backdrop.get_xlim()[1]:
            continue  # no room for another number; the table above has every moment
        backdrop.annotate(
            ",".join(numbers),
            (time_s, 1.0),
            xytext=(0, 4),
            textcoords="offset points",
            ha="center",
            va="bottom",
            annotation_clip=False,
        )
        last_s = time_s


def _mode_panel(axes: Axes, trace: Trace, end_s: float) -> None:
    """One lane for each mode, above them a mark for each decision, and where the faults acted."""
    ticks_end_s = min(end_s, float(trace.time_s[-1]) + trace.scenario.settings.clock.control_period_s)
    for lane, mode in enumerate(Mode):
        found = spans(trace.time_s, trace.ticks["mode"] == mode, ticks_end_s, COLUMNS)
        axes.broken_barh(found, (lane - 0.28, 0.56), facecolor=MODE_INK[mode].sentinel, edgecolor="none")
    _mark_decisions(axes, trace)
    lanes = [*MODE_WORDS.values(), "decisions"]
    if trace.scenario.faults:
        acted = spans(trace.time_s, trace.ticks["faults"] != 0, ticks_end_s, COLUMNS)
        axes.broken_barh(acted, (FAULT_LANE - 0.28, 0.56), facecolor=Ink.LIMIT.sentinel, edgecolor="none")
        lanes.append("faults")
    axes.set_yticks(range(len(lanes)), lanes)
    axes.set_ylim(-0.6, len(lanes) - 0.4)
    axes.tick_params(axis="y", length=0)
    axes.spines["left"].set_visible(False)
    if not trace.complete:
        axes.annotate(
            f"ended: {plain(trace.ended)}",
            (min(ticks_end_s, 0.8 * end_s), 0.0),
            xytext=(6, 0),
            textcoords="offset points",
            va="center",
        )


def _mark_decisions(axes: Axes, trace: Trace) -> None:
    """A mark for each decision whose shape is its outcome; a ring where the avoider had no usable answer."""
    decisions = trace.decisions
    marks = [(decisions["outcome"] == outcome, mark) for outcome, mark in OUTCOME_MARKER.items()]
    for these, (shape, size, fill, edge, width) in [*marks, (decisions["fault"] != "", FAULT_MARKER)]:
        times = decisions["time_s"][these]
        axes.plot(
            times,
            np.full(len(times), DECISION_LANE),
            linestyle="none",
            marker=shape,
            markersize=size,
            markerfacecolor=fill,
            markeredgecolor=edge,
            markeredgewidth=width,
        )
