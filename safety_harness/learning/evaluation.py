"""What a model is worth: its errors, its intervals and its doubt, on sets of independent decisions."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from safety_harness.avoidance.learned import LearnedAvoider
from safety_harness.avoidance.model_file import Dropout, Model
from safety_harness.controller.desired import desired_transform_tcp_to_base
from safety_harness.exceptions import ModelError, Place
from safety_harness.learning.calibration import interval_scale
from safety_harness.learning.evaluation_sets import EvaluationSet
from safety_harness.learning.metrics import (
    Errors,
    IntervalCoverage,
    auroc,
    calibration_curve,
    coverage,
    errors,
    largest_spread,
    picp_variants,
)
from safety_harness.proportions import Proportion
from safety_harness.robot.description import load_arm
from safety_harness.robot.inverse import InverseKinematics
from safety_harness.settings import Settings

Floats = NDArray[np.float64]

LEVELS = (0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 0.95, 0.99)
PAPER_PRECISION_PER_MM2 = 1e-6
RESIDUALS = "spread and residuals"  # the variant of the PICP that only a calibrated model has


@dataclass(frozen=True, eq=False, kw_only=True)
class CalibratedIntervals:
    """The calibrated intervals, and what the calibration says of a decision's spread.

    ``covered``: rows whose label is within its interval on all three axes.  ``above_threshold``: rows whose
    largest spread is above the threshold, for which the gate falls back: false alarms on a seen set,
    detections on an unseen one; None for a model without any spread.
    """

    covered: Proportion
    coverage: IntervalCoverage
    above_threshold: Proportion | None


@dataclass(frozen=True, eq=False, kw_only=True)
class Figures:
    """One model on one set; lengths in metres.

    ``errors`` are against the labels that the model was trained for, ``noise_free`` against eq. 13 with
    the continuous optimum.  ``curves``: the share of labels (levels, 3) within the central interval of
    each level of ``LEVELS``, by scale.  ``auroc`` is that of the largest spread as a detector of this set
    against the seen one: None on a seen set, or if the model has no spread.
    """

    model: str
    set: EvaluationSet
    errors: Errors
    noise_free: Errors
    picp: Mapping[str, IntervalCoverage]
    curves: Mapping[str, Floats]
    median_largest_spread_m: float
    intervals: CalibratedIntervals | None
    auroc: float | None
    unreachable: Proportion


def has_spread(model: Model) -> bool:
    """Whether its spread can be anything but zero."""
    return model.dropout is not Dropout.NONE or model.members > 1


def learns_noise_free(model: Model) -> bool:
    """Whether its card says that it was trained for the continuous optimum."""
    return _recipe(model).get("target") == "continuous"


def evaluate_model(
    label: str, model: Model, sets: list[EvaluationSet], settings: Settings, *, place: Place
) -> list[Figures]:
    """The figures of ``model`` on each set; the first set is the seen one that others are told from.

    ModelError with ``place`` if an answer is not finite.
    """
    avoider = LearnedAvoider.of(model)
    seen_spread: Floats | None = None
    figures = []
    for one in sets:
        positions, spreads = avoider.propose_many(one.hands_in_base, one.tcps_in_base, one.decision_seeds)
        bad = np.flatnonzero(~np.isfinite(positions + spreads).all(axis=1))
        if len(bad):
            hand, tcp = one.hands_in_base[bad[0]].tolist(), one.tcps_in_base[bad[0]].tolist()
            raise ModelError(
                place=place,
                expected=f"finite answers on the set {one.name!r}",
                got=f"{positions[bad[0]].tolist()} for hand {hand} and TCP {tcp}",
            )
        largest = largest_spread(spreads)
        if seen_spread is None:
            seen_spread = largest
        told = not one.seen and has_spread(model)
        labels = one.noise_free_in_base if learns_noise_free(model) else one.labels_in_base
        figures.append(
            Figures(
                model=label,
                set=one,
                errors=errors(positions, labels),
                noise_free=errors(positions, one.noise_free_in_base),
                picp=_picp(model, positions, labels, spreads),
                curves=_curves(model, positions, labels, spreads),
                median_largest_spread_m=float(np.median(largest)),
                intervals=_intervals(model, positions, labels, spreads),
                auroc=auroc(seen_spread, largest) if told else None,
                unreachable=Proportion.of(~reachable(positions, settings)),
            )
        )
    return figures


def reachable(positions_in_base_m: Floats, settings: Settings) -> NDArray[np.bool_]:
    """(n,): has the position inverse kinematics within the joint limits, in the desired orientation?

    The end alone; the gate looks at the straight way there as well.
    """
    kinematics = _kinematics()
    pose = desired_transform_tcp_to_base(settings)
    reference = np.array(settings.cell.preferred_joint_position_rad)
    has = np.empty(len(positions_in_base_m), dtype=np.bool_)
    for k, position in enumerate(positions_in_base_m):
        pose[:3, 3] = position
        has[k] = kinematics.nearest(pose, reference) is not None
    return has


@lru_cache(maxsize=1)
def _kinematics() -> InverseKinematics:
    return InverseKinematics(load_arm())


def _recipe(model: Model) -> Mapping[str, Any]:
    """What the card says of the training; empty for a card that is not ours."""
    recipe = model.card.get("recipe")
    return recipe if isinstance(recipe, dict) else {}


def _residual_std(model: Model) -> Floats | None:
    return None if model.calibration is None else np.array(model.calibration.residual_std_m)


def _picp(model: Model, positions: Floats, labels: Floats, spreads: Floats) -> dict[str, IntervalCoverage]:
    """The readings of the paper's PICP; without a calibration the one with residuals is left out."""
    per_mm2 = _recipe(model).get("precision_per_mm2")
    known = isinstance(per_mm2, int | float) and per_mm2 > 0.0
    precision_per_m2 = 1e6 * (float(per_mm2) if known else PAPER_PRECISION_PER_MM2)  # type: ignore[arg-type]
    residual_std = _residual_std(model)
    variants = picp_variants(
        positions,
        labels,
        spreads,
        precision=precision_per_m2,
        residual_std=np.zeros(3) if residual_std is None else residual_std,
    )
    if residual_std is None:
        del variants[RESIDUALS]
    return variants


def _curves(model: Model, positions: Floats, labels: Floats, spreads: Floats) -> dict[str, Floats]:
    levels, residual_std = np.array(LEVELS), _residual_std(model)
    curves = {"spread": calibration_curve(positions, labels, spreads, levels)}
    if residual_std is not None:
        scale = interval_scale(spreads, residual_std)
        curves[RESIDUALS] = calibration_curve(positions, labels, scale, levels)
    return curves


def _intervals(
    model: Model, positions: Floats, labels: Floats, spreads: Floats
) -> CalibratedIntervals | None:
    calibration = model.calibration
    if calibration is None:
        return None
    scale = interval_scale(spreads, np.array(calibration.residual_std_m))
    half_widths = calibration.interval_multiplier * scale
    above = np.asarray(largest_spread(spreads) > calibration.spread_threshold_m)
    inside: NDArray[np.bool_] = np.all(np.abs(positions - labels) <= half_widths, axis=-1)
    return CalibratedIntervals(
        covered=Proportion.of(inside),
        coverage=coverage(positions, labels, half_widths),
        above_threshold=Proportion.of(above) if has_spread(model) else None,
    )
