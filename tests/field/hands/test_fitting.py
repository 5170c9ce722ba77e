"""Fits find the parameters that samples were drawn with, and reject a family that is not theirs."""

from __future__ import annotations

import numpy as np
import pytest

from safety_harness.extensions.field.fitting import NORMAL, UNIFORM, Family, Fit, fit

LOW, HIGH = 0.1, 2.0


def drawn(family: Family, parameters: tuple[float, float], count: int, seed: int) -> np.ndarray:
    share = np.random.default_rng(seed).random((1, count))
    return family.values(share, np.array([parameters]), LOW, HIGH)[0]


def fits(values: np.ndarray, seed: int = 0) -> dict[str, Fit]:
    found = fit(values, low=LOW, high=HIGH, rng=np.random.default_rng(seed))
    return {one.family: one for one in found}


@pytest.mark.parametrize("parameters", [(0.8, 0.2), (0.2, 0.3), (1.8, 0.1)])
def test_a_normal_distribution_is_found_within_its_intervals_though_it_is_cut_off(
    parameters: tuple[float, float],
) -> None:
    one = fits(drawn(NORMAL, parameters, 300, 1))["normal"]
    assert not one.rejected
    for true, (low, high) in zip(parameters, one.intervals.values(), strict=True):
        assert low <= true <= high


def test_a_uniform_distribution_is_found_and_a_normal_one_rejected() -> None:
    found = fits(drawn(UNIFORM, (0.3, 1.2), 300, 2))
    assert found["normal"].rejected
    assert not found["uniform"].rejected
    assert found["uniform"].parameters["low"] == pytest.approx(0.3, abs=0.02)
    assert found["uniform"].parameters["high"] == pytest.approx(1.2, abs=0.02)


def test_of_two_humps_neither_is_the_distribution() -> None:
    humps = np.concatenate([drawn(NORMAL, (0.3, 0.03), 40, 3), drawn(NORMAL, (1.5, 0.05), 40, 4)])
    assert all(one.rejected for one in fits(humps).values())


def test_a_density_that_rises_to_both_ends_has_no_normal_distribution() -> None:
    share = np.random.default_rng(5).beta(0.4, 0.4, 200)
    assert "normal" not in fits(LOW + share * (HIGH - LOW))


def test_a_right_family_is_rejected_as_seldom_as_is_said() -> None:
    rejected = [fits(drawn(NORMAL, (0.7, 0.3), 25, seed))["normal"].p_value < 0.1 for seed in range(40)]
    assert 0 <= sum(rejected) <= 10  # 4 on the mean; more in one of 300 suites


def test_one_value_alone_has_no_distribution() -> None:
    assert fits(np.full(20, 0.5)) == {}


def test_the_same_seed_gives_the_same_fit() -> None:
    values = drawn(NORMAL, (0.7, 0.3), 25, 7)
    assert fits(values, 1) == fits(values, 1)
    assert fits(values, 1)["normal"].p_value != fits(values, 2)["normal"].p_value
