from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray

from safety_harness.search.cma_es import Descent

Function = Callable[[NDArray[np.float64]], NDArray[np.float64]]


def descended(function: Function, dimension: int, seed: int = 1, points: int = 4000) -> tuple[float, int]:
    """Return the least value that a descent finds, and how many points it takes."""
    rng = np.random.default_rng(seed)
    descent = Descent(np.zeros(dimension), np.ones(dimension), np.full(dimension, 0.5), 0.15, rng)
    least, tried = np.inf, 0
    while tried < points and not descent.ended:
        proposed = descent.propose(points)
        assert ((proposed >= 0.0) & (proposed <= 1.0)).all()
        scores = function(proposed)
        descent.learn(scores)
        least, tried = min(least, float(scores.min())), tried + len(proposed)
    return least, tried


@pytest.mark.parametrize("dimension", [1, 3, 8])
def test_a_descent_finds_the_bottom_of_a_turned_valley(dimension: int) -> None:
    """Its axes differ by a factor of 30; a distribution that did not adapt would end far above."""
    rng = np.random.default_rng(dimension)
    turn, bottom = np.linalg.qr(rng.normal(size=(dimension, dimension)))[0], rng.uniform(0.2, 0.8, dimension)
    steep = 10.0 ** np.linspace(0.0, 3.0, dimension)
    least, _ = descended(lambda x: (steep * ((x - bottom) @ turn) ** 2).sum(axis=1), dimension)
    assert least < 0.02


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
