"""Table 5: iterations from the repulsive pose to the gain switch, in PyBullet."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from safety_harness.base.settings import DEFAULTS
from safety_harness_paper.avoiders import BAYESIAN, OPPOSITE
from safety_harness_paper.intervals import Estimate, bootstrap_of, mean_of
from safety_harness_paper.measurements import all_trials, in_seeds
from safety_harness_paper.part import Found, Part
from safety_harness_paper.result import (
    ClaimState,
    FigureComparison,
    PaperClaim,
    Result,
    Table,
    below_zero,
    estimate_words,
    judge,
)
from safety_harness_paper.scale import Scale
from safety_harness_paper.trials import FEW, MANY

PAPER_BAYESIAN, PAPER_OPPOSITE = 201.3, 869.28
SAYS = (
    "With the Bayesian DNN's repulsive poses servoing takes 201.3 iterations on average until the gain is "
    "switched, with the opposite poses 869.28, from 20 TCPs outside the training space."
)
BOOTSTRAP_SEED = 5


def result(scale: Scale, found: Found) -> Result:
    """Over the trials that converged with both; all others are counted."""
    rows = in_seeds(found, "trials")
    many = [row[MANY]["systems"] for row in rows]
    pairs = [paired(one, BAYESIAN, OPPOSITE) for one in many]  # (n, 2) a training seed
    together = np.concatenate(pairs)
    by_seed = [float((one[:, 0] - one[:, 1]).mean()) for one in pairs if len(one)]
    ratios = [float(one[:, 1].mean() / one[:, 0].mean()) for one in pairs if len(one) and one[:, 0].any()]
    sentence = (
        "from the Bayesian DNN's pose the gain switch takes fewer iterations than from the opposite pose"
    )
    if by_seed:
        claims = [below_zero(sentence, mean_of(by_seed), digits=1)]
    else:
        claims = [PaperClaim(sentence, ClaimState.UNDECIDED, "no trial converged with both")]
    comparisons = []
    if ratios:  # a training that always arrives below the switch has none
        comparisons.append(
            FigureComparison(
                label="opposite / Bayesian DNN, ratio of the means",
                ours=mean_of(ratios),
                paper=round(PAPER_OPPOSITE / PAPER_BAYESIAN, 2),
            )
        )
    for name, column, paper in ((BAYESIAN, 0, PAPER_BAYESIAN), (OPPOSITE, 1, PAPER_OPPOSITE)):
        if not by_seed:
            break
        comparisons.append(
            FigureComparison(
                label=f"{name}: mean iterations",
                ours=mean_of([float(one[:, column].mean()) for one in pairs if len(one)]),
                paper=paper,
                digits=1,
                counts=False,
            )
        )
    word, why = judge(claims, comparisons)
    dt_ms = 1e3 * DEFAULTS.clock.control_period_s
    return Result(
        name="table5",
        title="Convergence after giving way",
        source="Table 5",
        paper_says=SAYS,
        word=word,
        why=why,
        claims=tuple(claims),
        comparisons=tuple(comparisons),
        tables=(
            _fates(
                many,
                f"{sum(len(one[OPPOSITE]['fates']) for one in many)} TCPs, each training seed with its own.",
            ),
            _fates(
                [rows[0][FEW]["systems"]],
                f"The paper's experiment: {len(rows[0][FEW]['systems'][OPPOSITE]['fates'])} TCPs and one "
                f"training.",
            ),
            _few(rows),
            _pairs(together),
        ),
        notes=(
            f"An iteration here is a control tick of {dt_ms:g} ms. The paper's period is not given, and "
            f"iterations to a "
            "threshold are inversely proportional to it, so only the ratio is compared.",
            "Counting begins when the TCP has arrived at the repulsive position (to 1 mm) and ends when eq. "
            "15 falls below 0.005. An arrival that is already below counts as zero iterations, and is "
            "counted as such. Without avoidance counting begins at the trigger.",
            "As in the paper the trigger comes at iteration 100, whatever the distance of the hand, which "
            "stays at its nominal position. Poses that the arm cannot go to straight are refused, and not "
            "run.",
        ),
    )


def paired(systems: dict[str, Any], first: str, second: str) -> NDArray[np.float64]:
    """(n, 2) iterations of the trials that converged with both systems."""
    columns = zip(systems[first]["iterations"], systems[second]["iterations"], strict=True)
    both = [(a, b) for a, b in columns if a is not None and b is not None]
    return np.array(both, dtype=np.float64).reshape(-1, 2)


def _fates(many: list[dict[str, Any]], caption: str) -> Table:
    """Zero and never-converging runs explicitly."""
    rows = []
    for name in many[0]:
        fates = [fate for one in many for fate in one[name]["fates"]]
        iterations = [n for one in many for n in one[name]["iterations"] if n is not None]
        zero = sum(n == 0 for n in iterations)
        rows.append(
            (
                name,
                _words(iterations),
                f"{np.median(iterations):.0f}" if iterations else "-",
                str(len(iterations)),
                str(zero),
                str(fates.count("never") + fates.count("lost") + fates.count("stopped")),
                str(fates.count("refused")),
            )
        )
    return Table(
        f"{caption} Mean iterations over the runs that converged, with a bootstrap interval over TCPs.",
        ("system", "mean iterations", "median", "converged", "of these zero", "never converged", "refused"),
        tuple(rows),
    )


def _words(iterations: list[int]) -> str:
    if not iterations:
        return "-"
    return estimate_words(bootstrap_of(iterations, "mean", seed=BOOTSTRAP_SEED), digits=1)


def _few(rows: list[dict[str, Any]]) -> Table:
    """The paper's experiment once a training, on the same TCPs."""
    table = []
    for number, row in enumerate(rows):
        pairs = paired(row[FEW]["systems"], BAYESIAN, OPPOSITE)
        ratio = pairs[:, 1].mean() / pairs[:, 0].mean() if len(pairs) and pairs[:, 0].any() else float("nan")
        means = [f"{value:.1f}" for value in pairs.mean(axis=0)] if len(pairs) else ["-", "-"]
        table.append((str(number + 1), *means, "-" if np.isnan(ratio) else f"{ratio:.2f}", str(len(pairs))))
    return Table(
        "The same experiment with each training, over the TCPs where both converged.",
        ("training", "Bayesian DNN", "opposite pose", "ratio", "TCPs"),
        tuple(table),
    )


def _pairs(together: NDArray[np.float64]) -> Table:
    sooner = int(np.count_nonzero(together[:, 0] < together[:, 1]))
    ratio: Estimate | None = None
    if len(together) and together[:, 0].any():
        ratio = bootstrap_of(together[:, ::-1], "ratio of means", seed=BOOTSTRAP_SEED)
    return Table(
        "All pairs together.",
        ("what", "value"),
        (
            ("pairs that converged with both", str(len(together))),
            ("sooner with the Bayesian DNN", str(sooner)),
            ("as soon", str(int(np.count_nonzero(together[:, 0] == together[:, 1])))),
            (
                "ratio of the means, opposite / Bayesian DNN (bootstrap over TCPs)",
                "-" if ratio is None else estimate_words(ratio),
            ),
        ),
    )


PART = Part("table5", all_trials, result)
