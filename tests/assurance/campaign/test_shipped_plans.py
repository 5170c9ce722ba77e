"""Plans name what comes with the package, and are named themselves."""

from __future__ import annotations

from pathlib import Path

import pytest

from safety_harness import read_scenario, read_space
from safety_harness.extensions.assurance.campaign.plan import read_plan
from safety_harness.extensions.assurance.certification.lodged import declaration_file
from safety_harness.scenario.expand import gather, read_all_scenarios
from safety_harness.testing import scenarios


def test_readers_take_names(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert read_scenario(Path("shipped:fast-reach")).name == "fast-reach"
    assert read_scenario(Path("shipped:recorded-handover")).hands
    assert read_space(Path("shipped:unseen-both")).name == "unseen-both"
    assert [one.name for one in read_plan(Path("shipped:quick")).strata] == ["seen", "unseen hand and TCP"]
    assert len(read_all_scenarios(Path("shipped:scenarios"))) > 50
    assert len(gather([Path("shipped:spaces")], spaces=True).spaces) == 6
    scenarios("shipped:unseen-hand")


def test_files_of_one_s_own_name_what_is_shipped(tmp_path: Path) -> None:
    mine = tmp_path / "mine.yaml"
    mine.write_text("extends: shipped:recorded-handover\nabout: mine\navoider: shipped:upwards.py:Upwards\n")
    (hand,), (base,) = read_scenario(mine).hands, read_scenario(Path("shipped:recorded-handover")).hands
    assert hand.motion.sha256 == base.motion.sha256  # type: ignore[union-attr]
    suite = tmp_path / "suite.yaml"
    suite.write_text("suite: mine\nscenarios:\n  - mine.yaml\n  - shipped:fast-reach\n")
    assert [one.name for one in read_all_scenarios(suite)] == ["mine", "fast-reach"]
    plan = tmp_path / "plan.yaml"
    plan.write_text(
        "plan: mine\nclaims:\n  - claim: repulsive poses reachable\n"
        "strata:\n  - stratum: seen\n    space: shipped:nominal\n    runs: 1\n"
    )
    assert read_plan(plan).strata[0].space.name == "nominal"


def test_a_declaration_lies_beside_a_plan_of_one_s_own() -> None:
    assert declaration_file(Path("plans/mine.yaml")) == Path("plans/mine.declared.json")
