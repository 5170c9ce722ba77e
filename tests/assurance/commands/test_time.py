"""``time``: the quantiles of an avoider's answers, and a profile that scenarios draw from."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from safety_harness import load_trace
from safety_harness.cli.console import AS_EXPECTED, BAD_INPUT
from safety_harness.cli.scenario_commands import replay, run
from safety_harness.extensions.lab.commands.learning import time_avoider
from tests.cli.test_own_avoider import MINE, VISIT

COST = "settings: {avoidance: {decision time: mine.json}}\n"


@pytest.fixture
def project(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    Path("mine.py").write_text(MINE)
    Path("visit.yaml").write_text(VISIT + COST)
    return tmp_path


def test_a_run_draws_from_the_profile_and_repeats(project: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert time_avoider("mine.py:Mine", out=Path("mine.json"), questions=200) == AS_EXPECTED
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
    time_avoider("mine.py:Mine", out=Path("mine.json"), questions=100)
    Path("mine.py").write_text(MINE + "# changed\n")
    assert run([Path("visit.yaml")], Path("out"), "mine.py:Mine") == BAD_INPUT
    err = capsys.readouterr().err
    assert "a profile of the avoider mine.py:Mine, as its file is now" in err
    assert "safety-harness time mine.py:Mine --out FILE.json" in err


def test_what_does_not_answer_or_cannot_be_written_leaves_nothing(
    project: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    Path("mine.py").write_text(MINE.replace("return Proposal(", "raise ValueError("))
    assert time_avoider("mine.py:Mine", out=Path("mine.json"), questions=100) == BAD_INPUT
    assert time_avoider("opposite pose", out=Path("mine.yaml"), questions=100) == BAD_INPUT
    assert time_avoider("nobody", out=Path("mine.json"), questions=100) == BAD_INPUT
    assert not Path("mine.json").exists()
    assert "an avoider that answers" in capsys.readouterr().err
