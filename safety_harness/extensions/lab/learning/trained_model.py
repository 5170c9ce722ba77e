"""Create a calibrated model, which a file can store, from the result of a training.

The calibration uses new TCPs in the *seen* space.  It determines the width of the intervals, and the
threshold of the spread above which an answer is uncertain.  Both numbers are quantiles of split-conformal
prediction, which correct for the finite number of samples.  Their guarantees apply to a new decision in the
seen space, because the calibration's decisions are exchangeable with such a decision.  Each TCP and each hand
occurs only once, because samples of the same TCP share the noise of its label.
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
    """Return a random split of ``dataset`` of the kind that ``recipe`` requires.

    The data set's own seed determines the split.
    """
    return SPLITS[recipe.split](dataset, seed=dataset.seed)


def model_of(trained: Trained, dataset: CompactDataset, split: Split, command: str) -> Model:
    """Return a model with the trained networks, their normalisation, their seen space and a card.

    The model has no calibration yet.

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
    """Return the model's card, which states the origin of the model and its losses in the validation."""
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


SAMPLES = 10_000  # decisions in each of the two sets; a choice
COVERAGE_LEVEL = 0.95  # of the intervals, jointly over the three axes
SPREAD_LEVEL = 0.99  # so the gate refuses one decision in a hundred of the seen space
_RESIDUALS, _QUANTILES = 0, 1  # leaves of (BRANCH, ...) below the seed: one data set for each purpose
BRANCH = 7


def calibrate(
    model: Model, recipe: Recipe, dataset: CompactDataset, *, seed: int, samples: int = SAMPLES
) -> Model:
    """Return a copy of ``model`` with a calibration on new random samples from the data set's space.

    The scale of an interval is sqrt(spread^2 + residual_std^2) for each axis.  A first set of samples
    determines residual_std.  A second, independent set determines the interval multiplier.  The multiplier is
    so large that 95 % of the labels lie within their intervals on all axes at once.  The second set also
    determines the threshold of the spread, which one decision in a hundred exceeds (Angelopoulos and Bates,
    2023).

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
    # The second set must be independent: the quantile holds only for scores that did not determine the scale.
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
    """Return the scale sqrt(s^2 + r^2) of intervals, shape (n, 3) [m].

    The half width of an interval is the interval multiplier times this scale.

    Here s is ``spreads``, and r is ``residual_std``.

    Args:
        spreads: (n, 3) the standard deviations over the passes.
        residual_std: (3,) the root mean square of the residuals on held-out labels.

    """
    scale: Floats = np.sqrt(spreads**2 + residual_std**2)
    return scale


def _decisions(
    avoider: LearnedAvoider, recipe: Recipe, dataset: CompactDataset, seed: int, purpose: int, samples: int
) -> tuple[Floats, Floats, Floats]:
    """Return predictions, labels and spreads for new random pairs of TCP and hand, shape (n, 3) each [m].

    The number n of pairs is ``samples``.
    """
    leaf = seed_below(seed, BRANCH, purpose)
    fresh, pairs = fresh_pairs(
        dataset.settings, dataset.space, seed=leaf, samples=samples, candidates=dataset.candidates
    )
    inputs = fresh.inputs(pairs)
    predictions, spreads = avoider.propose_many(
        inputs[:, :3], inputs[:, 3:], np.arange(samples, dtype=np.uint64)
    )
    return predictions, samples_for(recipe, fresh).targets(pairs), spreads
