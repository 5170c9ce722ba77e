"""``safety-harness train``: a data set and a recipe in, a model file out."""

from __future__ import annotations

import shlex
import time
from pathlib import Path
from typing import TYPE_CHECKING

from safety_harness.avoidance.model_file import Model, save_model
from safety_harness.cli.console import AS_EXPECTED, BAD_INPUT, INTERRUPTED, explain, result, say
from safety_harness.exceptions import InputError, ModelError, OutputError, Place
from safety_harness.learning.calibration import calibrate
from safety_harness.learning.checkpoint import Epoch
from safety_harness.learning.dataset import CompactDataset, generate
from safety_harness.learning.manifest import load_dataset
from safety_harness.learning.recipes import Recipe, recipe_named
from safety_harness.learning.samples import samples_for
from safety_harness.learning.spaces import seen
from safety_harness.learning.splits import Split
from safety_harness.learning.trained_model import model_of, split_for
from safety_harness.settings import DEFAULTS

if TYPE_CHECKING:
    from safety_harness.learning.training import Trained

MODEL = "model.safetensors"


def train(
    recipe_name: str,
    *,
    data: Path | None = None,
    seed: int = 0,
    out: Path = Path("models"),
    resume: bool = False,
    device: str = "cpu",
) -> int:
    """Train by a recipe on the data set in ``data`` (None: the paper's, made on the spot from ``seed``).

    One line an epoch goes to standard error; the best weights go to ``out``/model.safetensors.  Exit
    code 0, or 2 for bad input, or 130 after Ctrl-C, when ``resume`` goes on from the last epoch.
    """
    command = ["safety-harness", "train", recipe_name, "--seed", str(seed), "--out", str(out)]
    command += ["--data", str(data)] if data else []
    command += ["--device", device] if device != "cpu" else []
    try:
        recipe = recipe_named(recipe_name)
        dataset = load_dataset(data) if data else generate(DEFAULTS, seen(DEFAULTS), seed=seed)
        split = split_for(recipe, dataset)
        trained = _trained(recipe, dataset, split, seed, out, resume, device)
        say("calibrating on seen TCPs and hands that are new")
        model = model_of(trained, dataset, split, shlex.join(command))
        model = calibrate(model, recipe, dataset, seed=seed)
        _save(model, out / MODEL)
    except InputError as error:
        explain(error)
        return BAD_INPUT
    except KeyboardInterrupt:
        say(f"stopped; to go on from the last whole epoch: {shlex.join([*command, '--resume'])}")
        return INTERRUPTED
    assert model.calibration is not None
    multiplier, threshold_m = model.calibration.interval_multiplier, model.calibration.spread_threshold_m
    result(f"intervals of 95 % joint coverage: {multiplier:.3f} times sqrt(spread^2 + residual^2)")
    result(f"spread threshold: {1e3 * threshold_m:.2f} mm")
    result(f"model: {out / MODEL}")
    return AS_EXPECTED


def _trained(
    recipe: Recipe, dataset: CompactDataset, split: Split, seed: int, out: Path, resume: bool, device: str
) -> Trained:
    try:
        from safety_harness.learning.training import train as train_networks  # brings PyTorch
    except ModuleNotFoundError as error:
        raise ModelError(
            place=Place(field="train"),
            expected="PyTorch, which only training needs",
            got=str(error),
            hint="pip install 'safety-harness[learning]'",
        ) from error
    return train_networks(
        recipe,
        samples_for(recipe, dataset),
        split.train,
        split.validation,
        seed=seed,
        out=out,
        resume=resume,
        device=device,
        on_epoch=_EpochLines(recipe),
    )


class _EpochLines:
    """One line an epoch: the losses, and how long the rest will take."""

    def __init__(self, recipe: Recipe) -> None:
        self._recipe = recipe
        self._begun_s = time.monotonic()
        self._epochs = 0

    def __call__(self, epoch: Epoch) -> None:
        self._epochs += 1
        recipe = self._recipe
        left = recipe.members * recipe.epochs - epoch.member * recipe.epochs - epoch.number - 1
        left_s = left * (time.monotonic() - self._begun_s) / self._epochs
        member = f"member {epoch.member + 1}/{recipe.members}, " if recipe.members > 1 else ""
        say(
            f"{member}epoch {epoch.number + 1}/{recipe.epochs}: loss {epoch.training_loss:.4f}, "
            f"validation {epoch.validation_loss:.4f}, RMSE {1e3 * epoch.validation_rmse_m:.2f} mm"
            f"{' (best)' if epoch.is_best else ''}, {left_s:.0f} s left"
        )


def _save(model: Model, path: Path) -> None:
    try:
        save_model(model, path)
    except OSError as error:
        raise OutputError.of(path, error) from error
