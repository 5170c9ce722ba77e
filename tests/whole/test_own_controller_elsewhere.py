"""A controller of one's own in campaigns, certificates and the self-test."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest

from safety_harness.admission import repeatability
from safety_harness.extensions.assurance.certification import whose_fault
from tests.whole.test_own_controller import (
    MINE_AS_OPTION,
    PLAN,
    VISIT,
    command,
    search_little_in,
    with_files,
    words_of,
)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return with_files(tmp_path_factory.mktemp("own-controller"))


@pytest.fixture(autouse=True)
def _there(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    search_little_in(folder, monkeypatch)
    for module, least in ((whose_fault, "MOST"), (repeatability, "LEAST_RUNS")):
        monkeypatch.setattr(module, least, 1)  # each begins a process


@pytest.fixture(scope="module")
def ledgers(folder: Path) -> tuple[str, str]:
    """Two campaigns over the same episodes, with another controller each."""
    (folder / "other.yaml").write_text(PLAN.replace("mine.py:StopAndGo", "stop when near"))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(repeatability, "LEAST_RUNS", 1)
        for name in ("plan", "other"):
            ledger = folder / f"{name}.sqlite"
            plan = str(folder / f"{name}.yaml")
            found = command("campaign", "run", plan, "--ledger", str(ledger), "--workers", "1")
            assert found.exit_code == 0, found.output
    return "plan.sqlite", "other.sqlite"


def test_selftest_says_which_faults_do_not_apply(folder: Path) -> None:
    (folder / "scenarios" / "visit.yaml").write_text(VISIT.replace("mine.py", "../mine.py"))
    options = ("--scenarios", "scenarios", "--jobs", "1", "--out", "trial", *MINE_AS_OPTION)
    for fault, applies in (("overspeed", True), ("sign flip", False)):
        found = command("selftest", *options, "--fault", fault)
        assert "no avoider and no gate" in found.output
        assert ("does not apply" in found.output) is not applies, found.output
        assert found.exit_code == (0 if applies else 1)


def test_campaign_and_compare(ledgers: tuple[str, str]) -> None:
    status = command("campaign", "status", ledgers[0])
    assert status.exit_code == 0
    assert "8/8" in status.output
    assert "avoider" not in status.output
    compared = command("campaign", "compare", *ledgers)
    assert compared.exit_code == 0, compared.output
    assert "overruled" not in compared.output


def test_certify_and_verify(folder: Path) -> None:
    made = command("certify", "plan.yaml", "--out", "report", "--workers", "1")
    assert made.exit_code in (0, 1), made.output
    said = words_of(folder / "report" / "evidence.html")
    assert not re.findall(r".{40}avoider.{40}", said), re.findall(r".{40}avoider.{40}", said)
    found = json.loads((folder / "report" / "evidence.json").read_text())
    assert [one["controller"]["name"] for one in found["system"]["under_test"]] == ["mine.py:StopAndGo"]
    refused = command("verify", "report", "--runs", "1")
    assert refused.exit_code == 2
    assert "mine.py:StopAndGo" in refused.output
    stands = command("verify", "report", "--runs", "1", "--execute-programs")
    assert stands.exit_code == 0, stands.output


def test_a_campaign_in_which_nothing_could_be_run_tested_nothing() -> None:
    Path("raises.yaml").write_text(PLAN.replace("StopAndGo", "NotANumber"))
    found = command("campaign", "run", "raises.yaml", "--ledger", "raises.sqlite", "--workers", "1")
    assert "violated in 0 of 0 tested, 8 could not be run" in found.output, found.output
    assert "(0 runs tested it, 8 could not be run" in found.output
    assert "the controller ended no run that could be driven again" in found.output
