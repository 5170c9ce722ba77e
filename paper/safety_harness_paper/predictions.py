"""Errors and intervals of the networks on fresh draws of the seen space and of the three unseen ones.

One draw belongs to one training seed, so that an interval over trainings is one over test draws as well.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from safety_harness.base.settings import Settings
from safety_harness.cell.avoidance.learned import LearnedAvoider
from safety_harness.cell.avoidance.model_file import Dropout, Model
from safety_harness.extensions.lab.learning.evaluation import EvaluationSet, fresh_sets, leaf
from safety_harness.extensions.lab.learning.metrics import (
    auroc,
    coverage,
    errors,
    largest_spread,
    picp_variants,
)
from safety_harness_paper.networks import model_in
from safety_harness_paper.work import Done, Json, Task

PAPER_PRECISION_PER_M2 = 1.0  # tau = 1e-6 per mm^2
ROWS = 200  # of figure 6
SEEN, HAND, TCP, BOTH = "seen, new TCPs", "unseen hand", "unseen tcp", "unseen both"
_DRAW = 1  # below the root seed, on the evaluation's branch


def measurement(
    label: str,
    models: tuple[Task, ...],
    *,
    samples: int,
    root: int,
    k: int,
    passes: tuple[int, ...],
    settings: Settings,
) -> Task:
    """Evaluate ``models`` on the k-th draw of test sets."""
    return Task(
        f"evaluate {label}, draw {k}",
        measure,
        (
            ("samples", samples),
            ("draw_seed", leaf(root, _DRAW, k)),
            ("passes", passes),
            ("settings", settings),
        ),
        models,
        seconds=1.0 + samples * (1.2e-3 + 5e-5 * len(models)),
    )


def measure(
    folder: Path, *trained: Done, samples: int, draw_seed: int, passes: tuple[int, ...], settings: Settings
) -> Json:
    """{"models": [{set: {passes: figures}}], "floor": ..., "rows": ...}; metres."""
    count = settings.avoidance.candidate_count
    sets = fresh_sets(settings, samples=samples, seed=draw_seed, candidates=count)
    models = [model_in(one) for one in trained]
    floor = sets[0].floor
    assert floor is not None
    return {
        "models": [_of_model(model, sets, passes) for model in models],
        "floor": {"rmse_by_axis": list(floor.rmse_m), "mae_by_axis": list(floor.mae_m)},
        "floor_rmse": float(np.sqrt(np.mean(np.square(floor.rmse_m)))),
        "rows": _rows(models[-1], sets[0]),
    }


def _of_model(model: Model, sets: list[EvaluationSet], passes: tuple[int, ...]) -> Json:
    """Deterministic networks and ensembles have one number of passes: their own."""
    numbers = passes if model.dropout is not Dropout.NONE else (model.passes,)
    found: dict[str, dict[str, Any]] = {one.name: {} for one in sets}
    for number in numbers:
        seen_spread = None
        avoider = LearnedAvoider.from_model(replace(model, passes=number))
        for one in sets:
            if number != 10 and len(numbers) > 1 and one is not sets[0]:
                continue  # table 1 is about the seen set
            figures, spread = _figures(avoider, one)
            seen_spread = spread if seen_spread is None else seen_spread
            figures["auroc"] = auroc(seen_spread, spread) if one is not sets[0] else None
            found[one.name][str(number)] = figures
    return found


def _figures(avoider: LearnedAvoider, one: EvaluationSet) -> tuple[dict[str, Any], np.ndarray[Any, Any]]:
    positions, spreads = avoider.propose_many(one.hands_in_base, one.tcps_in_base, one.decision_seeds)
    calibration = avoider.model.calibration
    assert calibration is not None
    residual = np.array(calibration.residual_std_m)
    error, noise_free = errors(positions, one.labels_in_base), errors(positions, one.noise_free_in_base)
    variants = picp_variants(
        positions, one.labels_in_base, spreads, precision=PAPER_PRECISION_PER_M2, residual_std=residual
    )
    half = calibration.interval_multiplier * np.sqrt(spreads**2 + residual**2)
    figures = {
        "rmse": error.overall_rmse,
        "mae": error.overall_mae,
        "rmse_by_axis": error.rmse.tolist(),
        "mae_by_axis": error.mae.tolist(),
        "noise_free_rmse": noise_free.overall_rmse,
        "picp": {name: found.picp.tolist() for name, found in variants.items()},
        "calibrated_joint": coverage(positions, one.labels_in_base, half).joint,
        "median_spread": np.median(spreads, axis=0).tolist(),
    }
    return figures, largest_spread(spreads)


def _rows(model: Model, one: EvaluationSet) -> Json:
    """The first test samples as figure 6 shows them."""
    rows = slice(0, ROWS)
    positions, spreads = LearnedAvoider.from_model(model).propose_many(
        one.hands_in_base[rows], one.tcps_in_base[rows], one.decision_seeds[rows]
    )
    return {
        "label": one.labels_in_base[rows].tolist(),
        "position": positions.tolist(),
        "spread": spreads.tolist(),
    }
