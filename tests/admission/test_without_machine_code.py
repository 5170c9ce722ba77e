"""What decides without compiling decides as machine code does, and comes to the same numbers."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from safety_harness.admission.admit import _view_of_cell, check
from safety_harness.base.exceptions import InadmissibleError
from safety_harness.base.interpreted import without_compiling
from safety_harness.cell.robot.robots import inverse_kinematics
from safety_harness.scenario.expand import gather
from safety_harness.scenario.model import Scenario
from safety_harness.space.read import read_space

SCENARIOS = Path(__file__).parents[2] / "scenarios"
DRAWS = 8
ROUNDING = 1e-12


def numbers(scenario: Scenario) -> list[np.ndarray]:
    _view_of_cell.cache_clear()
    inverse_kinematics.cache_clear()
    found = check(scenario)
    arrays = [value for value in vars(found.view).values() if isinstance(value, np.ndarray)]
    return [found.joint_position_rad, *arrays]


def outcome(scenario: Scenario) -> list[np.ndarray] | str:
    try:
        return numbers(scenario)
    except InadmissibleError as error:
        return str(error)


def drawn() -> list[Scenario]:
    rng = np.random.default_rng(0)
    files = sorted((SCENARIOS / "spaces").glob("*.yaml"))
    return [space.at(rng.random(space.dimension)) for space in map(read_space, files) for _ in range(DRAWS)]


@pytest.mark.parametrize("of", ["shipped", "drawn"])
def test_scenarios_are_admitted_and_refused_alike(of: str) -> None:
    scenarios = drawn() if of == "drawn" else gather([SCENARIOS]).scenarios
    for scenario in scenarios:
        without, with_machine_code = without_compiling(lambda: outcome(scenario)), outcome(scenario)  # noqa: B023
        if isinstance(without, str) or isinstance(with_machine_code, str):
            assert without == with_machine_code
        else:
            for one, other in zip(without, with_machine_code, strict=True):
                np.testing.assert_allclose(one, other, rtol=ROUNDING, atol=ROUNDING)
