"""A report of edition 1, in which people came at 1.6 m/s, stands; a delta to edition 2 names both claims."""

from __future__ import annotations

from pathlib import Path

import pytest

from safety_harness.campaign.episodes import EpisodeRunner
from safety_harness.campaign.identity import edition_of
from safety_harness.campaign.ledger import Ledger
from safety_harness.campaign.plan import read_plan
from safety_harness.campaign.session import LEDGER
from safety_harness.certification.delta import EarlierReport, delta_of
from safety_harness.certification.evidence import read_evidence
from safety_harness.certification.folder import JSON, write_folder, write_manifest
from safety_harness.certification.gather import gather
from safety_harness.cli.certify import certify, verify
from safety_harness.cli.console import AS_EXPECTED, DIFFERS
from safety_harness.scenario.model import EDITION
from tests.certification.forging import other_software

SPACE = """\
scenario space: a hand that stands still where 1.6 m/s leaves room and 2 m/s does not
duration: 200 ms
avoider: opposite pose
tcp start:
  offset: [0 mm, from -40 mm to 0 mm, 20 mm]
hands:
  - hand: right hand
    starts at: [700 mm, from -985 mm to -965 mm, 400 mm]
    elbow towards: [700 mm, -1900 mm, 500 mm]
    moves:
      - wait: 1 s
claims:
  protective separation kept: holds
"""
PLAN = """\
plan: a hand that stands still
world: kinematic
seed: 4
strata:
  - stratum: beside
    space: still.yaml
    runs: 8
claims:
  - claim: protective separation kept
    violated in at most: 50 %
keep:
  random traces: 0
  violations: 0
"""


@pytest.fixture(scope="module")
def earlier(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What a program of edition 1 writes: no edition in the identity, and another source."""
    folder = tmp_path_factory.mktemp("edition")
    (folder / "still.yaml").write_text(SPACE)
    (folder / "plan.yaml").write_text(PLAN)
    report = folder / "earlier"
    plan = read_plan(folder / "plan.yaml", 1)
    report.mkdir()
    with Ledger.create(report / LEDGER, plan) as ledger:
        ledger.record(EpisodeRunner(plan).run(0, range(8)))
        gathered = gather(plan, ledger, report, command="safety-harness certify plan.yaml")
        evidence = write_folder(report, gathered, ledger)
    write_manifest(report, evidence.files)
    other_software(report, "the source of this package")
    return report


def test_what_edition_1_showed_stands_and_is_read_in_edition_1(
    earlier: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """All runs are made again: at 2 m/s none of them would hold."""
    (claim,) = read_evidence(earlier / JSON).claims
    assert (claim.sentence, claim.outcomes[0].holds) == ("protective separation kept", 8)
    with Ledger.open(earlier / LEDGER, alone=True) as ledger:
        assert edition_of(ledger.declared.identity) == 1 < EDITION
    assert verify(earlier, runs=8, seed=1) == AS_EXPECTED
    said = capsys.readouterr().out
    assert "DIFF" not in said
    assert "its claims are read in edition 1: hands come at 1.6 m/s where none is named" in said


def test_a_delta_names_the_speed_of_the_earlier_claim_and_calls_nothing_worse(earlier: Path) -> None:
    """The same runs violate the claim of today: that is another claim, which was never shown."""
    now = earlier.with_name("now")
    assert certify(earlier.with_name("plan.yaml"), out=now, workers=1) == DIFFERS
    (claim,) = read_evidence(now / JSON).claims
    assert claim.outcomes[0].violated == 8
    found = delta_of(EarlierReport.read(earlier), EarlierReport.read(now))
    before = {one.sentence for one in found.claims if one.before is not None}
    after = {one.sentence for one in found.claims if one.after is not None}
    assert before == {"protective separation kept at 1.6 m/s"}
    assert after == {"protective separation kept"}
    assert not any(one.worse for one in found.bounds)
