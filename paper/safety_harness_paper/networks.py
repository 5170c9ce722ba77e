"""The networks that everything is measured on: trained by the package's own training, kept as tasks.

All of one scale and seed learn from one data set, as the paper's do; they differ in initial weights, order of
samples and dropout.  The ensemble is the deterministic networks together.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

from safety_harness.base.settings import DEFAULTS, Settings
from safety_harness.cell.avoidance.learned import LearnedAvoider
from safety_harness.cell.avoidance.model_file import Model, load_model, save_model
from safety_harness.extensions.lab.learning.dataset import CompactDataset, generate, seen
from safety_harness.extensions.lab.learning.recipes import Recipe
from safety_harness.extensions.lab.learning.samples import samples_for
from safety_harness.extensions.lab.learning.trained_model import calibrate, model_of, split_for
from safety_harness_paper.scale import Scale
from safety_harness_paper.work import Done, Json, Task

MODEL = "model.safetensors"
SEEDS_APART = 1000  # a run with --seed 1 shares no seed with one with --seed 0
PASSES_A_SECOND = {"none": 95_000.0, "inter": 95_000.0, "full": 44_000.0}  # samples, on one core


def seed_of(root: int, k: int) -> int:
    """The k-th seed of a run: what ``safety-harness train --seed`` would be given."""
    return SEEDS_APART * root + k


def training(
    label: str, recipe: Recipe, scale: Scale, root: int, k: int, *, settings: Settings = DEFAULTS
) -> Task:
    """The training of one network."""
    samples = recipe.training_samples or int(0.8 * scale.tcps * scale.hands)
    return Task(
        f"train {label}, seed {seed_of(root, k)}",
        train_network,
        (
            ("recipe", recipe),
            ("seed", seed_of(root, k)),
            ("data_seed", seed_of(root, 0)),
            ("tcps", scale.tcps),
            ("hands", scale.hands),
            ("calibration_samples", scale.calibration_samples),
            ("settings", settings),
        ),
        seconds=5.0 + samples * recipe.epochs * recipe.members / PASSES_A_SECOND[recipe.dropout.value],
    )


def deterministic(scale: Scale, root: int, k: int) -> Task:
    """The paper's DNN."""
    return training("DNN", scale.deterministic, scale, root, k)


def inter(scale: Scale, root: int, k: int) -> Task:
    """The paper's Bayesian DNN: dropout between the residual blocks."""
    return training("DO-inter", scale.inter, scale, root, k)


def full(scale: Scale, root: int, k: int) -> Task:
    """Dropout before every layer, as many epochs as DO-inter."""
    return training("DO-full", scale.full, scale, root, k)


def full_long(scale: Scale, root: int, k: int) -> Task:
    """Dropout before every layer, six times as many epochs."""
    return training("DO-full, six times the epochs", scale.full_long, scale, root, k)


def ensemble(scale: Scale, root: int) -> Task:
    """All deterministic networks of the run as one model."""
    return Task(
        "put the ensemble together",
        combine,
        (("data_seed", seed_of(root, 0)), ("calibration_samples", scale.calibration_samples)),
        tuple(deterministic(scale, root, k) for k in range(scale.seeds)),
        seconds=4.0,
    )


def train_network(
    folder: Path,
    *,
    recipe: Recipe,
    seed: int,
    data_seed: int,
    tcps: int,
    hands: int,
    calibration_samples: int,
    settings: Settings,
) -> Json:
    """Train, calibrate, save; goes on from a checkpoint in ``folder``."""
    from safety_harness.extensions.lab.learning.training import train  # brings PyTorch

    dataset = _data(settings, data_seed, tcps, hands)
    split = split_for(recipe, dataset)
    trained = train(
        recipe,
        samples_for(recipe, dataset),
        split.train,
        split.validation,
        seed=seed,
        out=folder,
        resume=True,
    )
    model = model_of(
        trained, dataset, split, f"safety-harness reproduce (seed {seed}, data seed {data_seed})"
    )
    model = calibrate(model, recipe, dataset, seed=seed, samples=calibration_samples)
    save_model(model, folder / MODEL)
    return _about(model)


def combine(folder: Path, *members: Done, data_seed: int, calibration_samples: int) -> Json:
    """One model of several deterministic networks of the same data, calibrated anew."""
    models = [model_in(member) for member in members]
    first = models[0]
    assert all(model.input_mean == first.input_mean for model in models), "of one data set"
    together = replace(
        first,
        members=len(models),
        calibration=None,
        card=dict(first.card) | {"members": [dict(model.card) for model in models]},
        tensors={
            f"{k}/{name.partition('/')[2]}": tensor
            for k, model in enumerate(models)
            for name, tensor in model.tensors.items()
        },
    )
    dataset = _data(DEFAULTS, data_seed, 10, 10)  # calibration draws its own from the same space
    from safety_harness.extensions.lab.learning.recipes import OURS_ENSEMBLE

    together = calibrate(together, OURS_ENSEMBLE, dataset, seed=data_seed, samples=calibration_samples)
    save_model(together, folder / MODEL)
    return _about(together)


def model_in(done: Done) -> Model:
    """The model that a training left."""
    return load_model(done.folder / MODEL)


def avoider_in(done: Done) -> LearnedAvoider:
    """The same, ready to propose."""
    return LearnedAvoider.from_model(model_in(done))


def _data(settings: Settings, seed: int, tcps: int, hands: int) -> CompactDataset:
    count = settings.avoidance.candidate_count
    return generate(settings, seen(settings), seed=seed, tcps=tcps, candidates=count, hands=hands)


def _about(model: Model) -> Json:
    card: dict[str, Any] = dict(model.card)
    calibration = model.calibration
    assert calibration is not None
    return {
        "best_epoch": card["metrics"]["best_epoch"],
        "weight_decay": card["weight_decay"],
        "training_samples": card["data"]["training_samples"],
        "residual_std_m": list(calibration.residual_std_m),
        "spread_threshold_m": calibration.spread_threshold_m,
    }
