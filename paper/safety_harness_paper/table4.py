"""Table 4: repulsive poses out of the robot's reach, from TCPs outside the training range."""

from __future__ import annotations

from typing import Any

import numpy as np

from safety_harness_paper.avoiders import BAYESIAN, DNN
from safety_harness_paper.intervals import Paired, differences, mean_of, share_of
from safety_harness_paper.measurements import in_seeds, reaches
from safety_harness_paper.part import Found, Part
from safety_harness_paper.reach import EDGE, SETS
from safety_harness_paper.result import (
    FigureComparison,
    Result,
    Table,
    below_zero,
    estimate_words,
    fewer,
    judge,
)
from safety_harness_paper.scale import Scale

PAPER_DNN, PAPER_BAYESIAN, PAPER_TRIALS = 22, 0, 50
SAYS = (
    "On the real robot 22 of 50 repulsive poses of the regression ResNet are out of reach, and none of the "
    "Bayesian DNN's: the Bayesian DNN avoids undesired poses that the DNN cannot avoid."
)


def result(scale: Scale, found: Found) -> Result:
    """Judged at the edge of reach; those of all trainings are pooled for the test, and shown one by one."""
    rows = in_seeds(found, "reach")
    judged = _named(rows, EDGE)
    dnn, bayesian = (_column(judged, name, "unreachable") for name in (DNN, BAYESIAN))
    shares = [[float(np.mean(one)) for one in values] for values in (bayesian, dnn)]
    claims = [
        fewer(
            "fewer poses of the Bayesian DNN than of the DNN are out of reach, all trainings together",
            "the Bayesian DNN",
            "the DNN",
            Paired.of(np.concatenate(bayesian), np.concatenate(dnn)),
        ),
        below_zero(
            "a training of the Bayesian DNN has a smaller share out of reach than one of the DNN",
            mean_of(differences(*shares)),
            unit="%",
            scale=100.0,
            digits=1,
        ),
    ]
    comparisons = [
        FigureComparison(
            label=f"{name}: share out of reach",
            ours=mean_of([float(np.mean(one)) for one in values]),
            paper=100.0 * count / PAPER_TRIALS,
            unit="%",
            digits=1,
            scale=100.0,
            paper_ends=exact_ends(count),
        )
        for name, values, count in ((DNN, dnn, PAPER_DNN), (BAYESIAN, bayesian, PAPER_BAYESIAN))
    ]
    word, why = judge(claims, comparisons)
    return Result(
        name="table4",
        title="Out of the robot's reach",
        source="Table 4",
        paper_says=SAYS,
        word=word,
        why=why,
        claims=tuple(claims),
        comparisons=tuple(comparisons),
        tables=(_by_seed(dnn, bayesian), *(_by_system(rows, name) for name in SETS), _gates(judged)),
        notes=(
            "Reach is inverse kinematics of the UR10 within its joint limits, in the desired orientation. "
            "Where the paper's TCPs are is not said. Within four times the seen box everything 100 mm away "
            "is in reach, so TCPs at the edge of reach are judged: the arm reaches them, sees the whole "
            "object from them, and does not reach all that is 100 mm away. This was fixed by geometry alone.",
            "The exact test takes all trials for independent, which those of one training are not: its "
            "networks are the same. So the trainings are compared as well. (This second claim was added "
            "after a first look at the numbers; without it the word would follow from the test alone.)",
            "0 of 50 shows only that the share is below 7.1 % (exact, 95 %, two-sided).",
        ),
    )


def exact_ends(count: int) -> tuple[float, float]:
    """Of the paper's share, in per cent: Clopper and Pearson."""
    share = share_of(np.arange(PAPER_TRIALS) < count)
    return 100.0 * share.low, 100.0 * share.high


def _named(rows: list[dict[str, Any]], name: str) -> list[dict[str, Any]]:
    return [row[name]["avoiders"] for row in rows]


def _column(rows: list[dict[str, Any]], name: str, key: str) -> list[list[bool]]:
    return [row[name][key] for row in rows]


def _by_seed(dnn: list[list[bool]], bayesian: list[list[bool]]) -> Table:
    """Each training seed is one experiment like the paper's."""
    rows = []
    for number, (first, second) in enumerate(zip(dnn, bayesian, strict=True)):
        pairs = Paired.of(second, first)
        rows.append(
            (
                str(number + 1),
                f"{sum(first)} of {len(first)}",
                f"{sum(second)} of {len(second)}",
                f"{pairs.second_only} / {pairs.first_only}",
                f"{pairs.p_value:.2g}",
            )
        )
    return Table(
        f"Each training is an experiment like the paper's: TCPs of its own {EDGE}.",
        ("training", "DNN out of reach", "Bayesian DNN", "DNN alone / Bayesian alone", "p (McNemar, exact)"),
        tuple(rows),
    )


def _by_system(rows: list[dict[str, Any]], where: str) -> Table:
    named = _named(rows, where)
    redrawn = sum(row[where]["redrawn"] for row in rows)
    table = []
    for name in named[0]:
        out = np.concatenate(_column(named, name, "unreachable"))
        table.append(
            (
                name,
                f"{int(out.sum())} of {len(out)}",
                estimate_words(share_of(out), unit="%", scale=100.0, digits=1),
            )
        )
    return Table(
        f"TCPs {where}, all trainings together; the interval takes trials for independent. {redrawn:,} TCPs "
        "were drawn that would not do.",
        ("system", "out of reach", "share"),
        tuple(table),
    )


def _gates(judged: list[dict[str, Any]]) -> Table:
    """What a gate does with them: nothing out of reach is ever used."""
    table = []
    for name in judged[0]:
        cells = []
        for gate in ("reach", "full"):
            outcomes = [one for row in judged for one in row[name][gate]]
            cells.append(" / ".join(str(outcomes.count(word)) for word in ("proposed", "opposite", "stop")))
        doubted = sum(sum(row[name]["uncertain"]) for row in judged)
        table.append((name, *cells, str(doubted)))
    return Table(
        f"With the gate, {EDGE}: own proposal used / opposite pose in its "
        f"place / stop. "
        "No pose out of reach is ever used. Doubted: the spread is above the calibrated threshold.",
        ("system", "reach gate", "full gate", "doubted"),
        tuple(table),
    )


PART = Part("table4", reaches, result)
