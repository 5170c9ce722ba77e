"""The Hypothesis strategy: its examples are in the space, and it shrinks to what people call simple."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from random import Random

import numpy as np
import pytest
from hypothesis import HealthCheck, Phase, find, given, settings
from hypothesis import strategies as st
from spaces import FILES, HEAD, everything, of_duration

from safety_harness.scenario.model import Scenario
from safety_harness.scenario.moves import MoveTo
from safety_harness.space.distributions import InRegion
from safety_harness.space.read import parse_space, read_space
from safety_harness.space.space import ScenarioSpace
from safety_harness.space.strategy import real, strategy, values

EVERYTHING = everything()
QUICK = settings(max_examples=30, deadline=None, suppress_health_check=[HealthCheck.too_slow])
SEARCH = settings(max_examples=6000, deadline=None, database=None, phases=[Phase.generate, Phase.shrink])


def least(space: ScenarioSpace, predicate: Callable[[Scenario], bool]) -> Scenario:
    """The simplest example that Hypothesis finds for a predicate."""
    return find(strategy(space), predicate, settings=SEARCH, random=Random(3))  # the same search each time


def varied(space: ScenarioSpace, scenario: Scenario) -> dict[str, tuple[float, ...]]:
    """The parameters that are not their simplest."""
    found, simplest = space.values_of(scenario), space.simplest_values
    return {
        parameter.name: tuple(found[parameter.columns])
        for parameter in space.parameters
        if not np.array_equal(found[parameter.columns], simplest[parameter.columns], equal_nan=True)
    }


@pytest.mark.parametrize("space", [EVERYTHING, *map(read_space, FILES)], ids=lambda space: space.name)
def test_every_example_is_in_the_space(space: ScenarioSpace) -> None:
    @given(found=values(space))
    @QUICK
    def every_example(found: np.ndarray) -> None:
        assert np.isfinite(space.log_density_at(found[None])[0])
        scenario = space.scenario(found)
        assert scenario in space

    every_example()


@given(scenario=strategy(EVERYTHING))
@QUICK
def test_examples_come_back_from_the_cube(scenario: Scenario) -> None:
    u = EVERYTHING.cube_of(scenario)
    again = EVERYTHING.values_of(EVERYTHING.at(u))
    assert np.allclose(again, EVERYTHING.values_of(scenario), rtol=0, atol=1e-12, equal_nan=True)


@pytest.mark.parametrize("space", [EVERYTHING, *map(read_space, FILES)], ids=lambda space: space.name)
def test_without_a_reason_the_simplest_is_left(space: ScenarioSpace) -> None:
    found = least(space, lambda scenario: True)
    assert varied(space, found) == {}
    assert found.seed == 0


def test_a_speed_is_no_faster_and_no_less_round_than_it_must_be() -> None:
    space = read_space(FILES[0])

    def too_fast(scenario: Scenario) -> bool:
        return any(
            isinstance(m, MoveTo) and m.speed_mps > 0.7342 for hand in scenario.hands for m in hand.moves
        )  # type: ignore[union-attr]

    found = least(space, too_fast)
    assert varied(space, found) == {"hands[0].moves[1].speed": (0.74,)}


def test_repetitions_are_no_more_than_they_must_be() -> None:
    found = least(EVERYTHING, lambda scenario: len(scenario.hands[0].moves) >= 5)  # type: ignore[union-attr]
    # Two repetitions with first alternatives and simplest values.
    changed = varied(EVERYTHING, found)
    assert changed.pop("hands[0].moves[1].repeat") == (2.0,)
    simplest = {p.name: p.distribution.simplest for p in EVERYTHING.parameters}
    assert all(value == simplest[name] for name, value in changed.items())
    assert {name.rpartition(", ")[2] for name in changed} == {"time 1", "time 2"}


def test_an_unseen_point_stays_next_to_the_seen_space() -> None:
    space = parse_space(HEAD.replace("[0 mm, 0 mm, 0 mm]", "{in: unseen tcp}"))

    def far_up(scenario: Scenario) -> bool:
        return scenario.start.offset_in_base_m[2] > 0.1234  # type: ignore[union-attr]

    x, y, z = least(space, far_up).start.offset_in_base_m  # type: ignore[union-attr]
    assert z == 0.124
    assert y == 0.0
    assert abs(x) == 0.06 or x == 0.0  # beside the seen box, or above it


def test_an_offset_shrinks_to_none() -> None:
    space = parse_space(
        HEAD.replace("[0 mm, 0 mm, 0 mm]", "[from -50 mm to 50 mm, from -50 mm to 50 mm, 0 mm]")
    )

    def sideways(scenario: Scenario) -> bool:
        return scenario.start.offset_in_base_m[1] < -0.0103  # type: ignore[union-attr]

    found = least(space, sideways).start.offset_in_base_m  # type: ignore[union-attr]
    assert found == (0.0, -0.011, 0.0)


def test_an_angle_is_a_round_number_of_degrees() -> None:
    found = find(real(-0.5, 0.5, 0.0, "rad"), lambda angle: angle > 0.2, settings=SEARCH)
    assert np.degrees(found) == pytest.approx(11.5)


def test_what_only_lies_between_round_numbers_is_found_all_the_same() -> None:
    space = of_duration("from 1 s to 3 s")
    found = least(space, lambda scenario: 1.5001 < scenario.duration_s < 1.5099)
    assert 1.5001 < found.duration_s < 1.5099


def test_the_last_alternative_is_taken_when_it_must_be() -> None:
    space = of_duration("{one of: [2 s, from 3 s to 4 s, from 7 s to 9 s]}")
    found = least(space, lambda scenario: scenario.duration_s > 5.0)
    assert found.duration_s == 7.0


@given(data=st.data())
@QUICK
def test_a_range_is_never_left(data: st.DataObject) -> None:
    low = data.draw(st.floats(-100.0, 100.0))
    high = data.draw(st.floats(low + 1e-6, 200.0))
    target = data.draw(st.sampled_from([low, high, min(max(0.0, low), high)]))
    assert low <= data.draw(real(low, high, target, data.draw(st.sampled_from(["", "m", "rad"])))) <= high


def test_both_ends_and_the_middle_of_a_range_are_found() -> None:
    for wanted in (1.0, 2.0, 1.5):
        assert find(real(1.0, 2.0, 1.0, "s"), lambda value, w=wanted: value == w, settings=SEARCH) == wanted


def test_every_side_of_a_shell_is_found() -> None:
    space = parse_space(HEAD.replace("[0 mm, 0 mm, 0 mm]", "{in: unseen tcp}"))
    (parameter,) = space.parameters
    assert isinstance(parameter.distribution, InRegion)
    hole = parameter.distribution.known.hole
    assert hole is not None
    seen: set[tuple[int, bool]] = set()

    @given(point=values(space))
    @settings(max_examples=200, deadline=None, derandomize=True, database=None)
    def look(point: np.ndarray) -> None:
        seen.update((axis, True) for axis in np.flatnonzero(point > hole.high_m))
        seen.update((axis, False) for axis in np.flatnonzero(point < hole.low_m))

    look()
    assert len(seen) == 6


@pytest.mark.parametrize("file", FILES, ids=lambda file: file.stem)
def test_the_name_of_a_strategy_is_short_enough_for_hypothesis(file: Path) -> None:
    """It warns of long ones, whenever an example is not drawn to its end."""
    assert len(repr(strategy(read_space(file)))) < 1000
