"""The three compilations of a space against each other: cube, density and sampler, scenario and back."""

from __future__ import annotations

import math
import pickle
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays
from scipy import stats
from spaces import FILES, HEAD, everything, of_duration

from safety_harness import parse_scenario, write_scenario
from safety_harness.base.exceptions import ScenarioError
from safety_harness.scenario.model import Scenario
from safety_harness.scenario.read import scenario_of
from safety_harness.space.distributions import Choice, Uniform
from safety_harness.space.read import parse_space, read_space
from safety_harness.space.space import ScenarioSpace
from safety_harness.space.template import filled

EVERYTHING = everything()
SPACES = [EVERYTHING, *map(read_space, FILES)]


def ids(space: ScenarioSpace) -> str:
    return space.name


def scaled(space: ScenarioSpace, count: int, seed: int = 1) -> np.ndarray:
    return space.values_at(np.random.default_rng(seed).random((count, space.dimension)))


@pytest.mark.parametrize("space", [*SPACES, of_duration("from 1 s to 9 s")], ids=ids)
def test_what_all_scenarios_say_is_read_once_and_each_is_as_if_read_alone(space: ScenarioSpace) -> None:
    for values in scaled(space, 5):
        scenario = space.scenario(values, name="one")
        tree = filled(space.template, space.parameters, values.tolist())
        alone = scenario_of(tree, space.file, name="one")
        assert scenario == alone
        assert dict(scenario.places) == dict(alone.places)
        assert [claim.place for claim in scenario.claims] == [claim.place for claim in alone.claims]


@pytest.mark.parametrize("space", SPACES, ids=ids)
def test_a_draw_is_the_same_wherever_and_in_whatever_order_it_is_made(space: ScenarioSpace) -> None:
    later, earlier = space.draw(7, 3), space.draw(7, 1)
    assert [earlier, later] == list(space.draws(7, 4))[1::2]
    assert later != earlier
    assert space.draw(8, 3) != later
    assert later.name == f"{space.name}#3"
    for seed, values in zip(range(9), space.values_of_draws(range(9), 3), strict=True):
        np.testing.assert_array_equal(values, space.values_of_draws([seed], 3)[0])
        assert space.draw(seed, 3, values) == space.draw(seed, 3)


@pytest.mark.parametrize("space", SPACES, ids=ids)
def test_every_draw_comes_back_from_the_cube(space: ScenarioSpace) -> None:
    for drawn in space.draws(11, 25):
        u = space.cube_of(drawn)
        assert np.all((u >= 0.0) & (u <= 1.0))
        again = space.at(u, seed=drawn.seed, name=drawn.name)
        assert space.cube_of(again) == pytest.approx(u, abs=1e-12)
        assert np.allclose(space.values_of(again), space.values_of(drawn), rtol=0, atol=1e-12, equal_nan=True)
        assert drawn in space
        assert math.isfinite(space.log_density(drawn))


@given(u=arrays.arrays(float, EVERYTHING.dimension, elements=st.floats(0.0, 1.0)))
@settings(max_examples=60, deadline=None)
def test_every_point_of_the_cube_is_a_scenario_of_the_space(u: np.ndarray) -> None:
    values = EVERYTHING.values_at(u[None])[0]
    scenario = EVERYTHING.at(u)
    found = EVERYTHING.values_of(scenario)
    assert np.array_equal(found, values, equal_nan=True)
    back = EVERYTHING.cube_of(scenario)
    assert np.all(back[np.isnan(values)] == 0.5)
    assert EVERYTHING.log_density(scenario) == pytest.approx(EVERYTHING.log_density_at(values[None])[0])


@pytest.mark.parametrize("space", SPACES, ids=ids)
def test_a_drawn_scenario_can_be_written_as_a_plain_file(space: ScenarioSpace) -> None:
    for drawn in space.draws(3, 5):
        read = parse_scenario(write_scenario(drawn), drawn.file)
        assert replace(read, name=drawn.name) == drawn
        assert read in space


@pytest.mark.parametrize("space", SPACES, ids=ids)
def test_the_array_of_values_goes_to_the_cube_and_back(space: ScenarioSpace) -> None:
    values = scaled(space, 2000)
    again = space.values_at(space.cube_at(values))
    assert np.array_equal(np.isnan(again), np.isnan(values))
    assert np.nanmax(np.abs(again - values)) < 1e-12
    assert np.all(np.isfinite(space.log_density_at(values)))


@pytest.mark.parametrize("space", SPACES, ids=ids)
def test_the_simplest_scenario_is_in_the_space(space: ScenarioSpace) -> None:
    assert space.simplest in space
    assert np.array_equal(space.values_of(space.simplest), space.simplest_values, equal_nan=True)


def test_the_sampler_has_each_parameters_own_distribution() -> None:
    """Draws, row by row from their seeds, against what the parameter's type says, where it is used."""
    drawn = np.array([EVERYTHING.values_of(scenario) for scenario in EVERYTHING.draws(5, 200)])
    looked_at = 0
    for parameter in EVERYTHING.parameters:
        values = drawn[:, parameter.column]
        values = values[np.isfinite(values)]
        distribution = parameter.distribution
        if isinstance(distribution, Uniform):
            low, high = distribution.low, distribution.high
            assert stats.kstest(values, stats.uniform(low, high - low).cdf).pvalue > 1e-3, parameter.name
            looked_at += 1
        elif isinstance(distribution, Choice):
            chances = np.array(distribution.chances)
            counts = np.bincount(values.astype(int), minlength=len(chances))
            expected = chances / chances.sum() * len(values)
            assert stats.chisquare(counts, expected).pvalue > 1e-3, parameter.name
            looked_at += 1
    assert looked_at > 12


def test_a_density_integrates_to_one_over_a_mixture_of_lengths_and_counts() -> None:
    space = parse_space(
        HEAD.replace(
            "duration: 5 s", "duration: {one of: [2 s, from 1 s to 3 s, from 2 s to 6 s], chances: [2, 1, 1]}"
        )
    )
    grid = np.linspace(0.5, 7.0, 6501)
    scenario = space.simplest
    atom = math.exp(space.log_density(replace(scenario, duration_s=2.0)))
    density = [math.exp(space.log_density(replace(scenario, duration_s=float(x) + 1e-7))) for x in grid[::10]]
    assert atom == pytest.approx(0.5)  # a coincidence with the ranges weighs nothing beside it
    assert np.mean(density) * 6.5 == pytest.approx(0.5, abs=0.01)
    assert density[np.argmin(np.abs(grid[::10] - 2.5))] == pytest.approx(0.25 / 2 + 0.25 / 4)  # both ways


def test_equal_volumes_of_the_cube_are_equally_probable() -> None:
    """exp(-log density) is the volume that the cube is stretched to: of a uniform space, all of it."""
    space = of_duration("from 1 s to 5 s")
    assert space.log_density(space.draw(1, 1)) == pytest.approx(-math.log(4.0))


def test_a_scenario_of_another_space_is_refused() -> None:
    space = of_duration("from 1 s to 5 s")
    other = replace(space.simplest, duration_s=5.5)
    assert other not in space
    assert space.log_density(other) == -math.inf
    with pytest.raises(ScenarioError, match="expected a scenario of the space"):
        space.cube_of(other)


@pytest.mark.parametrize(
    "changed",
    [{"title": "another"}, {"avoider": "optimum"}, {"claims": ()}, {"hands": ()}, {"duration_s": 4.5}],
)
def test_nothing_else_may_differ(changed: dict[str, object]) -> None:
    drawn = EVERYTHING.draw(1, 1)
    assert replace(drawn, **changed) not in EVERYTHING  # type: ignore[arg-type]


def test_name_and_seed_do_not_count() -> None:
    drawn = EVERYTHING.draw(1, 1)
    assert replace(drawn, name="x", seed=99) in EVERYTHING


def test_each_draw_has_its_own_seed_whatever_the_file_says(tmp_path: Path) -> None:
    """A key `seed`, its own or an inherited one, makes no draws copies of one another: it changes none."""
    text = HEAD.replace("duration: 5 s", "duration: from 1 s to 5 s")
    (tmp_path / "own.yaml").write_text(text + "seed: 12\n")
    (tmp_path / "child.yaml").write_text("extends: own.yaml\n")
    free = list(parse_space(text).draws(1, 50))
    assert len({scenario.seed for scenario in free}) == 50
    for name in ("own", "child"):
        space = read_space(tmp_path / f"{name}.yaml")
        drawn = list(space.draws(1, 50))
        assert [one.seed for one in drawn] == [one.seed for one in free]
        assert all(one in space for one in drawn)


def test_overlapping_alternatives_bring_a_scenario_back_as_one_of_them() -> None:
    space = of_duration("{one of: [from 1 s to 3 s, from 2 s to 4 s]}")
    scenario = space.at([0.9, 0.5, 0.25])
    assert scenario.duration_s == 2.5
    u = space.cube_of(scenario)
    assert space.at(u) == scenario
    assert u.tolist() == [0.25, 0.75, 0.5]  # the first that fits, the other unused


def test_a_named_value_is_one_parameter_wherever_it_is_used() -> None:
    used = [p for p in EVERYTHING.parameters if p.name == "choices.reach speed"]
    assert len(used) == 1
    for scenario in EVERYTHING.draws(2, 20):
        speeds = {getattr(move, "speed_mps", None) for hand in scenario.hands for move in hand.moves}
        speed = EVERYTHING.values_of(scenario)[used[0].column]
        assert speed in speeds


def test_a_choice_puts_several_things_on_one_side() -> None:
    sides = set()
    for scenario in EVERYTHING.draws(4, 30):
        (hand,) = scenario.hands
        start, elbow = hand.starts_at_in_base_m[1], hand.elbow_towards_in_base_m[1]  # type: ignore[union-attr]
        assert start * elbow > 0.0
        sides.add(start > 0.0)
    assert sides == {False, True}


def test_repetitions_have_values_of_their_own() -> None:
    counts = set()
    for scenario in EVERYTHING.draws(6, 60):
        moves = scenario.hands[0].moves  # type: ignore[union-attr]
        counts.add(len(moves))
        places = [move.position_in_base_m for move in moves if hasattr(move, "position_in_base_m")]
        assert len(set(places)) == len(places)
    assert counts == {2, 4, 6, 8}


def test_what_is_outside_the_cube_is_refused() -> None:
    space = of_duration("from 1 s to 5 s")
    for u in ([1.1], [-0.1], [math.nan], [0.5, 0.5], []):
        with pytest.raises(ScenarioError, match="expected"):
            space.at(u)
    with pytest.raises(ScenarioError, match="within their distributions"):
        space.cube_at(np.array([[0.5]]))


def test_an_equal_scenario_is_equal_to_the_last_bit() -> None:
    one: Scenario = EVERYTHING.draw(9, 4)
    assert repr(one) == repr(EVERYTHING.draw(9, 4))


def test_many_repetitions_with_alternatives_come_back_all_the_same() -> None:
    """There are 3^20 ways to lay the template over such a scenario; one of them fits."""
    alternatives = (
        "{one of: [{wait: from 1 s to 2 s}, {wait: from 3 s to 4 s}, {withdraw: from 1 m/s to 2 m/s}]}"
    )
    space = parse_space(
        HEAD
        + "hands: [{hand: h, starts at: [1 m, 1 m, 1 m], elbow towards: [2 m, 1 m, 1 m], moves: "
        + f"[{{repeat: from 1 to 20 times, moves: [{alternatives}]}}]}}]\n"
    )
    for drawn in space.draws(1, 3):
        assert np.array_equal(
            space.values_of(drawn), space.values_of(space.at(space.cube_of(drawn))), equal_nan=True
        )
        assert math.isfinite(space.log_density(drawn))


def test_more_ways_than_can_be_added_are_an_error_and_no_number() -> None:
    both = "{one of: [{wait: from 1 s to 3 s}, {wait: from 2 s to 4 s}]}"
    space = parse_space(
        HEAD
        + "hands: [{hand: h, starts at: [1 m, 1 m, 1 m], elbow towards: [2 m, 1 m, 1 m], moves: "
        + f"[{{repeat: 10 times, moves: [{both}]}}]}}]\n"
    )
    u = np.full(space.dimension, 0.25)  # each first alternative
    u[1::3] = 0.75  # of which the upper half is the second's as well
    assert np.all(space.cube_of(space.at(u)) >= 0.0)
    with pytest.raises(ScenarioError, match="at most 1,000 ways"):
        space.log_density(space.at(u))


def test_a_space_can_be_sent_to_another_process() -> None:
    assert pickle.loads(pickle.dumps(EVERYTHING)).draw(1, 3) == EVERYTHING.draw(1, 3)
