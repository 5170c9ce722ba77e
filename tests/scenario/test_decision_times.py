"""The setting ``decision time``: its forms, what is refused, and measured profiles."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest

from safety_harness.base.exceptions import ScenarioError
from safety_harness.base.settings import DEFAULTS, DecisionCost, DecisionTimes, Measured
from safety_harness.scenario.decision_times import profile_text
from safety_harness.scenario.model import Scenario
from safety_harness.scenario.read import parse_scenario, read_scenario
from safety_harness.scenario.write import write_scenario
from safety_harness.space.read import parse_space
from tests.search.short_space import TEXT as SPACE

TEXT = """\
scenario: a hand
duration: 1 s
tcp start: {offset: [0 mm, 0 mm, 0 mm]}
claims: {joint speeds within limits: holds}
settings: {avoidance: {decision time: COST}}
"""
MEASURED = Measured(avoider="mc-dropout", sha256="ab12", machine='a "quiet" machine', questions=500)
PROFILE = DecisionTimes(quantiles_s=(0.001, 0.0021, 0.0021, 0.0123456789), measured=MEASURED)


def cost_of(text: str) -> DecisionCost | DecisionTimes:
    return read(text).settings.avoidance.decision_time


def read(text: str) -> Scenario:
    return parse_scenario(TEXT.replace("COST", text))


@pytest.mark.parametrize(
    ("text", "cost"),
    [
        ("as declared", DecisionCost.AS_DECLARED),
        ("wall clock", DecisionCost.WALL_CLOCK),
        ("40 ms", DecisionTimes(quantiles_s=(0.04,))),
        ("0 s", DecisionTimes(quantiles_s=(0.0,))),
        ("between 5 ms and 0.04 s", DecisionTimes(quantiles_s=(0.005, 0.04))),
    ],
)
def test_each_form_is_read_and_written_again(text: str, cost: DecisionCost | DecisionTimes) -> None:
    scenario = read(text)
    assert scenario.settings.avoidance.decision_time == cost
    for all_settings in (False, True):
        again = parse_scenario(write_scenario(scenario, all_settings=all_settings))
        assert again.settings == scenario.settings


def test_without_a_word_it_is_the_avoider_s() -> None:
    assert DEFAULTS.avoidance.decision_time is DecisionCost.AS_DECLARED
    assert "decision time" not in write_scenario(read("as declared"))


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("-1 ms", "at least 0 and at most 60 s"),
        ("61 s", "at least 0 and at most 60 s"),
        ("40", "a time such as"),
        ("between 40 ms and 5 ms", "times that rise"),
        ("between 40 ms", "a time such as"),
        ("between 1 ms and 61 s", "times that rise"),
        ("wall", "a time such as"),
        ("nothing.json", "a file that can be read"),
        ("{quantiles: [2 ms, 1 ms], avoider: a, sha256: b, machine: c, questions: 5}", "times that rise"),
        ("{quantiles: [1 ms, 2 ms], avoider: a, machine: c, questions: 5}", 'the key "sha256"'),
        ("{quantiles: [1 ms, 2 ms], avoider: a, sha256: b, machine: c, questions: 0}", "a whole number"),
    ],
)
def test_what_is_no_time_is_refused_at_its_line(text: str, expected: str) -> None:
    with pytest.raises(ScenarioError, match="decision time") as raised:
        read(text)
    assert expected in raised.value.expected
    assert raised.value.place.line == 5


def test_a_profile_is_read_beside_the_scenario_and_stands_in_what_is_written_of_it(tmp_path: Path) -> None:
    (tmp_path / "profile.json").write_text(profile_text(PROFILE))
    (tmp_path / "one.yaml").write_text(TEXT.replace("COST", "profile.json"))
    scenario = read_scenario(tmp_path / "one.yaml")
    assert scenario.settings.avoidance.decision_time == PROFILE
    written = write_scenario(scenario)
    assert parse_scenario(written).settings == scenario.settings
    assert "profile.json" not in written


def test_a_file_that_extends_another_finds_that_one_s_profile(tmp_path: Path) -> None:
    (tmp_path / "below").mkdir()
    (tmp_path / "profile.json").write_text(profile_text(PROFILE))
    (tmp_path / "one.yaml").write_text(TEXT.replace("COST", "profile.json"))
    (tmp_path / "below" / "two.yaml").write_text("extends: ../one.yaml\nscenario: another\n")
    assert read_scenario(tmp_path / "below" / "two.yaml").settings.avoidance.decision_time == PROFILE


@pytest.mark.parametrize(
    "changes",
    [
        {"format": "something else"},
        {"quantiles_s": [0.002, 0.001]},
        {"quantiles_s": [0.001]},
        {"quantiles_s": [0.001, None]},
        {"quantiles_s": [-0.001, 0.001]},
        {"quantiles_s": [0.001, float("nan")]},
        {"quantiles_s": 3},
        {"machine": "two\nlines"},
        {"avoider": 5},
        {"questions": True},
        {"questions": -1},
    ],
    ids=str,
)
def test_a_profile_that_is_none_is_refused_and_nothing_of_it_is_shown(
    changes: dict[str, object], tmp_path: Path
) -> None:
    (tmp_path / "profile.json").write_text(json.dumps(json.loads(profile_text(PROFILE)) | changes))
    (tmp_path / "one.yaml").write_text(TEXT.replace("COST", "profile.json"))
    with pytest.raises(ScenarioError, match="a profile of decision times") as raised:
        read_scenario(tmp_path / "one.yaml")
    assert raised.value.got == "another file: profile.json"


def test_in_a_space_a_time_may_be_drawn_once_a_scenario_or_for_each_decision() -> None:
    settings = "settings: {avoidance: {decision time: COST}}\n"
    once = parse_space(SPACE + settings.replace("COST", "from 5 ms to 40 ms"))
    (drawn_s,) = once.draw(1, 0).settings.avoidance.decision_time.quantiles_s  # type: ignore[union-attr]
    assert 0.005 < drawn_s < 0.04
    assert once.draw(1, 0) in once
    each = parse_space(SPACE + settings.replace("COST", "between 5 ms and 40 ms"))
    assert each.draw(1, 0).settings.avoidance.decision_time == DecisionTimes(quantiles_s=(0.005, 0.04))
    assert each.draw(1, 0) in each


@pytest.mark.parametrize("cost", ["wall clock", '"one of wall clock, as declared"'])
def test_the_runs_of_a_space_have_to_repeat(cost: str) -> None:
    with pytest.raises(ScenarioError, match="the runs of a space have to repeat") as raised:
        parse_space(SPACE + f"settings: {{avoidance: {{decision time: {cost}}}}}\n")
    assert raised.value.place.line == 17


def test_the_wall_limit_is_a_setting_of_the_clock() -> None:
    assert replace(DEFAULTS.clock).wall_limit_s == 30.0
    text = TEXT.replace("avoidance: {decision time: COST}", "clock: {wall limit: 90 s}")
    assert parse_scenario(text).settings.clock.wall_limit_s == 90.0
