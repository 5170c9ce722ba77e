"""``safety-harness selftest`` from its options to its exit code."""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest
from typer.testing import CliRunner

from safety_harness.cli.main import app
from safety_harness.extensions.selftest import session
from safety_harness.extensions.selftest.catalogue import EVERY
from safety_harness.extensions.selftest.commands import selftest
from safety_harness.extensions.selftest.outcome import FaultOutcome, outcome_of
from safety_harness.extensions.selftest.session import DATA, PAGE
from safety_harness.extensions.selftest.suite import SelfTestPlan
from safety_harness.extensions.selftest.trial import Rung

SHIPPED = Path(__file__).parents[3] / "scenarios"


@pytest.fixture
def scenarios(tmp_path: Path) -> Path:
    folder = tmp_path / "scenarios"
    folder.mkdir()
    shutil.copy(SHIPPED / "network-certain.yaml", folder)
    return folder


def test_a_fault_is_caught_and_written_down(
    scenarios: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert selftest(scenarios=scenarios, fault="overspeed", out=tmp_path, jobs=1) == 0
    printed = capsys.readouterr().out
    assert "TCP speed never above 250 mm/s" in printed
    assert "1 of 1 fault caught" in printed
    found = json.loads((tmp_path / DATA).read_text("utf-8"))
    assert found["faults"][0]["caught_by"] == "TCP speed never above 250 mm/s"
    assert found["faults"][0]["confirmed_in"] == ["PyBullet"]
    assert "overspeed" in (tmp_path / PAGE).read_text("utf-8")


def test_a_survivor_is_exit_code_1(scenarios: Path, tmp_path: Path) -> None:
    assert selftest(scenarios=scenarios, fault="one hand only", out=tmp_path, jobs=1) == 1


def test_a_users_own_avoider_is_put_on_trial(
    scenarios: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    mine = tmp_path / "mine.py"
    mine.write_text(
        "import numpy as np\n"
        "from safety_harness import Proposal\n"
        "class Mine:\n"
        "    name = 'mine'\n"
        "    def propose(self, *, hand_position_in_base_m, tcp_position_in_base_m, seed):\n"
        "        way = tcp_position_in_base_m - hand_position_in_base_m\n"
        "        return Proposal(tcp_position_in_base_m + 0.1 * way / np.linalg.norm(way))\n"
    )
    code = selftest(
        scenarios=scenarios, avoider=f"{mine}:Mine", fault="sign flip", out=tmp_path / "out", jobs=1
    )
    captured = capsys.readouterr()
    assert code == 0, captured.out
    assert "one question after another" in captured.err
    found = json.loads((tmp_path / "out" / DATA).read_text("utf-8"))
    assert found["about"]["avoider"] == f"{mine}:Mine"


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--profile", "weekly"], "quick or nightly"),
        (["--fault", "overspeet"], "overspeed"),
        (["--jobs", "0"], "at least 1"),
        (["--scenarios", "nowhere"], "no such folder"),
    ],
)
def test_bad_input_is_explained(options: list[str], words: str, tmp_path: Path) -> None:
    done = CliRunner().invoke(app, ["selftest", "--out", str(tmp_path / "out"), *options])
    assert done.exit_code == 2
    assert words in done.stderr
    assert not (tmp_path / "out").exists()


def test_ctrl_c_keeps_what_was_tried(
    scenarios: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def two_then_ctrl_c(plan: SelfTestPlan, numbers: list[int], jobs: int) -> Iterator[FaultOutcome]:
        for number in numbers[:2]:
            yield outcome_of(EVERY[number], (Rung(magnitude=1.0, words="1", episodes=1),))
        raise KeyboardInterrupt

    monkeypatch.setattr(session, "outcomes", two_then_ctrl_c)
    assert selftest(scenarios=scenarios, out=tmp_path / "out", jobs=1) == 130
    assert f"2 of {len(EVERY)} done" in capsys.readouterr().err
    found = json.loads((tmp_path / "out" / DATA).read_text("utf-8"))
    assert found["about"]["interrupted"] is True
    assert len(found["faults"]) == 2


def test_a_defect_of_ours_keeps_what_was_tried_and_is_exit_code_1(
    scenarios: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def one_then_a_defect(plan: SelfTestPlan, numbers: list[int], jobs: int) -> Iterator[FaultOutcome]:
        yield outcome_of(EVERY[numbers[0]], (Rung(magnitude=1.0, words="1", episodes=1),))
        raise ZeroDivisionError("made up")

    monkeypatch.setattr(session, "outcomes", one_then_a_defect)
    assert selftest(scenarios=scenarios, out=tmp_path / "out", jobs=1) == 1
    captured = capsys.readouterr()
    assert "ZeroDivisionError: made up" in captured.err
    assert f"1 of {len(EVERY)} done" in captured.err
    assert EVERY[0].name in captured.out
    assert len(json.loads((tmp_path / "out" / DATA).read_text("utf-8"))["faults"]) == 1


def test_what_is_finished_is_written_before_the_next_is_tried(
    scenarios: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """So that it is there whatever ends the process."""
    written: list[int] = []

    def looking(plan: SelfTestPlan, numbers: list[int], jobs: int) -> Iterator[FaultOutcome]:
        for number in numbers[:3]:
            yield outcome_of(EVERY[number], (Rung(magnitude=1.0, words="1", episodes=1),))
            found = json.loads((tmp_path / "out" / DATA).read_text("utf-8"))
            assert found["about"]["interrupted"] is True
            written.append(len(found["faults"]))

    monkeypatch.setattr(session, "outcomes", looking)
    selftest(scenarios=scenarios, out=tmp_path / "out", jobs=1)
    assert written == [1, 2, 3]


def test_faults_of_which_none_applies_are_no_success(
    scenarios: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """An avoider that states no spread can have none that is wrong."""
    options = {"avoider": "opposite pose", "fault": "spread", "out": tmp_path / "out", "jobs": 1}
    assert selftest(scenarios=scenarios, **options) == 1  # type: ignore[arg-type]
    assert "these faults do not apply" in capsys.readouterr().err


def test_a_folder_of_which_nothing_can_be_run_is_refused(tmp_path: Path) -> None:
    (tmp_path / "only").mkdir()
    shutil.copy(SHIPPED / "rendered-images.yaml", tmp_path / "only")
    assert selftest(scenarios=tmp_path / "only", out=tmp_path / "out", jobs=1) == 2


def test_a_folder_that_cannot_be_written_is_said(scenarios: Path, tmp_path: Path) -> None:
    (tmp_path / "taken").write_text("a file")
    assert selftest(scenarios=scenarios, fault="overspeed", out=tmp_path / "taken", jobs=1) == 2


def test_two_processes_say_what_one_says(scenarios: Path, tmp_path: Path) -> None:
    for jobs in (1, 2):
        assert selftest(scenarios=scenarios, fault="spe", out=tmp_path / str(jobs), jobs=jobs) in (0, 1)
    one, two = (json.loads((tmp_path / jobs / DATA).read_text("utf-8"))["faults"] for jobs in "12")
    assert one == two
    assert len(one) > 1
