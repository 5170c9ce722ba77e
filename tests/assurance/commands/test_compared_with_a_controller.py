"""campaign compare runs a plan with a reference."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.whole.test_controllers_against import with_both
from tests.whole.test_own_controller import command


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return with_both(tmp_path_factory.mktemp("controllers-against"))


@pytest.fixture(autouse=True)
def _there(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(folder)


def test_campaign_compare_runs_the_plan_with_the_reference_first() -> None:
    assert command("campaign", "run", "plan.yaml", "--ledger", "mine.sqlite", "--workers", "1").exit_code == 0
    found = command("campaign", "compare", "mine.sqlite", "--against", "mine.py:StopAndGo", "--workers", "1")
    assert found.exit_code == 0, found.output
    assert "controller: " in Path("mine-against-mine-py-stopandgo/plan.yaml").read_text()
    refused = command("campaign", "compare", "mine.sqlite", "--against", "mine.py:Hurried", "--workers", "1")
    assert refused.exit_code == 2
    assert "comparison" in refused.output
    assert "a comparison with itself" in refused.output
