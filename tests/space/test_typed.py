"""Spaces from Python are those from files: the same types, the same draws, and each written as the other."""

from __future__ import annotations

import pytest
from spaces import EVERYTHING, FILES, FOLDER, everything

from safety_harness import parse_scenario
from safety_harness.base.exceptions import ScenarioError
from safety_harness.scenario.model import Scenario
from safety_harness.space.distributions import InBox, InRegion, InShell, TruncatedNormal, Uniform
from safety_harness.space.read import parse_space, read_space
from safety_harness.space.space import ScenarioSpace
from safety_harness.space.typed import OneOf, Ref, Repeat, Switch, Value, space_from
from safety_harness.space.writing import write_space

VISIT = parse_scenario(
    """\
scenario: every kind of distribution
duration: 3 s
tcp start:
  offset: [0 mm, 0 mm, 0 mm]
  tilt: [0 deg, 0 deg, 0 deg]
avoider: opposite pose
hands:
  - hand: right
    starts at: [1.2 m, -0.7 m, 0.3 m]
    elbow towards: [1.6 m, -1.2 m, 0.3 m]
    moves:
      - wait: 1 s
      - move to: [1 m, 0 m, 0.5 m]
        speed: 1 m/s
claims:
  gain switch reached: holds
"""
)


def without_name(scenario: Scenario) -> Scenario:
    from dataclasses import replace

    return replace(scenario, name="")


def assert_same(one: ScenarioSpace, other: ScenarioSpace) -> None:
    """The same parameters at the same paths, and the same scenarios."""
    assert [(p.name, p.distribution, p.column, p.when) for p in one.parameters] == [
        (p.name, p.distribution, p.column, p.when) for p in other.parameters
    ]
    assert list(map(without_name, one.draws(3, 6))) == list(map(without_name, other.draws(3, 6)))


def test_a_space_from_python_is_the_one_from_the_file() -> None:
    moves: tuple[Value, ...] = (
        {"wait": OneOf(("500 ms", "1 s", "2 s"))},
        Repeat(
            0,
            3,
            (
                {"move to": InRegion("seen hand"), "speed": Ref("reach speed")},
                OneOf(
                    (
                        {"wait": Uniform(0.1, 1.0, "s")},
                        {
                            "reach for tcp": Ref("reach speed"),
                            "stop at distance": Uniform(0.05, 0.2, "m"),
                            "give up after": "2 s",
                        },
                        {"withdraw": Uniform(0.2, 0.4, "m/s")},
                    ),
                    chances=(2, 1, 1),
                ),
            ),
        ),
        {"move to": InShell((1.0, 0.0, 0.5), 0.1, 0.2), "speed": Ref("reach speed")},
    )
    tilt = 0.08726646259971647  # 5 deg
    space = space_from(
        VISIT,
        {
            "duration": Uniform(2.0, 4.0),
            "tcp start.offset": InRegion("unseen tcp"),
            "tcp start.tilt": InBox((-tilt, -tilt, 0.0), (tilt, tilt, 2 * tilt), "rad"),
            "hands[0].hand": OneOf(("a hand", "another hand")),
            "hands[0].starts at": Ref("start"),
            "hands[0].elbow towards": Switch("side", {"right": (1.6, -1.2, 0.3), "left": (1.6, 1.2, 0.3)}),
            "hands[0].moves": moves,
            "hand sensor": OneOf(
                ({"kind": "ideal"}, {"kind": "overhead", "pixel noise": Uniform(0.0, 3.0, "px")}),
                chances=(3, 1),
            ),
            "settings.avoidance.radius": TruncatedNormal(0.1, 0.02, 0.08, 0.15),
        },
        choices={
            "side": OneOf(("right", "left")),
            "reach speed": Uniform(0.5, 2.0, "m/s"),
            "start": Switch(
                "side",
                {
                    "right": ("1.2 m", Uniform(-0.8, -0.6, "m"), "0.3 m"),
                    "left": ("1.2 m", Uniform(0.6, 0.8, "m"), "0.3 m"),
                },
            ),
        },
    )
    theirs = {p.name: (p.distribution, len(p.when)) for p in everything().parameters}
    ours = {p.name: (p.distribution, len(p.when)) for p in space.parameters}
    assert ours == theirs
    assert_same(parse_space(write_space(space)), space)


@pytest.mark.parametrize("text", [EVERYTHING, *(file.read_text() for file in FILES)])
def test_what_is_written_of_a_space_is_the_space(text: str) -> None:
    space = parse_space(text, FOLDER / "x.yaml")
    written = write_space(space)
    again = parse_space(written, FOLDER / "x.yaml")
    assert_same(again, space)
    assert write_space(again) == written


def test_a_number_takes_the_unit_of_its_place() -> None:
    space = space_from(VISIT, {"hands[0].moves[0].wait": OneOf((0.5, 1.5)), "duration": Uniform(1.0, 2.0)})
    assert "wait:\n          one of: [0.5 s, 1.5 s]" in write_space(space)
    assert "duration: from 1.0 s to 2.0 s" in write_space(space)


def test_a_setting_that_the_scenario_leaves_at_its_default_can_be_varied() -> None:
    space = space_from(VISIT, {"camera.latency": Uniform(0.0, 0.1)})
    assert space.draw(1, 1).settings.camera.latency_s == space.values_of(space.draw(1, 1))[0]


def test_the_scenarios_seed_is_no_draws_seed() -> None:
    varied = {"duration": Uniform(1.0, 2.0)}
    assert len({s.seed for s in space_from(VISIT, varied).draws(1, 3)}) == 3


def test_the_scenario_itself_is_in_the_space_that_is_made_of_it() -> None:
    assert VISIT in space_from(VISIT, {"hands[0].moves[0].wait": Uniform(0.5, 1.5)})


def test_a_recording_is_found_from_python_too() -> None:
    recorded = read_space(FOLDER / "recorded-variations.yaml").draw(1, 1)
    space = space_from(recorded, {"hands[0].speed factor": Uniform(0.5, 1.0)})
    assert space.draw(2, 1).hands[0].speed_factor < 1.0  # type: ignore[union-attr]


@pytest.mark.parametrize(
    "path", ["hands[0].moves[0].wiat", "hands[3]", "settings.avoidance.radios", "", "a..b"]
)
def test_a_path_that_the_scenario_has_not_is_refused(path: str) -> None:
    with pytest.raises(ScenarioError, match="the path of a value"):
        space_from(VISIT, {path: Uniform(1.0, 2.0)})


def test_a_misspelt_path_has_a_hint() -> None:
    with pytest.raises(ScenarioError, match=r"did you mean .*moves\[0\]\.wait"):
        space_from(VISIT, {"hands[0].moves[0].wiat": Uniform(1.0, 2.0)})


def test_a_value_of_another_kind_is_refused() -> None:
    with pytest.raises(ScenarioError, match="expected a time"):
        space_from(VISIT, {"duration": Uniform(1.0, 2.0, "m")})
