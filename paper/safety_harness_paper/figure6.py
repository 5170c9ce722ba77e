"""Figure 6: predictions with their intervals over the first 200 test samples."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from safety_harness.extensions.lab.learning.metrics import NORMAL_95
from safety_harness_paper.intervals import share_of
from safety_harness_paper.measurements import AXES, main_evaluations
from safety_harness_paper.part import Found, Part
from safety_harness_paper.result import Panel, Plot, Result, Series, judge, most
from safety_harness_paper.scale import Scale

SAYS = "With T = 10, for most of the mean predictions the ground truth falls in the prediction interval."


def result(scale: Scale, found: Found) -> Result:
    """The first training's, on its own draw."""
    rows = found["main 0"].result["rows"]
    label, position, spread = (np.array(rows[name]) for name in ("label", "position", "spread"))
    half = NORMAL_95 * spread
    inside = np.abs(position - label) <= half
    claims = [
        most(f"in {axis} most of the labels lie in their intervals", share_of(inside[:, number], "samples"))
        for number, axis in enumerate(AXES)
    ]
    word, why = judge(claims, [])
    order = np.arange(len(label))
    panels = tuple(
        Panel(
            kind="intervals",
            title=f"{axis}: {int(inside[:, number].sum())} of {len(label)} labels in their intervals",
            x_label="test sample",
            y_label="mm",
            series=(
                Series(
                    "mean \u00b1 1.96 standard deviations of ten passes",
                    _floats(order),
                    _floats(1e3 * position[:, number]),
                    _floats(1e3 * (position - half)[:, number]),
                    _floats(1e3 * (position + half)[:, number]),
                ),
                Series("ground truth", _floats(order), _floats(1e3 * label[:, number])),
            ),
        )
        for number, axis in enumerate(AXES)
    )
    return Result(
        name="figure6",
        title="Predictions with intervals",
        source="Figure 6",
        paper_says=SAYS,
        word=word,
        why=why,
        claims=tuple(claims),
        plots=(
            Plot(
                "The first test samples",
                "Repulsive positions in the base frame; the first training of the Bayesian DNN on new TCPs. "
                "The spread of the passes is the network's own doubt; the labels' noise is not in it.",
                panels,
            ),
        ),
    )


def _floats(array: ArrayLike) -> tuple[float, ...]:
    return tuple(round(float(value), 3) for value in np.asarray(array))


PART = Part("figure6", main_evaluations, result)
