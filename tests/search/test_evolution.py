from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray

from safety_harness.search.cma_es import Descent, _folded, _unfolded

Function = Callable[[NDArray[np.float64]], NDArray[np.float64]]


def descended(
    function: Function, dimension: int, seed: int = 1, points: int = 4000, *, patient: bool = False
) -> tuple[float, int]:
    """Return the least value that a descent finds, and how many points it takes.

    A ``patient`` one goes on where a search would restart.
    """
    rng = np.random.default_rng(seed)
    descent = Descent(np.zeros(dimension), np.ones(dimension), np.full(dimension, 0.5), 0.15, rng)
    least, tried = np.inf, 0
    while tried < points and (patient or not descent.ended):
        proposed = descent.propose(points)
        assert ((proposed >= 0.0) & (proposed <= 1.0)).all()
        scores = function(proposed)
        descent.learn(scores)
        least, tried = min(least, float(scores.min())), tried + len(proposed)
    return least, tried


@pytest.mark.parametrize("dimension", [1, 3, 8])
def test_a_descent_finds_the_bottom_of_a_turned_valley(dimension: int) -> None:
    """One that did not adapt to axes of 1 and 30 ends at 7e-9 in three dimensions, and at 2e-3 in eight."""
    rng = np.random.default_rng(dimension)
    turn, bottom = np.linalg.qr(rng.normal(size=(dimension, dimension)))[0], rng.uniform(0.2, 0.8, dimension)
    steep = 10.0 ** np.linspace(0.0, 3.0, dimension)

    def valley(points: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.asarray((steep * ((points - bottom) @ turn) ** 2).sum(axis=1))

    for seed in range(5):
        assert descended(valley, dimension, seed, patient=True)[0] < 1e-12


def test_points_within_the_cube_are_reached_from_where_they_were_sent() -> None:
    sent = np.linspace(-0.05, 1.05, 221)
    assert np.abs(_unfolded(_folded(sent)) - sent).max() < 1e-12
    assert np.abs(_folded(_unfolded(np.linspace(0.0, 1.0, 201))) - np.linspace(0.0, 1.0, 201)).max() < 1e-15
    middle = np.linspace(0.05, 0.95, 181)
    assert np.abs(_folded(middle) - middle).max() < 1e-15
    assert np.abs(_folded(sent + 2.2) - _folded(sent)).max() < 1e-12  # a period
    assert np.abs(np.diff(_folded(np.linspace(-3.0, 4.0, 7001)))).max() < 1.1e-3  # no jump


def test_points_are_bent_to_the_faces_as_the_package_cma_does() -> None:
    """The values are of ``BoxConstraintsLinQuadTransformation([[0.0, 1.0]])`` in cma 4.5.0."""
    points = np.array([-1.3, -0.4, -0.06, -0.02, 0.01, 0.04, 0.3, 0.96, 1.02, 1.1, 1.9, 3.4])
    theirs = [0.9, 0.3, 0.0005, 0.0045, 0.018, 0.0405, 0.3, 0.9595, 0.9955, 0.9875, 0.2, 0.9]
    np.testing.assert_allclose(_folded(points), theirs, rtol=0.0, atol=1e-12)


def test_a_descent_reaches_a_corner() -> None:
    least, _ = descended(lambda x: x.sum(axis=1), 4)
    assert least < 0.02


def test_a_flat_function_ends_a_descent() -> None:
    assert descended(lambda x: np.zeros(len(x)), 3)[1] < 20


def test_a_seed_repeats_a_descent() -> None:
    assert descended(lambda x: (x**2).sum(axis=1), 3, seed=5) == descended(
        lambda x: (x**2).sum(axis=1), 3, seed=5
    )
    assert descended(lambda x: (x**2).sum(axis=1), 3, seed=5) != descended(
        lambda x: (x**2).sum(axis=1), 3, seed=6
    )
