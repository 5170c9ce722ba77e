"""Table 1: RMSE and PICP of the Bayesian DNN with 5 to 25 passes."""

from __future__ import annotations

from safety_harness_paper.intervals import differences, mean_of
from safety_harness_paper.measurements import (
    AXES,
    DNN,
    INTER,
    figures,
    in_seeds,
    main_evaluations,
    picp,
    rmse,
)
from safety_harness_paper.part import Found, Part
from safety_harness_paper.result import (
    FigureComparison,
    Result,
    Table,
    above_zero,
    below_zero,
    estimate_words,
    judge,
)
from safety_harness_paper.scale import PASSES, Scale

PAPER_PICP = {
    "x": (0.80, 0.84, 0.85, 0.85, 0.85),
    "y": (0.90, 0.94, 0.96, 0.96, 0.97),
    "z": (0.91, 0.95, 0.97, 0.98, 0.98),
}
PAPER_RMSE_MM = (21.93, 20.41, 19.87, 19.60, 19.20)
SAYS = (
    "With more passes T of the network PICP and RMSE get better; beyond T = 10 they gain little. The PICP in "
    "x is lower than in y and z."
)


def result(scale: Scale, found: Found) -> Result:
    """Claims by pairs of the same training and draw."""
    by_passes = {passes: figures(found, "main", INTER, passes=passes) for passes in PASSES}
    comparisons = [
        FigureComparison(
            label=f"PICP ({axis}), T = {passes}",
            ours=mean_of(picp(by_passes[passes], number)),
            paper=PAPER_PICP[axis][column],
        )
        for number, axis in enumerate(AXES)
        for column, passes in enumerate(PASSES)
    ]
    comparisons += [
        FigureComparison(
            label=f"RMSE, T = {passes}",
            ours=mean_of(rmse(by_passes[passes])),
            paper=PAPER_RMSE_MM[column],
            unit="mm",
            scale=1e3,
        )
        for column, passes in enumerate(PASSES)
    ]
    five, ten, fifteen = (rmse(by_passes[passes]) for passes in (5, 10, 15))
    claims = [
        below_zero(
            "the RMSE is lower with 10 passes than with 5",
            mean_of(differences(ten, five)),
            unit="mm",
            scale=1e3,
            digits=3,
        ),
        above_zero(
            "from 5 to 10 passes the RMSE falls more than from 10 to 15",
            mean_of(differences(differences(five, ten), differences(ten, fifteen))),
            unit="mm",
            scale=1e3,
            digits=3,
        ),
    ]
    for number, axis in enumerate(AXES):
        more = mean_of(differences(picp(by_passes[10], number), picp(by_passes[5], number)))
        claims.append(above_zero(f"the PICP in {axis} is higher with 10 passes than with 5", more, digits=3))
    for number in (1, 2):
        less = mean_of(differences(picp(by_passes[10], 0), picp(by_passes[10], number)))
        claims.append(below_zero(f"the PICP in x is lower than in {AXES[number]}", less, digits=3))
    word, why = judge(claims, comparisons)
    return Result(
        name="table1",
        title="Inference iterations",
        source="Table 1",
        paper_says=SAYS,
        word=word,
        why=why,
        claims=tuple(claims),
        comparisons=tuple(comparisons),
        tables=(_readings(found), _beside(found)),
        notes=(
            "The paper does not say how its intervals are made. Mean \u00b1 1.96 standard deviations of the "
            "passes is the only reading that can give its figures; the others are in the table below.",
            "Test samples are new TCPs. In the paper's split every TCP is in the training, validation and "
            "test parts.",
        ),
    )


def _readings(found: Found) -> Table:
    rows = figures(found, "main", INTER)
    return Table(
        "Readings of the PICP at T = 10.",
        ("interval", *AXES),
        tuple(
            (variant, *(estimate_words(mean_of(picp(rows, axis, variant))) for axis in range(3)))
            for variant in rows[0]["picp"]
        ),
    )


def _beside(found: Found) -> Table:
    """What no regressor can beat, and the network without dropout, beside them."""
    floor = [one["floor_rmse"] for one in in_seeds(found, "main")]
    rows = [
        ("Bayesian DNN, T = 10", rmse(figures(found, "main", INTER))),
        ("DNN", rmse(figures(found, "main", DNN, passes=1))),
        ("floor that the labels' own noise leaves", floor),
        (
            "Bayesian DNN against labels without noise",
            [r["noise_free_rmse"] for r in figures(found, "main", INTER)],
        ),
    ]
    return Table(
        "Overall RMSE on the same new TCPs.",
        ("what", "RMSE"),
        tuple((name, estimate_words(mean_of(values), unit="mm", scale=1e3)) for name, values in rows),
    )


PART = Part("table1", main_evaluations, result)
