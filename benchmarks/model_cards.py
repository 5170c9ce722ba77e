"""Write docs/results/networks.md, the cards of the shipped networks, from their files and a fresh evaluation.

Run: python benchmarks/model_cards.py (half a minute).
"""

from __future__ import annotations

import json
import os
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from safety_harness.admission.admit import answers_at_first, first_question
from safety_harness.base.settings import DEFAULTS
from safety_harness.cell.avoidance.learned import LearnedAvoider
from safety_harness.cell.avoidance.model_file import Model, load_model
from safety_harness.cell.avoidance.shipped import SHIPPED, shipped_model
from safety_harness.extensions.lab.commands.learning import metrics
from safety_harness.extensions.lab.measured_times import answer_times_s, machine
from safety_harness.report.words import milliseconds_words

PAGE = Path(__file__).parents[1] / "docs" / "results" / "networks.md"
EVALUATE = Path(__file__).with_name("EVALUATE.md")
ABOUT = {
    "mc-dropout": (
        "This is the default avoider. It has Monte Carlo dropout after each stage (DO-inter) and "
        "makes ten passes."
    ),
    "mc-dropout-full": (
        "This network has Monte Carlo dropout before every fully connected layer (DO-full) and makes "
        "ten passes."
    ),
    "deterministic": (
        "This network has no dropout and makes one pass. It has no spread, so the gate never finds it "
        "uncertain."
    ),
    "ensemble": (
        "The members are five deterministic networks from five seeds. The spread is their standard deviation."
    ),
    "optimum": (
        "This network was trained on the continuous optimum instead of the candidate that eq. 13 "
        "selects, so its labels have no noise."
    ),
    "student": (
        "This network has two ReLU layers of 32 units, and was trained like `optimum`. It is small, "
        "for use in [proofs](../how-to/prove.md)."
    ),
    "student-ensemble": (
        "The members are five `student` networks from five seeds. The spread is their standard "
        "deviation and needs no seed."
    ),
}
HEAD = """\
<!-- reader: research; written by: benchmarks/model_cards.py; question: How good are the shipped networks? -->

# The shipped networks

`python benchmarks/model_cards.py` writes this page from the model files and a fresh evaluation. Lengths are
in millimetres. `student` and `student-ensemble` are perceptrons. All other networks are the regression ResNet
of Chen et al. (2020), as in figures 3 and 4 of the paper. This ResNet has three stages of 32 units width,
each with one dense block and two identity blocks. We trained each network on two ordinary CPU cores in one
to four minutes, with [our own recipe](../how-to/train.md). `safety-harness train paper-mc-dropout` uses the
paper's recipe and scale instead.

**Training data**, the same for all networks: 10,000 TCPs x 500 hands, 100 candidates per TCP, seed 0, sha256
`{data}`.
The split is 0.8/0.1/0.1 by TCP. The seen space consists of two boxes (corners in the base frame): TCP {tcp},
hand {hand}.

**Calibration**: the residuals come from 10,000 fresh seen TCPs with one hand each, and the two quantiles
(multiplier and threshold) from 10,000 others. An interval extends to either side of the prediction by the
multiplier times sqrt(spread^2 + residual^2). Such intervals cover 95 % of the labels on all three axes
simultaneously. The spread exceeds the spread threshold in 1 % of the decisions in the seen space.

**Known limits**
{limits}
"""


def corner(values: tuple[float, ...]) -> str:
    """One corner of a box."""
    return "(" + ", ".join(f"{1e3 * value:.0f}" for value in values) + ")"


def millimetres(values: list[float]) -> str:
    """Lengths in metres, by axis."""
    return " / ".join(f"{1e3 * value:.2f}" for value in values)


def head(model: Model) -> str:
    """What the networks have in common."""
    seen = model.seen
    return HEAD.format(
        data=model.card["data"]["sha256"],
        tcp=f"{corner(seen.tcp_low_m)} to {corner(seen.tcp_high_m)}",
        hand=f"{corner(seen.hand_low_m)} to {corner(seen.hand_high_m)}",
        limits="\n".join(f"- {limit}" for limit in model.card["limits"]),
    )


def card(name: str, model: Model, found: dict[str, Any]) -> Iterator[str]:
    """One network."""
    calibration = model.calibration
    assert calibration is not None
    yield f"## {name}\n\n{ABOUT[name]}\n"
    yield f"- made by `{model.card['command']}` with PyTorch {model.card['software']['torch']}"
    yield f"- file sha256 `{found['sha256']}`"
    yield f"- best epoch {', '.join(map(str, model.card['metrics']['best_epoch']))}; weight decay " + (
        f"{model.card['weight_decay']:.3g}"
    )
    yield (
        f"- interval multiplier {calibration.interval_multiplier:.3f}, residuals "
        f"{millimetres(list(calibration.residual_std_m))}, spread threshold "
        f"{1e3 * calibration.spread_threshold_m:.2f}\n"
    )
    yield "| set | RMSE x / y / z | MAE x / y / z | joint coverage | spread above threshold | AUROC |"
    yield "|---|---|---|---|---|---|"
    for one in found["sets"]:
        yield row(one)
    yield ""


def row(one: dict[str, Any]) -> str:
    """One set of an evaluation."""
    errors, above, auroc = one["errors_m"], one.get("above_spread_threshold"), one["auroc_against_seen"]
    covered = one["intervals_95"]["joint"]["share"] if one.get("intervals_95") else None
    cells = (
        one["set"],
        millimetres(errors["rmse"]),
        millimetres(errors["mae"]),
        "-" if covered is None else f"{covered:.1%}",
        "-" if above is None else f"{above['share']:.1%}",
        "-" if auroc is None else f"{auroc:.3f}",
    )
    return "| " + " | ".join(cells) + " |"


def computing_time() -> Iterator[str]:
    """What each declares, and what it takes here."""
    yield "## Computing time\n"
    yield (
        "Every network declares a decision time of 0, so [time is not\n"
        "modelled](../how-to/avoider.md#computing-time) unless the settings state a time. Each network\n"
        "answered 1,000 queries, one at a time, as in `safety-harness time`. The machine was\n"
        f"{machine()}, with a load of {os.getloadavg()[0]:.0f} processes:\n"
    )
    yield "| network | declared | p50 | p99 | max |"
    yield "|---|---|---|---|---|"
    for name in SHIPPED:
        avoider = LearnedAvoider.from_model(load_model(shipped_model(name)))
        answers_at_first(avoider, *first_question(DEFAULTS))
        times_s, _ = answer_times_s(avoider, 1_000, 0)
        cells = (milliseconds_words(float(np.quantile(times_s, q))) for q in (0.5, 0.99, 1.0))
        declared = milliseconds_words(avoider.decision_time_s) if avoider.decision_time_s else "0"
        yield f"| `{name}` | {declared} | {' | '.join(cells)} |"
    yield ""


def what_evaluate_finds() -> Iterator[str]:
    """The rows of EVALUATE.md about the avoiders that ship."""
    yield "## What evaluate finds"
    yield ""
    yield "The table shows the findings of [`evaluate`](../how-to/evaluate.md) on the shipped avoiders, from"
    yield "`benchmarks/EVALUATE.md`, with the number of seeds of each finding and the ranges of the figures."
    yield "`opposite pose` and `nearest candidate` are far from the optimum, or jump, by design."
    yield ""
    shown = ("avoider", *SHIPPED, "opposite pose", "nearest candidate")
    rows = EVALUATE.read_text().partition("## Sound avoiders")[2].splitlines()
    yield from (row for row in rows if row.startswith(("|---", *(f"| {name} |" for name in shown))))
    yield ""


def main() -> None:
    """Evaluate, and write the page."""
    with tempfile.TemporaryDirectory() as folder:
        figures = Path(folder) / "figures.json"
        if metrics(SHIPPED, out=figures) != 0:
            sys.exit("the shipped models cannot be evaluated")
        found = json.loads(figures.read_text())
    models = {name: load_model(shipped_model(name)) for name in SHIPPED}
    floor = found["models"][0]["sets"][0]["label_floor_m"]
    lines = [head(models["mc-dropout"])]
    lines.append(
        f"Because of label noise, no regressor can have smaller errors than these on new seen TCPs: RMSE "
        f"{millimetres(floor['rmse_m'])}, MAE {millimetres(floor['mae_m'])} "
        "(1,000 redraws of the candidates of each TCP). "
        "Networks that are trained on the optimum have smaller errors, because their labels have no noise.\n"
    )
    lines.extend(computing_time())
    lines.extend(what_evaluate_finds())
    for name, one in zip(SHIPPED, found["models"], strict=True):
        lines.extend(card(name, models[name], one))
    PAGE.write_text("\n".join(lines).rstrip() + "\n")


if __name__ == "__main__":
    main()
