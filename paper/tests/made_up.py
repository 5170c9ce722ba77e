"""Measurements that nobody made: the paper's own figures with a little scatter, to be bent by tests."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from safety_harness_paper import table1, table3
from safety_harness_paper.avoiders import BAYESIAN, DNN, ENSEMBLE, NONE, OPPOSITE
from safety_harness_paper.predictions import BOTH, HAND, SEEN, TCP
from safety_harness_paper.reach import SETS
from safety_harness_paper.scale import PASSES
from safety_harness_paper.trials import FEW, MANY
from safety_harness_paper.work import Done

SEEDS = 5
OTHER_READINGS = ("spread and residuals", "spread and 1/tau", "eq. 11 as printed")
Found = dict[str, Done]
Bend = Callable[[float], float]


def same(value: float) -> float:
    return value


def done(result: dict[str, Any]) -> Done:
    return Done(Path("nowhere"), result)


def numbers(rmse_mm: float, picp: tuple[float, ...] = (0.0, 0.0, 0.0), *, k: int) -> dict[str, Any]:
    """One model on one set; training k is a little off."""
    off = 1.0 + 0.002 * (k - 2)
    return {
        "rmse": 1e-3 * rmse_mm * off,
        "picp": {"spread": [p * off for p in picp], **{name: [0.95] * 3 for name in OTHER_READINGS}},
        "noise_free_rmse": 5e-3,
        "auroc": 0.9,
    }


def main_evaluations(*, rmse: Bend = same, picp: Bend = same, dnn: Bend = same) -> Found:
    """Tables 1 and 3 as the paper has them, and DO-full of table 2 with as many epochs, a little worse."""
    found = {}
    for k in range(SEEDS):
        inter: dict[str, dict[str, Any]] = {SEEN: {}}
        for column, passes in enumerate(PASSES):
            shares = tuple(picp(table1.PAPER_PICP[axis][column]) for axis in "xyz")
            inter[SEEN][str(passes)] = numbers(rmse(table1.PAPER_RMSE_MM[column]), shares, k=k)
        plain = {SEEN: {"1": numbers(dnn(11.4), k=k)}}
        for column, name in enumerate((HAND, TCP, BOTH)):
            shares = tuple(picp(table3.PAPER_PICP[axis][column]) for axis in "xyz")
            inter[name] = {"10": numbers(rmse(table3.PAPER_RMSE_MM[BAYESIAN][column]), shares, k=k)}
            plain[name] = {"1": numbers(dnn(table3.PAPER_RMSE_MM[DNN][column]), k=k)}
        full = {SEEN: {"10": numbers(24.0, (0.70, 0.90, 0.90), k=k)}}
        found[f"main {k}"] = done({"models": [plain, full, inter], "floor_rmse": 0.0107, "rows": rows(k)})
    return found


def rows(k: int) -> dict[str, Any]:
    """Figure 6's: nine in ten labels within their intervals."""
    label = np.zeros((200, 3))
    label[::10] = 1.0
    return {
        "label": label.tolist(),
        "position": np.zeros((200, 3)).tolist(),
        "spread": np.full((200, 3), 0.01).tolist(),
    }


def long_evaluations(*, rmse_mm: float = 22.49, picp_x: float = 0.71) -> Found:
    return {
        f"long {k}": done({"models": [{SEEN: {"10": numbers(rmse_mm, (picp_x, 0.94, 0.94), k=k)}}]})
        for k in range(SEEDS)
    }


def ensemble_evaluations() -> Found:
    figures = {name: {"1": {}} for name in (SEEN, HAND, TCP, BOTH)}
    return {
        f"ensemble {k}": done(
            {"models": [{name: {"1": numbers(11.0, (0.3, 0.4, 0.4), k=k)} for name in figures}]}
        )
        for k in range(SEEDS)
    }


def reaches(*, dnn: int = 22, bayesian: int = 0) -> Found:
    """Of 50 poses each, so many out of reach."""
    found = {}
    for k in range(SEEDS):
        systems = {
            name: {
                "unreachable": [number < count for number in range(50)],
                "uncertain": [False] * 50,
                "reach": ["opposite" if number < count else "proposed" for number in range(50)],
                "full": ["stop"] * 50,
            }
            for name, count in ((DNN, dnn), (BAYESIAN, bayesian), (ENSEMBLE, 1), (OPPOSITE, 9))
        }
        found[f"reach {k}"] = done({name: {"redrawn": 3, "avoiders": systems} for name in SETS})
    return found


def trials(*, bayesian: float = 201.3, opposite: float = 869.28) -> Found:
    """One of them never converges, one takes no iteration at all."""
    found = {}
    for k in range(SEEDS):
        rng = np.random.default_rng(k)

        def system(mean: float, rng: np.random.Generator = rng) -> dict[str, Any]:
            iterations: list[int | None] = [round(mean + x) for x in rng.normal(0.0, 2.0, 20)]
            return {
                "fates": ["converged"] * 20 + ["lost", "refused", "converged"],
                "iterations": [*iterations, None, None, 0],
            }

        systems = {BAYESIAN: system(bayesian), OPPOSITE: system(opposite), NONE: system(400.0)}
        record = {
            "trigger": 100,
            "arrival": 160,
            "switch": 400,
            "feature_error": [[0.1] * 6, [None] * 6, [0.0] * 6],
            "camera_twist": [[0.1] * 6] * 3,
            "sse_gain_mode": [[0.1, 0.4, 0.0]] * 3,
            "proposed_in_base_m": [0.7, 0.0, 0.4],
        }
        few = {"redrawn": {}, "systems": systems, "records": {BAYESIAN: record, OPPOSITE: record}}
        found[f"trials {k}"] = done({FEW: few, MANY: {"redrawn": {}, "systems": systems}})
    return found
