"""Write the text of a failed claim.

The text has the margin, the moment of the failure, the decision before it, a picture, and the command that
repeats the run.
"""

from __future__ import annotations

import shlex
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from safety_harness.base.shipped.contents import shipped_name
from safety_harness.claims.properties.base import Evaluation
from safety_harness.report.decisions import DecisionRow, decision_rows
from safety_harness.report.words import (
    claimed_hand_distance_m,
    claimed_tcp_speed_mps,
    count_words,
    tested_words,
)
from safety_harness.scenario.expand import gather
from safety_harness.scenario.model import Scenario, Verdict
from safety_harness.scenario.write import write_scenario
from safety_harness.testing.session import TestRun, session
from safety_harness.testing.simulating import digest_of, is_of_an_object
from safety_harness.trace.trace import Trace
from safety_harness.trace.unmeasured import as_measured, decided


def failure_text(
    evaluation: Evaluation, trace: Trace, *, expected: Verdict, scenario: Scenario, test: TestRun | None
) -> str:
    """Return the whole text of a failure.

    ``scenario`` is the scenario that the test passed, and ``test`` is the failed test.
    """
    runs = not is_of_an_object(trace)
    trace = as_measured(trace)
    parts = [
        _verdict(evaluation, expected),
        _facts(evaluation, trace),
        _decision(evaluation, trace),
        picture(trace, evaluation),
        _scenario(scenario, test),
        again(scenario, test, runs=runs) if trace.known.simulated else [],
    ]
    return "\n\n".join("\n".join(part) for part in parts if part)


def _verdict(evaluation: Evaluation, expected: Verdict) -> list[str]:
    verdict = evaluation.verdict.value
    lines = [
        f"{evaluation.sentence}: {verdict}"
        + ("" if expected is Verdict.HOLDS else f", expected {expected.value}")
    ]
    if evaluation.verdict is Verdict.INCONCLUSIVE:
        lines.append("  no evidence either way, which a test does not take for a safe run")
    return lines


def _facts(evaluation: Evaluation, trace: Trace) -> list[str]:
    worst_s = evaluation.worst_time_s
    at = f" at {worst_s:.3f} s" if worst_s is not None else ""
    lines = [f"  margin    {evaluation.margin_text()}{at}"]
    lines.append(f"  because   {evaluation.reason}")
    lines += [
        f"  part      {part.sentence}: {part.verdict.value}, {part.margin_text()}"
        for part in evaluation.parts
    ]
    lines.append(f"  exercised {count_words(evaluation.exercised, 'time', 'times')}")
    lines.append(f"  run       {trace.scenario.name}, {trace.system.label}, seed {trace.scenario.seed}")
    tested = tested_words(trace.scenario, trace.system)
    lines += [f"  tested    {tested}"] * (tested != trace.system.label)
    if not trace.complete:
        lines.append(f"  ended     {trace.ended}")
    return lines


def _decision(evaluation: Evaluation, trace: Trace) -> list[str]:
    """Return the lines on the last decision before the worst moment."""
    rows = decision_rows(trace)
    if not decided(trace, "tick", "time_s"):
        return ["  what was decided was not measured"]
    if not rows:
        return ["  no decision was made in this run"]
    worst_s = evaluation.worst_time_s
    times = trace.decisions["time_s"][: len(rows)]
    earlier = np.flatnonzero(times <= (np.inf if worst_s is None else worst_s))
    if not len(earlier):
        first = f"the first of {count_words(len(trace.decisions), 'decision', 'decisions')}"
        return [f"  no decision was made before that moment; {first} came at {float(times[0]):.3f} s"]
    return _row(rows[int(earlier[-1])], len(trace.decisions))


def _row(row: DecisionRow, count: int) -> list[str]:
    lines = [
        f"  decision  {row.number} of {count}, at {row.time} s, because: {row.trigger}",
        f"  predicted hand at ({row.hand}) mm, TCP at ({row.tcp}) mm",
        f"  proposed  ({row.proposed}) mm" + (f", spread {row.spread} mm" if row.spread else ""),
        f"  chosen    ({row.chosen}) mm: {row.outcome}",
    ]
    return [*lines, f"  failed    {row.failed}"] if row.failed != "none" else lines


def _scenario(scenario: Scenario, test: TestRun | None) -> list[str]:
    """Return the name of the scenario's file, or the text of a scenario that no file contains."""
    if (test is None or not test.draws) and _is_what_its_file_holds(scenario):
        assert scenario.file is not None
        return [f"  scenario  {nearest_path(scenario.file)}"]
    title = "the scenario, made smaller:" if test is not None and test.draws else "the scenario:"
    return [title, *(f"  {line}" for line in write_scenario(scenario).splitlines())]


def again(scenario: Scenario, test: TestRun | None, *, runs: bool) -> list[str]:
    """Return the commands that repeat a failure.

    If ``runs`` is true, the commands include one that runs the scenario's file.
    """
    avoider = session().avoider
    own = [] if avoider is None else ["--avoider", avoider]
    chosen = [session().world] if session().world not in ("", "PyBullet") else []
    lines = []
    file = scenario.file if in_store(scenario) or _is_what_its_file_holds(scenario) else None
    file = file or (test.kept if test is not None else None)
    if test is not None:
        lines.append("  " + shlex.join(["pytest", test.id, *own, *_with("--safety-world", chosen)]))
    if file is not None and runs:
        own += _with("--world", chosen)
        lines.append("  " + shlex.join(["safety-harness", "run", str(nearest_path(file)), *own]))
    return ["to see it again:", *lines] if lines else []


def _with(option: str, values: list[str]) -> list[str]:
    return [option, *values] if values else []


def _is_what_its_file_holds(scenario: Scenario) -> bool:
    """Return whether the scenario equals a scenario in its file.

    The result is False if the scenario was drawn or changed.
    """
    if scenario.file is None:
        return False
    return digest_of(scenario) in map(digest_of, gather([scenario.file], spaces=True).scenarios)


def in_store(scenario: Scenario) -> bool:
    """Return whether the scenario comes from the folder of kept failures."""
    file = scenario.file
    return file is not None and session().failures.resolve() in file.resolve().parents


def nearest_path(file: Path) -> Path:
    """Return the path relative to the working directory.

    For a file outside this directory, return its shipped name or, for other files, the path itself.
    """
    try:
        return file.resolve().relative_to(Path.cwd())
    except ValueError:
        return Path(shipped_name(file.resolve()) or file)


WIDTH, HEIGHT = 60, 10  # in characters, so that a picture fits into a terminal of 80 columns
_FARTHEST_M = 0.8  # larger distances are drawn at the upper edge


@dataclass(frozen=True, eq=False)
class _Signal:
    """A signal to be drawn.

    ``values`` (n,) are its values at the ticks. ``worst`` reduces the values of a column to the value to be
    drawn. The value ``most`` is drawn at the upper edge of the picture.
    """

    title: str
    values: NDArray[np.float64]
    limit: float | None
    worst: Callable[[NDArray[np.float64]], np.float64]
    most: float = np.inf


def picture(trace: Trace, evaluation: Evaluation) -> list[str]:
    """Return the picture as lines of at most 70 characters.

    The list is empty if the trace has no data to draw. For a claim about the TCP speed, the picture shows
    this speed. Otherwise it shows the distance from the nearest hand to the arm's surface. Each column
    represents a stretch of time, and shows the least distance or the largest speed in this stretch.
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
    # The limit is always in view, and a constant signal still has a height.
    top = max(min(float(finite.max()), signal.most), signal.limit or 0.0, float(finite.min()) + 1e-3)
    canvas = [[" "] * width for _ in range(HEIGHT)]
    labels = {0: top, HEIGHT - 1: bottom}
    if signal.limit is not None:
        row = _line_of(signal.limit, bottom, top)
        canvas[row], labels[row] = ["-"] * width, signal.limit
    for column, value in enumerate(shown):
        if np.isfinite(value):
            canvas[_line_of(float(value), bottom, top)][column] = "*" if value <= top else "^"
    lines = [signal.title]
    for number, line in enumerate(canvas):
        label = f"{labels[number] * 1e3:.0f}" if number in labels else ""
        lines.append(f"{label:>6} |{''.join(line).rstrip()}")
    return [*lines, *_axis(trace, evaluation, width)]


def _line_of(value: float, bottom: float, top: float) -> int:
    """Return the line, counted from the top, on which a value is drawn."""
    share = (min(value, top) - bottom) / (top - bottom)
    return round((1.0 - share) * (HEIGHT - 1))


def _axis(trace: Trace, evaluation: Evaluation, width: int) -> list[str]:
    """Return the time axis, which marks decisions with D and the worst moment with !."""
    end_s = float(trace.time_s[-1])

    def column(time_s: float) -> int:
        return min(int(time_s / end_s * width), width - 1)

    marks = [" "] * width
    times = trace.decisions["time_s"]
    for time_s in times[np.isfinite(times)]:
        marks[column(float(time_s))] = "D"
    worst_s = evaluation.worst_time_s
    if worst_s is not None and np.isfinite(worst_s):
        marks[column(worst_s)] = "!"
    scale = "0 s" + f"{end_s:g} s".rjust(width - 3)
    lines = ["       +" + "-" * width]
    if "".join(marks).strip():
        lines.append("        " + "".join(marks).rstrip())
    return [*lines, "        " + scale, "        D a decision   ! the worst moment   - the limit   ^ beyond"]
