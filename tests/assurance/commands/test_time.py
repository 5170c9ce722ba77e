"""``time``: the quantiles of an avoider's answers, and a profile that scenarios draw from."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from safety_harness import load_trace
from safety_harness.cli.console import AS_EXPECTED, BAD_INPUT
from safety_harness.cli.scenario_commands import replay, run
from safety_harness.extensions.lab.commands.learning import time_answers
from tests.cli.test_own_avoider import MINE, VISIT

COST = "settings: {avoidance: {decision time: mine.json}}\n"


@pytest.fixture
def project(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    Path("mine.py").write_text(MINE)
    Path("visit.yaml").write_text(VISIT + COST)
    return tmp_path


def test_a_run_draws_from_the_profile_and_repeats(project: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert time_answers("mine.py:Mine", out=Path("mine.json"), questions=200) == AS_EXPECTED
    out = capsys.readouterr().out
    assert out.startswith("mine.py:Mine (mine): p50 ")
    assert all(word in out for word in ("p99", "max", "of 200 answers", "CPUs"))
    profile = json.loads(Path("mine.json").read_text())
    assert len(profile["quantiles_s"]) == 101
    assert str(project) not in Path("mine.json").read_text()
    assert run([Path("visit.yaml")], Path("out"), "mine.py:Mine") == AS_EXPECTED
    assert "drawn for each decision from 200 answers of mine.py:Mine on " in capsys.readouterr().err
    trace = load_trace(Path("out/traces/visit.trace"))
    cost_s = trace.decisions["decision_time_s"]
    assert (profile["quantiles_s"][0] <= cost_s).all()
    assert (cost_s <= profile["quantiles_s"][-1]).all()
    assert (trace.decisions["tick"] > trace.decisions["asked_tick"]).all()
    assert replay(Path("out/traces/visit.trace"), "mine.py:Mine") == AS_EXPECTED


def test_the_profile_of_another_text_of_the_avoider_is_refused(
    project: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    time_answers("mine.py:Mine", out=Path("mine.json"), questions=100)
    Path("mine.py").write_text(MINE + "# changed\n")
    assert run([Path("visit.yaml")], Path("out"), "mine.py:Mine") == BAD_INPUT
    err = capsys.readouterr().err
    assert "a profile of mine.py:Mine, as its file is now" in err
    assert "safety-harness time mine.py:Mine --out FILE.json" in err


DRIVER = """
import time

from safety_harness import Move


class Slow:
    name, sees = "slow", ("joints",)

    def reset(self, **start):
        pass

    def act(self, seen):
        time.sleep(0.001)
        return Move(joint_velocity_radps=[0.01] * 6)
"""


def test_a_controller_is_measured_in_runs_and_its_answers_then_cost_that_time(
    project: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    Path("driver.py").write_text(DRIVER)
    of = {"controller": "driver.py:Slow", "out": Path("mine.json"), "questions": 100}
    assert time_answers(**of, scenario="visit.yaml") == BAD_INPUT  # type: ignore[arg-type]
    assert "mine.json" in capsys.readouterr().err  # which the scenario names, and nobody has measured yet
    Path("short.yaml").write_text(VISIT)
    assert time_answers(**of, scenario="short.yaml") == AS_EXPECTED  # type: ignore[arg-type]
    assert capsys.readouterr().out.startswith("driver.py:Slow: p50 ")
    profile = json.loads(Path("mine.json").read_text())
    assert profile["avoider"] == "driver.py:Slow"
    assert profile["questions"] >= 100
    assert profile["quantiles_s"][0] >= 0.001
    assert run([Path("visit.yaml")], Path("out"), controller="driver.py:Slow") == AS_EXPECTED
    out, err = capsys.readouterr()
    assert "avoidance.decision_time of driver.py:Slow, as measured, in PyBullet" in out
    assert "drawn for each answer from" in err
    Path("driver.py").write_text(DRIVER.replace("0.001", "0.002"))
    assert run([Path("visit.yaml")], Path("out"), controller="driver.py:Slow") == BAD_INPUT
    err = capsys.readouterr().err
    assert "a profile of driver.py:Slow, as its file is now" in err
    assert "safety-harness time --controller driver.py:Slow --out FILE.json" in err


def test_an_avoider_or_a_controller_is_measured_and_not_both(
    project: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert time_answers() == BAD_INPUT
    assert time_answers("mine.py:Mine", controller="driver.py:Slow") == BAD_INPUT
    assert capsys.readouterr().err.count("an avoider, or --controller") == 2
    assert time_answers(controller="visual servo") == BAD_INPUT
    assert "visual servo, whose avoider answers" in capsys.readouterr().err


def test_what_does_not_answer_or_cannot_be_written_leaves_nothing(
    project: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    Path("mine.py").write_text(MINE.replace("return Proposal(", "raise ValueError("))
    assert time_answers("mine.py:Mine", out=Path("mine.json"), questions=100) == BAD_INPUT
    assert time_answers("opposite pose", out=Path("mine.yaml"), questions=100) == BAD_INPUT
    assert time_answers("nobody", out=Path("mine.json"), questions=100) == BAD_INPUT
    assert not Path("mine.json").exists()
    assert "an avoider that answers" in capsys.readouterr().err
