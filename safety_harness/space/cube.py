"""A space's parameters as arrays: the unit cube, values, and densities, a row for each scenario.

Arrays of values are (n, d) like those of cube coordinates: quantities in SI, numbers of alternatives,
three coordinates of a point, and NaN for what a scenario does not use.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from safety_harness.space.distributions import Choice
from safety_harness.space.template import Condition, Parameter

Vector = NDArray[np.float64]

UNUSED = 0.5  # the cube coordinate of what a scenario does not use


def values_at(parameters: Sequence[Parameter], u: Vector) -> Vector:
    """(n, d) in the unit cube -> (n, d) values."""
    values = np.empty_like(u)
    for parameter in parameters:
        values[:, parameter.columns] = parameter.distribution.values_at(u[:, parameter.columns])
    return without_unused(parameters, values)


def without_unused(parameters: Sequence[Parameter], values: Vector) -> Vector:
    """(n, d) -> (n, d) with NaN in place of what the choices among the values leave unused."""
    cleared = values.copy()
    for parameter, used in zip(parameters, used_by(parameters, values), strict=True):
        cleared[~used, parameter.columns] = np.nan
    return cleared


def cube_at(parameters: Sequence[Parameter], values: Vector) -> Vector:
    """(n, d) values within their distributions -> (n, d) in the unit cube."""
    u = np.full_like(values, UNUSED)
    for parameter, used in zip(parameters, used_by(parameters, values), strict=True):
        if used.any():
            u[used, parameter.columns] = parameter.distribution.cube_at(values[used, parameter.columns])
    return u


def log_density_at(parameters: Sequence[Parameter], values: Vector) -> Vector:
    """(n, d) values -> (n,) natural logarithm of the density, -inf outside.

    The measure is the product of lengths, volumes and counts over the parameters that are used.
    """
    density = np.zeros(len(values))
    for parameter, used in zip(parameters, used_by(parameters, values), strict=True):
        if used.any():
            density[used] += parameter.distribution.log_density(values[used, parameter.columns])
    return density


def used_by(parameters: Sequence[Parameter], values: Vector) -> list[NDArray[np.bool_]]:
    """For each parameter (n,): which of the scenarios use it."""
    return [uses(parameters, parameter, values) for parameter in parameters]


def uses(parameters: Sequence[Parameter], parameter: Parameter, values: Vector) -> NDArray[np.bool_]:
    """(n, d) values -> (n,): which of the scenarios use this parameter."""
    used = np.zeros(len(values), bool)
    for conditions in parameter.when:
        if not conditions:
            return np.ones(len(values), bool)
        all_hold = np.ones(len(values), bool)
        for condition in conditions:
            all_hold &= _holds(parameters, condition, values)
        used |= all_hold
    return used


def dimension_of(parameters: Sequence[Parameter]) -> int:
    """How many coordinates the cube has."""
    return sum(parameter.distribution.columns for parameter in parameters)


def continuous(parameter: Parameter) -> bool:
    """Whether single values of it have a probability of zero."""
    return not isinstance(parameter.distribution, Choice)


def _holds(parameters: Sequence[Parameter], condition: Condition, values: Vector) -> NDArray[np.bool_]:
    number = values[:, parameters[condition.parameter].column]
    holds: NDArray[np.bool_] = (number >= condition.least) & (number <= condition.most)  # NaN: no
    return holds
