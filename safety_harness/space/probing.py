"""A space is tried out when it is read: at the ends of every parameter, between them, at every choice."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from safety_harness.exceptions import ScenarioError
from safety_harness.scenario.model import Scenario
from safety_harness.space.boxes import InRegion
from safety_harness.space.cube import without_unused
from safety_harness.space.distributions import Choice
from safety_harness.space.space import ScenarioSpace
from safety_harness.space.template import Parameter

Vector = NDArray[np.float64]

_BETWEEN = 0.381966  # of the cube: no round number, so that whole numbers are told from others


def try_out(space: ScenarioSpace) -> None:
    """ScenarioError for the first value that the reader refuses, or that a scenario does not show again."""
    anchors = _anchors(space.scenario(space.simplest_values))
    has_regions = any(isinstance(parameter.distribution, InRegion) for parameter in space.parameters)
    for parameter in space.parameters:
        for values, read_back in _trials(space, parameter):
            scenario = space.scenario(values)
            if has_regions and _anchors(scenario) != anchors:
                raise _error(
                    parameter,
                    "the same avoider, desired TCP, nominal hand and table throughout",
                    "one that varies",
                    hint='what "seen" and "unseen" mean depends on them',
                )
            if read_back:
                _refuse_unseen(space, parameter, scenario)


def _trials(space: ScenarioSpace, parameter: Parameter) -> Iterator[tuple[Vector, bool]]:
    """Values (d,) that use ``parameter``, and whether to look for them in the scenario."""
    raw = np.concatenate([other.distribution.simplest for other in space.parameters])
    for condition in parameter.when[0] if parameter.when else ():
        raw[space.parameters[condition.parameter].column] = condition.least
    distribution = parameter.distribution
    if isinstance(distribution, Choice):
        trials = [((float(number),), True) for number in range(len(distribution.labels))]
    else:
        u = np.array([0.0, 1.0, _BETWEEN])[:, None].repeat(distribution.columns, axis=1)
        ends_and_between = distribution.values_at(u)
        trials = [(tuple(row), number == 2) for number, row in enumerate(ends_and_between)]
    for value, read_back in trials:
        values = raw.copy()
        values[parameter.columns] = value
        yield without_unused(space.parameters, values[None])[0], read_back


def _refuse_unseen(space: ScenarioSpace, parameter: Parameter, scenario: Scenario) -> None:
    if scenario not in space:
        raise _error(
            parameter,
            "a value that the scenario shows again",
            "one that is lost in reading",
            hint="of two keys that say the same, vary the one that a written scenario has",
        )


def _anchors(scenario: Scenario) -> tuple[object, ...]:
    """What the named regions depend on."""
    cell, avoidance = scenario.settings.cell, scenario.settings.avoidance
    return (
        scenario.avoider,
        cell.desired_tcp_position_in_base_m,
        cell.table_height_m,
        avoidance.nominal_hand_position_in_base_m,
    )


def _error(parameter: Parameter, expected: str, got: str, hint: str) -> ScenarioError:
    return ScenarioError(place=parameter.place, expected=expected, got=got, hint=hint)
