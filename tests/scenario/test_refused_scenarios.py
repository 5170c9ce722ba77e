from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given
from hypothesis import settings as hypothesis_settings
from hypothesis import strategies as st
from scenario_strategies import number_of
from scenario_texts import FILE, SHORTEST, VALID, changed, line_of, parse, refusal

from safety_harness.base.exceptions import InputError, Place, RecordingError, ScenarioError
from safety_harness.base.settings import DEFAULTS
from safety_harness.scenario.codec import Key
from safety_harness.scenario.model import Scenario
from safety_harness.scenario.settings_keys import SETTINGS_KEYS, TOP_GROUPS, setting_keys
from safety_harness.scenario.units import format_quantity


@dataclass(frozen=True)
class Mistake:
    """One of mistakes.txt."""

    text: str
    line: int
    message: str  # its beginning: "field: expected ...; got ..."


def mistake(case: str) -> Mistake:
    said = {sign: [line[2:] for line in case.splitlines() if line[0] == sign] for sign in "-+@!"}
    old, new = "\n".join(said["-"]), "\n".join(said["+"])
    text = changed(old, new)
    return Mistake(text, line_of(text, *said["@"]) if said["@"] else line_of(VALID, old), said["!"][0])


GROUPS = (*SETTINGS_KEYS, *TOP_GROUPS)
CASES = (Path(__file__).parent / "mistakes.txt").read_text().split("\n\n")[1:]
MISTAKES = [mistake(case) for case in CASES]


@pytest.mark.parametrize("mistake", MISTAKES, ids=lambda mistake: mistake.message)
def test_a_mistake_is_refused_with_line_field_expected_and_got(mistake: Mistake) -> None:
    error = refusal(mistake.text)
    field, _, sentence = mistake.message.partition(": expected ")
    expected, _, got = sentence.partition("; got ")
    assert error.place == Place(file=FILE, line=mistake.line, field=field)
    assert error.expected.startswith(expected)
    assert error.got.startswith(got)


def test_the_corpus_of_mistakes_is_not_empty() -> None:
    assert len(MISTAKES) > 50


@pytest.mark.parametrize(
    ("old", "new", "hint"),
    [
        ("duration: 12 s", "durations: 12 s", 'did you mean "duration"?'),
        ("speed: 0.5 m/s", "sped: 0.5 m/s", 'did you mean "speed"?'),
        ("speed: 0.5 m/s", "speed: 0.5 mps", "allowed units: m/s, cm/s, mm/s, km/h"),
        ("- wait: 1 s", "- wiat: 1 s", 'did you mean "wait"?'),
        ("track: left hand", "track: left hnd", 'did you mean "left_hand"?'),
        ("interaction: mean", "interaction: meen", 'did you mean "mean"?'),
        ("kind: overhead", "kind: Overhead", 'did you mean "overhead"?'),
        ("  servo: {interaction: mean}", "  gain far: 0.3", "write servo: {gain far: ...}"),
        (
            "  servo: {interaction: mean}",
            "  cell: {object yaw: 10 deg}",
            "object: {yaw: ...} at the top of the file",
        ),
        ("- reach for object: 0.8", "- reach for objekt: 0.8", 'did you mean "reach for object"?'),
        ("- wander: 0.9", "- wandr: 0.9", 'did you mean "wander"?'),
        ("{amplitude: 3 mm", "{amplitud: 3 mm", 'did you mean "amplitude"?'),
        (
            "  servo: {interaction: mean}",
            "  camera: {rate: 30 Hz}",
            '"camera:" stands at the top of the file',
        ),
    ],
)
def test_a_near_miss_gets_advice(old: str, new: str, hint: str) -> None:
    assert hint in refusal(changed(old, new)).hint


def test_more_control_periods_than_a_trace_holds_are_refused() -> None:
    text = SHORTEST.replace("1 s", "20 min") + "settings: {clock: {control period: 1 ms}}\n"
    error = refusal(text)
    assert error.place == Place(file=FILE, line=2, field="duration")
    assert (error.expected, error.got) == ("at most 1,000,000 control periods", "20 min")


def test_an_elbow_point_on_the_way_of_a_recorded_hand_is_refused_where_it_stands() -> None:
    where = "elbow towards: [1.4 m, -0.9 m, 200 mm]"  # where the hand starts
    text = changed("elbow track: right elbow", where)
    error = refusal(text)
    assert error.place == Place(file=FILE, line=line_of(text, where), field="hands[1].elbow towards")
    assert "walk.csv" in error.expected


@pytest.mark.parametrize("group", GROUPS)
def test_every_number_of_the_settings_has_bounds_that_a_file_cannot_leave(group: str) -> None:
    """Just within its bounds a value is read, just beyond them refused, whatever the key."""
    default = getattr(DEFAULTS, {**SETTINGS_KEYS, **TOP_GROUPS}[group])
    for key in setting_keys(type(default)):
        value = getattr(default, key.attribute)
        if isinstance(value, Enum) or (isinstance(value, tuple) and isinstance(value[0], tuple)):
            continue
        bounds = number_of(key)
        for bound, beyond in ((bounds.least, -np.inf), (bounds.most, np.inf)):
            assert bound is not None
            outside = bound + np.sign(beyond) if isinstance(value, int) else np.nextafter(bound, beyond)
            within, without = (setting_text(group, key, value, number) for number in (bound, float(outside)))
            assert parse(within)
            error = refusal(without)
            assert error.place.line == within.count("\n"), key
            assert error.place.field is not None
            assert error.place.field.partition("[")[0].endswith(key.name)


def setting_text(group: str, key: Key, default: object, number: float) -> str:
    """The shortest file with one setting."""
    dimension = number_of(key).dimension
    whole = isinstance(default, int)
    value = f"{int(number)} {dimension.si}" if whole else format_quantity(number, dimension)
    if isinstance(default, tuple):
        value = f"[{', '.join([value] * len(default))}]"
    for word in reversed(key.path):
        value = f"{{{word}: {value}}}"
    return SHORTEST.replace("1 s", "2 s") + (
        f"{group}: {value}\n" if group in TOP_GROUPS else f"settings: {{{group}: {value}}}\n"
    )


def test_a_ninth_hand_is_refused() -> None:
    hand = "  - {hand: NAME, starts at: [1 m, 0 m, 0 m], elbow towards: [2 m, 0 m, 0 m], moves: []}\n"
    text = SHORTEST + "hands:\n" + "".join(hand.replace("NAME", name) for name in "abcdefghi")
    error = refusal(text)
    assert (error.place.field, error.expected, error.got) == (
        "hands",
        "a list of at most 8 hands",
        "a list of 9",
    )


def test_a_scenario_without_claims_is_refused() -> None:
    error = refusal(SHORTEST.replace("{gain switch reached: holds}", "{}"))
    assert (error.place.line, error.place.field, error.got) == (4, "claims", "an empty mapping")


@pytest.mark.parametrize(("text", "got"), [("[1, 2]", "a list of 2"), ("hello", "hello")])
def test_a_file_that_is_no_mapping_is_refused(text: str, got: str) -> None:
    error = refusal(text)
    assert (error.place.line, error.got) == (1, got)
    assert error.expected.startswith("a mapping with the keys scenario, about, duration")


@pytest.mark.parametrize("character", ["\\x07", "\\ud800", "\\u2028"])
def test_a_title_with_control_characters_is_refused(character: str) -> None:
    error = refusal(SHORTEST.replace("nothing happens", f'"a{character}b"'))
    assert (error.place.line, error.place.field) == (1, "scenario")
    assert error.got.startswith("a text with the character U+")


LINES = VALID.splitlines()
WORDS = r"""
: - [ ] { } , # &a *a !t | > ' " % ~ null 0 -1 1e309 nan .inf mm m/s deg x ² \ ../.. /dev/zero --- ... ?
<<: hands moves
"""
TOKENS = [
    *WORDS.split(),
    "",
    " ",
    "  ",
    "\n",
    "\t",
    "\x00",
    "\ufeff",
    "\ud800",
    ": ",
    "- ",
    "0 m",
    "1 s",
    "recording: x",
]


@st.composite
def broken_texts(draw: st.DrawFn) -> str:
    """The valid file after a few slips of the editor."""
    lines = list(LINES)
    for _ in range(draw(st.integers(min_value=1, max_value=4))):
        at = draw(st.integers(min_value=0, max_value=len(lines) - 1))
        slip = draw(st.sampled_from(["delete", "duplicate", "swap", "indent", "insert", "replace", "cut"]))
        line, column = lines[at], draw(st.integers(min_value=0, max_value=len(lines[at])))
        token = draw(st.sampled_from(TOKENS))
        if slip == "delete" and len(lines) > 1:
            del lines[at]
        elif slip == "duplicate":
            lines.insert(draw(st.integers(min_value=0, max_value=len(lines))), line)
        elif slip == "swap":
            other = draw(st.integers(min_value=0, max_value=len(lines) - 1))
            lines[at], lines[other] = lines[other], line
        elif slip == "indent":
            lines[at] = " " * draw(st.integers(min_value=0, max_value=8)) + line.lstrip()
        elif slip == "insert":
            lines[at] = line[:column] + token + line[column:]
        elif slip == "replace":
            words = line.split(" ")
            words[draw(st.integers(min_value=0, max_value=len(words) - 1))] = token
            lines[at] = " ".join(words)
        else:
            lines[at] = line[:column]
    return "\n".join(lines) + "\n"


@hypothesis_settings(deadline=None, max_examples=200, suppress_health_check=[HealthCheck.too_slow])
@given(broken_texts())
def test_a_broken_file_is_a_scenario_or_refused_with_its_reasons(text: str) -> None:
    outcome = read(text)
    if isinstance(outcome, Scenario):
        assert outcome.ticks > 0
    else:
        assert outcome.expected
        assert outcome.got
        assert outcome.place.line is None or 1 <= outcome.place.line <= text.count("\n") + 1
        assert outcome.place.file is not None


def read(text: str) -> Scenario | InputError:
    try:
        return parse(text)
    except (ScenarioError, RecordingError) as error:
        return error
