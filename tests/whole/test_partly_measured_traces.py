"""Commands meet a trace of which not all was measured: the right words, the right exit code."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from partly_measured import partly_measured

from safety_harness.cli.console import AS_EXPECTED, BAD_INPUT, DIFFERS, answered_as_json
from safety_harness.cli.replay import judge_again, replay
from safety_harness.extensions.attribution.commands.attribute_lines import attribute_runs
from safety_harness.trace.store import save_trace
from safety_harness.trace.trace import Trace

KNOWN = "TCP speed never above 250 mm/s"
CLAIMS = (KNOWN, "hand predictions within 50 mm", "hand distance never below 50 mm")


@pytest.fixture(scope="module")
def stored(visit: Trace, tmp_path_factory: pytest.TempPathFactory) -> Path:
    file = tmp_path_factory.mktemp("traces") / "partly.trace"
    save_trace(partly_measured(visit), file)
    return file


def test_judge_says_what_was_measured_and_what_each_claim_lacks(
    stored: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert judge_again([stored], CLAIMS) == DIFFERS
    out, err = capsys.readouterr()
    lines = out.splitlines()
    assert any(line.startswith("holds ") and KNOWN in line for line in lines)
    lacking = [
        line.strip() for line in lines if line.strip().startswith("not measured: ") and " of right f" in line
    ]
    assert len(lacking) == 2
    assert all(" of right from 0.800 to " in line for line in lacking)
    assert lines[lines.index("what was measured of example:") + 1 :] == [
        "  log: joint_position_rad",
        "  log, within 0.0572958 deg/s: joint_velocity_radps",
        "  sensor, within 8 mm: hand_position_in_base_m, elbow_position_in_base_m; "
        "not measured from 0.800 to 1.440 s of right",
        "  derived, within 8 mm: hand_distance_m; not measured from 0.800 to 1.440 s of right",
        "  derived: hand_distance_capsule; not measured from 0.800 to 1.440 s of right",
        "  simulated truth: all else",
        "  not measured: object_visible, features, feature_error, sse, track_valid, "
        "predicted_hand_in_base_m, predicted_distance_m, mode, gain, camera_twist, "
        "demanded_joint_velocity_radps, limits, faults, decision, all of decisions",
    ]
    assert err.endswith(" claims: 2 not measured\n")


def test_of_a_run_that_was_all_simulated_nothing_more_is_said(
    visit: Trace, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    save_trace(visit, tmp_path / "whole.trace")
    assert judge_again([tmp_path / "whole.trace"], [KNOWN]) == AS_EXPECTED
    out, err = capsys.readouterr()
    assert (len(out.splitlines()), len(err.splitlines())) == (3, 1)
    assert out.startswith("tested in ")
    assert err.startswith("Basis: ")


def test_on_a_narrow_terminal_every_line_fits(
    stored: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("COLUMNS", "40")
    judge_again([stored], CLAIMS)
    out, err = capsys.readouterr()
    assert max(map(len, (out + err).splitlines())) <= 40


def test_programs_are_told_of_each_column_and_of_each_claim(
    stored: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert answered_as_json(lambda: judge_again([stored], CLAIMS)) == DIFFERS
    (run,) = json.loads(capsys.readouterr().out)["result"]["runs"]
    assert run["known"]["mode"] == {"source": "not measured", "uncertainty_si": 0.0, "gaps": []}
    assert run["known"]["hand_distance_m"] == {
        "source": "derived",
        "uncertainty_si": 0.008,
        "gaps": [{"first_tick": 100, "after_tick": 180, "hand": 0}],
    }
    assert "tcp_speed_mps" not in run["known"]
    assert (run["decisions"], run["overruling"]) == (None, None)
    known, unknown = run["claims"][:2]
    assert (known["verdict"], known["unmeasured"]) == ("holds", [])
    assert unknown["verdict"] == "inconclusive"
    assert "hand_position_in_base_m" in unknown["unmeasured"]


def test_replay_refuses_it(stored: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert answered_as_json(lambda: replay(stored)) == BAD_INPUT
    (error,) = json.loads(capsys.readouterr().out)["errors"]
    assert error["field"] == "known"
    assert "only that can be run again" in error["expected"]


def test_attribute_refuses_it(stored: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert attribute_runs([stored], None, None, confirm=False) == BAD_INPUT
    out, err = capsys.readouterr()
    assert out == ""
    assert "only that can be run again" in err
