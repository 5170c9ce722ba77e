"""Another library measures the same hand distances on a user's arm."""

from __future__ import annotations

from dataclasses import replace

import pytest

from safety_harness import read_scenario, run_trial
from safety_harness.admission.admit import admit
from safety_harness.base.shipped.contents import located
from safety_harness.cell.simulation.worlds import KINEMATIC, PYBULLET
from safety_harness.extensions.selftest.geometry import Kept, PyBulletArm, hand_distance_kept
from safety_harness.scenario.model import Scenario
from safety_harness.trace.trace import Trace


def shipped(name: str) -> Scenario:
    return replace(read_scenario(located(f"shipped:robot-{name}")), duration_s=4.0)


@pytest.fixture(scope="module")
def panda() -> dict[str, Trace]:
    admitted = admit(shipped("panda"))
    return {world.name: run_trial(admitted, world=world) for world in (PYBULLET, KINEMATIC)}


def test_another_librarys_geometry_says_the_same_of_the_hand_distance(panda: dict[str, Trace]) -> None:
    trace = panda[KINEMATIC.name]
    least_m = float(trace.ticks["hand_distance_m"].min())
    assert hand_distance_kept(trace, least_m - 0.03) is Kept.PROVEN
    assert hand_distance_kept(trace, least_m + 0.005) is Kept.REFUTED
    with PyBulletArm(trace) as cell:
        for tick in trace.ticks[::100]:
            assert cell.distance_m(tick) == pytest.approx(float(tick["hand_distance_m"].min()), abs=2e-4)
