"""Another library measures the same hand distances on a user's arm."""

from __future__ import annotations

import pytest

from safety_harness.cell.simulation.worlds import KINEMATIC
from safety_harness.extensions.selftest.geometry import Kept, PyBulletArm, hand_distance_kept
from safety_harness.trace.trace import Trace
from tests.cell.simulation.test_own_robots_run import in_both_worlds


@pytest.fixture(scope="module")
def panda() -> dict[str, Trace]:
    return in_both_worlds("panda")


def test_another_librarys_geometry_says_the_same_of_the_hand_distance(panda: dict[str, Trace]) -> None:
    trace = panda[KINEMATIC.name]
    least_m = float(trace.ticks["hand_distance_m"].min())
    assert hand_distance_kept(trace, least_m - 0.03) is Kept.PROVEN
    assert hand_distance_kept(trace, least_m + 0.005) is Kept.REFUTED
    with PyBulletArm(trace) as cell:
        for tick in trace.ticks[::100]:
            assert cell.distance_m(tick) == pytest.approx(float(tick["hand_distance_m"].min()), abs=2e-4)
