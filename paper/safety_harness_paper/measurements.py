"""Which measurements the tables share, and how their numbers are found in them."""

from __future__ import annotations

from typing import Any

from safety_harness.base.settings import DEFAULTS
from safety_harness_paper.networks import deterministic, ensemble, full, full_long, inter
from safety_harness_paper.part import Found
from safety_harness_paper.predictions import SEEN
from safety_harness_paper.predictions import measurement as evaluation
from safety_harness_paper.reach import measurement as reach
from safety_harness_paper.scale import PASSES, Scale
from safety_harness_paper.trials import measurement as trial
from safety_harness_paper.work import Task

DNN, FULL, INTER = range(3)  # the models of a "main" evaluation
SPREAD = "spread"  # the reading of the PICP that can give the paper's figures
AXES = ("x", "y", "z")


def main_evaluations(scale: Scale, root: int) -> dict[str, Task]:
    """Of DNN, DO-full and DO-inter, one a training seed."""
    return {
        f"main {k}": evaluation(
            "DNN, DO-full, DO-inter",
            (deterministic(scale, root, k), full(scale, root, k), inter(scale, root, k)),
            samples=scale.test_samples,
            root=root,
            k=k,
            passes=PASSES,
            settings=DEFAULTS,
        )
        for k in range(scale.seeds)
    }


def long_evaluations(scale: Scale, root: int) -> dict[str, Task]:
    """Of DO-full with six times the epochs."""
    return {
        f"long {k}": evaluation(
            "DO-full, six times the epochs",
            (full_long(scale, root, k),),
            samples=scale.test_samples,
            root=root,
            k=k,
            passes=(10,),
            settings=DEFAULTS,
        )
        for k in range(scale.seeds)
    }


def ensemble_evaluations(scale: Scale, root: int) -> dict[str, Task]:
    """Of the one ensemble, on every draw."""
    return {
        f"ensemble {k}": evaluation(
            "the ensemble",
            (ensemble(scale, root),),
            samples=scale.test_samples,
            root=root,
            k=k,
            passes=(1,),
            settings=DEFAULTS,
        )
        for k in range(scale.seeds)
    }


def systems(scale: Scale, root: int, k: int) -> tuple[Task, ...]:
    """DNN and Bayesian DNN of a training seed, and the ensemble."""
    return deterministic(scale, root, k), inter(scale, root, k), ensemble(scale, root)


def reaches(scale: Scale, root: int) -> dict[str, Task]:
    """Table 4's, one a training seed."""
    return {
        f"reach {k}": reach(systems(scale, root, k), tcps=scale.reach_tcps, root=root, k=k, settings=DEFAULTS)
        for k in range(scale.seeds)
    }


def all_trials(scale: Scale, root: int) -> dict[str, Task]:
    """Table 5's, one a training seed."""
    return {
        f"trials {k}": trial(
            systems(scale, root, k),
            trials=scale.trials,
            few=scale.few_trials,
            root=root,
            k=k,
            settings=DEFAULTS,
        )
        for k in range(scale.seeds)
    }


def in_seeds(found: Found, prefix: str) -> list[dict[str, Any]]:
    """The results of "prefix 0", "prefix 1", ... in order."""
    count = sum(name.rpartition(" ")[0] == prefix for name in found)
    return [found[f"{prefix} {k}"].result for k in range(count)]


def figures(
    found: Found, prefix: str, model: int, *, on: str = SEEN, passes: int = 10
) -> list[dict[str, Any]]:
    """Of one model on one set, one a training seed."""
    return [one["models"][model][on][str(passes)] for one in in_seeds(found, prefix)]


def rmse(rows: list[dict[str, Any]]) -> list[float]:
    """Overall RMSE [m] of each."""
    return [row["rmse"] for row in rows]


def picp(rows: list[dict[str, Any]], axis: int, variant: str = SPREAD) -> list[float]:
    """Of one axis."""
    return [row["picp"][variant][axis] for row in rows]
