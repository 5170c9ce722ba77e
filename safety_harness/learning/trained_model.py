"""A training made into a model file's contents: networks, normalisation, seen space and card."""

from __future__ import annotations

from dataclasses import asdict
from importlib import metadata
from typing import TYPE_CHECKING, Any

import numpy as np

from safety_harness.avoidance.model_file import Dropout, Model, SeenSpace
from safety_harness.learning.dataset import CompactDataset
from safety_harness.learning.manifest import data_hash
from safety_harness.learning.recipes import Recipe
from safety_harness.learning.splits import Split, split_by_sample, split_by_tcp

if TYPE_CHECKING:
    from safety_harness.learning.training import Trained  # which brings PyTorch

LIMITS = (
    "made for the cell, camera and tool orientation of the data set's settings, and no others",
    "says nothing useful about TCPs and hands outside the seen space; the spread hardly tells unseen hands",
    "the spread is the network's own doubt and does not contain the noise of the labels",
)


def split_for(recipe: Recipe, dataset: CompactDataset) -> Split:
    """The data set's split of the kind that the recipe names, from the data set's own seed."""
    split = split_by_tcp if recipe.split == "by TCP" else split_by_sample
    return split(dataset, seed=dataset.seed)


def model_of(trained: Trained, dataset: CompactDataset, split: Split, command: str) -> Model:
    """The trained networks with their normalisation, seen space and card, to be calibrated."""
    recipe, normal = trained.recipe, trained.normalisation
    drops = recipe.dropout is not Dropout.NONE
    hand, tcp = dataset.space.hand.outer, dataset.space.tcp.outer
    return Model(
        dropout=recipe.dropout,
        dropout_probability=recipe.dropout_probability if drops else 0.0,
        members=recipe.members,
        passes=recipe.passes if drops else 1,
        input_mean=_floats(normal.input_mean),
        input_std=_floats(normal.input_std),
        target_mean=_floats(normal.target_mean),
        target_std=_floats(normal.target_std),
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
    """How the model came about, and what it was seen to do."""
    best = [
        [epoch for epoch in trained.history if epoch.member == member and epoch.is_best][-1]
        for member in range(trained.recipe.members)
    ]
    return {
        "command": command,
        "recipe": asdict(trained.recipe) | {"dropout": trained.recipe.dropout.value},
        "seed": trained.seed,
        "weight_decay": trained.weight_decay,
        "software": {
            "safety-harness": metadata.version("safety-harness"),
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


def _floats(array: np.ndarray[Any, np.dtype[np.float64]]) -> tuple[float, ...]:
    return tuple(float(x) for x in array)
