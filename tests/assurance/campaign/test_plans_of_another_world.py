"""A plan runs in any world of the table, and its bounds are of the model."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from safety_harness.base.exceptions import ScenarioError
from safety_harness.cell.simulation.worlds import WORLDS, WorldEntry
from safety_harness.extensions.assurance.campaign.episodes import EpisodeRunner
from safety_harness.extensions.assurance.certification.credibility import credibility_of
from safety_harness.extensions.assurance.certification.stored import random_traces
from safety_harness.extensions.assurance.certification.tools import NO_TRIALS
from tests.assurance.campaign.plans import PLAN, ledger_in, plan_in
from tests.cell.simulation.test_worlds import HALF


@pytest.fixture
def half() -> Iterator[WorldEntry]:
    WORLDS.append(HALF)
    yield HALF
    WORLDS.remove(HALF)


def test_another_world_runs_a_plan_whose_bounds_are_of_the_model(half: WorldEntry, tmp_path: Path) -> None:
    plan = plan_in(tmp_path, PLAN.replace("world: kinematic", "world: half speed").replace("30", "2"))
    assert plan.world is half
    rows = list(EpisodeRunner(plan).run(0, range(2)))
    assert not any(row.failure for row in rows)
    assert sum(row.trace is not None for row in rows) == 2
    with ledger_in(tmp_path, plan) as ledger:
        ledger.record(rows)
        declaration = ledger.sample("near", plan.claims[0].sentence).declaration
        assert declaration.world is half
        assert declaration.model_only
        stored, damaged = random_traces(plan, ledger)
        assert not damaged
        again = credibility_of(stored, NO_TRIALS).reruns
    assert [one.title for one in again] == [f"These runs in {world}" for world in WORLDS if world is not half]
    assert again[0].how == "in PyBullet in place of the half speed world"


def test_a_plan_names_a_world_of_the_table(tmp_path: Path) -> None:
    with pytest.raises(ScenarioError, match=f"{WORLDS[-1].label}, or a simulator.*got half speed"):
        plan_in(tmp_path, PLAN.replace("world: kinematic", "world: half speed"))
