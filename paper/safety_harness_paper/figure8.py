"""Figure 8: the two repulsive poses from the same TCP, compared by the camera's velocities."""

from __future__ import annotations

from safety_harness_paper.avoiders import BAYESIAN, OPPOSITE
from safety_harness_paper.figure7 import velocities
from safety_harness_paper.measurements import all_trials
from safety_harness_paper.part import Found, Part
from safety_harness_paper.result import Plot, Result, Table, every, judge
from safety_harness_paper.scale import Scale
from safety_harness_paper.trials import FEW

SAYS = (
    "Both poses are generated at the same TCP with the same hand; from the Bayesian DNN's the gain is "
    "switched sooner than from the opposite one."
)


def result(scale: Scale, found: Found) -> Result:
    """The same trial as in figure 7, and its twin."""
    few = found["trials 0"].result[FEW]
    took = {name: few["systems"][name]["iterations"][0] for name in (BAYESIAN, OPPOSITE)}
    first, second = took[BAYESIAN], took[OPPOSITE]
    sooner = first is not None and (second is None or first < second)
    claims = [every("the gain is switched sooner after the Bayesian DNN's pose", int(sooner), 1)]
    word, why = judge(claims, [])
    records = few["records"]
    panels = tuple(velocities(records[name], f", {name}") for name in took if records[name])
    return Result(
        name="figure8",
        title="The two repulsive poses compared",
        source="Figure 8",
        paper_says=SAYS,
        word=word,
        why=why,
        claims=tuple(claims),
        tables=(
            Table(
                "Iterations (8 ms) from the arrival to the gain switch in this one example; table 5 has "
                "many.",
                ("system", "iterations"),
                tuple((name, "never" if value is None else str(value)) for name, value in took.items()),
            ),
        ),
        plots=(
            Plot(
                "Camera velocities",
                "Demanded velocities of the camera in its own frame; zero while the arm gives way.",
                panels,
            ),
        )
        if panels
        else (),
    )


PART = Part("figure8", all_trials, result)
