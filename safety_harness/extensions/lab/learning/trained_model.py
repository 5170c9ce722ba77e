"""The contents of a model file from a training: networks, normalisation, seen space, card, calibration.

The calibration uses held-out *seen* TCPs.  It determines the width of the intervals, and the spread above
which an answer is in doubt.  Both numbers are quantiles with the finite-sample correction of split-conformal
prediction.  They come from decisions that are exchangeable with a new decision in the seen space.  The
calibration draws new TCPs and hands and uses each once, since samples of a TCP share the noise of its label.
"""

from __future__ import annotations

from dataclasses import replace
from importlib import metadata
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from safety_harness.base.distribution import installed_version
from safety_harness.cell.avoidance.learned import LearnedAvoider
from safety_harness.cell.avoidance.model_file import CARD_ARM, SIZES, Calibration, Dropout, Model, SeenSpace
from safety_harness.extensions.lab.learning.dataset import (
    SPLITS,
    CompactDataset,
    Split,
    fresh_pairs,
    seed_below,
)
from safety_harness.extensions.lab.learning.manifest import data_hash
from safety_harness.extensions.lab.learning.metrics import conformal_multiplier, spread_threshold
from safety_harness.extensions.lab.learning.recipes import Recipe
from safety_harness.extensions.lab.learning.samples import samples_for
from safety_harness.scenario.typed_json import plain

if TYPE_CHECKING:
    from safety_harness.extensions.lab.learning.training import Trained  # which brings PyTorch

Floats = NDArray[np.float64]

LIMITS = (
    "made for the cell, camera and tool orientation of the data set's settings, and no others",
    "says nothing useful about TCPs and hands outside the seen space; the spread hardly tells unseen hands",
    "the spread is the network's own doubt and does not contain the noise of the labels",
)


def split_for(recipe: Recipe, dataset: CompactDataset) -> Split:
    """Return the split of ``dataset`` that ``recipe`` names, drawn from the data set's own seed."""
    return SPLITS[recipe.split](dataset, seed=dataset.seed)


def model_of(trained: Trained, dataset: CompactDataset, split: Split, command: str) -> Model:
    """Return a model of the trained networks, with normalisation, seen space and card; no calibration yet.

    Args:
        trained: The result of the training.
        dataset: The data set of the training.
        split: The split of the data set.
        command: The command that ran the training, for the card.

    """
    recipe = trained.recipe
    drops = recipe.dropout is not Dropout.NONE
    hand, tcp = dataset.space.hand.outer, dataset.space.tcp.outer
    moments: dict[str, Any] = {name: tuple(m.tolist()) for name, m in vars(trained.normalisation).items()}
    stages, blocks = SIZES[recipe.kind]
    return Model(
        kind=recipe.kind,
        stages=stages,
        blocks=blocks,
        dropout=recipe.dropout,
        dropout_probability=recipe.dropout_probability if drops else 0.0,
        members=recipe.members,
        passes=recipe.passes if drops else 1,
        **moments,
        seen=SeenSpace(
            hand_low_m=hand.low_m, hand_high_m=hand.high_m, tcp_low_m=tcp.low_m, tcp_high_m=tcp.high_m
        ),
        calibration=None,
        card=_card(trained, dataset, split, command),
        tensors={
            f"{member}/{name}": tensor
            for member, tensors in enumerate(trained.members)
            for name, tensor in tensors.items()
        },
    )


def _card(trained: Trained, dataset: CompactDataset, split: Split, command: str) -> dict[str, Any]:
    """Return the card, which states the origin of the model and its figures in the validation."""
    best = [
        [epoch for epoch in trained.history if epoch.member == member and epoch.is_best][-1]
        for member in range(trained.recipe.members)
    ]
    return {
        CARD_ARM: dataset.arm,
        "command": command,
        "recipe": plain(trained.recipe),
        "seed": trained.seed,
        "weight_decay": trained.weight_decay,
        "software": {
            "safety-harness": installed_version(),
            "torch": metadata.version("torch"),
        },
        "data": {
            "sha256": data_hash(dataset),
            "seed": dataset.seed,
            "tcps": dataset.tcps,
            "candidates": dataset.candidates,
            "hands": dataset.hands,
            "space": dataset.space.name,
            "split": split.kind,
            "training_samples": len(split.train),
        },
        "metrics": {
            "best_epoch": [epoch.number + 1 for epoch in best],
            "validation_loss": [epoch.validation_loss for epoch in best],
            "validation_rmse_m": [epoch.validation_rmse_m for epoch in best],
        },
        "limits": list(LIMITS),
    }


SAMPLES = 10_000
COVERAGE_LEVEL = 0.95  # of the intervals, jointly over the three axes
SPREAD_LEVEL = 0.99
_RESIDUALS, _QUANTILES = 0, 1  # leaves of (BRANCH, ...) below the seed: one data set for each purpose
BRANCH = 7


def calibrate(
    model: Model, recipe: Recipe, dataset: CompactDataset, *, seed: int, samples: int = SAMPLES
) -> Model:
    """Return ``model`` with a calibration from fresh draws of the data set's space.

    The residuals on a first set determine the scale sqrt(spread^2 + residual_std^2) of an interval, by axis.
    A second, independent set determines the multiple of this scale that covers 95 % of the labels on all axes
    at once.  The second set also determines the spread that one decision in a hundred exceeds (Angelopoulos
    and Bates, 2023).

    Args:
        model: The model.
        recipe: The recipe of its training.
        dataset: The data set of its training.
        seed: The root of the draws.
        samples: The number of decisions in each set.

    """
    avoider = LearnedAvoider.from_model(model)
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
    """Return the scale sqrt(s^2 + r^2) (n, 3) [m] that the interval multiplier multiplies.

    Here s is ``spreads`` (n, 3), and r is ``residual_std`` (3,).

    Args:
        spreads: The standard deviations over the passes.
        residual_std: The root mean square of the residuals on held-out labels.

    """
    scale: Floats = np.sqrt(spreads**2 + residual_std**2)
    return scale


def _decisions(
    avoider: LearnedAvoider, recipe: Recipe, dataset: CompactDataset, seed: int, purpose: int, samples: int
) -> tuple[Floats, Floats, Floats]:
    """Return predictions, labels and spreads (n, 3) [m] for ``samples`` fresh pairs of a TCP and a hand."""
    leaf = seed_below(seed, BRANCH, purpose)
    fresh, pairs = fresh_pairs(
        dataset.settings, dataset.space, seed=leaf, samples=samples, candidates=dataset.candidates
    )
    inputs = fresh.inputs(pairs)
    predictions, spreads = avoider.propose_many(
        inputs[:, :3], inputs[:, 3:], np.arange(samples, dtype=np.uint64)
    )
    return predictions, samples_for(recipe, fresh).targets(pairs), spreads
