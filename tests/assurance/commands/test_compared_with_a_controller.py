"""campaign compare runs a plan with a reference."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.cli.test_own_controller import MINE, PLAN, SPACE, VISIT, command

HURRIED = """

class Hurried(StopAndGo):
    def act(self, seen):
        return Move(tcp_velocity_mps=0.5 * (self.target_in_base_m - seen.tcp_position_in_base_m))
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """With two classes, a scenario, a space and a plan of the hurried one."""
    folder = tmp_path_factory.mktemp("controllers-against")
    plan = PLAN.replace("StopAndGo", "Hurried").replace("runs: 8", "runs: 4")
    texts = {"mine.py": MINE + HURRIED, "visit.yaml": VISIT, "space.yaml": SPACE, "plan.yaml": plan}
    for name, text in texts.items():
        (folder / name).write_text(text)
    return folder


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
    assert "finds nothing" in refused.output
