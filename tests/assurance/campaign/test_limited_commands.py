"""A campaign tells of the limits that changed its controller's commands, by its stored random runs."""

from __future__ import annotations

from pathlib import Path

import pytest

from safety_harness.extensions.assurance.campaign.ledger import Ledger
from safety_harness.extensions.assurance.campaign.plan import read_plan
from safety_harness.extensions.assurance.certification import stored
from safety_harness.extensions.assurance.certification.evidence import read_evidence
from safety_harness.extensions.assurance.certification.stored import limited_lines
from safety_harness.extensions.assurance.commands.campaign import run
from safety_harness.extensions.assurance.commands.certify import certify
from safety_harness.trace.limiting import AS_MEANT
from tests.assurance.campaign.plans import PLAN, ledger_in, plan_in

FILE = """
import numpy as np

from safety_harness import Move


class Millimetres:
    name, sees = "millimetres", ()
    rate_mps = 100.0

    def reset(self, **start):
        pass

    def act(self, seen):
        return Move(tcp_velocity_mps=np.array([0.0, 0.0, self.rate_mps]))


class Metres(Millimetres):
    name, rate_mps = "metres", 0.01
"""
SMALL = (
    PLAN.replace("runs: 30", "runs: 2")
    .replace("runs: 20", "runs: 2")
    .replace("    violated in at most: 50 %\n", "")
)


def plan_of(folder: Path, name: str) -> Path:
    (folder / "mine.py").write_text(FILE)
    plan_in(folder, SMALL.replace("avoider: opposite pose", f"controller: mine.py:{name}"))
    return folder / "plan.yaml"


def test_run_and_certify_tell_of_commands_in_a_wrong_unit(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    plan, report = plan_of(tmp_path, "Millimetres"), tmp_path / "report"
    run(plan, ledger=report / "ledger.sqlite", workers=1)
    told = [line for line in capsys.readouterr().out.splitlines() if line.startswith("limits: ")]
    assert [line.split(":")[1].strip() for line in told] == [
        "near, in 2 stored runs",
        "nearer, in 2 stored runs",
    ]
    assert all("millimetres: 102 of 102 commands limited (100.0 %)" in line for line in told)
    assert all(line.endswith(AS_MEANT) for line in told)
    certify(plan, out=report, workers=1)
    assert [one for one in capsys.readouterr().out.splitlines() if one.startswith("limits: ")] == told
    findings = [finding.text for finding in read_evidence(report / "evidence.json").findings]
    assert [text for text in findings if AS_MEANT in text] == [line.removeprefix("limits: ") for line in told]


def test_a_limit_that_acts_seldom_is_told_but_is_no_finding(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    plan = plan_of(tmp_path, "Metres")
    certify(plan, out=tmp_path / "report", workers=1)
    told = [line for line in capsys.readouterr().out.splitlines() if line.startswith("limits: ")]
    assert len(told) == 2
    assert all("metres: 2 of 102 commands limited (2.0 %): TCP acceleration 2" in line for line in told)
    assert AS_MEANT not in (tmp_path / "report" / "evidence.json").read_text()


def test_a_count_that_fails_loses_no_campaign(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    plan = read_plan(plan_of(tmp_path, "Metres"))
    monkeypatch.setattr(stored, "limit_lines", lambda _: 1 // 0)
    with ledger_in(tmp_path, plan) as ledger:
        assert limited_lines(plan, ledger) == []


def test_without_a_controller_or_filter_no_trace_is_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    plan = plan_in(tmp_path)
    monkeypatch.setattr(Ledger, "traces", lambda _: pytest.fail("reads traces"))
    with ledger_in(tmp_path, plan) as ledger:
        assert limited_lines(plan, ledger) == []
