"""Train networks with Adam on the L1 or L2 loss (section 4.1).

A training keeps the weights after the epoch with the lowest validation loss.

If a training is repeated with the same recipe, samples and seed on the same machine, the result is
bit-identical, even after an interruption.  A training uses one thread, because the rounding of sums depends
on the number of threads.  Each epoch of each member draws its samples and dropout masks from its own
generators, which derive from the training's seed.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch

from safety_harness.base.exceptions import ModelError, Place
from safety_harness.cell.avoidance.model_file import Dropout
from safety_harness.extensions.lab.learning.checkpoint import (
    Checkpoint,
    Epoch,
    Tensors,
    begin_or_resume,
    save_checkpoint,
)
from safety_harness.extensions.lab.learning.dataset import seed_below
from safety_harness.extensions.lab.learning.networks import (
    Masks,
    Network,
    RegressionResNet,
    fresh_network,
    load_tensors,
    to_tensors,
)
from safety_harness.extensions.lab.learning.recipes import Recipe
from safety_harness.extensions.lab.learning.samples import (
    Index,
    Normalisation,
    Samples,
    moments,
    network_samples,
)

CHECKPOINT = "checkpoint.safetensors"
VALIDATION_ROWS = 10_000  # at a time, so that a layer's values stay in the processor's cache

# Leaves of the seed: (WEIGHTS, member), (EPOCH, member, epoch[, 1 for masks]), (VALIDATION[, 0 for masks])
_WEIGHTS, _EPOCH, _VALIDATION = 1, 2, 3


@dataclass(frozen=True, eq=False, kw_only=True)
class Trained:
    """The result of a training: the best weights of each member, and the history of all epochs."""

    recipe: Recipe
    seed: int
    normalisation: Normalisation
    members: tuple[Tensors, ...]
    history: tuple[Epoch, ...]
    weight_decay: float


def train(
    recipe: Recipe,
    samples: Samples,
    training: Index,
    validation: Index,
    *,
    seed: int,
    out: Path,
    resume: bool = False,
    device: str = "cpu",
    on_epoch: Callable[[Epoch], None] = lambda epoch: None,
) -> Trained:
    """Train all members of a recipe, and write the state after each epoch to checkpoint.safetensors.

    An interruption at any time loses only the current epoch.  The function does not catch KeyboardInterrupt.

    Args:
        recipe: The recipe.
        samples: The samples.
        training: The numbers of the samples to train on.
        validation: The numbers of the samples to validate with.
        seed: The root of all random numbers.
        out: The folder of the checkpoint.
        resume: Whether to continue from the checkpoint in ``out``.  If there is no checkpoint, the training
            starts anew.
        device: The device of PyTorch.
        on_epoch: A function that receives each epoch after its checkpoint is written.

    Raises:
        OutputError: ``out`` cannot be written, or it contains a checkpoint although ``resume`` is False.
        ModelError: The checkpoint belongs to another training, there are too few samples, the device does not
            exist, or a loss is not finite.

    """
    if len(training) < 2 or len(validation) < 1:
        raise ModelError(
            place=Place(field="samples"),
            expected="at least 2 samples to train on and 1 to validate with",
            got=f"{len(training)} and {len(validation)}",
        )
    if seed < 0:
        raise ModelError(place=Place(field="seed"), expected="a seed of at least 0", got=str(seed))
    with _one_thread():
        run = _Run(recipe, samples, training, validation, seed, _device(device))
        path = out / CHECKPOINT
        state = begin_or_resume(path, recipe, seed, run.data, resume=resume)
        history = list(state.history) if state else []
        best = list(state.best) if state else []
        # A checkpoint's last member may be unfinished, so a resumed training begins with that member.
        for member in range(len(best) - 1 if state else 0, recipe.members):
            first = run.restore(state) if state else run.begin(member)
            state = None
            for number in range(first, recipe.epochs):
                epoch = run.epoch(member, number, [e for e in history if e.member == member])
                history.append(epoch)
                if epoch.is_best:
                    best[member:] = [to_tensors(run.network)]
                save_checkpoint(run.checkpoint(history, best), path)
                on_epoch(epoch)
    return Trained(
        recipe=recipe,
        seed=seed,
        normalisation=run.normalisation,
        members=tuple(best),
        history=tuple(history),
        weight_decay=run.weight_decay,
    )


def _device(name: str) -> torch.device:
    """Return the device after a small test, and raise ModelError if this machine has no such device."""
    try:
        device = torch.device(name)
        torch.ones(1, device=device)
    except (RuntimeError, AssertionError) as error:
        reason = str(error).splitlines()[0]
        raise ModelError(
            place=Place(field="device"), expected="a device that PyTorch finds, such as cpu", got=reason
        ) from error
    return device


@contextmanager
def _one_thread() -> Iterator[None]:
    """Make PyTorch compute with one thread, and restore the number of threads afterwards."""
    old_count = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(old_count)


class _Run:
    """The state of a training: its constants, and the network and optimiser of the current member."""

    network: Network
    optimiser: torch.optim.Adam

    def __init__(
        self,
        recipe: Recipe,
        samples: Samples,
        training: Index,
        validation: Index,
        seed: int,
        device: torch.device,
    ) -> None:
        self.recipe, self.seed, self.device = recipe, seed, device
        self._samples, self._training = samples, training
        mean, std = moments(samples, training)
        self.normalisation = Normalisation.from_recipe(recipe, mean, std)
        variance_mm2 = float(np.mean(std[6:] ** 2)) * 1e6
        self.weight_decay = recipe.weight_decay(len(training), variance_mm2)
        chosen = self._chosen(validation, recipe.validation_samples, _VALIDATION)
        x, y = network_samples(samples, np.sort(chosen), self.normalisation)
        self._validation = torch.from_numpy(x).to(device), torch.from_numpy(y).to(device)
        digest = hashlib.sha256(repr((len(training), len(validation))).encode())
        for array in (mean, std, x, y):
            digest.update(array.tobytes())
        self.data = digest.hexdigest()

    def begin(self, member: int) -> int:
        """Begin the training of a new member, and return the number of its first epoch."""
        self._use(fresh_network(self.recipe, seed_below(self.seed, _WEIGHTS, member)))
        return 0

    def restore(self, state: Checkpoint) -> int:
        """Restore the last member in a checkpoint, and return the number of its next epoch."""
        # The seed has no effect, because the tensors of the checkpoint replace all weights.
        network = fresh_network(self.recipe, 0)
        load_tensors(network, state.weights)
        self._use(network)
        optimiser = self.optimiser.state_dict()
        for name, array in state.optimiser.items():
            index, key = name.split("/")
            optimiser["state"].setdefault(int(index), {})[key] = torch.from_numpy(array.copy())
        self.optimiser.load_state_dict(optimiser)
        return state.history[-1].number + 1

    def checkpoint(self, history: list[Epoch], best: list[Tensors]) -> Checkpoint:
        """Return the current state as a checkpoint."""
        adam = {
            f"{index}/{key}": tensor.detach().cpu().numpy().copy()
            for index, entry in self.optimiser.state_dict()["state"].items()
            for key, tensor in entry.items()
        }
        return Checkpoint(
            recipe=self.recipe,
            seed=self.seed,
            data=self.data,
            history=tuple(history),
            best=tuple(best),
            weights=to_tensors(self.network),
            optimiser=adam,
        )

    def epoch(self, member: int, number: int, earlier: list[Epoch]) -> Epoch:
        """Train for one epoch, then validate, and return the losses.

        ``earlier`` contains the member's epochs so far.
        """
        training_loss = self._train(member, number)
        validation_loss, rmse_m = self._validate()
        if not math.isfinite(training_loss + validation_loss):
            raise ModelError(
                place=Place(field="learning_rate"),
                expected="a step size with which the losses stay finite",
                got=f"losses of {training_loss} and {validation_loss} in epoch {number + 1}",
            )
        return Epoch(
            member=member,
            number=number,
            training_loss=training_loss,
            validation_loss=validation_loss,
            validation_rmse_m=rmse_m,
            is_best=all(validation_loss < epoch.validation_loss for epoch in earlier),
        )

    def _use(self, network: Network) -> None:
        """Move ``network`` to the device and create a fresh optimiser for it."""
        self.network = network.to(self.device)
        self.optimiser = torch.optim.Adam(
            self.network.parameters(),
            lr=self.recipe.learning_rate,
            weight_decay=self.weight_decay,
            fused=self.device.type in ("cpu", "cuda"),
        )

    def _train(self, member: int, number: int) -> float:
        """Train once on the samples of an epoch, and return the mean loss of its batches.

        The method skips an incomplete last batch, because the statistics of a small batch are noisy.
        """
        recipe, network = self.recipe, self.network
        chosen = self._chosen(self._training, recipe.training_samples, _EPOCH, member, number)
        arrays = network_samples(self._samples, chosen, self.normalisation)
        x, y = (torch.from_numpy(array).to(self.device) for array in arrays)
        rows = min(recipe.batch_size, len(chosen))
        batches = len(chosen) // rows
        generator = self._mask_generator(_EPOCH, member, number, 1)
        # A float64 total on the device: reading each loss would wait for the device after every batch.
        total = torch.zeros((), dtype=torch.float64, device=self.device)
        draw = self._masks
        network.train()
        for batch in range(batches):
            self._set_rate((number + batch / batches) / recipe.epochs)
            part = slice(batch * rows, (batch + 1) * rows)
            masks = draw(rows, generator) if draw else None
            self.optimiser.zero_grad()
            loss: Any = self._loss(network(x[part], masks) - y[part])
            loss.backward()
            self.optimiser.step()
            total += loss.detach()
        return float(total) / batches

    @property
    def _masks(self) -> Callable[[int, torch.Generator], Masks] | None:
        """The function that draws dropout masks, or None for a network without dropout."""
        if self.recipe.dropout is Dropout.NONE or not isinstance(self.network, RegressionResNet):
            return None
        return self.network.draw_masks

    def _loss(self, error: torch.Tensor) -> torch.Tensor:
        """Return the mean of the recipe's loss over samples and axes."""
        return error.abs().mean() if self.recipe.loss == "l1" else error.square().mean()

    def _set_rate(self, progress: float) -> None:
        """Set the learning rate according to the progress of the training.

        ``progress`` is the finished fraction of the training, between 0 and 1.
        """
        fall = (1.0 + math.cos(math.pi * progress)) / 2.0 if self.recipe.annealed else 1.0
        for group in self.optimiser.param_groups:
            group["lr"] = self.recipe.learning_rate * fall

    @torch.no_grad()
    def _validate(self) -> tuple[float, float]:
        """Return the validation loss in the network's unit, and the RMSE over all axes [m].

        The prediction is the mean over the passes.

        If a network has dropout, its validation uses dropout too, as an avoider does.  Without dropout, the
        network would be less accurate, because its running statistics come from passes with dropout.  The
        masks are the same in every epoch.
        """
        network, draw = self.network.eval(), self._masks
        x, y = self._validation
        generator = self._mask_generator(_VALIDATION, 0)
        total = torch.zeros_like(y)
        passes = self.recipe.passes if draw else 1
        for _ in range(passes):
            for part, out in zip(
                torch.split(x, VALIDATION_ROWS), torch.split(total, VALIDATION_ROWS), strict=True
            ):
                out += network(part, draw(len(part), generator) if draw else None)
        error = (total / passes - y).double()
        scale = torch.from_numpy(self.normalisation.target_std).to(self.device)
        return float(self._loss(error)), math.sqrt(float(((error * scale) ** 2).mean()))

    def _mask_generator(self, *leaf: int) -> torch.Generator:
        """Return a generator for dropout masks, whose seed derives from the training's seed by ``leaf``."""
        return torch.Generator(self.device).manual_seed(seed_below(self.seed, *leaf))

    def _chosen(self, index: Index, count: int | None, *leaf: int) -> Index:
        """Return ``count`` distinct elements of ``index`` in random order.

        If ``count`` is None or exceeds the length of ``index``, return all elements in random order.
        """
        rng = np.random.Generator(np.random.PCG64(np.random.SeedSequence(self.seed, spawn_key=leaf)))
        size = len(index) if count is None else min(count, len(index))
        return index[rng.choice(len(index), size, replace=False)]
