"""How files are read that need more than a path, and a checkpoint to read."""

from __future__ import annotations

import tempfile
from dataclasses import replace
from functools import lru_cache
from pathlib import Path

import numpy as np

from safety_harness.cell.avoidance.model_file import onnx_bytes
from safety_harness.cell.avoidance.onnx_model import OnnxAvoider
from safety_harness.extensions.lab.learning.checkpoint import (
    Checkpoint,
    Epoch,
    load_checkpoint,
    save_checkpoint,
)
from safety_harness.extensions.lab.learning.recipes import OURS_DETERMINISTIC
from safety_harness.scenario.read import read_scenario
from safety_harness.testing.session import TestRun, begin, session
from safety_harness.testing.watching import kept_for


def onnx_read(path: Path) -> object:
    """As the process of the file does it, which would take too long to begin for each of these."""
    data = onnx_bytes(path)
    return OnnxAvoider.load(path, data, hand=np.array([0.8, -0.3, 0.1]), tcp=np.array([0.7, 0.0, 0.35]))


@lru_cache
def checkpoint_bytes() -> bytes:
    """A training after its first epoch, of two tensors."""
    tensors = {"a": np.zeros((3, 4), np.float32), "b": np.ones(5, np.float32)}
    epoch = Epoch(
        member=0, number=0, training_loss=1.0, validation_loss=1.0, validation_rmse_m=0.1, is_best=True
    )
    state = Checkpoint(
        recipe=OURS_DETERMINISTIC,
        seed=1,
        data="data",
        history=(epoch,),
        best=(tensors,),
        weights=tensors,
        optimiser=tensors,
    )
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "checkpoint.safetensors"
        save_checkpoint(state, path)
        return path.read_bytes()


def checkpoint_read(path: Path) -> object:
    """Of the same training."""
    return load_checkpoint(path, OURS_DETERMINISTIC, 1, "data")


def kept_read(path: Path) -> object:
    """As the tests of a session find their failures; no file of that name is no failure."""
    before = begin(replace(session(), failures=path.parent))
    try:
        found = list(kept_for(TestRun("", draws=True), None))
    finally:
        begin(before)
    return found or read_scenario(path)
