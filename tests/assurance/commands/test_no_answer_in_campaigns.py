"""Campaigns and certificates of an avoider that never answers."""

from __future__ import annotations

from pathlib import Path

import pytest

from safety_harness.cli.console import AS_EXPECTED, DIFFERS
from safety_harness.extensions.assurance.certification.evidence import ClaimStatus, read_evidence
from safety_harness.extensions.assurance.commands import campaign
from safety_harness.extensions.assurance.commands.certify import certify, verify
from tests.assurance.campaign.plans import plan_in
from tests.cli.test_own_avoider import VISIT
from tests.whole.test_avoiders_that_never_answer import IN_PLACE, LISTING, RAISING

PLAN = """\
plan: a hand nearby
avoider: mine.py:Mine
world: {world}
strata:
  - stratum: near
    space: short.yaml
    runs: 8
claims:
  - claim: joint speeds within limits
    violated in at most: 50 %
{claims}keep:
  random traces: 1
"""


@pytest.fixture(autouse=True)
def _here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


@pytest.fixture(
    params=[RAISING, pytest.param(LISTING, marks=pytest.mark.long)], ids=["raises", "returns a list"]
)
def visit(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    (tmp_path / "mine.py").write_text(request.param)
    file = tmp_path / "visit.yaml"
    file.write_text(VISIT)
    return file


def test_a_campaign_says_it_above_its_bounds_and_ends_with_1(
    visit: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    plan_in(tmp_path, PLAN.format(world="kinematic", claims=""))
    assert campaign.run(Path("plan.yaml"), ledger=Path("ledger.sqlite"), workers=1) == DIFFERS
    assert campaign.status(Path("ledger.sqlite")) == AS_EXPECTED
    out = capsys.readouterr().out
    (bounds,) = {line for line in out.splitlines() if line.startswith("how often a run")}
    assert IN_PLACE in bounds
    assert "in 8 of 8 episodes" in out


def test_a_certificate_is_never_green_for_an_avoider_that_did_not_answer(
    visit: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    plan_in(tmp_path, PLAN.format(world="PyBullet", claims=""))
    assert certify(Path("plan.yaml"), out=Path("report"), workers=1) == DIFFERS
    out = capsys.readouterr().out
    assert "NO  " not in out
    assert "ok  " not in out
    assert out.count(IN_PLACE) == 2  # at the claim and at the end
    evidence = read_evidence(Path("report/evidence.json"))
    assert evidence.standing is ClaimStatus.DOUBTED
    page = Path("report/evidence.html").read_text()
    assert IN_PLACE in page.split("<title>")[1].split("</title>")[0]
    assert IN_PLACE in page.split("<h1>")[1].split("</h1>")[0]
    assert 'class="banner fine"' not in page
    assert "Shown with doubt" in page
    assert "<failure" in (junit := Path("report/junit.xml").read_text()) or "<error" in junit
    assert verify(Path("report"), runs=2, seed=1, execute_programs=True) == AS_EXPECTED
