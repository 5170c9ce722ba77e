"""Table 2: dropout between the blocks (DO-inter) and before every layer (DO-full)."""

from __future__ import annotations

from safety_harness_paper.intervals import differences, mean_of
from safety_harness_paper.measurements import (
    AXES,
    FULL,
    INTER,
    figures,
    long_evaluations,
    main_evaluations,
    picp,
    rmse,
)
from safety_harness_paper.part import Found, Part
from safety_harness_paper.result import FigureComparison, Result, above_zero, below_zero, judge
from safety_harness_paper.scale import Scale
from safety_harness_paper.work import Task

INTER_NAME, LONG_NAME, EQUAL_NAME = "DO-inter", "DO-full, six times the epochs", "DO-full, as many epochs"
PAPER = {INTER_NAME: (0.84, 0.94, 0.95, 20.41), LONG_NAME: (0.71, 0.94, 0.94, 22.49)}
SAYS = (
    "DO-full is trained for 1,200 epochs against the 200 of DO-inter, and is still worse on the test set: "
    "higher RMSE, lower PICP. A dropout layer before each layer is not necessary."
)


def tasks(scale: Scale, root: int) -> dict[str, Task]:
    """DO-full both ways."""
    return main_evaluations(scale, root) | long_evaluations(scale, root)


def result(scale: Scale, found: Found) -> Result:
    """The paper's row of DO-full is the long one; the equal one has no figure there."""
    rows = {
        INTER_NAME: figures(found, "main", INTER),
        LONG_NAME: figures(found, "long", 0),
        EQUAL_NAME: figures(found, "main", FULL),
    }
    comparisons = []
    for name, one in rows.items():
        paper = PAPER.get(name)
        comparisons += [
            FigureComparison(
                label=f"{name}: PICP ({axis})",
                ours=mean_of(picp(one, number)),
                paper=None if paper is None else paper[number],
            )
            for number, axis in enumerate(AXES)
        ]
        comparisons.append(
            FigureComparison(
                label=f"{name}: RMSE",
                ours=mean_of(rmse(one)),
                paper=None if paper is None else paper[3],
                unit="mm",
                scale=1e3,
            )
        )
    inter, long, equal = rows.values()
    claims = [
        below_zero(
            "the RMSE of DO-inter is lower than that of DO-full with six times the epochs",
            mean_of(differences(rmse(inter), rmse(long))),
            unit="mm",
            scale=1e3,
        ),
        below_zero(
            "the RMSE of DO-inter is lower than that of DO-full with as many epochs",
            mean_of(differences(rmse(inter), rmse(equal))),
            unit="mm",
            scale=1e3,
        ),
        below_zero(
            "DO-full needs the longer training",
            mean_of(differences(rmse(long), rmse(equal))),
            unit="mm",
            scale=1e3,
        ),
        above_zero(
            "the PICP in x of DO-inter is higher than that of DO-full with six times the epochs",
            mean_of(differences(picp(inter, 0), picp(long, 0))),
            digits=3,
        ),
    ]
    word, why = judge(claims, comparisons)
    return Result(
        name="table2",
        title="Dropout placement",
        source="Table 2",
        paper_says=SAYS,
        word=word,
        why=why,
        claims=tuple(claims),
        comparisons=tuple(comparisons),
        notes=(f"Epochs here: {scale.inter.epochs} and {scale.full_long.epochs}.",),
    )


PART = Part("table2", tasks, result)
