"""The JSON Schema: shipped files keep to it, and what it refuses the reader refuses as well."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import settings as hypothesis_settings
from jsonschema import Draft202012Validator
from ruamel.yaml import YAML
from scenario_strategies import scenarios
from scenario_texts import SHORTEST, VALID, changed
from test_refused_scenarios import MISTAKES

from safety_harness.scenario.model import Scenario
from safety_harness.scenario.schema import scenario_schema
from safety_harness.scenario.write import write_scenario

ROOT = Path(__file__).parents[2]
SHIPPED = [*sorted((ROOT / "scenarios").glob("*.yaml")), *sorted((ROOT / "scenarios/spaces").glob("*.yaml"))]
VALIDATOR = Draft202012Validator(scenario_schema())


def data(text: str) -> Any:
    return YAML(typ="safe", pure=True).load(text)


def test_the_schema_is_a_schema() -> None:
    Draft202012Validator.check_schema(scenario_schema())


@pytest.mark.parametrize("file", SHIPPED, ids=lambda file: file.stem)
def test_every_shipped_file_keeps_to_it(file: Path) -> None:
    VALIDATOR.validate(data(file.read_text()))


@pytest.mark.parametrize(
    "text",
    [
        VALID,
        SHORTEST,
        "extends: base.yaml\nwithout: [seed]\n",
        "suite: s\nscenarios: [a.yaml]\n",
        SHORTEST + "matrix: {a: {b: {seed: 1}, c: {}}}\n",
        SHORTEST + "settings: {avoidance: {hand pull: 0.1, critical distance: 0.3 m}}\n",
        SHORTEST + "camera: {rate: every tick}\n",
        SHORTEST + "hand sensor: {depth noise: 1 / m, dropout: 0.05}\n",
        SHORTEST + "settings: {motion: {max tcp acceleration: 1 m/s², max tcp angular speed: 20°/s}}\n",
    ],
)
def test_valid_files_keep_to_it(text: str) -> None:
    VALIDATOR.validate(data(text))


@hypothesis_settings(deadline=None, max_examples=60)
@given(scenarios())
def test_every_written_scenario_keeps_to_it(scenario: Scenario) -> None:
    VALIDATOR.validate(data(write_scenario(scenario)))


# What a schema cannot tell: a bound in a unit, a file that is there, what does not go together.
BEYOND_A_SCHEMA = re.compile(
    "above|at least|at most|below|tracks|before|another name|both|neither|a point other|a title|one line|"
    "a whole number of pixels|such as 80 mm, at|a time after|faults.* the key|slower than|faster than|"
    "farther away|hesitating|moves.*for: expected the key"
)


def test_the_mistakes_that_a_schema_can_tell_do_not_keep_to_it() -> None:
    missed = [mistake for mistake in MISTAKES if VALIDATOR.is_valid(data(mistake.text))]
    assert len(MISTAKES) - len(missed) > 40
    assert [one.message for one in missed if not BEYOND_A_SCHEMA.search(one.message)] == []


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("duration: 12 s", "duration: 12"),
        ("duration: 12 s", "durations: 12 s"),
        ("speed: 0.5 m/s", "speed: 0.5 mps"),
        ("speed: 0.5 m/s", "speed: 0.5 m"),
        ("- wait: 1 s", "- wiat: 1 s"),
        ("interaction: mean", "interaction: meen"),
        ("[40 mm, -120 mm, 60 mm]", "[40 mm, -120 mm]"),
        ("dropout: 5 %", "dropout: 5 percent"),
        ("gain switch reached: inconclusive", "gain switch reached: maybe"),
        ("    track: left hand\n", ""),
    ],
)
def test_a_mistake_does_not_keep_to_it(old: str, new: str) -> None:
    assert not VALIDATOR.is_valid(data(changed(old, new)))
