"""A report of an avoider that remembers shows no claim, and verify agrees with it."""

from __future__ import annotations

from pathlib import Path

import pytest

from safety_harness.campaign.ledger import Ledger
from safety_harness.campaign.session import LEDGER, carry_on, processes
from safety_harness.certification import verify_report
from safety_harness.certification.evidence import ClaimStatus
from safety_harness.certification.folder import PAGE, write_folder, write_manifest
from safety_harness.certification.gather import gather
from safety_harness.certification.verify import verify
from tests.admission.remembering import TEXT as MINE
from tests.campaign.plans import PLAN, plan_in

SMALL = PLAN.replace("runs: 30", "runs: 10").replace("runs: 20", "runs: 6")
WHY = "the avoider remembers earlier questions: episodes are not independent, no bound is stated"


def test_no_claim_is_shown_and_the_report_says_why(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "mine.py").write_text(MINE)
    plan, report = plan_in(tmp_path, SMALL.replace("opposite pose", "mine.py:Counts")), tmp_path / "report"
    assert carry_on(plan, report / LEDGER, processes(1))
    with Ledger.open(report / LEDGER) as ledger:
        gathered = gather(plan, ledger, report, command="safety-harness certify plan.yaml")
        evidence = write_folder(report, gathered, ledger)
    write_manifest(report, evidence.files)
    assert evidence.standing is ClaimStatus.NOT_SHOWN
    for claim in evidence.claims:
        assert claim.standing is ClaimStatus.NOT_SHOWN
        assert WHY in claim.why
        assert all(one.bound is None and not one.quantiles for one in claim.outcomes)
    assert any("answers differ" in found.text and found.place == "strata" for found in evidence.findings)
    page = (report / PAGE).read_text()
    assert WHY in page
    monkeypatch.setattr(verify_report, "render", lambda *_: page)
    checks = list(verify(report, runs=0))
    assert [fault for check in checks for fault in check.faults] == []
    with Ledger.open(report / LEDGER, write=True) as ledger, ledger.transaction():
        ledger.connection.execute("UPDATE repeated SET differing = 0, words = ''")
    write_manifest(report, evidence.files)
    faults = [fault for check in verify(report, runs=0) for fault in check.faults]
    assert any("bound" in fault or "standing" in fault for fault in faults)
