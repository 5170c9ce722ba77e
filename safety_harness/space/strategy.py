"""A space as a Hypothesis strategy: every example is in the space, and shrinking leads to its simplest.

Shrinking takes first alternatives, fewer repetitions, values nearer to zero (so: slower, shorter, less
turned), points nearer to the seen space, and round numbers before others: values lie on a decimal grid of
100 to 1000 steps (millimetres for a range of a decimetre and more; of degrees for angles), unless an
example needs one between.
"""

from __future__ import annotations

import math
from fractions import Fraction
from functools import lru_cache

import numpy as np
from hypothesis import reject
from hypothesis import strategies as st
from numpy.typing import NDArray

from safety_harness.base.exceptions import InputError, refuse_other_type
from safety_harness.scenario.model import LARGEST_SEED, Scenario
from safety_harness.space.distributions import Choice, Distribution, InBox, InRegion, InShell
from safety_harness.space.space import ScenarioSpace

Vector = NDArray[np.float64]

_STEPS = 100  # at least, on the grid of a value


def strategy(space: ScenarioSpace) -> st.SearchStrategy[Scenario]:
    """Scenarios of ``space``, each with a seed of its own."""
    refuse_other_type("strategy(space)", space, ScenarioSpace)
    seeds = st.integers(min_value=0, max_value=LARGEST_SEED)
    return st.builds(_scenario, st.just(space), values(space), seeds)


@st.composite
def values(draw: st.DrawFn, space: ScenarioSpace) -> Vector:
    """(d,) values of ``space`` in SI, NaN where a scenario does not use them; parameter by parameter."""
    found = np.full((1, space.dimension), np.nan)
    for number, parameter in enumerate(space.parameters):
        # A named value comes before the choices that decide whether it is used.
        undecided = any(condition.parameter > number for when in parameter.when for condition in when)
        if undecided or space.used_by(found, [parameter])[0][0]:
            found[0, parameter.columns] = draw(_value(parameter.distribution))
    row: Vector = space.without_unused(found)[0]
    return row


def _scenario(space: ScenarioSpace, found: Vector, seed: int) -> Scenario:
    try:
        return space.scenario(found, seed=seed)
    except InputError:  # values that the reader refuses together
        reject()


@lru_cache(maxsize=1024)
def _value(distribution: Distribution) -> st.SearchStrategy[tuple[float, ...]]:
    """The values of one parameter, simplest first."""
    if isinstance(distribution, Choice):
        return st.tuples(st.integers(0, len(distribution.labels) - 1).map(float))
    if isinstance(distribution, InShell):
        return _in_shell(distribution)
    if isinstance(distribution, InRegion):
        return _in_region(distribution)
    if isinstance(distribution, InBox):
        ends = zip(distribution.low, distribution.high, distribution.simplest, strict=True)
        return st.tuples(*(near(low, high, to, distribution.unit) for low, high, to in ends))
    (to,) = distribution.simplest
    return st.tuples(near(distribution.low, distribution.high, to, distribution.unit))


def _in_shell(shell: InShell) -> st.SearchStrategy[tuple[float, ...]]:
    """From the inner sphere outwards, and from the direction of x away."""

    def point(r: float, height: float, azimuth_rad: float) -> tuple[float, ...]:
        across = r * math.sqrt(1.0 - height * height)
        x, y, z = shell.centre
        return x + across * math.cos(azimuth_rad), y + across * math.sin(azimuth_rad), z + r * height

    radius = near(shell.inner, shell.outer, shell.inner, shell.unit)
    return st.builds(point, radius, near(-1.0, 1.0, 0.0, ""), near(-math.pi, math.pi, 0.0, "rad"))


def _in_region(distribution: InRegion) -> st.SearchStrategy[tuple[float, ...]]:
    """From the centre of a box outwards; of a shell, from the nearest side of the hole outwards."""
    outer, hole = distribution.known.outer, distribution.known.hole
    if hole is None:
        return _value(InBox(outer.low_m, outer.high_m))

    def beyond(axis: int, low: float, high: float, face: float) -> st.SearchStrategy[tuple[float, ...]]:
        centre = hole.centre_m
        ranges = [
            near(low, high, face, "m") if k == axis else near(outer.low_m[k], outer.high_m[k], centre[k], "m")
            for k in range(3)
        ]
        return st.tuples(*ranges)

    return st.one_of(*(beyond(*side) for side in distribution.sides_of(hole)))


def near(low: float, high: float, target: float, unit: str) -> st.SearchStrategy[float]:
    """Values from ``low`` to ``high`` that shrink to ``target``, on a decimal grid before others.

    Angles (``rad``) have their grid in degrees.
    """
    grid = _grid(low, high, 180.0 / math.pi if unit.startswith("rad") else 1.0)
    above = [target, *(value for value in grid if value > target)]
    below = [target, *(value for value in reversed(grid) if value < target)]

    def value(between: float, step: int) -> float:
        side, place = (above, step) if step >= 0 else (below, -step)
        if between == 0.0 or place == 0:
            return side[place]
        # Back towards the target: the round number just beyond is then as good where more is worse.
        return min(max(side[place] + between * (side[place - 1] - side[place]), low), high)

    # What lies between is drawn first, so that shrinking gets rid of it first.
    between = st.floats(min_value=0.0, max_value=1.0, exclude_max=True)
    return st.builds(value, between, st.integers(1 - len(below), len(above) - 1))


def _grid(low: float, high: float, scale: float) -> list[float]:
    """The round numbers from ``low`` to ``high`` in units of 1 / ``scale``, and these two."""
    step = Fraction(10) ** math.floor(math.log10((high - low) * scale / _STEPS))
    first, last = math.ceil(low * scale / step), math.floor(high * scale / step)
    round_numbers = (float(k * step) / scale for k in range(first, last + 1))
    return [low, *(value for value in round_numbers if low < value < high), high]
