"""A run as a small picture in text: one signal over time, its limit, the decisions, the worst moment."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from safety_harness.properties.base import Evaluation
from safety_harness.report.words import claimed_hand_distance_m, claimed_tcp_speed_mps
from safety_harness.trace.trace import Trace

WIDTH, HEIGHT = 60, 10
_FARTHEST_M = 0.8  # what is farther away is drawn at the upper edge


@dataclass(frozen=True, eq=False)
class _Signal:
    """Drawn are ``values`` (n,) at the ticks: the ``worst`` in each column, ``most`` at the upper edge."""

    title: str
    values: NDArray[np.float64]
    limit: float | None
    worst: Callable[[NDArray[np.float64]], np.float64]
    most: float = np.inf


def picture(trace: Trace, evaluation: Evaluation) -> list[str]:
    """Lines of at most 70 characters; none for a trace without anything to draw.

    The TCP speed for a claim about it, else the distance of the nearest hand from the arm's surface.
    Each column shows the least distance, or the largest speed, of its time.
    """
    if len(trace.ticks) < 2:
        return []
    speed_mps = claimed_tcp_speed_mps(evaluation)
    if speed_mps is not None:
        speeds = trace.ticks["tcp_speed_mps"]
        return _drawn(trace, evaluation, _Signal("TCP speed [mm/s]", speeds, speed_mps, np.max))
    if not trace.scenario.hands:
        return []
    distance_m, limit_m = trace.ticks["hand_distance_m"].min(axis=1), claimed_hand_distance_m(evaluation)
    signal = _Signal("hand distance [mm]", distance_m, limit_m, np.min, _FARTHEST_M)
    return _drawn(trace, evaluation, signal)


def _drawn(trace: Trace, evaluation: Evaluation, signal: _Signal) -> list[str]:
    width = min(WIDTH, len(signal.values))
    shown = np.array([signal.worst(column) for column in np.array_split(signal.values, width)])
    finite = shown[np.isfinite(shown)]
    if not len(finite):
        return []
    bottom = min(0.0, float(finite.min()))
    top = max(min(float(finite.max()), signal.most), signal.limit or 0.0, float(finite.min()) + 1e-3)
    canvas = [[" "] * width for _ in range(HEIGHT)]
    labels = {0: top, HEIGHT - 1: bottom}
    if signal.limit is not None:
        row = _row(signal.limit, bottom, top)
        canvas[row], labels[row] = ["-"] * width, signal.limit
    for column, value in enumerate(shown):
        if np.isfinite(value):
            canvas[_row(float(value), bottom, top)][column] = "*" if value <= top else "^"
    lines = [signal.title]
    for number, line in enumerate(canvas):
        label = f"{labels[number] * 1e3:.0f}" if number in labels else ""
        lines.append(f"{label:>6} |{''.join(line).rstrip()}")
    return [*lines, *_axis(trace, evaluation, width)]


def _row(value: float, bottom: float, top: float) -> int:
    """The line of a value, counted from the top."""
    share = (min(value, top) - bottom) / (top - bottom)
    return round((1.0 - share) * (HEIGHT - 1))


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
