"""``safety_harness.certify``: what it returns, and that the command goes on in the same folder."""

from __future__ import annotations

from pathlib import Path

import pytest

import safety_harness
from safety_harness.base.exceptions import InputError
from safety_harness.extensions.assurance.certification.evidence import ClaimStatus, read_evidence
from safety_harness.extensions.assurance.commands.certify import certify as certify_command
from tests.assurance.campaign.plans import plan_in


def test_the_report_is_that_of_the_command(tmp_path: Path) -> None:
    plan_in(tmp_path)
    found = safety_harness.certify(tmp_path / "plan.yaml", out=tmp_path / "report", workers=1)
    assert found.complete
    assert found.evidence == read_evidence(tmp_path / "report" / "evidence.json")
    assert certify_command(tmp_path / "plan.yaml", out=tmp_path / "report", workers=1) == found.exit_code
    again = read_evidence(tmp_path / "report" / "evidence.json")
    assert again.record.rows_sha256 == found.evidence.record.rows_sha256
    assert found.evidence.standing is not ClaimStatus.SHOWN
    assert repr(found).startswith(f"<{found.evidence.standing.value}: ")
    assert "kinematic world; claims exercised in " in repr(found)
    copied = found.write(tmp_path / "elsewhere")
    assert copied.page.is_file()
    with pytest.raises(InputError, match="not there yet"):
        found.write(tmp_path / "elsewhere")


def test_a_plan_that_is_not_there_is_refused() -> None:
    with pytest.raises(InputError, match=r"gone\.yaml"):
        safety_harness.certify("gone.yaml")
