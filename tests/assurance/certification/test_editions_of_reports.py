"""A report of edition 1, in which people came at 1.6 m/s, stands; a delta to edition 2 names both claims."""

from __future__ import annotations

import tarfile
from pathlib import Path

import pytest

from safety_harness.cli.console import AS_EXPECTED, DIFFERS
from safety_harness.extensions.assurance.campaign.identity import edition_of
from safety_harness.extensions.assurance.campaign.ledger import Ledger
from safety_harness.extensions.assurance.campaign.session import LEDGER
from safety_harness.extensions.assurance.certification.delta import EarlierReport, delta_of
from safety_harness.extensions.assurance.certification.evidence import read_evidence
from safety_harness.extensions.assurance.certification.folder import JSON
from safety_harness.extensions.assurance.commands.certify import certify, verify
from safety_harness.scenario.model import EDITION

REVISION = "dbfdc93f"


@pytest.fixture(scope="module")
def earlier(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Eight runs of 26 November 2026: a hand stands still where 1.6 m/s leaves room, and 2 m/s does not."""
    folder = tmp_path_factory.mktemp("edition")
    with tarfile.open(Path(__file__).with_name("earlier") / f"{REVISION}.tar.xz") as packed:
        packed.extractall(folder, filter="data")
    return folder / REVISION


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
    assert "its claims have edition 1: a hand without a stated speed comes at 1.6 m/s" in said


def test_a_delta_names_the_speed_of_the_earlier_claim_and_calls_nothing_worse(earlier: Path) -> None:
    """The same runs violate the claim of today: that is another claim, which was never shown."""
    now = earlier.with_name("now")
    assert certify(earlier / "plan" / "plan.yaml", out=now, workers=1) == DIFFERS
    (claim,) = read_evidence(now / JSON).claims
    assert claim.outcomes[0].violated == 8
    found = delta_of(EarlierReport.read(earlier), EarlierReport.read(now))
    before = {one.sentence for one in found.claims if one.before is not None}
    after = {one.sentence for one in found.claims if one.after is not None}
    assert before == {"protective separation kept at 1.6 m/s"}
    assert after == {"protective separation kept"}
    assert not any(one.worse for one in found.bounds)
