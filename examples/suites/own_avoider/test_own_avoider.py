"""A suite for an avoider of one's own: its file beside the tests, the scenarios name it.

pytest examples/suites/own_avoider
"""

from __future__ import annotations

import numpy as np
from avoider import LIFT_M, STEP_M, Sidestep
from hypothesis import given
from hypothesis import strategies as st

from safety_harness import Scenario
from safety_harness.testing import Simulate, assert_holds, hand_distance, mm, scenarios, servoing, whenever

COORDINATE = st.floats(-1.0, 1.0)


@given(st.tuples(COORDINATE, COORDINATE, COORDINATE), st.tuples(COORDINATE, COORDINATE, COORDINATE))
def test_the_step_has_its_length_whatever_the_question(
    hand: tuple[float, ...], tcp: tuple[float, ...]
) -> None:
    asked = {"hand_position_in_base_m": np.array(hand), "tcp_position_in_base_m": np.array(tcp)}
    step = Sidestep().propose(**asked, seed=0).position_in_base_m - asked["tcp_position_in_base_m"]
    np.testing.assert_allclose(np.hypot(*step[:2]), STEP_M)
    np.testing.assert_allclose(step[2], LIFT_M)


@given(scenario=scenarios("visits.yaml"))
def test_keeps_its_distance(scenario: Scenario, simulate: Simulate) -> None:
    trace = simulate(scenario)
    assert_holds(hand_distance() > mm(50), trace)
    assert_holds(whenever(~servoing()).then(hand_distance() > mm(50)), trace)
