"""``attribute`` takes what ``run`` and ``fuzz`` write, and says whose fault it is."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path

import pytest
from examples import hand, scenario

from safety_harness.admission.admit import admit
from safety_harness.admission.trial import run_many
from safety_harness.cli.console import AS_EXPECTED, BAD_INPUT, DIFFERS, INTERRUPTED
from safety_harness.cli.scenario_commands import run
from safety_harness.extensions.attribution import attribute_job as attribution_job
from safety_harness.extensions.attribution.commands.attribute import attribute
from safety_harness.scenario.faults import HandSensorBlind
from safety_harness.scenario.model import Claim, Scenario, Verdict
from safety_harness.scenario.moves import MoveTo, Wait
from safety_harness.scenario.write import write_scenario
from safety_harness.trace.store import save_trace

DISTANCE = "hand distance never below 50 mm"
COMES = hand(MoveTo(position_in_base_m=(0.76, -0.08, 0.38), speed_mps=0.25), Wait(duration_s=1.0))


def blind(expected: Verdict = Verdict.HOLDS) -> Scenario:
    claims = (Claim(sentence=DISTANCE, expected=expected),)
    return replace(scenario(COMES, duration_s=4.5), faults=(HandSensorBlind(),), claims=claims)


def sees(expected: Verdict) -> Scenario:
    return replace(blind(expected), faults=())


def written(one: Scenario, path: Path) -> Path:
    path.write_text(write_scenario(one), encoding="utf-8")
    return path


def test_a_scenario_file_is_attributed_and_its_data_and_picture_are_written(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = written(blind(), tmp_path / "blind.yaml")
    assert attribute([file], out=tmp_path / "out") == AS_EXPECTED
    out = capsys.readouterr().out
    assert f"blind: {DISTANCE}: -" in out
    assert ": perception (ideal): +" in out
    assert "of 1: 1 perception" in out
    data = json.loads((tmp_path / "out" / "attribution.json").read_text(encoding="utf-8"))
    assert data["groups"] == {"perception": 1}
    assert data["attributions"][0]["ingredients"] == ["perception"]
    assert "1 violation" in (tmp_path / "out" / "attribution.svg").read_text(encoding="utf-8")


def test_a_folder_of_traces_is_attributed_by_what_they_violate(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "traces").mkdir()
    for number, trace in enumerate(run_many([admit(blind()), admit(sees(Verdict.HOLDS))])):
        save_trace(trace, tmp_path / "traces" / f"{number}.trace")
    assert attribute([tmp_path]) == AS_EXPECTED
    assert "of 1: 1 perception" in capsys.readouterr().out


def test_a_violation_that_is_not_reproduced_is_told_by_the_exit_code(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert attribute([written(sees(Verdict.VIOLATED), tmp_path / "sees.yaml")]) == DIFFERS
    assert "not attributed: the kinematic replay does not reproduce it: holds" in capsys.readouterr().out


def test_where_nothing_is_violated_nothing_is_attributed(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert attribute([written(sees(Verdict.HOLDS), tmp_path / "sees.yaml")]) == AS_EXPECTED
    told = capsys.readouterr()
    assert told.out == ""
    assert "nothing to attribute" in told.err


def test_an_interruption_before_any_answer_is_not_called_nothing_to_attribute(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupted(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(attribution_job, "attribute_run", interrupted)
    assert attribute([written(blind(), tmp_path / "blind.yaml")]) == INTERRUPTED
    err = capsys.readouterr().err
    assert "nothing to attribute" not in err
    assert err.endswith("interrupted: the finished attributions are above; the same command repeats all\n")


def test_a_folder_without_runs_and_a_file_that_is_none_are_bad_input(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "empty").mkdir()
    (tmp_path / "not.trace").write_text("nothing", encoding="utf-8")
    assert attribute([tmp_path / "empty", tmp_path / "not.trace", tmp_path / "no.yaml"]) == BAD_INPUT
    told = capsys.readouterr()
    assert told.out == ""
    assert "3 of the inputs cannot be used" in told.err


def test_a_program_of_a_trace_is_not_executed_before_it_is_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (trace,) = run_many([admit(blind())])
    foreign = replace(trace, scenario=replace(trace.scenario, avoider="own.py:Own"))
    save_trace(foreign, tmp_path / "own.trace")
    assert attribute([tmp_path / "own.trace"]) == BAD_INPUT
    assert "the program named with --avoider" in capsys.readouterr().err


def test_pybullet_is_asked_for_what_is_shown(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert attribute([written(blind(), tmp_path / "blind.yaml")], confirm=True) == AS_EXPECTED
    out = capsys.readouterr().out
    assert "in PyBullet, as it is: still violated, -" in out
    assert "in PyBullet, perception (ideal): kept, +" in out


def test_run_names_the_command_that_attributes_its_violations(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert run([written(blind(), Path("blind.yaml"))], Path("out")) == DIFFERS
    assert run([written(blind(Verdict.VIOLATED), Path("expected.yaml"))], Path("as-it-says")) == AS_EXPECTED
    commands = re.findall(r"next: safety-harness attribute (\S+) +\(whose fault", capsys.readouterr().err)
    assert commands == ["out/traces/blind.trace", "as-it-says/traces/expected.trace"]
    assert attribute([Path(commands[0])]) == AS_EXPECTED
    assert "of 1: 1 perception" in capsys.readouterr().out
