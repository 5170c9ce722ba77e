"""Plans before they are run: drafted, checked, explained, tried by a pilot."""

from __future__ import annotations

from pathlib import Path

import pytest
from typer.testing import CliRunner

from safety_harness.cli.console import AS_EXPECTED, BAD_INPUT, DIFFERS
from safety_harness.cli.main import app
from safety_harness.extensions.assurance.campaign.plan import read_plan
from safety_harness.extensions.assurance.statistics.binomial import ends_of
from safety_harness.extensions.assurance.statistics.planning import Aim, runs_needed
from tests.assurance.campaign.plans import PLAN, plan_in
from tests.search.short_space import TEXT


def said(*words: str) -> tuple[int, str]:
    done = CliRunner().invoke(app, [*words], env={"COLUMNS": "300"})
    return done.exit_code, done.output


def test_a_plan_is_drafted_of_a_space_and_can_be_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("short.yaml").write_text(TEXT.replace("space: a hand nearby", 'space: "a hand: nearby #1"'))
    assert said("new", "plan", "short.yaml")[0] == AS_EXPECTED
    (path,) = tmp_path.glob("*-plan.yaml")
    plan = read_plan(path)
    assert plan.title == "a hand: nearby #1"
    assert [claim.target for claim in plan.claims] == [0.02, 0.02]
    assert plan.runs == runs_needed(Aim(target=0.02, family=ends_of(2, 1)))
    assert said("validate", path.name) == (
        AS_EXPECTED,
        f"ok {path.name}: a plan, 1 stratum, {plan.runs} runs, 2 claims\n",
    )
    assert said("new", "plan", "short.yaml")[0] == BAD_INPUT  # it is there
    assert said("new", "plan")[0] == BAD_INPUT
    assert said("new", "reaching", "a.yaml", "b.yaml")[0] == BAD_INPUT


def test_validate_tells_a_plans_mistakes_and_what_certify_will_refuse(tmp_path: Path) -> None:
    plan_in(tmp_path, PLAN)
    file = tmp_path / "plan.yaml"
    file.write_text(PLAN.replace("50 %", "1 %"))
    code, words = said("validate", str(file))
    assert code == AS_EXPECTED
    assert "warning: certify refuses " in words
    assert ": expected at least" in words
    file.write_text(PLAN.replace("seed: 7", "seed: seven"))
    code, words = said("validate", str(file))
    assert code == BAD_INPUT
    assert "plan.yaml:5: seed" in words


def test_a_plan_is_explained_without_running_it(tmp_path: Path) -> None:
    plan_in(tmp_path, PLAN)
    code, words = said("explain", str(tmp_path / "plan.yaml"))
    assert code == AS_EXPECTED
    assert "8 bounds hold together with 95 % confidence, each alone with 99.375 %" in words
    needed = runs_needed(Aim(target=0.5, family=8))
    assert f"violated in at most 50 %: needs {needed} tested runs in a stratum" in words
    assert "joint speeds within limits: no target: estimated only" in words


def test_a_pilot_warns_of_what_the_planned_runs_will_not_show(tmp_path: Path) -> None:
    plan_in(tmp_path, PLAN.replace("within limits\n", "within limits\n    violated in at most: 2 %\n"))
    code, words = said("campaign", "pilot", str(tmp_path / "plan.yaml"), "--runs", "6", "--workers", "2")
    assert code == DIFFERS
    needed = runs_needed(Aim(target=0.02, family=8))
    assert (
        f"WARN near: joint speeds within limits: 30 runs for 2 %: 30 will test it (16 to 30); {needed} runs"
        in words
    )
    assert "50 runs: about " in words
    assert not list(tmp_path.glob("**/*.sqlite"))
