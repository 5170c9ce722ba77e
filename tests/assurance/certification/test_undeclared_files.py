"""A declaration does not cover the files that a program opens; report and ``verify`` say so."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from safety_harness.cli.console import AS_EXPECTED, DIFFERS
from safety_harness.extensions.assurance.commands.certify import certify, declare, verify
from tests.assurance.campaign.plans import plan_in
from tests.assurance.certification.test_opened_in_reports import MODULE, PLAN, TEXT


def test_weights_that_change_after_the_declaration_are_an_open_point(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "mine.py").write_text(MODULE)
    weights = tmp_path / "weights.json"
    weights.write_text("[0.1]")
    plan_in(tmp_path, PLAN, TEXT)
    plan, report = tmp_path / "plan.yaml", tmp_path / "report"
    assert declare(plan) == AS_EXPECTED
    assert "not covered: other files that mine.py reads" in capsys.readouterr().err
    weights.write_text("[0.3]")
    certify(plan, out=report, workers=1)
    findings = json.loads((report / "evidence.json").read_text())["findings"]
    assert any("the declaration does not cover weights.json" in finding["text"] for finding in findings)

    capsys.readouterr()
    declared = str(tmp_path / "plan.declared.json")
    asked = {"runs": 1, "seed": 1, "declared": declared, "execute_programs": True}
    assert verify(report, **asked) == AS_EXPECTED
    assert "not checked: the declaration does not cover weights.json" in capsys.readouterr().out
    assert verify(report, **asked, strict=True) == DIFFERS


def test_a_plan_whose_programs_open_nothing_has_no_such_point(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "mine.py").write_text(
        MODULE.replace('json.loads(Path(__file__).with_name("weights.json").read_text())[0]', "0.1")
    )
    plan_in(tmp_path, PLAN, TEXT)
    assert declare(tmp_path / "plan.yaml") == AS_EXPECTED
    certify(tmp_path / "plan.yaml", out=tmp_path / "report", workers=1)
    assert "does not cover" not in (tmp_path / "report" / "evidence.json").read_text()
