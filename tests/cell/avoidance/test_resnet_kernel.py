"""The compiled passes against a plain numpy network in float64, and against PyTorch in float32."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from safety_harness.cell.avoidance.masks import masks
from safety_harness.cell.avoidance.model_file import PLACES, WIDTH, Dropout, Model
from safety_harness.cell.avoidance.resnet_kernel import FULL_PLACES, decide, fold
from tests.cell.avoidance.random_models import normalised_input, one_pass, random_inputs, random_model

KINDS = [(Dropout.NONE, 1), (Dropout.NONE, 5), (Dropout.INTER, 1), (Dropout.FULL, 1)]
every_kind = pytest.mark.parametrize(("dropout", "members"), KINDS, ids=lambda value: str(value))

# Some thirty layers of float32 (6e-8 relative) with targets of 34 to 75 mm standard deviation.
ROUNDING_M = 2e-6


def decided(model: Model, hands: Any, tcps: Any, seeds: Any) -> tuple[NDArray[np.float64], ...]:
    positions, spreads = np.empty(hands.shape), np.empty(hands.shape)
    decide(fold(model), hands, tcps, seeds, positions, spreads)
    return positions, spreads


def masks_of(model: Model, seed: np.uint64) -> NDArray[np.bool_]:
    passes = model.passes if PLACES[model.dropout] else 1
    return masks(seed, passes, PLACES[model.dropout], WIDTH, model.dropout_probability)


def summary(model: Model, answers: Any) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Mean and standard deviation of normalised answers (n, 3), in metres."""
    positions = np.array(model.target_mean) + np.array(model.target_std) * np.asarray(answers, np.float64)
    return positions.mean(axis=0), positions.std(axis=0)


@every_kind
def test_a_decision_is_mean_and_deviation_of_the_passes_of_the_plain_network(
    dropout: Dropout, members: int
) -> None:
    model = random_model(dropout, members=members)
    hands, tcps, seeds = random_inputs(5, seed=1)
    positions, spreads = decided(model, hands, tcps, seeds)
    for n in range(len(seeds)):
        x = normalised_input(model, hands[n], tcps[n])
        answers = [one_pass(model, m, x, mask) for m in range(members) for mask in masks_of(model, seeds[n])]
        mean, deviation = summary(model, answers)
        assert positions[n] == pytest.approx(mean, abs=ROUNDING_M)
        assert spreads[n] == pytest.approx(deviation, abs=ROUNDING_M)


@every_kind
def test_a_decision_is_the_same_bits_alone_and_in_any_batch(dropout: Dropout, members: int) -> None:
    model = random_model(dropout, members=members)
    hands, tcps, seeds = random_inputs(64, seed=3)
    together = np.stack(decided(model, hands, tcps, seeds))  # (2, 64, 3)
    order = np.random.default_rng(0).permutation(64)
    shuffled = np.stack(decided(model, hands[order], tcps[order], seeds[order]))
    assert np.array_equal(shuffled, together[:, order])
    for size in (1, 7):
        for start in range(0, 64, size):
            few = slice(start, start + size)
            apart = np.stack(decided(model, hands[few], tcps[few], seeds[few]))
            assert np.array_equal(apart, together[:, few])


def test_without_dropout_neither_seed_nor_number_of_passes_matters_and_the_spread_is_zero() -> None:
    hands, tcps, seeds = random_inputs(20, seed=5)
    positions, spreads = decided(random_model(Dropout.NONE, passes=10), hands, tcps, seeds)
    again, _ = decided(random_model(Dropout.NONE, passes=1), hands, tcps, seeds[::-1].copy())
    assert np.array_equal(positions, again)
    assert (spreads == 0.0).all()


def test_members_that_are_all_alike_agree() -> None:
    one = random_model(Dropout.NONE)
    five = random_model(Dropout.NONE, members=5)
    alike = {name: one.tensors["0/" + name.partition("/")[2]] for name in five.tensors}
    five.tensors.update(alike)  # type: ignore[attr-defined]
    hands, tcps, seeds = random_inputs(20, seed=6)
    positions, spreads = decided(five, hands, tcps, seeds)
    assert positions == pytest.approx(decided(one, hands, tcps, seeds)[0], abs=1e-15)
    assert spreads == pytest.approx(0.0, abs=1e-15)


@pytest.mark.parametrize("dropout", [Dropout.INTER, Dropout.FULL])
def test_with_another_seed_a_pass_drops_other_units(dropout: Dropout) -> None:
    hands, tcps, seeds = random_inputs(20, seed=7)
    model = random_model(dropout)
    positions, spreads = decided(model, hands, tcps, seeds)
    others, _ = decided(model, hands, tcps, seeds + np.uint64(1))
    assert (positions != others).all()
    assert (spreads > 0.0).all()


@pytest.mark.parametrize("dropout", list(Dropout))
@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("axis", range(6))
def test_an_input_that_is_not_finite_is_never_answered(dropout: Dropout, value: float, axis: int) -> None:
    hands, tcps, seeds = random_inputs(3, seed=8)
    sound = decided(random_model(dropout), hands, tcps, seeds)[0]
    (hands if axis < 3 else tcps)[1, axis % 3] = value
    positions, _ = decided(random_model(dropout), hands, tcps, seeds)
    assert not np.isfinite(positions[1]).any()
    assert np.array_equal(positions[[0, 2]], sound[[0, 2]])  # and its neighbours do not notice


def test_full_dropout_is_told_from_the_others_by_its_places() -> None:
    assert PLACES[Dropout.FULL] == FULL_PLACES
    assert len(set(PLACES.values())) == len(Dropout)
