"""A report carries what its program opened, if that is small; else ``verify`` says what to put where."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest

from safety_harness.cli.console import AS_EXPECTED, BAD_INPUT, DIFFERS
from safety_harness.extensions.assurance.certification import folder as folder_module
from safety_harness.extensions.assurance.certification import verify_report
from safety_harness.extensions.assurance.certification.folder import OPENED, stored_files, write_manifest
from safety_harness.extensions.assurance.commands.certify import certify, verify
from tests.assurance.campaign.plans import plan_in
from tests.search.short_space import TEXT

PLAN = """\
plan: weights
avoider: mine.py:Mine
world: kinematic
strata:
  - stratum: near
    space: short.yaml
    runs: 4
claims:
  - claim: joint speeds within limits
keep:
  random traces: 4
"""
MODULE = """\
import json
from pathlib import Path
from safety_harness import Proposal
UP = json.loads(Path(__file__).with_name("weights.json").read_text())[0]

class Mine:
    name = "mine"

    def propose(self, *, hand_position_in_base_m, tcp_position_in_base_m, seed):
        return Proposal(tcp_position_in_base_m + [0.0, 0.0, UP])
"""


def report_elsewhere(folder: Path) -> Path:
    """A report of four runs on another machine than the one that made it: the plan's folder is not there."""
    made = folder / "made"
    made.mkdir()
    (made / "mine.py").write_text(MODULE)
    (made / "weights.json").write_text("[0.1]")
    plan_in(made, PLAN, TEXT)
    certify(made / "plan.yaml", out=made / "report", workers=1)
    shutil.move(made / "report", folder / "report")
    shutil.rmtree(made)
    return folder / "report"


def test_small_weights_are_carried_and_large_ones_are_asked_for(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(folder_module, "drawn", lambda evidence, *_: ("the page", evidence))
    monkeypatch.setattr(verify_report, "render", lambda *_: "the page")
    report = report_elsewhere(tmp_path)
    (packed,) = (report / OPENED).iterdir()
    assert json.loads(packed.read_text()) == [0.1]
    assert verify(report, runs=2, seed=1, execute_programs=True) == AS_EXPECTED

    (report / OPENED / ("0" * 64)).write_text("another")
    write_manifest(report, stored_files(report))
    capsys.readouterr()
    assert verify(report, runs=2, seed=1, execute_programs=True) == DIFFERS
    assert f"{OPENED}/{'0' * 64} was opened by no program" in capsys.readouterr().out

    shutil.rmtree(report / OPENED)
    document = json.loads((report / "evidence.json").read_text())
    document["files"] = [one for one in document["files"] if not one["path"].startswith(OPENED)]
    (report / "evidence.json").write_text(json.dumps(document, indent=1, ensure_ascii=False) + "\n")
    write_manifest(report, stored_files(report))
    assert verify(report, runs=2, seed=1, execute_programs=True) == BAD_INPUT
    told = " ".join(capsys.readouterr().err.split())
    assert "weights.json with the SHA-256" in told
    assert f"put it at {tmp_path}/report.{OPENED}/{packed.name}" in told.replace("- ", "-")

    beside = tmp_path / f"report.{OPENED}"
    beside.mkdir()
    (beside / packed.name).write_text("[0.1]")
    assert verify(report, runs=2, seed=1, execute_programs=True) == AS_EXPECTED


def test_more_than_is_small_is_not_carried(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(folder_module, "MOST_OPENED_BYTES", 4)  # "[0.1]" has five
    assert not (report_elsewhere(tmp_path) / OPENED).exists()
