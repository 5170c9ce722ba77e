"""A report of an avoider that remembers shows no claim, and verify agrees with it."""

from __future__ import annotations

from pathlib import Path

import pytest

from safety_harness.extensions.assurance.campaign.ledger import Ledger
from safety_harness.extensions.assurance.campaign.plan import Plan
from safety_harness.extensions.assurance.campaign.session import LEDGER, processes, run_missing
from safety_harness.extensions.assurance.certification import verify_report, whose_fault
from safety_harness.extensions.assurance.certification.evidence import ClaimStatus
from safety_harness.extensions.assurance.certification.folder import PAGE, write_folder, write_manifest
from safety_harness.extensions.assurance.certification.gather import gather
from safety_harness.extensions.assurance.certification.verify import verify
from safety_harness.extensions.attribution.search_attribution import SearchAttribution
from safety_harness.search.counterexample import Explanation
from tests.admission.remembering import TEXT as MINE
from tests.assurance.campaign.plans import PLAN, plan_in

SMALL = PLAN.replace("runs: 30", "runs: 6").replace("runs: 20", "runs: 4")
WHY = "the avoider remembers earlier questions: episodes are not independent, no bound is stated"


RAISES = """
class Raises:
    name = "raises"

    def propose(self, *, hand_position_in_base_m, tcp_position_in_base_m, seed):
        if seed % 2:
            raise ValueError("odd")
        from safety_harness import Proposal

        return Proposal(position_in_base_m=tcp_position_in_base_m + [-0.02, 0.07, 0.07])
"""


@pytest.fixture(autouse=True)
def _no_causes(monkeypatch: pytest.MonkeyPatch) -> None:
    """The causes of violations take longer than all else here."""
    monkeypatch.setattr(whose_fault, "attribute", lambda *_: ())
    monkeypatch.setattr(SearchAttribution, "explain", lambda *_: Explanation())


def reported(plan: Plan, report: Path) -> str:
    """The page of the report that certify makes of the ledger as it is now."""
    with Ledger.open(report / LEDGER) as ledger:
        gathered = gather(plan, ledger, report, command="safety-harness certify plan.yaml")
        evidence = write_folder(report, gathered, ledger)
    write_manifest(report, evidence.files)
    return (report / PAGE).read_text()


@pytest.mark.parametrize(
    ("program", "avoider", "forgery", "said"),
    [
        (MINE, "Counts", "UPDATE repeated SET differing = 0, words = ''", "the ledger does not say so"),
        (
            RAISES,
            "Raises",
            "UPDATE episode SET faults = 0, mishap = NULL",
            "0 questions without an answer then",
        ),
    ],
    ids=["remembers", "raises"],
)
def test_what_a_forger_makes_of_a_program_does_not_come_out_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, program: str, avoider: str, forgery: str, said: str
) -> None:
    (tmp_path / "mine.py").write_text(program)
    plan, report = (
        plan_in(tmp_path, SMALL.replace("opposite pose", f"mine.py:{avoider}")),
        tmp_path / "report",
    )
    assert run_missing(plan, report / LEDGER, processes(1))
    for statement in (None, forgery):
        if statement is not None:
            with Ledger.open(report / LEDGER, write=True) as ledger, ledger.transaction():
                ledger.connection.execute(statement)
        page = reported(plan, report)
        monkeypatch.setattr(verify_report, "render", lambda *_, page=page: page)
        checks = list(verify(report, runs=3, execute_programs=True))
        found = [fault for check in checks for fault in check.faults]
        assert any(said in fault for fault in found) == (statement is not None), found


def test_no_claim_is_shown_and_the_report_says_why(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "mine.py").write_text(MINE)
    plan, report = plan_in(tmp_path, SMALL.replace("opposite pose", "mine.py:Counts")), tmp_path / "report"
    assert run_missing(plan, report / LEDGER, processes(1))
    with Ledger.open(report / LEDGER) as ledger:
        gathered = gather(plan, ledger, report, command="safety-harness certify plan.yaml")
        evidence = write_folder(report, gathered, ledger)
    write_manifest(report, evidence.files)
    assert evidence.standing is ClaimStatus.NOT_SHOWN
    assert not evidence.unmade
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
