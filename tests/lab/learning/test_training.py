"""Training: it learns, it repeats bit for bit, and an interruption changes nothing."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from safetensors import safe_open

from safety_harness.base.exceptions import ModelError, OutputError
from safety_harness.cell.avoidance.model_file import Dropout
from safety_harness.extensions.lab.learning.checkpoint import Epoch
from safety_harness.extensions.lab.learning.networks import RegressionResNet, load_tensors
from safety_harness.extensions.lab.learning.recipes import Recipe
from safety_harness.extensions.lab.learning.samples import (
    ArraySamples,
    Normalisation,
    moments,
    network_inputs,
)
from safety_harness.extensions.lab.learning.training import CHECKPOINT, Trained, train

TINY = Recipe(
    name="tiny",
    dropout=Dropout.INTER,
    training_samples=240,
    validation_samples=50,
    epochs=3,
    batch_size=60,
    annealed=True,
    normalise=True,
)
ENSEMBLE = replace(TINY, dropout=Dropout.NONE, members=2, epochs=2)
TRAINING, VALIDATION = np.arange(400), np.arange(400, 500)


def smooth_samples(count: int = 500) -> ArraySamples:
    """Targets a tenth of a metre around the TCP, bent by where it is."""
    rng = np.random.default_rng(1)
    inputs = rng.uniform(-1.0, 1.0, (count, 6)) * [0.3, 0.3, 0.3, 0.06, 0.15, 0.1] + 0.5
    tcp = inputs[:, 3:]
    return ArraySamples(inputs, tcp + 0.1 * np.sin(8.0 * tcp[:, ::-1]) - 0.05 * inputs[:, :3])


SAMPLES = smooth_samples()


def tiny_training(
    out: Path,
    recipe: Recipe = TINY,
    *,
    samples: ArraySamples = SAMPLES,
    seed: int = 7,
    resume: bool = False,
    device: str = "cpu",
    on_epoch: Callable[[Epoch], None] = lambda epoch: None,
) -> Trained:
    return train(
        recipe,
        samples,
        TRAINING,
        VALIDATION,
        seed=seed,
        out=out,
        resume=resume,
        device=device,
        on_epoch=on_epoch,
    )


def bits(trained: Trained) -> list[dict[str, bytes]]:
    return [{name: tensor.tobytes() for name, tensor in member.items()} for member in trained.members]


def interrupt_after(epochs: int) -> Callable[[Epoch], None]:
    """Ctrl-C as the line of the epoch number ``epochs`` is shown."""
    seen: list[Epoch] = []

    def on_epoch(epoch: Epoch) -> None:
        seen.append(epoch)
        if len(seen) == epochs:
            raise KeyboardInterrupt

    return on_epoch


def predict(trained: Trained, member: int, inputs: np.ndarray) -> np.ndarray:
    """The deterministic prediction in metres."""
    network = RegressionResNet(dropout=trained.recipe.dropout)
    load_tensors(network, trained.members[member])
    with torch.no_grad():
        y = network.eval()(torch.from_numpy(network_inputs(inputs, trained.normalisation)))
    return trained.normalisation.target_mean + trained.normalisation.target_std * y.double().numpy()


def test_training_brings_the_error_far_below_that_of_the_mean(tmp_path: Path) -> None:
    recipe = replace(TINY, dropout=Dropout.NONE, epochs=40, learning_rate=0.01)
    trained = tiny_training(tmp_path, recipe)
    targets = SAMPLES.all_targets[VALIDATION]
    plain = np.sqrt(((targets - SAMPLES.all_targets[TRAINING].mean(axis=0)) ** 2).mean())
    error = np.sqrt(((predict(trained, 0, SAMPLES.all_inputs[VALIDATION]) - targets) ** 2).mean())
    assert error < 0.35 * plain


@pytest.mark.parametrize("normalise", [True, False], ids=["normalised", "millimetres"])
def test_the_best_validation_epoch_is_kept(tmp_path: Path, normalise: bool) -> None:
    """The kept weights have, on all validation samples, the RMSE that their epoch reported.

    Targets are pure noise, so that the longer the training, the worse the validation.
    """
    noise = ArraySamples(SAMPLES.all_inputs, np.random.default_rng(2).normal(0.0, 0.05, (500, 3)))
    plain = replace(TINY, dropout=Dropout.NONE, validation_samples=None, epochs=15, learning_rate=0.01)
    recipe = replace(plain, normalise=normalise)
    trained = tiny_training(tmp_path, recipe, samples=noise)
    best = min(trained.history, key=lambda epoch: epoch.validation_loss)
    assert best.number < 14  # else the last epoch would do as well
    assert best.is_best
    assert [e for e in trained.history if e.is_best][-1] == best
    error = predict(trained, 0, noise.all_inputs[VALIDATION]) - noise.all_targets[VALIDATION]
    assert np.sqrt((error**2).mean()) == pytest.approx(best.validation_rmse_m, rel=1e-4)


def test_a_dropout_network_is_validated_by_the_mean_of_its_passes(tmp_path: Path) -> None:
    """Of many passes: two draws of the masks then agree, and a pass without dropout does not."""
    plain = replace(TINY, dropout=Dropout.FULL, validation_samples=None, passes=100)
    recipe = replace(plain, epochs=12, learning_rate=0.01)
    trained = tiny_training(tmp_path, recipe)
    best = [epoch for epoch in trained.history if epoch.is_best][-1]
    network = RegressionResNet(dropout=Dropout.FULL)
    load_tensors(network, trained.members[0])
    normal = trained.normalisation
    x = torch.from_numpy(network_inputs(SAMPLES.all_inputs[VALIDATION], normal))
    generator = torch.Generator().manual_seed(0)
    with torch.no_grad():
        passes = [network.eval()(x, network.draw_masks(len(x), generator)).numpy() for _ in range(100)]
        without = network(x).numpy()
    y = (SAMPLES.all_targets[VALIDATION] - normal.target_mean) / normal.target_std
    loss, loss_without = (np.abs(prediction - y).mean() for prediction in (np.mean(passes, axis=0), without))
    assert abs(best.validation_loss - loss) < 0.2 * abs(best.validation_loss - loss_without)


def test_the_same_seed_gives_the_same_bits_whatever_the_global_generators_do(tmp_path: Path) -> None:
    torch.manual_seed(1)
    first = tiny_training(tmp_path / "a")
    torch.manual_seed(2)
    again = tiny_training(tmp_path / "b")
    other = tiny_training(tmp_path / "c", seed=8)
    assert bits(first) == bits(again)
    assert first.history == again.history
    assert bits(first) != bits(other)
    assert (tmp_path / "a" / CHECKPOINT).read_bytes() == (tmp_path / "b" / CHECKPOINT).read_bytes()


@pytest.mark.parametrize("recipe", [TINY, replace(TINY, dropout=Dropout.FULL), ENSEMBLE])
def test_an_interrupted_and_resumed_training_equals_an_uninterrupted_one(
    tmp_path: Path, recipe: Recipe
) -> None:
    """Interrupted after every single epoch: also between two members, and after the last."""
    whole = tiny_training(tmp_path / "whole", recipe)
    for _ in range(len(whole.history)):
        with pytest.raises(KeyboardInterrupt):
            tiny_training(tmp_path / "parts", recipe, resume=True, on_epoch=interrupt_after(1))
    resumed = tiny_training(tmp_path / "parts", recipe, resume=True, on_epoch=interrupt_after(1))
    assert bits(resumed) == bits(whole)
    assert resumed.history == whole.history
    files = [(tmp_path / folder / CHECKPOINT).read_bytes() for folder in ("whole", "parts")]
    assert files[0] == files[1]


def test_a_loss_of_power_while_saving_leaves_the_checkpoint_before(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = tiny_training(tmp_path / "whole")
    with pytest.raises(KeyboardInterrupt):
        tiny_training(tmp_path / "parts", on_epoch=interrupt_after(1))

    def power_cut(descriptor: int) -> None:
        raise RuntimeError("dark")

    with monkeypatch.context() as patch:
        patch.setattr("os.fsync", power_cut)
        with pytest.raises(RuntimeError, match="dark"):
            tiny_training(tmp_path / "parts", resume=True)
    assert bits(tiny_training(tmp_path / "parts", resume=True)) == bits(whole)


def test_members_of_an_ensemble_differ(tmp_path: Path) -> None:
    first, second = bits(tiny_training(tmp_path, ENSEMBLE))
    assert first != second


def test_the_losses_of_each_epoch_are_reported_once_and_in_order(tmp_path: Path) -> None:
    seen: list[Epoch] = []
    trained = tiny_training(tmp_path, ENSEMBLE, on_epoch=seen.append)
    assert tuple(seen) == trained.history
    assert [(e.member, e.number) for e in seen] == [(0, 0), (0, 1), (1, 0), (1, 1)]


def test_one_thread_while_training_and_as_many_as_before_after_it(tmp_path: Path) -> None:
    before = torch.get_num_threads()
    during: list[int] = []
    tiny_training(tmp_path, on_epoch=lambda epoch: during.append(torch.get_num_threads()))
    assert set(during) == {1}
    assert torch.get_num_threads() == before


def test_weight_decay_is_gal_s_for_the_whole_training_set_and_the_targets_variance(tmp_path: Path) -> None:
    trained = tiny_training(tmp_path)
    variance_mm2 = (1e3 * SAMPLES.all_targets[TRAINING]).var(axis=0).mean()
    assert trained.weight_decay == pytest.approx(0.9 * 0.01**2 / (2 * 400 * 1e-6 * variance_mm2))


def test_normalised_training_samples_have_mean_zero_and_variance_one() -> None:
    normal = Normalisation.from_recipe(TINY, *moments(SAMPLES, TRAINING))
    x = network_inputs(SAMPLES.all_inputs[TRAINING], normal)
    assert x[:, :6].mean(axis=0) == pytest.approx(0.0, abs=1e-5)
    assert x[:, :6].std(axis=0) == pytest.approx(1.0, abs=1e-5)
    assert np.all(x[:, 6] == 1.0)
    raw = Normalisation.from_recipe(replace(TINY, normalise=False), *moments(SAMPLES, TRAINING))
    assert network_inputs(SAMPLES.all_inputs, raw)[:, :6] == pytest.approx(1e3 * SAMPLES.all_inputs)


def test_a_folder_with_a_training_is_not_overwritten(tmp_path: Path) -> None:
    tiny_training(tmp_path)
    before = (tmp_path / CHECKPOINT).read_bytes()
    with pytest.raises(OutputError, match="resume"):
        tiny_training(tmp_path, seed=8)
    assert (tmp_path / CHECKPOINT).read_bytes() == before


def test_a_checkpoint_of_another_training_is_not_resumed(tmp_path: Path) -> None:
    tiny_training(tmp_path)
    with pytest.raises(ModelError, match=r"recipe: expected .*'epochs': 4.*got .*'epochs': 3"):
        tiny_training(tmp_path, replace(TINY, epochs=4), resume=True)
    with pytest.raises(ModelError, match="seed: expected 8; got 7"):
        tiny_training(tmp_path, seed=8, resume=True)
    moved = ArraySamples(SAMPLES.all_inputs, SAMPLES.all_targets + 0.001)
    with pytest.raises(ModelError, match="data"):
        tiny_training(tmp_path, samples=moved, resume=True)


@pytest.mark.parametrize("content", [b"", b"\x80\x04nonsense", b"\x02\0\0\0\0\0\0\0{}"])
def test_what_is_no_checkpoint_is_not_resumed(tmp_path: Path, content: bytes) -> None:
    (tmp_path / CHECKPOINT).write_bytes(content)
    with pytest.raises(ModelError, match="checkpoint"):
        tiny_training(tmp_path, resume=True)


def test_a_checkpoint_is_plain_tensors_and_json(tmp_path: Path) -> None:
    tiny_training(tmp_path)
    with safe_open(tmp_path / CHECKPOINT, framework="np") as file:
        history = json.loads(file.metadata()["safety_harness"])["history"]
        groups = {name.split("/")[0] for name in file.keys()}  # noqa: SIM118
    assert len(history) == TINY.epochs
    assert groups == {"weights", "optimiser", "best 0"}


def test_a_place_that_cannot_be_written_is_named(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(OutputError, match="file"):
        tiny_training(tmp_path / "file" / "folder")


def test_a_loss_that_runs_away_is_an_error_and_not_a_model(tmp_path: Path) -> None:
    with pytest.raises(ModelError, match="finite"):
        tiny_training(tmp_path, replace(TINY, learning_rate=1e38, annealed=False))


def test_what_cannot_be_trained_on_is_refused(tmp_path: Path) -> None:
    frozen_hand = SAMPLES.all_inputs.copy()
    frozen_hand[:, 1] = 0.2
    with pytest.raises(ModelError, match="column 1"):
        tiny_training(tmp_path, samples=ArraySamples(frozen_hand, SAMPLES.all_targets))
    broken = SAMPLES.all_targets.copy()
    broken[3, 2] = np.nan
    with pytest.raises(ModelError, match="column 8"):
        tiny_training(tmp_path, samples=ArraySamples(SAMPLES.all_inputs, broken))
    with pytest.raises(ModelError, match="at least 2 samples"):
        train(TINY, SAMPLES, TRAINING[:1], VALIDATION, seed=1, out=tmp_path)
    with pytest.raises(ModelError, match="seed"):
        tiny_training(tmp_path, seed=-1)
    with pytest.raises(ModelError, match="device"):
        tiny_training(tmp_path, device="abacus")
