"""docs/reference/scenario.md: its examples run, its tables name every key, its defaults are the defaults."""

from __future__ import annotations

import re
from dataclasses import dataclass, fields
from pathlib import Path

import pytest
import tables

from safety_harness.base.exceptions import Place, ScenarioError
from safety_harness.base.settings import DEFAULTS
from safety_harness.scenario import model, moves, units
from safety_harness.scenario.compose import COMPOSING
from safety_harness.scenario.expand import read_all_scenarios
from safety_harness.scenario.faults import EVERY_FAULT, OWN_KEYS, TIMES
from safety_harness.scenario.model import RecordedHand, Scenario
from safety_harness.scenario.read import parse_scenario
from safety_harness.scenario.reference_tables import TCP_START, TOP
from safety_harness.scenario.settings_keys import SETTINGS_KEYS, setting_keys
from safety_harness.scenario.units import Dimension
from tests.scenario.scenario_strategies import number_of

ROOT = Path(__file__).parents[2]
TEXT = (ROOT / "docs/reference/scenario.md").read_text()
FILE = ROOT / "scenarios/example.yaml"  # examples stand where the recordings are
BASE = {
    "scenario": "scenario: an example",
    "duration": "duration: 1 s",
    "tcp start": "tcp start: {offset: [0 mm, 0 mm, 0 mm]}",
    "claims": "claims: {gain switch reached: holds}",
}


def blocks(kind: str) -> list[str]:
    return re.findall(rf"^```{kind}\n(.*?)^```$", TEXT, re.MULTILINE | re.DOTALL)


def completed(example: str) -> str:
    """An example with the required keys that it leaves out, at its end so that lines stay."""
    return example + "".join(
        f"{line}\n" for key, line in BASE.items() if not re.search(f"^{key}:", example, re.M)
    )


@dataclass(frozen=True)
class Row:
    keys: tuple[str, ...]
    value: str
    default: str


def rows(heading: str) -> list[Row]:
    """The rows of the first table below a heading."""
    section = TEXT.split(f"{heading}\n", 1)[1].split("\n#", 1)[0]
    table = re.split("\n\n|<!-- end", section.split("|---", 1)[1])[0].splitlines()[1:]
    cells = [[cell.strip() for cell in line.strip("|").split("|")] for line in table]
    return [Row(tuple(re.findall("`(.*?)`", first)), value, default) for first, value, default, *_ in cells]


def defaults_of(heading: str, indent: str) -> str:
    """The defaults of a table of settings, as they would stand in a file."""
    lines: list[str] = []
    for row in rows(heading):
        key = row.keys[-1]
        if row.default == "none":
            lines.append(f"{indent}{key}:")
        else:
            lines.append(f"{indent}{'  ' if len(row.keys) == 2 else ''}{key}: {row.default}")
    return "\n".join(lines) + "\n"


@pytest.mark.parametrize("example", blocks("yaml"))
def test_every_example_can_be_read(example: str) -> None:
    assert isinstance(parse_scenario(completed(example), FILE), Scenario)


def test_there_are_examples() -> None:
    assert len(blocks("yaml")) == 14


def test_the_first_example_is_complete() -> None:
    assert completed(blocks("yaml")[0]) == blocks("yaml")[0]


def test_the_refused_example_is_refused_in_the_words_of_the_page() -> None:
    (example,), (message,) = blocks("yaml refused"), blocks("text")
    with pytest.raises(ScenarioError) as caught:
        parse_scenario(completed(example), Path("example.yaml"))
    assert str(caught.value) == message.strip()


def test_the_note_about_a_recording_is_what_the_example_gives() -> None:
    (example,) = (example for example in blocks("yaml") if "recording:" in example)
    hand = parse_scenario(completed(example), FILE).hands[0]
    assert isinstance(hand, RecordedHand)
    assert f"`{hand.motion.notes[0]}`" in " ".join(TEXT.split())


def test_the_published_schema_is_what_the_code_knows() -> None:
    """If not: python docs/tables.py."""
    assert tables.SCHEMA.read_text() == tables.schema_text()


def test_the_composed_example_and_the_suite_can_be_read(tmp_path: Path) -> None:
    for name in ("fast-reach", "hand-visits-and-leaves"):
        (tmp_path / f"{name}.yaml").write_text((ROOT / f"scenarios/{name}.yaml").read_text())
    ((composed,), (suite,)) = blocks("yaml composed"), blocks("yaml suite")
    (tmp_path / "reach.yaml").write_text(composed)
    (tmp_path / "suite.yaml").write_text(suite)
    assert [one.name for one in read_all_scenarios(tmp_path / "reach.yaml")] == [
        f"reach[{sensor},{start}]" for sensor in ("ideal", "late") for start in ("near", "far")
    ]
    assert len(read_all_scenarios(tmp_path / "suite.yaml")) == 2


@pytest.mark.parametrize(
    ("heading", "keys"),
    [
        ("## Files made of others", COMPOSING),
        ("## Top of the file", TOP.names),
        ("## A hand that moves", (*model.MOVING_HAND.names, *moves.TREMOR.names)),
        ("## A hand that holds the same part as another", model.JOINED_HAND.names),
        ("## A hand that repeats a recording", model.RECORDED_HAND.names),
        ("## `tcp start`", TCP_START.names),
        ("## `object`", {key.path[0] for key in setting_keys(type(DEFAULTS.object))}),
        ("### The time of a fault", TIMES),
        ("## `hand sensor`", {key.path[0] for key in setting_keys(type(DEFAULTS.hand_sensor))}),
        ("## `camera`", {word for key in setting_keys(type(DEFAULTS.camera)) for word in key.path}),
    ],
)
def test_the_tables_name_every_key_and_no_other(heading: str, keys: tuple[str, ...]) -> None:
    assert {key for row in rows(heading) for key in row.keys} == set(keys)


def test_the_page_names_every_move() -> None:
    for table in moves.MOVES:
        move, *further = table.names
        (line,) = re.findall(rf"^\| `{move}`(?: \([a-z]+\)) \|(.*?)\|", TEXT, re.M)
        assert re.findall("`(.*?)`", line.split("|")[0]) == further


def test_the_page_names_every_fault_with_its_keys() -> None:
    section = TEXT.split("## `faults`", 1)[1].split("| key |", 1)[0]
    lines = {words: line for words, line in re.findall(r"^\| `(.*?: .*?)` \|(.*?)\|", section, re.M)}
    assert list(lines) == [f"{kind.phrase.subject}: {kind.phrase.predicate}" for kind in EVERY_FAULT]
    for own in OWN_KEYS.values():
        line = lines[f"{own.told_by}: {own.name}"]
        assert tuple(re.findall("`(.*?)`", line)) == own.names


@pytest.mark.parametrize("group", SETTINGS_KEYS)
def test_the_tables_of_settings_name_every_key_with_its_default(group: str) -> None:
    keys = setting_keys(type(getattr(DEFAULTS, SETTINGS_KEYS[group])))
    assert [row.keys for row in rows(f"### `{group}`")] == [key.path for key in keys]
    text = completed("") + f"settings:\n  {group}:\n" + defaults_of(f"### `{group}`", "    ")
    assert parse_scenario(text, FILE).settings == DEFAULTS


@pytest.mark.parametrize("group", ["object", "camera", "hand sensor"])
def test_the_defaults_of_the_groups_at_the_top_are_the_defaults(group: str) -> None:
    text = completed("") + f"{group}:\n" + defaults_of(f"## `{group}`", "  ")
    assert parse_scenario(text, FILE).settings == DEFAULTS


def test_the_other_defaults_are_the_defaults() -> None:
    default = {key: row.default for row in rows("## A hand that repeats a recording") for key in row.keys}
    longest_gap_s = units.parse_quantity(default["longest gap"], units.TIME, Place())
    fastest_jump_mps = units.parse_quantity(default["fastest jump"], units.SPEED, Place())
    assert (longest_gap_s, fastest_jump_mps) == (RecordedHand.longest_gap_s, RecordedHand.fastest_jump_mps)
    moving = {row.keys[-1]: row.default for row in rows("## A hand that moves")}
    assert units.parse_quantity(moving["speed at most"], units.SPEED, Place()) == moves.REACHING_MPS
    bound = units.parse_quantity(moving["acceleration at most"], units.ACCELERATION, Place())
    assert bound == model.REACHING_MPS2
    top = {key: row.default for row in rows("## Top of the file") for key in row.keys}
    assert top["avoider"] == model.DEFAULT_AVOIDER
    assert {key for key in top if top[key] == "required"} == set(BASE)


def test_the_table_of_units_is_complete() -> None:
    section = TEXT.split("## Values", 1)[1].split("\n## ", 1)[0]
    table = {cells[1].strip(): cells for line in section.splitlines() if len(cells := line.split("|")) == 6}
    for dimension in (value for value in vars(units).values() if isinstance(value, Dimension)):
        _, _, allowed, example, bounds, _ = table[dimension.name]
        found = re.findall(r"[^\s,]+", allowed.replace("or no unit", "").replace("no unit", ""))
        assert found == list(dimension.units)
        assert units.parse_quantity(example, dimension, Place()) > 0.0
        assert bounds_of(bounds, dimension) == (dimension.least, dimension.most)


def bounds_of(text: str, dimension: Dimension) -> tuple[float, ...]:
    """``1 ms to 60 s`` in SI."""
    least, most = text.split(" to ")
    return tuple(units.parse_quantity(bound, dimension, Place()) for bound in (least, most))


@pytest.mark.parametrize("group", [*SETTINGS_KEYS, "object", "camera", "hand sensor"])
def test_the_tables_have_every_keys_own_bounds_and_no_others(group: str) -> None:
    at_the_top = group in ("object", "camera", "hand sensor")
    table = {row.keys: row.value for row in rows(f"## `{group}`" if at_the_top else f"### `{group}`")}
    kind = type(getattr(DEFAULTS, group.replace(" ", "_")))
    for field, key in zip(fields(kind), setting_keys(kind), strict=True):
        _, comma, told = table[key.path].rpartition(", ")
        if field.metadata["least"] is not None:
            number = number_of(key)
            bounds = (number.least, number.most)
            assert bounds_of(told.removeprefix("each "), number.dimension) == bounds, key.path
        else:
            assert not comma or " to " not in told
