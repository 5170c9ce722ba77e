"""Campaigns where PyBullet is not installed."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from safety_harness.cli.console import BAD_INPUT
from safety_harness.extensions.assurance.campaign.episodes import EpisodeRunner
from safety_harness.extensions.assurance.commands.campaign import run as run_campaign
from tests.assurance.campaign.plans import PLAN, plan_in
from tests.whole.test_without_pybullet import NEEDS, without_pybullet


@pytest.fixture(autouse=True)
def _without_pybullet(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    yield from without_pybullet(monkeypatch)


def test_a_campaign_in_pybullet_is_refused_before_it_has_a_ledger(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    plan = plan_in(tmp_path, PLAN.replace("world: kinematic\n", ""))
    assert run_campaign(plan.file, ledger=tmp_path / "ledger.sqlite") == BAD_INPUT
    assert NEEDS in capsys.readouterr().err
    assert not (tmp_path / "ledger.sqlite").exists()


def test_a_campaign_in_the_kinematic_world_needs_none(tmp_path: Path) -> None:
    rows = list(EpisodeRunner(plan_in(tmp_path)).run(0, range(2)))
    assert len(rows) == 2
    assert not any(row.failure for row in rows)
