"""A plan of a space whose shield reacts later than the robot's drives need is refused."""

from __future__ import annotations

from pathlib import Path

import pytest

from safety_harness.cli.console import AS_EXPECTED, BAD_INPUT
from safety_harness.cli.validate import validate
from tests.scenario.test_shield_key import LATE, files_in

PLAN = """\
plan: behind a shield
world: kinematic
seed: 1
strata:
  - stratum: shielded
    space: space.yaml
    runs: 2
claims:
  - claim: joint speeds within limits
"""


@pytest.mark.parametrize("drives", [LATE[0], LATE[-1]])  # each of them: tests/scenario/test_shield_key.py
def test_validate_refuses_a_plan_whose_drives_are_later_than_the_shield(
    drives: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    plan = tmp_path / "plan.yaml"
    plan.write_text(PLAN)
    files_in(tmp_path, drives, "shield: speed and separation\n")
    assert validate([plan]) == BAD_INPUT
    assert "expected a reaction time of at least" in capsys.readouterr().err
    files_in(tmp_path, drives, "shield: {reaction time: 150 ms}\n")
    assert validate([plan]) == AS_EXPECTED
