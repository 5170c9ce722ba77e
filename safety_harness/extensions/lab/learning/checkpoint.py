"""Save the state of a training after an epoch as one file, in the safetensors format with a JSON text.

Loading returns bit-identical numbers and never unpickles data.  The file does not contain the state of a
random generator, because each epoch uses its own generator, which derives from the training's seed.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from msgspec import Meta
from numpy.typing import NDArray
from safetensors import SafetensorError, safe_open
from safetensors.numpy import save

from safety_harness.base.exceptions import ModelError, OutputError, Place
from safety_harness.base.whole_file import replacing, writing
from safety_harness.extensions.lab.learning.recipes import Recipe
from safety_harness.scenario.files import refuse_no_file
from safety_harness.scenario.typed_json import plain, typed

FORMAT = "safety-harness checkpoint 1"
KEY = "safety_harness"  # the key of the JSON text in the metadata

Tensors = Mapping[str, NDArray[np.float32]]


@dataclass(frozen=True, kw_only=True)
class Epoch:
    """The losses after one epoch of one ensemble member.

    The numbers of epochs and members begin at 0.  Losses are means, in the unit of the network's output.

    ``training_loss`` is the mean of the losses of the epoch's batches.  ``validation_loss`` is the loss on
    the validation samples after the epoch.  A network with dropout is validated by the mean output of its
    passes.  ``is_best`` is True if this is the member's lowest validation loss so far.
    """

    member: int
    number: int
    training_loss: float
    validation_loss: float
    validation_rmse_m: float
    is_best: bool


@dataclass(frozen=True)
class _History:
    """The epochs in a checkpoint; a valid checkpoint contains at least one epoch."""

    history: Annotated[tuple[Epoch, ...], Meta(min_length=1)]


@dataclass(frozen=True, eq=False, kw_only=True)
class Checkpoint:
    """The state of a training, saved after the last epoch in ``history``.

    ``data`` is a hash of the training data.  ``best`` contains the best weights so far of every member whose
    training has begun.  ``weights`` and ``optimiser`` are the current state of the last of these members.
    """

    recipe: Recipe
    seed: int
    data: str
    history: tuple[Epoch, ...]
    best: tuple[Tensors, ...]
    weights: Tensors
    optimiser: Tensors


def begin_or_resume(path: Path, recipe: Recipe, seed: int, data: str, *, resume: bool) -> Checkpoint | None:
    """Return the checkpoint from which a training continues, or None if the training begins anew.

    If the training begins anew, the function creates the folder.

    Args:
        path: The checkpoint's file.
        recipe: The recipe of the training.
        seed: The seed of the training.
        data: The hash of the training data.
        resume: Whether to continue from an existing checkpoint.

    Raises:
        OutputError: The folder cannot be created, or it contains a checkpoint although ``resume`` is False.
        ModelError: The checkpoint belongs to another training, or is damaged.

    """
    if resume and path.exists():
        return load_checkpoint(path, recipe, seed, data)
    if path.exists():
        raise OutputError(
            place=Place(file=path),
            expected="a folder without a training in it",
            got="a checkpoint of one",
            hint="resume it, or choose another folder",
        )
    with writing(path.parent):
        path.parent.mkdir(parents=True, exist_ok=True)
    return None


def save_checkpoint(checkpoint: Checkpoint, path: Path) -> None:
    """Write the checkpoint to ``path`` atomically, and raise OutputError if that fails."""
    groups = {"weights": checkpoint.weights, "optimiser": checkpoint.optimiser}
    groups |= {f"best {member}": tensors for member, tensors in enumerate(checkpoint.best)}
    text = {
        "format": FORMAT,
        **_identity(checkpoint.recipe, checkpoint.seed, checkpoint.data),
        "history": [asdict(epoch) for epoch in checkpoint.history],
    }
    content = save(
        {f"{group}/{name}": tensor for group, tensors in groups.items() for name, tensor in tensors.items()},
        metadata={KEY: json.dumps(text, sort_keys=True)},
    )
    with writing(path), replacing(path) as unfinished:
        unfinished.write_bytes(content)


def load_checkpoint(path: Path, recipe: Recipe, seed: int, data: str) -> Checkpoint:
    """Return the checkpoint in ``path`` after a check that it belongs to this training.

    Args:
        path: The checkpoint's file.
        recipe: The recipe of the training.
        seed: The seed of the training.
        data: The hash of the training data.

    Raises:
        ModelError: The checkpoint belongs to another training, or is damaged.

    """
    refuse_no_file(path, "a checkpoint of a training", ModelError)
    try:
        with safe_open(path, framework="np") as file:
            text = json.loads((file.metadata() or {}).get(KEY, "null"))
            arrays = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
    except (OSError, SafetensorError, ValueError, RecursionError) as error:
        raise _refused(path, None, "a checkpoint of a training", str(error)) from error
    if not isinstance(text, dict) or text.get("format") != FORMAT:
        raise _refused(path, "format", FORMAT, "something else")
    for name, expected in _identity(recipe, seed, data).items():
        if text.get(name) != expected:
            raise _refused(path, name, *_difference(expected, text.get(name)))
    history = typed({"history": text.get("history")}, _History, path, error=ModelError).history
    members = range(recipe.members)[: history[-1].member + 1]
    return Checkpoint(
        recipe=recipe,
        seed=seed,
        data=data,
        history=history,
        best=tuple(_group(arrays, f"best {member}") for member in members),
        weights=_group(arrays, "weights"),
        optimiser=_group(arrays, "optimiser"),
    )


def _identity(recipe: Recipe, seed: int, data: str) -> dict[str, Any]:
    """Return the values in which a checkpoint and a training must agree, as JSON-compatible data."""
    return {"recipe": plain(recipe), "seed": seed, "data": data}


def _difference(expected: object, got: object) -> tuple[str, str]:
    """Return both values as text. If both are recipes, the texts contain only the fields that differ."""
    if isinstance(expected, dict) and isinstance(got, dict):
        keys = [key for key in expected if expected[key] != got.get(key)]
        return str({key: expected[key] for key in keys}), str({key: got.get(key) for key in keys})
    return str(expected), str(got)


def _group(arrays: Tensors, group: str) -> dict[str, NDArray[np.float32]]:
    """Return the arrays of a group as a dictionary; its keys are the names without the group's prefix."""
    prefix = group + "/"
    return {name.removeprefix(prefix): array for name, array in arrays.items() if name.startswith(prefix)}


def _refused(path: Path, field: str | None, expected: str, got: str) -> ModelError:
    return ModelError(
        place=Place(file=path, field=field),
        expected=expected,
        got=got,
        hint="resume with the same recipe, seed and data, or begin in another folder",
    )
