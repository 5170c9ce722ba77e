"""A Hypothesis strategy for the scenarios of a space.

Examples shrink towards the simplest scenario of the space.  Shrinking prefers first alternatives, fewer
repetitions, points nearer to the seen space, and values nearer to zero.  Such values mean slower, shorter and
less turned motion.  Shrinking also prefers round numbers on a decimal grid of 100 to 1000 steps, unless a
failure needs a value between them.  For a range of a decimetre or more, the steps of the grid are in
millimetres.  For angles, the steps are in degrees.
"""

from __future__ import annotations

import math
from fractions import Fraction
from functools import lru_cache

import numpy as np
from hypothesis import reject
from hypothesis import strategies as st
from numpy.typing import NDArray

from safety_harness.base.elementary import cos, sin
from safety_harness.base.exceptions import InputError, refuse_other_type
from safety_harness.scenario.model import LARGEST_SEED, Scenario
from safety_harness.space.distributions import Choice, Distribution, InBox, InRegion, InShell
from safety_harness.space.space import ScenarioSpace

Vector = NDArray[np.float64]

_STEPS = 100  # at least, on the grid of a value


def strategy(space: ScenarioSpace) -> st.SearchStrategy[Scenario]:
    """Return a strategy for the scenarios of ``space``, each with its own seed."""
    refuse_other_type("strategy(space)", space, ScenarioSpace)
    seeds = st.integers(min_value=0, max_value=LARGEST_SEED)
    return st.builds(_scenario, st.just(space), values(space), seeds)


@st.composite
def values(draw: st.DrawFn, space: ScenarioSpace) -> Vector:
    """Draw values (d,) of ``space`` in SI, one parameter after another.

    Unused values are NaN.
    """
    drawn = np.full((1, space.dimension), np.nan)
    for number, parameter in enumerate(space.parameters):
        # A named value is drawn before the choices that decide about its use.
        undecided = any(condition.parameter > number for when in parameter.when for condition in when)
        if undecided or space.used_by(drawn, [parameter])[0][0]:
            drawn[0, parameter.columns] = draw(_value(parameter.distribution))
    row: Vector = space.without_unused(drawn)[0]
    return row


def _scenario(space: ScenarioSpace, row: Vector, seed: int) -> Scenario:
    """Return the scenario of the values (d,).

    If the reader refuses the values, make Hypothesis reject them.
    """
    try:
        return space.scenario(row, seed=seed)
    except InputError:  # values that the reader refuses together
        reject()


@lru_cache(maxsize=1024)
def _value(distribution: Distribution) -> st.SearchStrategy[tuple[float, ...]]:
    """Return a strategy for the values of one parameter, which shrink towards the simplest value."""
    if isinstance(distribution, Choice):
        return st.tuples(st.integers(0, len(distribution.labels) - 1).map(float))
    if isinstance(distribution, InShell):
        return _in_shell(distribution)
    if isinstance(distribution, InRegion):
        return _in_region(distribution)
    if isinstance(distribution, InBox):
        ends = zip(distribution.low, distribution.high, distribution.simplest, strict=True)
        return st.tuples(*(real(low, high, to, distribution.unit) for low, high, to in ends))
    (to,) = distribution.simplest
    return st.tuples(real(distribution.low, distribution.high, to, distribution.unit))


def _in_shell(shell: InShell) -> st.SearchStrategy[tuple[float, ...]]:
    """Return a strategy for points that shrink towards the inner sphere's point on the x axis."""

    def point(r: float, height: float, azimuth_rad: float) -> tuple[float, ...]:
        across = r * math.sqrt(1.0 - height * height)
        x, y, z = shell.centre
        return x + across * cos(azimuth_rad), y + across * sin(azimuth_rad), z + r * height

    radius = real(shell.inner, shell.outer, shell.inner, shell.unit)
    return st.builds(point, radius, real(-1.0, 1.0, 0.0, ""), real(-math.pi, math.pi, 0.0, "rad"))


def _in_region(distribution: InRegion) -> st.SearchStrategy[tuple[float, ...]]:
    """Return a strategy for points that shrink towards a box's centre, or to the nearest face of a hole."""
    outer, hole = distribution.known.outer, distribution.known.hole
    if hole is None:
        return _value(InBox(outer.low_m, outer.high_m))

    def outside(axis: int, low: float, high: float, face: float) -> st.SearchStrategy[tuple[float, ...]]:
        centre = hole.centre_m
        ranges = [
            real(low, high, face, "m") if k == axis else real(outer.low_m[k], outer.high_m[k], centre[k], "m")
            for k in range(3)
        ]
        return st.tuples(*ranges)

    return st.one_of(*(outside(*side) for side in distribution.sides_of(hole)))


def real(low: float, high: float, target: float, unit: str) -> st.SearchStrategy[float]:
    """Return a strategy for numbers from ``low`` to ``high``.

    The numbers shrink towards ``target`` and towards round numbers.  For angles (the unit ``rad``), the round
    numbers are in degrees.
    """
    grid = _grid(low, high, 180.0 / math.pi if unit.startswith("rad") else 1.0)
    above = [target, *(value for value in grid if value > target)]
    below = [target, *(value for value in reversed(grid) if value < target)]

    def value(fraction: float, step: int) -> float:
        side, place = (above, step) if step >= 0 else (below, -step)
        if fraction == 0.0 or place == 0:
            return side[place]
        # The fraction leads back towards the target, so shrinking can reach the round number just beyond.
        return min(max(side[place] + fraction * (side[place - 1] - side[place]), low), high)

    # The fraction between grid points is drawn first, so that shrinking removes it first.
    fraction = st.floats(min_value=0.0, max_value=1.0, exclude_max=True)
    return st.builds(value, fraction, st.integers(1 - len(below), len(above) - 1))


def _grid(low: float, high: float, scale: float) -> list[float]:
    """Return the grid of a value, which consists of ``low``, the round numbers below ``high``, and ``high``.

    The numbers are round in units of 1 / ``scale``.
    """
    step = Fraction(10) ** int(f"{(high - low) * scale / _STEPS:e}".split("e")[1])
    first, last = math.ceil(low * scale / step), math.floor(high * scale / step)
    round_numbers = (float(k * step) / scale for k in range(first, last + 1))
    return [low, *(value for value in round_numbers if low < value < high), high]
