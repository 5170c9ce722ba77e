"""A run as a small picture in text: one signal over time, its limit, the decisions, the worst moment."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from safety_harness.properties.base import Evaluation
from safety_harness.report.words import claimed_hand_distance_m, claimed_tcp_speed_mps
from safety_harness.trace.trace import Trace

WIDTH, HEIGHT = 60, 10
_FARTHEST_M = 0.8  # what is farther away is drawn at the upper edge


def picture(trace: Trace, evaluation: Evaluation) -> list[str]:
    """Lines of at most 70 characters; none for a trace without anything to draw.

    The TCP speed for a claim about it, else the distance of the nearest hand from the arm's surface.
    Each column shows the least distance, or the largest speed, of its time.
    """
    speed_mps = claimed_tcp_speed_mps(evaluation)
    if len(trace.ticks) < 2:
        return []
    if speed_mps is not None:
        return _drawn(trace, evaluation, trace.ticks["tcp_speed_mps"], speed_mps, "TCP speed [mm/s]", np.max)
    if not trace.scenario.hands:
        return []
    distance_m = trace.ticks["hand_distance_m"].min(axis=1)
    limit_m = claimed_hand_distance_m(evaluation)
    return _drawn(trace, evaluation, distance_m, limit_m, "hand distance [mm]", np.min)


def _drawn(
    trace: Trace,
    evaluation: Evaluation,
    values: NDArray[np.float64],
    limit: float | None,
    title: str,
    worst: np.ufunc | object,
) -> list[str]:
    columns = np.array_split(values, WIDTH) if len(values) >= WIDTH else [values[k : k + 1] for k in range(len(values))]
    shown = np.array([worst(column) for column in columns])  # type: ignore[operator]
    finite = shown[np.isfinite(shown)]
    if not len(finite):
        return []
    top = min(float(finite.max()), _FARTHEST_M) if worst is np.min else float(finite.max())
    top = max(top, limit or 0.0, float(finite.min()) + 1e-3)
    bottom = min(0.0, float(finite.min()))
    canvas = [[" "] * len(shown) for _ in range(HEIGHT)]
    limit_row = None if limit is None else _row(limit, bottom, top)
    if limit_row is not None:
        canvas[limit_row] = ["-"] * len(shown)
    for column, value in enumerate(shown):
        if np.isfinite(value):
            canvas[_row(float(value), bottom, top)][column] = "*" if value <= top else "^"
    lines = [title]
    for number, row in enumerate(canvas):
        label = {0: f"{top * 1e3:.0f}", HEIGHT - 1: f"{bottom * 1e3:.0f}"}.get(number, "")
        if number == limit_row and limit is not None:
            label = f"{limit * 1e3:.0f}"
        lines.append(f"{label:>6} |{''.join(row).rstrip()}")
    return [*lines, *_axis(trace, evaluation, len(shown))]


def _row(value: float, bottom: float, top: float) -> int:
    """The line of a value, counted from the top."""
    share = (min(value, top) - bottom) / (top - bottom)
    return int(round((1.0 - share) * (HEIGHT - 1)))


def _axis(trace: Trace, evaluation: Evaluation, width: int) -> list[str]:
    """The time axis with D for decisions and ! for the worst moment."""
    end_s = float(trace.time_s[-1])

    def column(time_s: float) -> int:
        return min(int(time_s / end_s * width), width - 1)

    marks = [" "] * width
    for time_s in trace.decisions["time_s"]:
        marks[column(float(time_s))] = "D"
    worst_s = evaluation.worst_time_s
    if worst_s is not None and np.isfinite(worst_s):
        marks[column(worst_s)] = "!"
    scale = "0 s" + f"{end_s:g} s".rjust(width - 3)
    lines = ["       +" + "-" * width]
    if "".join(marks).strip():
        lines.append("        " + "".join(marks).rstrip())
    return [*lines, "        " + scale, "        D a decision   ! the worst moment   - the limit   ^ beyond"]
