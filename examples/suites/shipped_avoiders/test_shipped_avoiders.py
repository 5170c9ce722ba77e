"""What has to hold of every shipped avoider, whatever the hand does within a space of scenarios.

pytest examples/suites/shipped_avoiders --safety-profile nightly
pytest examples/suites/shipped_avoiders --avoider ensemble
"""

from __future__ import annotations

from hypothesis import given

from safety_harness import Scenario
from safety_harness.testing import (
    Simulate,
    assert_holds,
    eventually,
    hand_distance,
    mm,
    mm_per_s,
    ms,
    predicted_hand_distance,
    scenarios,
    servoing,
    tcp_speed,
    whenever,
)

VISITS = scenarios("visits.yaml")


@given(scenario=VISITS)
def test_keeps_its_distance(scenario: Scenario, simulate: Simulate) -> None:
    assert_holds(hand_distance() > mm(50), simulate(scenario))


@given(scenario=VISITS)
def test_moves_slowly_and_only_to_where_it_can_be(scenario: Scenario, simulate: Simulate) -> None:
    trace = simulate(scenario)
    assert_holds(tcp_speed() < mm_per_s(250), trace)
    assert_holds("repulsive poses reachable", trace)
    assert_holds("joint speeds within limits", trace)


@given(scenario=VISITS)
def test_a_hand_that_is_seen_near_ends_servoing_at_once(scenario: Scenario, simulate: Simulate) -> None:
    near = predicted_hand_distance() < mm(400)  # the critical distance
    assert_holds(whenever(near).then(eventually(~servoing(), window=ms(100))), simulate(scenario))
