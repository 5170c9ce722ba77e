"""The table of worlds: what its entries say is so, and one more is an entry and a class."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from examples import VISIT, scenario
from numpy.typing import NDArray

from safety_harness.admission.admit import admit
from safety_harness.admission.trial import run_all, run_trial
from safety_harness.base.exceptions import InstallationError, TraceError
from safety_harness.cell.simulation.kinematic_world import KinematicWorld
from safety_harness.cell.simulation.worlds import KINEMATIC, WORLDS, WorldEntry, world_of_trace
from safety_harness.cli.scenario_commands import replay, run
from safety_harness.search.trials import InWorld, Trials
from safety_harness.trace.store import save_trace
from tests.search.short_space import SHORT

SHORT_SCENARIO = """\
scenario: no hand at all
duration: 100 ms
avoider: opposite pose
tcp start:
  offset: [0 mm, -20 mm, 20 mm]
claims:
  joint speeds within limits: holds
"""
POINTS = np.array([[0.5, 0.2, 0.05], [0.5, 0.2, 0.95]])  # a slow hand and a fast one


class HalfWorld(KinematicWorld):
    """Joints turn at half of what they are told."""

    name = "half"

    def step(self, command: NDArray[np.void]) -> bool:
        less = command.copy()
        less["joint_velocity_radps"] *= 0.5
        return super().step(less)


HALF = WorldEntry(name="half", label="half speed", load=lambda: HalfWorld, model_only=True)


@pytest.fixture
def half() -> Iterator[WorldEntry]:
    WORLDS.append(HALF)
    yield HALF
    WORLDS.remove(HALF)


def test_each_class_is_what_its_entry_says() -> None:
    for world in WORLDS:
        opener = world.opener()
        assert (opener.name, opener.renders) == (world.name, world.renders)  # type: ignore[attr-defined]
        assert world_of_trace(world.name) is world


def test_another_world_runs_a_trial_and_repeats_it(half: WorldEntry, tmp_path: Path) -> None:
    admitted = admit(scenario(duration_s=0.4))
    trace = run_trial(admitted, world=half)
    assert trace.provenance.world == "half"
    turned = [
        np.abs(np.diff(one.ticks["joint_position_rad"], axis=0))[1].max()
        for one in (trace, run_trial(admitted, world=KINEMATIC))
    ]
    assert turned[0] < 0.75 * turned[1]
    save_trace(trace, tmp_path / "half.trace")
    assert replay(tmp_path / "half.trace") == 0


def test_another_world_is_named_on_the_command_line(half: WorldEntry, tmp_path: Path) -> None:
    (tmp_path / "short.yaml").write_text(SHORT_SCENARIO)
    assert run([tmp_path / "short.yaml"], tmp_path, world="half speed") == 0
    assert '"world": "half"' in (tmp_path / "report.json").read_text()


def test_another_world_is_searched(half: WorldEntry) -> None:
    found = Trials(SHORT, InWorld(half), seed=3)(POINTS, 10)
    assert found.margins[1, 0] < 0.0 < found.margins[0, 0]
    assert (found.margins != Trials(SHORT, InWorld(KINEMATIC), seed=3)(POINTS, 10).margins).any()


def test_a_trace_of_a_world_that_is_not_here_is_refused() -> None:
    with pytest.raises(TraceError, match=f" or {WORLDS[-1].name}"):
        world_of_trace("elsewhere")


def test_a_world_whose_engine_is_missing_says_so_and_harms_no_other() -> None:
    def load() -> type[HalfWorld]:
        raise ModuleNotFoundError("No module named 'bullets'", name="bullets")

    gone = WorldEntry(name="gone", label="Gone", load=load)
    admitted = admit(scenario(VISIT, duration_s=0.1))
    with pytest.raises(InstallationError, match="no module bullets") as error:
        run_trial(admitted, world=gone)
    assert error.value.place.field == "the world Gone"
    with pytest.raises(InstallationError, match="no module bullets"):
        next(run_all([admitted], gone))
    assert not gone.is_installed
