"""Points of the unit cube become scenarios that can be tried, or reasons why not, in their order."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from examples import Displaced

from safety_harness.admission.admit import Admitted, admit
from safety_harness.admission.spaces import admit_points
from safety_harness.admission.trial import run_many
from safety_harness.base.exceptions import InputError
from safety_harness.space.read import read_space
from safety_harness.space.space import ScenarioSpace

SPACES = Path(__file__).parents[2] / "scenarios" / "spaces"


@pytest.fixture(scope="module")
def space() -> ScenarioSpace:
    return read_space(SPACES / "unseen-both.yaml")


def test_each_point_is_its_scenario_or_why_it_cannot_be_tried(space: ScenarioSpace) -> None:
    u = np.random.default_rng(3).random((24, space.dimension))
    found = list(admit_points(space, u, range(100, 124)))
    assert len(found) == 24
    kinds = {isinstance(one, Admitted) for one in found}
    assert kinds == {True, False}
    for k, one in enumerate(found):
        expected = space.at(u[k], seed=100 + k)
        if isinstance(one, Admitted):
            assert one.scenario.seed == 100 + k
            assert one.scenario.hands == expected.hands
            assert np.array_equal(one.joint_position_rad, admit(expected).joint_position_rad)
        else:
            with pytest.raises(InputError) as error:
                admit(expected)
            assert (error.value.expected, error.value.got) == (one.expected, one.got)


def test_an_avoider_is_made_and_rehearsed_once(space: ScenarioSpace) -> None:
    u = np.random.default_rng(3).random((24, space.dimension))
    made = [one.avoider for one in admit_points(space, u, range(24)) if isinstance(one, Admitted)]
    assert len({id(avoider) for avoider in made}) == 1


def test_an_avoider_of_ones_own_takes_the_place_of_theirs(space: ScenarioSpace) -> None:
    u = np.random.default_rng(4).random((8, space.dimension))
    avoider = Displaced((0.0, 0.0, 0.05))
    found = [one for one in admit_points(space, u, range(8), avoider=avoider) if isinstance(one, Admitted)]
    assert all(one.avoider is avoider for one in found)
    assert all(trace.system.tested.name == "displaced" for trace in run_many(found[:2]))


def test_seeds_and_points_go_together(space: ScenarioSpace) -> None:
    with pytest.raises(ValueError, match="shorter"):
        list(admit_points(space, np.full((3, space.dimension), 0.5), range(2)))
