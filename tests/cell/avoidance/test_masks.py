from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from safety_harness.cell.avoidance.masks import GAMMA, fill_factors, masks, mixed

ALL_BITS = (1 << 64) - 1


def in_python(seed: int, which_pass: int, place: int, unit: int, probability: float) -> bool:
    """The same generator with Python's unbounded integers."""

    def mixed(z: int) -> int:
        z = (z ^ (z >> 30)) * 0xBF58476D1CE4E5B9 & ALL_BITS
        z = (z ^ (z >> 27)) * 0x94D049BB133111EB & ALL_BITS
        return z ^ (z >> 31)

    gamma = 0x9E3779B97F4A7C15
    counter = which_pass * 2**32 + place * 2**16 + unit
    return mixed((mixed((seed + gamma) & ALL_BITS) + counter * gamma) & ALL_BITS) >= probability * 2.0**64


def many(
    seeds: int = 2000, passes: int = 10, places: int = 3, width: int = 32, probability: float = 0.1
) -> NDArray[np.bool_]:
    """(seeds, passes, places, width) of neighbouring seeds, which is what a generator fears most."""
    return np.array([masks(np.uint64(s), passes, places, width, probability) for s in range(seeds)])


@pytest.mark.parametrize("seed", [0, 1, 12345, 2**63 - 1, 2**64 - 1])
@pytest.mark.parametrize("probability", [0.0, 0.1, 0.5, 0.9])
def test_masks_are_those_of_splitmix64_on_unbounded_integers(seed: int, probability: float) -> None:
    expected = [
        [[in_python(seed, t, place, unit, probability) for unit in range(32)] for place in range(31)]
        for t in range(4)
    ]
    assert np.array_equal(masks(np.uint64(seed), 4, 31, 32, probability), np.array(expected))


def test_the_finalizer_is_the_published_one() -> None:
    """The first outputs of splitmix64 seeded with 1234567, as its reference implementation gives them."""
    with np.errstate(over="ignore"):
        states = np.uint64(1234567) + np.arange(1, 4, dtype=np.uint64) * GAMMA
    expected = [6457827717110365317, 3203168211198807973, 9817491932198370423]
    assert [int(mixed(state)) for state in states] == expected


def test_a_python_integer_is_the_same_seed() -> None:
    assert np.array_equal(masks(77, 3, 3, 32, 0.1), masks(np.uint64(77), 3, 3, 32, 0.1))


def test_without_dropout_every_unit_is_kept() -> None:
    assert masks(np.uint64(3), 10, 31, 32, 0.0).all()


@pytest.mark.parametrize("probability", [0.02, 0.1, 0.5])
def test_units_are_kept_at_the_rate_asked_for(probability: float) -> None:
    drawn = many(probability=probability)
    deviation = np.sqrt(probability * (1.0 - probability) / drawn.size)
    assert abs(drawn.mean() - (1.0 - probability)) < 4.0 * deviation


@pytest.mark.parametrize("axis", ["seed", "pass", "place", "unit"])
def test_every_seed_pass_place_and_unit_has_the_same_rate(axis: str) -> None:
    drawn = many()
    k = ("seed", "pass", "place", "unit").index(axis)
    rates = drawn.mean(axis=tuple(i for i in range(4) if i != k))
    trials = drawn.size / drawn.shape[k]
    chi_squared = float(((rates - 0.9) ** 2).sum() / (0.09 / trials))
    # Chi squared with n degrees of freedom has mean n and variance 2 n.
    assert abs(chi_squared - drawn.shape[k]) < 4.5 * np.sqrt(2.0 * drawn.shape[k])


@pytest.mark.parametrize("axis", ["seed", "pass", "place", "unit"])
@pytest.mark.parametrize("lag", [1, 2])
def test_neighbours_along_any_axis_are_independent(axis: str, lag: int) -> None:
    drawn = many() - 0.9
    k = ("seed", "pass", "place", "unit").index(axis)
    ahead = np.take(drawn, range(lag, drawn.shape[k]), axis=k)
    behind = np.take(drawn, range(drawn.shape[k] - lag), axis=k)
    correlation = (ahead * behind).mean() / 0.09
    assert abs(correlation) < 4.5 / np.sqrt(ahead.size)


def test_the_number_of_dropped_units_is_binomial() -> None:
    dropped = (~many()).sum(axis=3).ravel()
    assert dropped.mean() == pytest.approx(3.2, abs=0.03)
    assert dropped.var() == pytest.approx(32 * 0.1 * 0.9, rel=0.03)


def test_fewer_passes_and_units_are_the_beginning_of_more() -> None:
    large = masks(np.uint64(5), 20, 31, 32, 0.1)
    assert np.array_equal(masks(np.uint64(5), 10, 3, 7, 0.1), large[:10, :3, :7])


def test_other_seeds_give_other_masks() -> None:
    drawn = many(seeds=500).reshape(500, -1)
    assert len({row.tobytes() for row in drawn}) == 500


def test_factors_are_masks_scaled_to_keep_the_mean() -> None:
    factors = np.empty((3, 10, 32), dtype=np.float32)
    fill_factors(np.uint64(9), 0.1, factors)
    expected = masks(np.uint64(9), 10, 3, 32, 0.1).transpose(1, 0, 2) / 0.9
    assert np.array_equal(factors, expected.astype(np.float32))
