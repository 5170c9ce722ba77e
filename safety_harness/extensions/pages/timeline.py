"""Draw one run over time, in eight panels with a common time axis and a common background.

A labelled horizontal line shows a limit. Each limit is drawn only in the panel of the quantity that it
limits. The length in a claim is drawn with the distance between surfaces. The critical distance is drawn with
the distance to the predicted hand's centre.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from itertools import cycle

import numpy as np

from safety_harness.base.proportions import share_words
from safety_harness.claims.properties.base import Evaluation
from safety_harness.extensions.pages.axes import Axes, Picture, Share, text_px
from safety_harness.extensions.pages.svg import (
    DASHES,
    HANDS,
    Floats,
    Ink,
    keep_extremes,
    plain,
    spans,
    ticks_per_column,
)
from safety_harness.report.evidence import JudgedRun
from safety_harness.report.words import (
    MODE_WORDS,
    OUTCOME_WORDS,
    claimed_hand_distance_m,
    claimed_tcp_speed_mps,
)
from safety_harness.scenario.model import Verdict
from safety_harness.scenario.robots import OwnRobot
from safety_harness.trace.records import DecisionOutcome, Mode
from safety_harness.trace.trace import Trace
from safety_harness.trace.unmeasured import decided, measured

PANEL_PX = 882.0  # width; a choice
COLUMNS = int(PANEL_PX / 2.0)  # a column is as wide as a line, which covers the column's two extremes
MM, DEGREES = 1e3, 180.0 / np.pi

UR_JOINTS = ("pan", "lift", "elbow", "wrist 1", "wrist 2", "wrist 3")
JOINT_INKS = (
    *(Ink.TCP, Ink.HAND_1, Ink.GREEN, Ink.HAND_2, Ink.PREDICTED, Ink.SKY),
    *(Ink.LIMIT, Ink.MUTED),
)
SUPERSCRIPT = str.maketrans(
    "-0123456789", "\u207b\u2070\u00b9\u00b2\u00b3\u2074\u2075\u2076\u2077\u2078\u2079"
)
MOST_DECADES = 4  # steps between the labels of a logarithmic axis
LABEL_PX = 13.0  # the height of a limit's name
LEFT_PX, RIGHT_PX, TOP_PX, BOTTOM_PX, GAP_PX = 104.0, 14.0, 22.0, 42.0, 34.0
WIDTH_PX = LEFT_PX + PANEL_PX + RIGHT_PX
TIME_STEPS = 10  # between the ticks of the time axis, at most
# One for each panel, in the order of COLUMNS_SHOWN.
HEIGHTS_PX = (112.0, 116.0, 92.0, 92.0, 92.0, 92.0, 92.0, 116.0)
COLUMNS_SHOWN = (  # the columns that each panel shows
    ("mode",),
    ("hand_present", "hand_distance_m"),
    ("predicted_distance_m",),
    *(("object_visible", "feature_error"),) * 2,
    ("object_visible", "sse"),
    ("tcp_speed_mps",),
    ("joint_position_rad",),
)
MODE_INK = {
    Mode.SERVOING: Ink.SERVOING,
    Mode.REPULSING: Ink.REPULSING,
    Mode.PROTECTIVE_STOP: Ink.STOPPED,
    Mode.OBJECT_LOST: Ink.LOST,
}
OUTCOME_MARKER = {  # shape, size, fill, edge, and the edge's width
    DecisionOutcome.PROPOSED: ("o", 7.5, Ink.TEXT, Ink.PAPER, 0.8),
    DecisionOutcome.OPPOSITE: ("D", 7.5, Ink.PAPER, Ink.TEXT, 2.0),
    DecisionOutcome.STOP: ("X", 10.0, Ink.TEXT, Ink.PAPER, 0.8),
}
FAULT_MARKER = "o", 16.0, None, Ink.LIMIT, 1.8
DECISION_LANE = len(Mode)
FAULT_LANE = DECISION_LANE + 1  # only where the scenario has faults

Line = tuple[str, Floats, Ink, tuple[float, ...]]  # name, (n,) values, colour, dash pattern


def thinning(trace: Trace) -> int:
    """Return the number of consecutive ticks in one drawn column."""
    return ticks_per_column(len(trace.ticks), COLUMNS)


def timeline(run: JudgedRun, *, prefix: str) -> str:
    """Return all panels as one SVG.

    Args:
        run: A run with at least one tick.
        prefix: The text with which every id starts.

    """
    trace = run.trace
    height = TOP_PX + BOTTOM_PX + sum(HEIGHTS_PX) + GAP_PX * (len(HEIGHTS_PX) - 1)
    picture = Picture(WIDTH_PX, height)
    end_s = max(trace.scenario.duration_s, float(trace.time_s[-1]))
    backdrop = _add_axes(picture, TOP_PX, height - TOP_PX - BOTTOM_PX, end_s)
    backdrop.x.line = backdrop.y.line = backdrop.y.labelled = False
    backdrop.y.show(0.0, 1.0)
    _shade(backdrop, trace, end_s)
    _mark_moments(backdrop, run)
    panels = []
    top = TOP_PX
    for panel_height in HEIGHTS_PX:
        panels.append(_add_axes(picture, top, panel_height, end_s))
        top += panel_height + GAP_PX
    _mode_panel(panels[0], trace, end_s)
    distance_panel(panels[1], run)
    predicted_panel(panels[2], trace)
    errors = _seen(trace, "feature_error")
    error_panel(panels[3], trace, "Feature errors, lengths, mm", errors[:, :3] * MM, LENGTHS)
    error_panel(panels[4], trace, OF_SHAPES, errors[:, 3:], SHAPES)
    sse_panel(panels[5], trace)
    speed_panel(panels[6], run)
    joint_panel(panels[7], trace)
    for panel, names in zip(panels, COLUMNS_SHOWN, strict=True):
        _hatch_unmeasured(panel, trace, names, end_s)
    panels[-1].x.labelled, panels[-1].x.label = True, "time, s"
    return picture.svg(
        prefix=prefix,
        title=f"{trace.scenario.name}: time series",
        description=_description(run),
    )


def _description(run: JudgedRun) -> str:
    trace = run.trace
    modes = trace.ticks["mode"]
    shares = [
        f"{label} {share_words(int(np.count_nonzero(modes == mode)), len(modes))}"
        for mode, label in MODE_WORDS.items()
    ]
    outcomes = trace.decisions["outcome"]
    counts = [
        f"{int(np.count_nonzero(outcomes == outcome))} {label}" for outcome, label in OUTCOME_WORDS.items()
    ]
    return (
        f"Panels from {trace.time_s[0]:.2f} to {trace.time_s[-1]:.2f} s: controller mode, distance of hands, "
        f"distance of the predicted hand, feature errors, squared image error, TCP speed, joint angles. "
        f"Share of the ticks: {', '.join(shares)}. Outcomes of decisions: {', '.join(counts)}."
        if decided(trace, "outcome") and measured(trace, "mode").all()
        else "Some modes or decisions were not measured."
    )


def _hatch_unmeasured(axes: Axes, trace: Trace, names: Sequence[str], end_s: float) -> None:
    """Hatch the times at which a quantity of the panel was not measured."""
    hands = len(trace.scenario.hands)
    there = np.ones(len(trace.ticks), np.bool_)
    for known in (measured(trace, name) for name in names):
        there &= known if known.ndim == 1 else known[:, :hands].all(axis=1)
    if not there.all():
        low, high = axes.y.view()
        # Fix the view first, so that the bars do not extend it.
        axes.y.show(low, high)
        axes.bars(spans(trace.time_s, ~there, end_s, COLUMNS), (low, high), Ink.MISSING, hatched=True)
    if not there.any():
        axes.text("not measured", Share(0.5), Share(0.5), anchor="middle")


def _add_axes(picture: Picture, top: float, height: float, end_s: float) -> Axes:
    axes = picture.axes(LEFT_PX, top, PANEL_PX, height)
    axes.x.steps, axes.x.labelled = TIME_STEPS, False
    axes.x.show(0.0, end_s)
    return axes


def _shade(backdrop: Axes, trace: Trace, end_s: float) -> None:
    """Tint the background of all panels for every mode except servoing.

    Hatch the time after an early end.
    """
    ticks_end_s = min(end_s, float(trace.time_s[-1]) + trace.scenario.settings.clock.control_period_s)
    known = measured(trace, "mode")
    for mode in (Mode.REPULSING, Mode.PROTECTIVE_STOP, Mode.OBJECT_LOST):
        stretches = spans(trace.time_s, known & (trace.ticks["mode"] == mode), ticks_end_s, COLUMNS)
        backdrop.bars(stretches, (0.0, 1.0), MODE_INK[mode], opacity=0.13)
    if not trace.complete and ticks_end_s < end_s:
        backdrop.bars([(ticks_end_s, end_s - ticks_end_s)], (0.0, 1.0), Ink.MISSING, hatched=True)
        backdrop.vline(ticks_end_s, Ink.TEXT, width=1.2)


def _mark_moments(backdrop: Axes, run: JudgedRun) -> None:
    """Draw a thin line at each decision, and a line at each claim's worst moment.

    The line of a violation is solid.
    """
    asked_s = run.trace.decisions["time_s"]
    ups = np.tile([0.0, 1.0, np.nan], len(asked_s))
    backdrop.line(np.repeat(asked_s, 3), ups, Ink.TEXT, width=0.6, opacity=0.45)
    labelled: dict[float, list[str]] = {}
    for number, evaluation in enumerate(run.evaluations, start=1):
        if evaluation.worst_time_s is None or not np.isfinite(evaluation.worst_time_s):
            continue
        violated = evaluation.verdict is Verdict.VIOLATED
        ink, width, dashes = (Ink.LIMIT, 1.8, ()) if violated else (Ink.MUTED, 1.0, (1, 2))
        backdrop.vline(evaluation.worst_time_s, ink, width=width, dashes=dashes)
        labelled.setdefault(round(evaluation.worst_time_s, 2), []).append(str(number))
    end_px = -np.inf
    for time_s, numbers in sorted(labelled.items()):
        label = ",".join(numbers)
        place_px, half_px = backdrop.x.at(time_s), 0.5 * text_px(label)
        if place_px - half_px < end_px:
            continue  # there is no room for another number; the table above lists every moment
        backdrop.text(label, time_s, Share(1.0), shift=(0.0, -6.0), anchor="middle")
        end_px = place_px + half_px


def _mode_panel(axes: Axes, trace: Trace, end_s: float) -> None:
    """Draw a lane for each mode, a lane with a mark for each decision, and the times at which faults act."""
    ticks_end_s = min(end_s, float(trace.time_s[-1]) + trace.scenario.settings.clock.control_period_s)
    known = measured(trace, "mode")
    for lane, mode in enumerate(Mode):
        stretches = spans(trace.time_s, known & (trace.ticks["mode"] == mode), ticks_end_s, COLUMNS)
        axes.bars(stretches, (lane - 0.28, lane + 0.28), MODE_INK[mode])
    _mark_decisions(axes, trace)
    lanes = [*MODE_WORDS.values(), "decisions"]
    if trace.scenario.faults:
        acted = spans(trace.time_s, trace.ticks["faults"] != 0, ticks_end_s, COLUMNS)
        axes.bars(acted, (FAULT_LANE - 0.28, FAULT_LANE + 0.28), Ink.LIMIT)
        lanes.append("faults")
    axes.y.ticks = list(enumerate(lanes))
    axes.y.show(-0.6, len(lanes) - 0.4)
    axes.y.line = False
    if not trace.complete:
        axes.text(f"ended: {plain(trace.ended)}", min(ticks_end_s, 0.8 * end_s), 0.0, shift=(6.0, 4.0))


def _mark_decisions(axes: Axes, trace: Trace) -> None:
    """Draw a mark for each decision.

    The mark's shape shows the outcome, and a ring shows an unusable answer.
    """
    decisions = trace.decisions
    if not decided(trace, "time_s", "outcome", "fault"):
        return
    marks = [(decisions["outcome"] == outcome, mark) for outcome, mark in OUTCOME_MARKER.items()]
    for these, (shape, size, fill, edge, width) in [*marks, (decisions["fault"] != "", FAULT_MARKER)]:
        times = decisions["time_s"][these]
        lane = np.full(len(times), DECISION_LANE)
        axes.marks(times, lane, shape, size, fill=fill, edge=edge, width=width)


def distance_panel(axes: Axes, run: JudgedRun) -> None:
    """Draw the distance between the surfaces of true hands and robot, with the limits of claims."""
    trace = run.trace
    lines: list[Line] = []
    for hand, ink in enumerate(HANDS[: trace.scenario.hand_slots]):
        present = trace.ticks["hand_present"][:, hand]
        if present.any():
            values = np.where(present, trace.ticks["hand_distance_m"][:, hand], np.nan) * MM
            hands = trace.scenario.hands
            name = hands[hand].name if hand < len(hands) else f"hand {hand + 1}"
            lines.append((plain(name, longest=22), values, ink, DASHES[hand % len(DASHES)]))
    _panel(axes, trace, "True hand to robot, surface to surface, mm", lines, zero=True)
    axes.y.hold(0.0)
    _limit_lines(axes, _claimed(run, claimed_hand_distance_m))


def predicted_panel(axes: Axes, trace: Trace) -> None:
    """Draw the distance from the TCP to the nearest predicted hand's centre, with the critical distance."""
    values = trace.ticks["predicted_distance_m"] * MM
    _panel(axes, trace, "Predicted hand to TCP, centre to centre, mm", [("", values, Ink.PREDICTED, ())])
    axes.y.hold(0.0)
    critical_m = trace.scenario.settings.avoidance.critical_distance_m
    _limit_lines(axes, [("critical distance", critical_m * MM)])


LENGTHS = (("x\u2099", Ink.TCP), ("y\u2099", Ink.HAND_1), ("a\u2099", Ink.GREEN))
SHAPES = (("\u03b3", Ink.HAND_2), ("\u03b4", Ink.PREDICTED), ("\u03b1", Ink.SKY))
OF_SHAPES = "Feature errors, \u03b3 and \u03b4 (no unit), \u03b1 (rad)"


def error_panel(
    axes: Axes, trace: Trace, title: str, errors: Floats, names: Iterable[tuple[str, Ink]]
) -> None:
    """Draw the feature errors (n, 3), with the names ``names``, while the object was in view."""
    lines = [(name, errors[:, i], ink, DASHES[i]) for i, (name, ink) in enumerate(names)]
    _panel(axes, trace, title, lines, zero=True)


def sse_panel(axes: Axes, trace: Trace) -> None:
    """Draw |f - f*|^2 (eq. 15) on a logarithmic axis, and the threshold at which the gain switches."""
    sse = _seen(trace, "sse")
    positive = np.where(sse > 0.0, sse, np.nan)
    switch = trace.scenario.settings.servo.gain_switch_sse
    shown = np.append(positive[np.isfinite(positive)], switch)
    if len(shown) > 1:
        _whole_decades(axes, float(shown.min()), float(shown.max()))
    _panel(axes, trace, "Squared image error |f \u2212 f*|\u00b2", [("sse", positive, Ink.TCP, ())])
    _limit_lines(axes, [("gain switch", switch)])


def _whole_decades(axes: Axes, least: float, most: float) -> None:
    """Extend a logarithmic axis to whole decades, so that at least its two ends have labels."""
    low = int(np.floor(np.log10(least)))
    high = max(int(np.ceil(np.log10(most))), low + 1)
    step = -(-(high - low) // MOST_DECADES)
    axes.y.log = True
    axes.y.show(10.0**low, 10.0**high)
    labelled = range(high, low - 1, -step)
    axes.y.ticks = [(10.0**power, "10" + str(power).translate(SUPERSCRIPT)) for power in labelled]
    if step == 1:
        axes.y.minor = [m * 10.0**exponent for exponent in range(low, high) for m in range(2, 10)]


def speed_panel(axes: Axes, run: JudgedRun) -> None:
    """Draw the TCP's speed with its limits."""
    trace = run.trace
    speed = trace.ticks["tcp_speed_mps"] * MM
    _panel(axes, trace, "TCP speed, mm/s", [("TCP", speed, Ink.TCP, ())], zero=True)
    limit = trace.scenario.settings.motion.max_tcp_speed_mps * MM
    _limit_lines(axes, [("speed limit", limit), *_claimed(run, claimed_tcp_speed_mps)])


def _claimed(run: JudgedRun, limit_of: Callable[[Evaluation], float | None]) -> list[tuple[str, float]]:
    """Return (name, value [mm or mm/s]) for each claim that states a limit of this quantity."""
    limits = [(number, limit_of(judged)) for number, judged in enumerate(run.evaluations, start=1)]
    return [(f"claim {number}", limit * MM) for number, limit in limits if limit is not None]


def joint_panel(axes: Axes, trace: Trace) -> None:
    """Draw the joint angles.

    The joints of a user's own arm have numbers as names.
    """
    angles = (trace.ticks["joint_position_rad"] * DEGREES).T
    ours = not isinstance(trace.scenario.robot, OwnRobot)
    names = UR_JOINTS if ours else [f"joint {number}" for number in range(1, len(angles) + 1)]
    styles = zip(names, angles, JOINT_INKS, cycle(DASHES), strict=False)
    lines = [(name, angle, ink, dashes) for name, angle, ink, dashes in styles]
    _panel(axes, trace, "Joint angles, deg", lines)


def _seen(trace: Trace, name: str) -> Floats:
    """Return a field of the image, with NaN at the ticks at which the object was not in view."""
    visible = trace.ticks["object_visible"]
    values: Floats = trace.ticks[name]
    return np.where(visible.reshape(-1, *[1] * (values.ndim - 1)), values, np.nan)


def _panel(axes: Axes, trace: Trace, title: str, lines: list[Line], *, zero: bool = False) -> None:
    """Draw a panel with the curves ``lines``, its title at the left and its key at the right."""
    axes.x.grid = axes.y.grid = True
    if zero:
        axes.hline(0.0, Ink.MUTED)
    for name, values, ink, dashes in lines:
        times, kept = keep_extremes(trace.time_s, values, COLUMNS)
        axes.line(times, kept, ink, dashes=dashes, name=name if len(lines) > 1 else None)
    axes.title(title)
    axes.legend()


def _limit_lines(axes: Axes, limits: list[tuple[str, float]]) -> None:
    """Draw horizontal limits (name, value) with their names at the right end.

    Extend the view to these limits. Limits with the same value have one common line and label. If a label
    would cover another label, it moves to the left.
    """
    named: dict[float, list[str]] = {}
    for name, value in limits:
        named.setdefault(round(value, 9), []).append(name)
    for value in named:
        axes.y.hold(value)
        axes.hline(value, Ink.LIMIT, width=1.2, dashes=(4, 3))
    used: list[tuple[float, float]] = []  # (height in pixels, place along the axis)
    for value, names in named.items():
        height = axes.y.at(value)
        right = 1.0
        while any(abs(height - used_height) < LABEL_PX and right == place for used_height, place in used):
            right -= 0.25
        used.append((height, right))
        label = f"{' and '.join(names)}: {value:g}"
        axes.text(label, Share(right), value, shift=(-4.0, -4.0), anchor="end", size=10)
