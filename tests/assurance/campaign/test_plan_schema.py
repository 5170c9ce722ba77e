"""The schema of plans: shipped plans keep to it, and what it refuses the reader refuses as well."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from jsonschema import Draft202012Validator
from ruamel.yaml import YAML

from safety_harness.base.exceptions import InputError
from safety_harness.extensions.assurance.campaign.plan import read_plan
from safety_harness.extensions.assurance.campaign.plan_keys import PLAN, TITLE
from safety_harness.scenario.schema import table_schema
from tests.assurance.campaign.plans import PLAN as SHORT
from tests.assurance.campaign.plans import plan_in

ROOT = Path(__file__).parents[3]
VALIDATOR = Draft202012Validator(table_schema(PLAN, TITLE))
PLANS = [file for file in sorted((ROOT / "plans").glob("*.yaml")) if file.read_text().startswith("plan:")]
MISTAKES = {
    "a key that there is not": SHORT + "stopping early: yes\n",
    "no strata": SHORT.replace("strata:", "layers:"),
    "runs that are no number": SHORT.replace("runs: 30", "runs: many"),
    "half a run": SHORT.replace("runs: 30", "runs: 2.5"),
    "another world": SHORT.replace("world: kinematic", "world: moon"),
    "a share without a unit that there is": SHORT.replace("50 %", "50 mm"),
    "a claim without its sentence": SHORT.replace("- claim: joint speeds within limits", "- hazard: a hand"),
    "a key of a stratum that there is not": SHORT.replace("    runs: 20", "    runs: 20\n    seed: 3"),
    "neither yes nor no": SHORT + "stop early: perhaps\n",
    "a hazard with half of its keys": SHORT + "hazards:\n  - hazard: crushed hand\n    task: packing\n",
}


def data(text: str) -> Any:
    return YAML(typ="safe", pure=True).load(text)


def test_it_is_a_schema() -> None:
    Draft202012Validator.check_schema(VALIDATOR.schema)


@pytest.mark.parametrize("file", PLANS, ids=lambda file: file.stem)
def test_every_shipped_plan_keeps_to_it(file: Path) -> None:
    VALIDATOR.validate(data(file.read_text()))


def test_so_does_the_plan_that_mistakes_are_made_in() -> None:
    VALIDATOR.validate(data(SHORT))
    assert len(PLANS) > 4


@pytest.mark.parametrize("what", MISTAKES)
def test_what_it_refuses_the_reader_refuses_too(what: str, tmp_path: Path) -> None:
    assert list(VALIDATOR.iter_errors(data(MISTAKES[what])))
    with pytest.raises(InputError):
        plan_in(tmp_path, MISTAKES[what])


def test_the_reader_takes_the_keys_of_the_table_and_no_others(tmp_path: Path) -> None:
    assert read_plan(plan_in(tmp_path).file).title == "a hand nearby"
    with pytest.raises(InputError, match="stop early") as refused:
        plan_in(tmp_path, SHORT + "stopping: yes\n")
    assert all(name in str(refused.value) for name in PLAN.names)
