"""A reader takes a path, also as a text; what is none of its kind is refused in words of ours."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

import safety_harness
from safety_harness.base.exceptions import InputError
from safety_harness.scenario.expand import read_all_scenarios
from safety_harness.scenario.model import Scenario
from safety_harness.testing.drawing import scenarios
from safety_harness.testing.simulating import simulate
from tests.kinds_of_files import SCENARIO

READERS: dict[str, Callable[[Any], object]] = {
    "read_scenario": safety_harness.read_scenario,
    "read_space": safety_harness.read_space,
    "load_trace": safety_harness.load_trace,
    "read_all_scenarios": read_all_scenarios,
    "simulate": simulate,
    "scenarios": scenarios,
}
TAKERS: dict[str, Callable[[Any], object]] = {
    "admit": safety_harness.admit,
    "judge": safety_harness.judge,
    "run_trial": safety_harness.run_trial,
    "run_many": lambda one: list(safety_harness.run_many([one])),
    "draw_admissible": lambda one: safety_harness.draw_admissible(one, 0, 1),
    "strategy": safety_harness.strategy,
    "write_scenario": safety_harness.write_scenario,
    "write_space": safety_harness.write_space,
    "first_difference": lambda one: safety_harness.first_difference(one, one),
    "Trials": lambda one: safety_harness.Trials(one, safety_harness.in_kinematic),
}


@pytest.fixture
def file(tmp_path: Path) -> Path:
    path = tmp_path / "mine.yaml"
    path.write_text(SCENARIO)
    return path


def test_a_text_is_a_path_and_a_scenario_stays_what_it_is(file: Path) -> None:
    read = safety_harness.read_scenario(str(file))
    assert isinstance(read, Scenario)
    assert read == safety_harness.read_scenario(file)
    assert safety_harness.read_scenario(read) is read
    assert read_all_scenarios(str(file)) == (read,)


@pytest.mark.judges_runs_itself
def test_simulate_takes_a_path_as_well(file: Path) -> None:
    assert simulate(str(file)).complete
    assert simulate(file).scenario == safety_harness.read_scenario(file)


@pytest.mark.parametrize("name", READERS)
@pytest.mark.parametrize("wrong", [3, None, ["a.yaml"], b"a.yaml", "", "a\0b", "gone.yaml", SCENARIO])
def test_what_is_no_path_is_refused(name: str, wrong: object) -> None:
    with pytest.raises(InputError):
        READERS[name](wrong)


@pytest.mark.parametrize("name", ["read_scenario", "simulate"])
def test_the_text_of_a_scenario_is_told_from_a_path(name: str) -> None:
    with pytest.raises(InputError, match=r"a text of 5 lines \(parse_scenario\(text\) reads a text\)"):
        READERS[name](SCENARIO)


@pytest.mark.parametrize("name", TAKERS)
@pytest.mark.parametrize("wrong", ["mine.yaml", Path("mine.yaml"), None, 3])
def test_a_function_that_takes_an_object_says_what_makes_one(name: str, wrong: object) -> None:
    with pytest.raises(InputError, match=rf"{name}\(.*\): expected a.*(reads|makes) one"):
        TAKERS[name](wrong)


@pytest.mark.parametrize("wrong", ["opposite pose", 3, type("Mine", (), {"propose": None})])
def test_an_avoider_is_an_object_with_a_propose(wrong: Any, file: Path) -> None:
    with pytest.raises(InputError, match="expected an object with a propose"):
        safety_harness.admit(safety_harness.read_scenario(file), avoider=wrong)
