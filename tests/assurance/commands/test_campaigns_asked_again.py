"""Campaigns notice an avoider that is no function of its question."""

from __future__ import annotations

from pathlib import Path

import pytest

from safety_harness.base.exceptions import StatisticsError
from safety_harness.cli.console import AS_EXPECTED, DIFFERS
from safety_harness.extensions.assurance.campaign.ledger import Ledger
from safety_harness.extensions.assurance.commands.campaign import merge, resume, status
from safety_harness.extensions.assurance.commands.campaign import run as run_campaign
from tests.admission.remembering import NO_FUNCTIONS
from tests.assurance.campaign.plans import PLAN
from tests.whole.test_asking_again import in_a_folder_with_files

SMALL = (
    PLAN.replace("runs: 30", "runs: 4")
    .replace("runs: 20", "runs: 2")
    .replace("    violated in at most: 50 %\n", "")  # which so few cannot show
)
REFUSAL = "episodes are not independent, no bound is stated"


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    return in_a_folder_with_files(tmp_path, monkeypatch)


def test_a_campaign_of_it_states_its_bounds_and_says_so(capsys: pytest.CaptureFixture[str]) -> None:
    Path("plan.yaml").write_text(SMALL.replace("opposite pose", "mine.py:Rounds"))
    file = Path("ledger.sqlite")
    assert run_campaign(Path("plan.yaml"), ledger=file, workers=1) == AS_EXPECTED
    shown = capsys.readouterr().out
    assert "hold together" in shown
    assert "rounds otherwise" in shown
    with Ledger.open(file) as ledger:
        assert ledger.repeated.words
        assert not ledger.dependent


@pytest.mark.parametrize(
    "name",
    # Those of which one more is noticed alike, each of them by ``run``: tests/cli/test_asking_again.py
    [pytest.param(one, marks=[pytest.mark.long] * (one in ("Averages", "Clocked"))) for one in NO_FUNCTIONS],
)
def test_a_campaign_with_it_states_no_bound(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    Path("plan.yaml").write_text(SMALL.replace("opposite pose", f"mine.py:{name}"))
    file = Path("ledger.sqlite")
    assert run_campaign(Path("plan.yaml"), ledger=file, workers=1) == DIFFERS
    assert status(file) == AS_EXPECTED
    shown = capsys.readouterr().out
    assert REFUSAL in shown
    assert "hold together" not in shown
    with Ledger.open(file) as ledger:
        assert ledger.repeated.differing > 0
        with pytest.raises(StatisticsError, match=REFUSAL):
            ledger.sample("near", ledger.declared.claims[0])
    assert resume(file) == DIFFERS  # nothing is left to run, and it is not forgotten


def test_a_campaign_with_a_function_says_how_often_it_was_asked(capsys: pytest.CaptureFixture[str]) -> None:
    Path("plan.yaml").write_text(SMALL.replace("opposite pose", "mine.py:Pure"))
    assert run_campaign(Path("plan.yaml"), ledger=Path("ledger.sqlite"), workers=1) == AS_EXPECTED
    shown = capsys.readouterr().out
    assert "hold together" in shown
    assert "of a second avoider in a process of its own" in shown


def test_what_one_part_of_a_campaign_shows_of_the_avoider_the_whole_remembers(
    capsys: pytest.CaptureFixture[str],
) -> None:
    Path("plan.yaml").write_text(SMALL.replace("opposite pose", "mine.py:Pure"))
    parts = [Path("one.sqlite"), Path("two.sqlite")]
    for k, file in enumerate(parts, start=1):
        run_campaign(Path("plan.yaml"), ledger=file, workers=1, part=f"{k}/2")
    with Ledger.open(parts[0], write=True) as ledger, ledger.transaction():
        ledger.connection.execute("UPDATE repeated SET differing = 1, words = 'it differs'")
    assert merge(Path("whole.sqlite"), parts) == AS_EXPECTED
    assert REFUSAL in capsys.readouterr().out
