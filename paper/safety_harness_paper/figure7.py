"""Figure 7: one whole trial, servo, give way at the 100th iteration, servo on: errors and velocities."""

from __future__ import annotations

from typing import Any

from safety_harness_paper.avoiders import BAYESIAN
from safety_harness_paper.measurements import all_trials
from safety_harness_paper.part import Found, Part
from safety_harness_paper.result import Panel, Plot, Result, Series, every, judge
from safety_harness_paper.scale import Scale
from safety_harness_paper.trials import FEW

SAYS = (
    "From iteration 0 to 100 the robot servoes; at the 100th a hand is in the critical range and a repulsive "
    "pose is generated; the robot moves there and servoes on; at the 428th the squared error is below 0.005 "
    "and the gain switches from 0.4 to 0.1."
)


def result(scale: Scale, found: Found) -> Result:
    """The first of the few TCPs, the first training."""
    record = found["trials 0"].result[FEW]["records"][BAYESIAN]
    switch = record.get("switch")
    done = [record.get("trigger"), record.get("arrival"), switch]
    claims = [
        every(
            "trigger, arrival at the repulsive pose and gain switch follow each other",
            sum(event is not None for event in done),
            3,
        )
    ]
    word, why = judge(claims, [])
    plots = (Plot("One trial", _caption(record), (errors(record), velocities(record, ""))),) if record else ()
    return Result(
        name="figure7",
        title="A whole trial",
        source="Figure 7",
        paper_says=SAYS,
        word=word,
        why=why,
        claims=tuple(claims),
        plots=plots,
        notes=(
            f"Trigger at iteration {done[0]}, arrival at {done[1]}, gain switch at {done[2]} (8 ms each). "
            f"The paper's "
            "control period is not known, so its 428 is not compared.",
        ),
    )


def _caption(record: dict[str, Any]) -> str:
    return (
        "PyBullet, exact image moments, the Bayesian DNN's first training, the first of the few TCPs. "
        "Iterations of 8 ms. While the arm gives way servoing is paused and the camera's demanded velocity "
        "is shown as zero."
    )


def marks(record: dict[str, Any]) -> tuple[tuple[float, str], ...]:
    """Trigger, arrival and gain switch, as far as they came."""
    names = (("trigger", "trigger"), ("arrival", "arrival"), ("switch", "gain 0.1"))
    return tuple((float(record[key]), word) for key, word in names if record.get(key) is not None)


def errors(record: dict[str, Any]) -> Panel:
    """The six features' errors; lengths in metres as the paper has them, which makes all six comparable."""
    names = ("x\u2099, m", "y\u2099, m", "a\u2099, m", "\u03b3", "\u03b4", "\u03b1, rad")
    rows = record["feature_error"]
    return Panel(
        kind="lines",
        title="Image-moment errors",
        x_label="iteration",
        y_label="error",
        series=tuple(_series(name, rows, column) for column, name in enumerate(names)),
        marks=marks(record),
    )


def velocities(record: dict[str, Any], title: str) -> Panel:
    """Demanded camera velocities: linear in m/s, angular in rad/s."""
    names = (
        "v\u2093, m/s",
        "v\u1d67, m/s",
        "v_z, m/s",
        "\u03c9\u2093, rad/s",
        "\u03c9\u1d67, rad/s",
        "\u03c9_z, rad/s",
    )
    rows = record["camera_twist"]
    return Panel(
        kind="lines",
        title=f"Camera velocities{title}",
        x_label="iteration",
        y_label="velocity",
        series=tuple(_series(name, rows, column) for column, name in enumerate(names)),
        marks=marks(record),
    )


def _series(name: str, rows: list[list[float | None]], column: int) -> Series:
    """What was not seen leaves a gap."""
    values = tuple(float("nan") if row[column] is None else float(row[column] or 0.0) for row in rows)
    return Series(name, tuple(float(k) for k in range(len(rows))), values)


PART = Part("figure7", all_trials, result)
