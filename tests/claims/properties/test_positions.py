"""The opposite pose by hand, what a position has to spare, and the way of a stop."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import own_oracles as own
import pytest
from broken import TOO_FAR
from examples import VISIT, ConstantSpeed, run, scenario

from safety_harness.claims.properties.positions import (
    gone_towards,
    opposite_position,
    reach_m,
    spare_m,
    stopped_m,
)
from safety_harness.trace.records import Mode
from safety_harness.trace.trace import Trace


def tcp(trace: Trace, number: int = 0) -> np.ndarray:
    return trace.ticks["transform_tcp_to_base"][trace.decisions["tick"][number], :3, 3]


def test_the_opposite_pose_lies_on_the_line_from_the_hand_through_the_tcp(visit: Trace) -> None:
    decision = visit.decisions[0]
    tick = visit.ticks[decision["tick"]]
    hand = tick["predicted_hand_in_base_m"][tick["track_valid"]][0]
    opposite = opposite_position(visit, decision)
    assert np.linalg.norm(opposite - tcp(visit)) == pytest.approx(0.1, abs=1e-12)
    assert np.linalg.norm(opposite - hand) == pytest.approx(np.linalg.norm(tcp(visit) - hand) + 0.1)
    assert opposite == pytest.approx(decision["opposite_position_in_base_m"], abs=1e-12)


def test_where_the_hand_is_at_the_tcp_there_is_no_opposite_pose(visit: Trace) -> None:
    ticks = visit.ticks.copy()
    ticks["predicted_hand_in_base_m"] = ticks["transform_tcp_to_base"][:, None, :3, 3]
    assert np.isnan(opposite_position(replace(visit, ticks=ticks), visit.decisions[0])).all()


def test_a_position_away_from_the_hand_has_something_to_spare_and_others_lack_it(visit: Trace) -> None:
    decision = visit.decisions[0]
    away = opposite_position(visit, decision) - tcp(visit)

    def spare(by_m: np.ndarray) -> float:
        return spare_m(visit, decision, tcp(visit) + by_m)

    assert spare(away) > 0.05
    assert spare(-away) == pytest.approx(-0.1, abs=1e-9)  # all of it towards the hand
    assert spare(20.0 * away) < -0.5  # out of reach
    below = away + [0.0, 0.0, -0.65]
    assert spare(below) < 0.0
    assert spare_m(visit, decision, np.full(3, np.nan)) < 0.0


@pytest.mark.parametrize("direction", [(0.36, 0.86, 0.35), (0.9, 0.06, -0.44)])
def test_a_way_that_can_be_gone_to_its_end_is_never_said_to_be_too_long(
    visit: Trace, direction: tuple[float, float, float]
) -> None:
    """Newton's method follows the way to the singularity; a search by halves stops up to 0.1 mm before."""
    decision, unit = visit.decisions[0], np.array(direction) / np.linalg.norm(direction)
    joints_rad = visit.ticks["joint_position_rad"][decision["tick"]]
    reach = own.way_gone(visit, joints_rad, unit)[0]
    assert 0.3 < reach < 1.0
    for short_m in (1e-6, 1e-5, 2e-5, 4e-5):
        assert reach_m(visit, decision, tcp(visit) + (reach - short_m) * unit) >= 0.0
        assert reach_m(visit, decision, tcp(visit) + (reach + short_m) * unit) < 0.0


def test_a_repulsion_keeps_up_on_its_own_way_and_not_on_another(visit: Trace) -> None:
    there = opposite_position(visit, visit.decisions[0])
    towards = gone_towards(visit, 0, there, 0)
    backwards = gone_towards(visit, 0, 2.0 * tcp(visit) - there, 0)
    assert towards is not None
    assert backwards is not None
    assert backwards.margin_m < -0.03 < 0.0 < towards.margin_m
    assert gone_towards(visit, 0, there, 2000) is None


def test_a_protective_stop_is_one_and_going_on_is_none(visit: Trace) -> None:
    stopped = run(scenario(VISIT, settings=TOO_FAR))
    begun = int(np.argmax(stopped.ticks["mode"] == Mode.PROTECTIVE_STOP))
    assert 0.0 <= stopped_m(stopped, begun) < 0.01
    assert stopped_m(visit, int(visit.decisions["tick"][0])) < -0.02


def test_the_way_of_an_arm_that_does_not_stop_is_computed_by_hand() -> None:
    going = run(scenario(duration_s=1.0), controller=ConstantSpeed((0.2, 0.0, 0.0, 0.0, 0.0, 0.0)))
    speed_mps = float(going.ticks["tcp_speed_mps"][20])
    stop_s = 0.35 + 0.1 * speed_mps
    ticks = np.ceil((0.1 + stop_s) / 0.008) + 3
    expected = speed_mps * (0.1 + 0.5 * stop_s + 0.008) + 0.002 - speed_mps * 0.008 * ticks
    assert stopped_m(going, 20) == pytest.approx(expected, abs=1e-3)
