"""Each distribution against scipy's, its map against its own inverse, its density against its own volume."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats

from safety_harness.base.geometry.regions import Box, Region
from safety_harness.space.distributions import (
    Choice,
    Distribution,
    InBox,
    InRegion,
    InShell,
    TruncatedNormal,
    Uniform,
)

SHELL = InRegion(
    "unseen", Region(Box((-1.0, -1.0, 0.0), (2.0, 1.0, 1.0)), Box((-0.5, -0.5, 0.25), (0.5, 0.5, 0.75)))
)
POINTS: list[Distribution] = [
    InBox((-1.0, 0.0, 2.0), (1.0, 0.5, 5.0)),
    InShell((0.3, -0.2, 1.0), 0.1, 0.4),
    InShell((0.0, 0.0, 0.0), 0.0, 2.0),
    SHELL,
    InRegion("seen", Region(Box((0.0, 0.0, 0.0), (1.0, 2.0, 3.0)))),
]
SCALARS: list[Distribution] = [
    Uniform(0.5, 2.0),
    Uniform(-1e-3, 1e3),
    TruncatedNormal(1.0, 0.2, 0.5, 2.0),
    TruncatedNormal(0.0, 1.0, 3.0, 9.0),
    TruncatedNormal(5.0, 2.0, -4.0, 4.9),
    Choice(("a", "b", "c"), (1.0, 2.0, 5.0)),
]
ALL = SCALARS + POINTS
CUBE = st.floats(min_value=0.0, max_value=1.0)


def sample(distribution: Distribution, count: int, seed: int = 1) -> np.ndarray:
    u = np.random.default_rng(seed).random((count, distribution.columns))
    return distribution.values_at(u)


def same(values: np.ndarray, cdf: object) -> bool:
    """Whether a sample may come from a distribution: with these seeds, at a level of a thousandth."""
    return bool(stats.kstest(values, cdf).pvalue > 1e-3)


def test_a_uniform_sample_is_uniform() -> None:
    assert same(sample(Uniform(0.5, 2.0), 5000)[:, 0], stats.uniform(0.5, 1.5).cdf)
    assert not same(sample(Uniform(0.5, 2.0), 5000)[:, 0], stats.uniform(0.5, 1.6).cdf)


@pytest.mark.parametrize(
    ("mean", "std", "low", "high"),
    [
        (1.0, 0.2, 0.5, 2.0),
        (0.0, 1.0, 3.0, 9.0),
        (5.0, 2.0, -4.0, 4.9),
        (0.0, 1.0, -4.5, -3.0),
        (2.0, 9.0, 0.0, 1.0),
    ],
)
def test_a_normal_sample_is_scipys_truncated_normal(mean: float, std: float, low: float, high: float) -> None:
    ours = TruncatedNormal(mean, std, low, high)
    theirs = stats.truncnorm((low - mean) / std, (high - mean) / std, loc=mean, scale=std)
    values = sample(ours, 5000)
    assert same(values[:, 0], theirs.cdf)
    assert np.allclose(ours.log_density(values), theirs.logpdf(values[:, 0]), rtol=1e-9, atol=1e-9)
    u = np.linspace(0.0, 1.0, 101)[:, None]
    assert np.allclose(ours.values_at(u)[:, 0], theirs.ppf(u[:, 0]), rtol=1e-8, atol=1e-8)


def test_a_choice_is_made_by_its_chances() -> None:
    numbers = sample(Choice(("a", "b", "c"), (1.0, 2.0, 5.0)), 8000)[:, 0].astype(int)
    assert stats.chisquare(np.bincount(numbers), [1000, 2000, 5000]).pvalue > 1e-3


def test_a_sphere_shell_is_uniform_in_volume() -> None:
    points = sample(InShell((0.3, -0.2, 1.0), 0.1, 0.4), 5000) - (0.3, -0.2, 1.0)
    radius = np.linalg.norm(points, axis=1)
    assert same((radius**3 - 0.1**3) / (0.4**3 - 0.1**3), stats.uniform().cdf)
    for axis in range(3):  # Archimedes: each coordinate of a uniform direction is uniform
        assert same(points[:, axis] / radius, stats.uniform(-1.0, 2.0).cdf)


def test_a_region_with_a_hole_is_filled_like_one_by_rejection() -> None:
    points = sample(SHELL, 6000)
    outer = SHELL.known.outer
    box = np.random.default_rng(2).uniform(outer.low_m, outer.high_m, (8000, 3))
    by_rejection = box[SHELL.known.contains(box)]
    assert SHELL.known.contains(points).all()
    for direction in np.vstack([np.eye(3), [[1.0, 1.0, 1.0], [1.0, -2.0, 0.5]]]):
        assert stats.ks_2samp(points @ direction, by_rejection @ direction).pvalue > 1e-3


@pytest.mark.parametrize("distribution", ALL, ids=repr)
def test_there_and_back_gives_the_same_values(distribution: Distribution) -> None:
    values = sample(distribution, 3000)
    again = distribution.values_at(distribution.cube_at(values))
    if isinstance(distribution, Uniform | Choice | InBox):
        assert np.array_equal(again, values)
    else:
        assert np.abs(again - values).max() <= 1e-12 * (1.0 + np.abs(values).max())


@pytest.mark.parametrize("distribution", ALL, ids=repr)
def test_back_and_there_gives_the_same_cube_point(distribution: Distribution) -> None:
    u = np.random.default_rng(3).random((3000, distribution.columns))
    again = distribution.cube_at(distribution.values_at(u))
    if isinstance(distribution, Choice):
        edges = np.cumsum([0.0, 1.0, 2.0, 5.0]) / 8.0
        middles = (edges[1:] + edges[:-1]) / 2.0
        assert np.array_equal(np.unique(again), middles)
        assert np.abs(again - u).max() <= 5.0 / 16.0
    else:
        assert np.abs(again - u).max() < 1e-9


@pytest.mark.parametrize("distribution", [*SCALARS, InBox((-1.0, 0.0, 2.0), (1.0, 0.5, 5.0))], ids=repr)
@given(pair=st.tuples(CUBE, CUBE))
@settings(max_examples=50, deadline=None)
def test_a_scalar_rises_with_its_cube_coordinate(
    distribution: Distribution, pair: tuple[float, float]
) -> None:
    u = np.repeat(np.sort(pair)[:, None], distribution.columns, axis=1)
    low, high = distribution.values_at(u)
    assert np.all(low <= high)


@pytest.mark.parametrize("distribution", ALL, ids=repr)
def test_the_corners_of_the_cube_are_in_the_support(distribution: Distribution) -> None:
    corners = np.array(np.meshgrid(*[[0.0, 1.0]] * distribution.columns)).reshape(distribution.columns, -1).T
    values = distribution.values_at(corners)
    assert np.all(np.isfinite(distribution.log_density(values)))
    again = distribution.cube_at(values)
    assert np.all((again >= 0.0) & (again <= 1.0))
    assert np.allclose(distribution.values_at(again), values, atol=1e-12)


@pytest.mark.parametrize("distribution", [d for d in SCALARS if not isinstance(d, Choice)], ids=repr)
def test_the_ends_of_a_range_are_reached_and_nothing_beyond(distribution: Uniform | TruncatedNormal) -> None:
    ends = distribution.values_at(np.array([[0.0], [1.0]]))[:, 0]
    assert tuple(ends) == (distribution.low, distribution.high)
    beyond = np.array(
        [[np.nextafter(distribution.low, -np.inf)], [np.nextafter(distribution.high, np.inf)], [np.nan]]
    )
    assert np.all(distribution.log_density(beyond) == -np.inf)


@pytest.mark.parametrize("distribution", POINTS, ids=repr)
def test_the_density_of_a_point_integrates_to_one(distribution: Distribution) -> None:
    low, high = np.array([-2.0, -2.0, -2.0]), np.array([2.0, 3.0, 5.0])
    points = low + stats.qmc.Sobol(3, seed=4).random_base2(17) * (high - low)
    integral = np.mean(np.exp(distribution.log_density(points))) * np.prod(high - low)
    assert integral == pytest.approx(1.0, abs=0.03)


@pytest.mark.parametrize("distribution", ALL, ids=repr)
def test_the_simplest_value_is_in_the_support(distribution: Distribution) -> None:
    assert len(distribution.simplest) == distribution.columns
    assert np.isfinite(distribution.log_density(np.array([distribution.simplest]))[0])


def test_the_simplest_values_are_the_simplest() -> None:
    assert Uniform(0.5, 2.0).simplest == (0.5,)
    assert Uniform(-2.0, -0.5).simplest == (-0.5,)
    assert Uniform(-0.3, 0.3).simplest == (0.0,)
    assert InBox((-1.0, 0.0, 2.0), (1.0, 0.5, 5.0)).simplest == (0.0, 0.25, 3.5)
    assert SHELL.simplest == (0.0, 0.0, 0.75)  # the middle of the hole's nearest side


def test_a_side_on_the_outer_box_is_no_way_out_of_the_hole() -> None:
    region = Region(Box((-1.0, -1.0, 0.0), (1.0, 1.0, 2.0)), Box((-0.5, -0.5, 0.0), (0.5, 0.5, 0.2)))
    assert InRegion("unseen", region).simplest == (0.0, 0.0, 0.2)


@pytest.mark.parametrize(
    "make",
    [
        lambda: Uniform(1.0, 1.0),
        lambda: Uniform(2.0, 1.0),
        lambda: Uniform(0.0, math.inf),
        lambda: Uniform(math.nan, 1.0),
        lambda: TruncatedNormal(0.0, 0.0, -1.0, 1.0),
        lambda: TruncatedNormal(0.0, 1.0, 6.0, 7.0),  # a billionth of it
        lambda: TruncatedNormal(math.nan, 1.0, 0.0, 1.0),
        lambda: Choice((), ()),
        lambda: Choice(("a", "b"), (1.0, 0.0)),
        lambda: Choice(("a", "b"), (1.0,)),
        lambda: InBox((0.0, 0.0, 0.0), (1.0, 0.0, 1.0)),
        lambda: InShell((0.0, 0.0, 0.0), 0.2, 0.1),
        lambda: InShell((0.0, 0.0, 0.0), -0.1, 0.1),
    ],
)
def test_impossible_distributions_are_refused(make: object) -> None:
    with pytest.raises(ValueError, match="expected"):
        make()  # type: ignore[operator]
