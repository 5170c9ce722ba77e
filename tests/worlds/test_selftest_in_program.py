"""``selftest`` in the user's own simulator: faults of our parts are caught there as in our own world."""

from __future__ import annotations

import json
import shutil
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from safety_harness.cli.console import AS_EXPECTED, BAD_INPUT
from safety_harness.extensions.selftest.commands import selftest
from safety_harness.extensions.selftest.session import DATA, PAGE
from safety_harness.extensions.worlds.program import simulator

ROOT = Path(__file__).parents[2]
SIMULATOR = f"exec:{sys.executable} {ROOT / 'examples' / 'worlds' / 'kinematic_cell.py'}"


@pytest.fixture(autouse=True)
def _processes_end() -> Iterator[None]:
    yield
    simulator.cache_clear()


@pytest.fixture
def scenarios(tmp_path: Path) -> Path:
    folder = tmp_path / "scenarios"
    folder.mkdir()
    shutil.copy(ROOT / "scenarios" / "network-certain.yaml", folder)
    return folder


@pytest.mark.parametrize("fault", ["overspeed", "threshold ignored"])
def test_a_fault_is_caught_in_a_simulator_by_the_claim_of_our_own_world(
    scenarios: Path, tmp_path: Path, fault: str
) -> None:
    found = []
    for world in ("kinematic", SIMULATOR):
        assert selftest(scenarios=scenarios, fault=fault, out=tmp_path, jobs=1, world=world) == AS_EXPECTED
        document = json.loads((tmp_path / DATA).read_text())
        assert document["about"]["world"] == world
        found.append(
            [(one["caught_by"], one["slightest_caught"], one["confirmed_in"]) for one in document["faults"]]
        )
    assert found[0] == found[1]
    assert found[0][0][2] == ["PyBullet"]
    assert "the simulator exec:" in (tmp_path / PAGE).read_text()


def test_a_world_that_is_not_there_is_refused(scenarios: Path, tmp_path: Path) -> None:
    assert selftest(scenarios=scenarios, out=tmp_path, world="exec:./no-such-cell") == BAD_INPUT
