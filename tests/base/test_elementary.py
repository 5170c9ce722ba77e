from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import mpmath
import numpy as np
import pytest
from numpy.typing import NDArray

from safety_harness.base import elementary
from safety_harness.base.compiled import compiled
from safety_harness.base.elementary import arccos, arctan2, cos, hypot, log_sum_exp, product, sin, sin_cos

Floats = NDArray[np.float64]
RNG = np.random.default_rng(20261129)
MANY = 3000


def either(size: Floats) -> Floats:
    return size * RNG.choice([-1.0, 1.0], len(size))


def small(most: float = 0.0, least: float = -15.0, count: int = MANY) -> Floats:
    return 10.0 ** RNG.uniform(least, most, count)


def near_quarters() -> Floats:
    """The floats next to multiples of pi/2, up to the bound: the hardest arguments of a sine."""
    with mpmath.workprec(200):
        return np.array([float(k * mpmath.pi / 2) for k in RNG.integers(1, 667_000, MANY).tolist()])


ANGLES = np.concatenate(
    [either(near_quarters()), RNG.uniform(-7.0, 7.0, MANY), RNG.uniform(-1.0, 1.0, MANY) * 2.0**20, small()]
)
ONES = np.concatenate([RNG.uniform(-1.0, 1.0, MANY), 1.0 - small(), small() - 1.0])
PLANE = either(small(3.0)), either(small(3.0))
CASES: dict[str, tuple[float, Any]] = {
    "sin": (1.0, (ANGLES,)),
    "cos": (1.0, (ANGLES,)),
    "arctan2": (2.0, PLANE),
    "arccos": (2.0, (ONES,)),
    "hypot": (2.0, PLANE),
    "exp": (2.0, (np.concatenate([RNG.uniform(-700.0, 700.0, MANY), either(small())]),)),
    "expm1": (2.0, (np.concatenate([RNG.uniform(-40.0, 40.0, MANY), either(small(1.0))]),)),
    "log": (2.0, (np.concatenate([small(300.0, -300.0), 1.0 + either(small(-1.0))]),)),
    "log1p": (2.0, (np.concatenate([small(9.0), -small(-1e-3)]),)),
    "cbrt": (2.0, (small(200.0, -200.0),)),
}


def units_off(found: Floats, exact: Callable[..., Any], arguments: tuple[Floats, ...]) -> float:
    """Return the largest error in units of the last place of the exact value."""
    most = 0.0
    with mpmath.workprec(200):
        for value, *each in zip(found.tolist(), *(a.tolist() for a in arguments), strict=True):
            true = exact(*map(mpmath.mpf, each))
            most = max(most, float(abs(value - true) / math.ulp(float(true))))
    return most


@pytest.mark.parametrize("name", CASES)
def test_the_error_is_within_the_stated_units(name: str) -> None:
    allowed, arguments = CASES[name]
    exact = {"arctan2": mpmath.atan2, "arccos": mpmath.acos}.get(name) or getattr(mpmath, name)
    assert units_off(getattr(elementary, name)(*arguments), exact, arguments) <= allowed


@compiled
def _compiled(x: float, y: float) -> tuple[float, float, float, float]:
    s, c = sin_cos(x)
    return s, c, arctan2(x, y), hypot(x, y)


def test_machine_code_python_and_arrays_have_the_same_bits() -> None:
    x, y = ANGLES[:500], ANGLES[-500:]
    arrays = np.array([*sin_cos(x), arctan2(x, y), hypot(x, y)]).T
    for row, a, b in zip(arrays, x.tolist(), y.tolist(), strict=True):
        assert _compiled(a, b) == tuple(row)
        assert (*sin_cos(a), arctan2(a, b), hypot(a, b)) == tuple(row)


def test_a_large_angle_and_a_nan_have_no_sine() -> None:
    beyond = [2.0**20, -(2.0**20), 1e300, math.inf, math.nan]
    assert all(math.isnan(value) for angle in beyond for value in sin_cos(angle))
    assert all(math.isfinite(value) for value in sin_cos(math.nextafter(2.0**20, 0.0)))


def test_values_that_are_known() -> None:
    assert (sin(0.0), cos(0.0), arccos(1.0), arctan2(0.0, 0.0)) == (0.0, 1.0, 0.0, 0.0)
    assert (arctan2(0.0, -1.0), arctan2(1.0, 0.0), arctan2(-1.0, 0.0)) == (math.pi, math.pi / 2, -math.pi / 2)
    assert (elementary.exp(0.0), elementary.exp(-1e4), elementary.exp(1e4)) == (1.0, 0.0, math.inf)
    assert (elementary.log(0.0), elementary.log(1.0), elementary.log1p(-1.0)) == (-math.inf, 0.0, -math.inf)
    assert all(map(math.isnan, (elementary.log(-1.0), elementary.exp(math.nan), elementary.log(math.nan))))


@pytest.mark.parametrize(
    ("left", "right"),
    [((3,), (3,)), ((4, 4), (4, 4)), ((3,), (3, 2)), ((5, 2, 3), (3,)), ((5, 2, 3), (5, 3, 4))],
)
def test_a_product_is_the_matrix_product(left: tuple[int, ...], right: tuple[int, ...]) -> None:
    a, b = RNG.normal(size=left), RNG.normal(size=right)
    assert product(a, b) == pytest.approx(a @ b, rel=1e-14, abs=1e-15)


def test_a_sum_of_exponentials_neither_overflows_nor_vanishes() -> None:
    rows = np.array([[1000.0, 1000.0], [-1000.0, -2000.0]])
    assert log_sum_exp(rows, axis=1) == pytest.approx([1000.0 + math.log(2.0), -1000.0])
    assert log_sum_exp([-math.inf, -math.inf]) == -math.inf
