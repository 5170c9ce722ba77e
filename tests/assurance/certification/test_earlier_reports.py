"""Folders and plans of earlier revisions are still read, verified and compared; others say what to do.

``earlier/REVISION.tar.xz`` is a report of twelve runs as ``certify`` of that revision wrote it: of 23
November 2026, before the system was a record and with fewer reasons to overrule, and of 24 November.
"""

from __future__ import annotations

import json
import tarfile
from collections.abc import Callable
from pathlib import Path

import pytest

from safety_harness.base.exceptions import InputError
from safety_harness.cli.console import AS_EXPECTED, DIFFERS
from safety_harness.extensions.assurance.campaign.ledger import Ledger
from safety_harness.extensions.assurance.campaign.plan import read_plan
from safety_harness.extensions.assurance.campaign.summary import root_of
from safety_harness.extensions.assurance.certification.delta import EarlierReport, delta_of
from safety_harness.extensions.assurance.certification.evidence import read_evidence
from safety_harness.extensions.assurance.certification.folder import JSON, sha256_of
from safety_harness.extensions.assurance.commands.certify import verify
from safety_harness.trace.overruling import COUNTS

EARLIER = Path(__file__).with_name("earlier")
REVISIONS = ("c33d30b", "57e81b3")


@pytest.fixture
def report(tmp_path: Path) -> Callable[[str], Path]:
    """The folder of a revision's report, unpacked."""

    def unpacked(revision: str) -> Path:
        with tarfile.open(EARLIER / f"{revision}.tar.xz") as packed:
            packed.extractall(tmp_path, filter="data")
        return tmp_path / revision

    return unpacked


def rewrite(folder: Path, change: Callable[[str], str]) -> None:
    """Change the evidence, and its hash in the manifest."""
    file, manifest = folder / JSON, folder / "manifest.json"
    file.write_text(change(file.read_text()))
    listed = json.loads(manifest.read_text())
    listed["sha256"][JSON] = sha256_of(file)
    manifest.write_text(json.dumps(listed))


@pytest.mark.parametrize("revision", REVISIONS)
def test_an_earlier_report_stands(
    revision: str, report: Callable[[str], Path], capsys: pytest.CaptureFixture[str]
) -> None:
    assert verify(report(revision), runs=0) == AS_EXPECTED
    said = capsys.readouterr().out
    assert "DIFF" not in said
    assert "since the report: the source of this package changed" in said


@pytest.mark.parametrize("revision", REVISIONS)
def test_its_rows_have_the_root_and_its_plan_the_runs_that_they_had_then(
    revision: str, report: Callable[[str], Path]
) -> None:
    folder = report(revision)
    evidence = read_evidence(folder / JSON)
    with Ledger.open(folder / "ledger.sqlite", alone=True) as ledger:
        assert ledger.counts == COUNTS[: len(ledger.counts)]
        assert len(ledger.counts) < len(COUNTS)
        assert root_of(ledger) == evidence.record.rows_sha256
        assert list(ledger.all(f"SELECT sum({COUNTS[-1]}) FROM episode")) == [(0,)]
    plan = read_plan(folder / "plan" / "plan.yaml")
    assert [one.runs for one in plan.strata] == [12]
    assert [one.sentence for one in plan.claims] == [one.sentence for one in evidence.claims]


def test_a_delta_between_two_of_them_names_what_is_another(report: Callable[[str], Path]) -> None:
    found = delta_of(*(EarlierReport.read(report(one)) for one in REVISIONS))
    assert found.regressions == ()
    assert {"software", "system", "results"} <= {one.part for one in found.parts}
    (runs,) = found.carried
    assert not runs.carries
    assert "the source of this package changed" in runs.why


def test_an_earlier_evidence_that_was_edited_does_not_stand(
    report: Callable[[str], Path], capsys: pytest.CaptureFixture[str]
) -> None:
    folder = report(REVISIONS[0])
    rewrite(folder, lambda text: text.replace('"violated": 0', '"violated":  0', 1))
    assert verify(folder, runs=0) == DIFFERS
    assert "certify writes the same content in another form" in capsys.readouterr().out
    rewrite(folder, lambda text: text.replace('"violated":  0', '"violated": 1', 1))
    assert verify(folder, runs=0) == DIFFERS


def test_one_that_cannot_be_read_says_what_to_do(report: Callable[[str], Path]) -> None:
    folder = report(REVISIONS[0])
    rewrite(folder, lambda text: text.replace('"overruling"', '"overruled"'))
    with pytest.raises(InputError, match="overruling") as refused:
        read_evidence(folder / JSON)
    assert (
        "verify it with that version, or certify the plan in the report's folder plan/ anew"
        in refused.value.hint
    )
