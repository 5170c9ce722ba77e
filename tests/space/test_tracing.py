"""Values are filled in at the paths where the reader put others: the same scenarios and refusals."""

from __future__ import annotations

import math
import pickle
from operator import itemgetter
from typing import Any

import numpy as np
import pytest
from spaces import FILES, HEAD, everything

from safety_harness.base.exceptions import ScenarioError
from safety_harness.scenario.model import Scenario
from safety_harness.scenario.read import scenario_of
from safety_harness.space.read import parse_space, read_space
from safety_harness.space.space import ScenarioSpace
from safety_harness.space.template import filled
from safety_harness.space.tracing import Form, TracedNumber, form_of, leaves, value_at, with_value

SPACES = [everything(), *map(read_space, FILES)]
HAND = """\
hands:
  - hand: a
    starts at: [1 m, from -1 m to 1 m, 0.2 m]
    elbow towards: [1.5 m, -1 m, 0.3 m]
    speed at most: from 1.5 m/s to 3 m/s
    tremor: {amplitude: from 1 mm to 20 mm, rate: from 1 Hz to 20 Hz}
    moves: [{move to: [1 m, 0 m, from 0.1 m to 0.4 m], speed: from 0.2 m/s to 1.3 m/s}]
"""


def read_alone(space: ScenarioSpace, values: np.ndarray) -> Scenario:
    tree = filled(space.template, space.parameters, values.tolist())
    return scenario_of(tree, space.file, name=space.name)


def outcome(make: object, *arguments: object) -> object:
    """A scenario to the last bit (a negative zero is another number), or the words of its refusal."""
    try:
        made = make(*arguments)  # type: ignore[operator]
    except ScenarioError as error:
        return str(error)
    return [repr(leaf) for _, leaf in leaves(made)], dict(made.places)


@pytest.mark.parametrize("space", SPACES, ids=lambda space: space.name)
def test_each_scenario_is_as_if_read_alone(space: ScenarioSpace) -> None:
    """Met first, a structure is read; then a form is made of it; then that is filled in."""
    rng = np.random.default_rng(2)
    for values in space.values_at(rng.random((4, space.dimension))):
        same = space.values_at(rng.random((4, space.dimension)))
        for parameter in space.parameters:  # the same alternatives, other numbers
            if hasattr(parameter.distribution, "labels"):
                same[:, parameter.columns] = values[parameter.columns]
        for row in space.without_unused(same):
            assert outcome(space.scenario, row) == outcome(read_alone, space, row)


@pytest.mark.parametrize("wrong", [math.nan, math.inf, -math.inf, -0.0, 0.0, 1e9, -0.5, 15.0, 5e-324])
def test_what_the_reader_refuses_is_refused_in_its_words(wrong: float) -> None:
    space = parse_space(HEAD + HAND)
    usual = space.simplest_values
    for _ in range(3):
        space.scenario(usual)
    for column in range(space.dimension):
        values = usual.copy()
        values[column] = wrong
        assert outcome(space.scenario, values) == outcome(read_alone, space, values)


def test_two_values_that_contradict_are_refused_in_the_readers_words() -> None:
    space = parse_space(HEAD + HAND)
    refused = 0
    for values in space.values_at(np.random.default_rng(3).random((200, space.dimension))):
        found = outcome(space.scenario, values)
        refused += isinstance(found, str)
        assert found == outcome(read_alone, space, values)
    assert 20 < refused < 180


def test_the_reader_is_not_asked_again(monkeypatch: pytest.MonkeyPatch) -> None:
    space = parse_space(HEAD + HAND)
    for _ in range(2):
        space.scenario(space.simplest_values)
    monkeypatch.setattr("safety_harness.space.space.scenario_of", None)
    other = space.simplest_values + 0.001
    assert space.scenario(other, name="x", seed=7).seed == 7
    sent = pickle.loads(pickle.dumps(space.scenario(other)))
    assert sent == space.scenario(other)
    assert all(isinstance(leaf, float) for path, leaf in leaves(sent) if path[-1] == "speed_mps")


@pytest.mark.parametrize("space", SPACES, ids=lambda space: space.name)
def test_of_what_is_shipped_only_recordings_are_read_each_time(
    space: ScenarioSpace, monkeypatch: pytest.MonkeyPatch
) -> None:
    for _ in range(2):
        space.scenario(space.simplest_values)
    monkeypatch.setattr("safety_harness.space.space.scenario_of", None)
    if space.name == "recorded-variations":
        with pytest.raises(TypeError, match="not callable"):
            space.scenario(space.simplest_values)
    else:
        assert space.scenario(space.simplest_values).title == space.title


def traced(*values: float) -> tuple[list[TracedNumber], list[tuple[Any, bool]]]:
    checks: list[tuple[Any, bool]] = []
    return [TracedNumber(itemgetter(k), values, checks) for k in range(len(values))], checks


def test_a_traced_number_remembers_how_it_was_computed_and_compared() -> None:
    (a, b), checks = traced(3.0, 4.0)
    other = 1.0 - (2.0 * a + b / 4.0 - 1.0) / b
    assert isinstance(other, TracedNumber)
    assert other.compute((3.0, 4.0)) == -0.5
    assert other.compute((1.0, 1.0)) == -0.25
    assert a < b
    assert not a >= 5.0
    assert bool(a)
    answers = [(of((3.0, 4.0)), of((6.0, 4.0)), answer) for of, answer in checks]
    assert answers == [(True, False, True), (False, True, False), (True, True, True)]


@pytest.mark.parametrize(
    "forget",
    [float, int, str, repr, hash, math.sqrt, math.isfinite, round, np.sin, lambda a: f"{a:.2f}", abs],
)
def test_what_would_be_forgotten_is_an_error(forget: object) -> None:
    (number,), _ = traced(3.0)
    with pytest.raises(TypeError):
        forget(number)  # type: ignore[operator]
    with pytest.raises(TypeError):
        _ = np.ones(3) * number


def test_a_form_of_what_cannot_be_remembered_fits_nothing() -> None:
    def read(numbers: object) -> Scenario:
        raise TypeError

    assert Form.read([1.0], read).filled([1.0], "name", 0) is None


def test_paths_lead_to_the_leaves_and_a_form_changes_nothing_else() -> None:
    scenario = everything().draw(1, 1)
    for path, leaf in leaves(scenario):
        assert value_at(scenario, path) is leaf
    assert with_value(scenario, ("hands", 0, "delay_s"), 0.25).hands[0].delay_s == 0.25  # type: ignore[union-attr]
    fill = form_of(scenario, {("duration_s",): 1, ("start", "tilt_in_tcp_rad", 2): 0})
    changed = fill([0.5, 7.0])
    assert (changed.duration_s, changed.start.tilt_in_tcp_rad[2]) == (7.0, 0.5)  # type: ignore[union-attr]
    assert changed.hands is scenario.hands
    assert changed.places is scenario.places
