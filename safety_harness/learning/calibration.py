"""Calibration: how wide an interval must be, and which spread is too large, by held-out *seen* TCPs.

Both numbers are quantiles with the finite-sample correction of split-conformal prediction, over
decisions that are exchangeable with a new one of the seen space: every TCP and every hand is drawn
afresh and used once, as two samples of one TCP would share the noise of its label.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from safety_harness.avoidance.learned import LearnedAvoider
from safety_harness.avoidance.model_file import Calibration, Model
from safety_harness.learning.dataset import CompactDataset, generate
from safety_harness.learning.metrics import conformal_multiplier, spread_threshold
from safety_harness.learning.recipes import Recipe
from safety_harness.learning.samples import samples_for

Floats = NDArray[np.float64]

SAMPLES = 10_000
COVERAGE_LEVEL = 0.95  # of the intervals, jointly over the three axes
SPREAD_LEVEL = 0.99
_RESIDUALS, _QUANTILES = 0, 1  # leaves of (BRANCH, ...) below the seed: one data set for each purpose
BRANCH = 7


def calibrate(
    model: Model, recipe: Recipe, dataset: CompactDataset, *, seed: int, samples: int = SAMPLES
) -> Model:
    """``model`` with its calibration, from fresh draws of the space that ``dataset`` was drawn from.

    Residuals say how wide the scale sqrt(spread^2 + residual_std^2) of an interval is, by axis; a
    second, independent set says by what multiple of it 95 % of the labels are covered on all axes
    at once, and which spread one decision in a hundred exceeds.  (Angelopoulos and Bates, 2023.)
    """
    avoider = LearnedAvoider.of(model)
    predictions, targets, _ = _decisions(avoider, recipe, dataset, seed, _RESIDUALS, samples)
    residual_std = np.sqrt(((predictions - targets) ** 2).mean(axis=0))
    predictions, targets, spreads = _decisions(avoider, recipe, dataset, seed, _QUANTILES, samples)
    scales = interval_scale(spreads, residual_std)
    x, y, z = (float(std) for std in residual_std)
    return replace(
        model,
        calibration=Calibration(
            interval_multiplier=conformal_multiplier(predictions, targets, scales, COVERAGE_LEVEL),
            spread_threshold_m=spread_threshold(spreads, SPREAD_LEVEL),
            residual_std_m=(x, y, z),
            samples=samples,
            more={"coverage_level": COVERAGE_LEVEL, "spread_level": SPREAD_LEVEL, "seed": seed},
        ),
    )


def interval_scale(spreads: Floats, residual_std: Floats) -> Floats:
    """(n, 3): sqrt(spread^2 + residual_std^2), what the interval multiplier multiplies [m]."""
    scale: Floats = np.sqrt(spreads**2 + residual_std**2)
    return scale


def _decisions(
    avoider: LearnedAvoider, recipe: Recipe, dataset: CompactDataset, seed: int, purpose: int, samples: int
) -> tuple[Floats, Floats, Floats]:
    """Predictions, labels and spreads (n, 3) [m] on ``samples`` fresh pairs of a TCP and a hand."""
    leaf = np.random.SeedSequence(seed, spawn_key=(BRANCH, purpose)).generate_state(1, np.uint64)
    fresh = generate(
        dataset.settings,
        dataset.space,
        seed=int(leaf[0]),
        tcps=samples,
        candidates=dataset.candidates,
        hands=samples,
    )
    pairs = np.arange(samples) * (samples + 1)  # TCP k with hand k
    inputs = fresh.inputs(pairs)
    predictions, spreads = avoider.propose_many(
        inputs[:, :3], inputs[:, 3:], np.arange(samples, dtype=np.uint64)
    )
    return predictions, samples_for(recipe, fresh).targets(pairs), spreads
