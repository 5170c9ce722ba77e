"""What does an epoch of training cost, next to an ordinary loop of PyTorch?

Run: python benchmarks/training.py.  Both train the regression ResNet with dropout on the same samples, on
one thread, in turns.  The ordinary loop reads a sample at a time through a Dataset and a DataLoader, as
tutorials have it, with nn.Dropout and Adam; ours also validates, and writes a checkpoint.
"""

from __future__ import annotations

import one_thread  # noqa: F401 (before every library that reads its variables)

# isort: split

import sys
import tempfile
import time
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path

if find_spec("torch") is None:
    sys.exit("this benchmark compares with PyTorch: pip install -e '.[benchmarks]'")

import numpy as np
import torch
from naive_loop import regression_network
from ratios import Ratio
from torch.utils.data import DataLoader, Dataset

from safety_harness.extensions.lab.learning.recipes import TRIAL_MC_DROPOUT
from safety_harness.extensions.lab.learning.samples import ArraySamples
from safety_harness.extensions.lab.learning.training import train

SAMPLES, VALIDATION, BATCH, TURNS = 20_000, 1_000, 1_000, 3
RECIPE = replace(
    TRIAL_MC_DROPOUT,
    name="benchmark",
    training_samples=SAMPLES,
    validation_samples=VALIDATION,
    epochs=1,
    batch_size=BATCH,
)


def samples() -> ArraySamples:
    """Made-up hands and TCPs, and targets 100 mm away from the hand."""
    inputs = np.random.default_rng(1).uniform(0.2, 0.9, (SAMPLES + VALIDATION, 6))
    away = inputs[:, 3:] - inputs[:, :3]
    return ArraySamples(inputs, inputs[:, 3:] + 0.1 * away / np.linalg.norm(away, axis=1, keepdims=True))


class OneByOne(Dataset):  # type: ignore[misc]
    """A sample at a time."""

    def __init__(self, given: ArraySamples) -> None:
        every = np.arange(SAMPLES)
        self.inputs = np.append(given.inputs(every), np.ones((SAMPLES, 1)), axis=1)
        self.targets = given.targets(every)

    def __len__(self) -> int:
        return SAMPLES

    def __getitem__(self, k: int) -> tuple[torch.Tensor, torch.Tensor]:
        return (
            torch.tensor(self.inputs[k], dtype=torch.float32),
            torch.tensor(self.targets[k], dtype=torch.float32),
        )


def ordinary_epoch(given: ArraySamples) -> float:
    """Seconds."""
    network = regression_network().train()
    optimiser = torch.optim.Adam(network.parameters(), lr=1e-3)
    loader = DataLoader(OneByOne(given), batch_size=BATCH, shuffle=True)
    begun_s = time.perf_counter()
    for x, y in loader:
        optimiser.zero_grad()
        torch.nn.functional.l1_loss(network(x), y).backward()
        optimiser.step()
    return time.perf_counter() - begun_s


def our_epoch(given: ArraySamples) -> float:
    """Seconds of a whole training of one epoch."""
    training, validation = np.arange(SAMPLES), np.arange(SAMPLES, SAMPLES + VALIDATION)
    with tempfile.TemporaryDirectory() as folder:
        begun_s = time.perf_counter()
        train(RECIPE, given, training, validation, seed=1, out=Path(folder))
        return time.perf_counter() - begun_s


def ratios() -> list[Ratio]:
    """The ordinary loop over ours."""
    torch.set_num_threads(1)
    given = samples()
    our_epoch(given)
    turns = [(ordinary_epoch(given), our_epoch(given)) for _ in range(TURNS)]
    note = f"ours {min(own_s for _, own_s in turns) / SAMPLES * 1e6:.0f} us a sample"
    return [Ratio.of("an epoch of training, ordinary loop over ours", [a / b for a, b in turns], note=note)]


if __name__ == "__main__":
    for row in ratios():
        print(row)
