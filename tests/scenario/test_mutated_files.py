"""A thousand spoilt files: each is refused with its reasons, or is a scenario that shows what was changed.

Never a traceback, a hang or a silent default.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from copy import deepcopy
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, example, given
from hypothesis import settings as hypothesis_settings
from hypothesis import strategies as st
from scenario_strategies import RECORDINGS
from scenario_texts import FILE, VALID

from safety_harness.base.exceptions import InputError, RecordingError, ScenarioError
from safety_harness.scenario.files import decode
from safety_harness.scenario.layout import laid_out, meaning
from safety_harness.scenario.model import Scenario
from safety_harness.scenario.nodes import Mapping, Node, Scalar, parse_tree
from safety_harness.scenario.read import parse_scenario
from safety_harness.scenario.write import write_scenario

SHIPPED = Path(__file__).parents[2] / "scenarios"
TEXTS = [
    VALID,
    *(
        (SHIPPED / f"{name}.yaml").read_text()
        for name in (
            "between-two-hands",
            "rendered-images",
            "nothing-reachable",
            "wrong-hand-eye-calibration",
        )
    ),
]
ORIGINALS = [parse_scenario(text, FILE, RECORDINGS) for text in TEXTS]


def quick(examples: int) -> hypothesis_settings:
    return hypothesis_settings(
        max_examples=examples,
        deadline=None,
        suppress_health_check=[HealthCheck.too_slow, HealthCheck.data_too_large],
    )


def outcome(data: bytes) -> Scenario | InputError:
    """What reading gives; anything else than these two is a defect and is raised."""
    try:
        return parse_scenario(decode(data, most=10**6, file=FILE, error=ScenarioError), FILE, RECORDINGS)
    except (ScenarioError, RecordingError) as error:
        return error


def check(found: Scenario | InputError) -> None:
    """A clear error, or a scenario that can be written and read again."""
    if isinstance(found, Scenario):
        assert parse_scenario(write_scenario(found), FILE, RECORDINGS) == found
        return
    assert found.expected
    assert found.got
    assert len(str(found)) < 5_000
    assert str(found).isprintable()
    assert found.place.file is not None


SLIPS = [
    *":-[]{},#&*!|>'\"%@`?\\~=<.",
    "\n",
    " ",
    "  ",
    "\t",
    "\x00",
    "é",
    "\ufeff",
    "0",
    "9",
    "e",
    "m",
    "---\n",
]


@st.composite
def spoilt_bytes(draw: st.DrawFn) -> bytes:
    """A file with bytes, words, lines or indentations that slipped."""
    data = draw(st.sampled_from(TEXTS)).encode()
    for _ in range(draw(st.integers(1, 3))):
        at = draw(st.integers(0, max(len(data) - 1, 0)))
        to = min(len(data), at + draw(st.integers(0, 12)))
        kind = draw(st.sampled_from(["flip", "cut", "insert", "copy", "line", "indent", "end"]))
        if kind == "flip":
            data = data[:at] + bytes([draw(st.integers(0, 255))]) + data[at + 1 :]
        elif kind == "cut":
            data = data[:at] + data[to:]
        elif kind == "insert":
            data = data[:at] + draw(st.sampled_from(SLIPS)).encode() + data[at:]
        elif kind == "copy":
            there = draw(st.integers(0, len(data)))
            data = data[:there] + data[at:to] + data[there:]
        elif kind == "end":
            data = data[:at]
        else:
            lines = data.split(b"\n")
            one, other = draw(st.tuples(*[st.integers(0, len(lines) - 1)] * 2))
            if kind == "line":
                lines[one], lines[other] = lines[other], lines[one]
            else:
                lines[one] = b" " * draw(st.integers(0, 9)) + lines[one].lstrip()
            data = b"\n".join(lines)
    return data


@quick(200)
@given(spoilt_bytes())
def test_a_spoilt_text_is_a_scenario_or_refused_with_its_reasons(data: bytes) -> None:
    check(outcome(data))


@dataclass
class Pairs:
    """A mapping that can be spoilt: a key may come twice."""

    pairs: list[list[Any]]


Tree = Any  # a text, a list of trees, or Pairs


def tree_of(node: Node) -> Tree:
    if isinstance(node, Scalar):
        return node.text
    if isinstance(node, Mapping):
        return Pairs([[key.text, tree_of(value)] for key, value in node.entries])
    return [tree_of(item) for item in node.items]


def text_of(tree: Tree) -> str:
    """YAML on one line, which is JSON but for keys that come twice."""
    if isinstance(tree, Pairs):
        return "{" + ", ".join(f"{json.dumps(key)}: {text_of(value)}" for key, value in tree.pairs) + "}"
    return "[" + ", ".join(map(text_of, tree)) + "]" if isinstance(tree, list) else json.dumps(tree)


def slots(tree: Tree) -> Iterator[tuple[list[Any], int, bool]]:
    """Every item of a list and every pair of a mapping: its list, its place, whether it is a pair."""
    if isinstance(tree, Pairs):
        for at, (_, value) in enumerate(tree.pairs):
            yield tree.pairs, at, True
            yield from slots(value)
    elif isinstance(tree, list):
        for at, value in enumerate(tree):
            yield tree, at, False
            yield from slots(value)


VALUES = """
0 1 -1 7 0.5 1e9 1e-9 1e400 nan inf 99999999999999999999 0x10 07 1_000 true null ~ yes holds ideal
0 mm 1 mm -1 mm 80 mn 5 mmm 0.1 s 2 s 61 min 5 % 105 % 30 Hz 1 m/s 3 mps 1 m/s2 9 deg 361 deg 1 rad 2 px
every tick|overhead|raster|../../etc/passwd|/dev/zero|x.py:X|a.safetensors|walks/walk.csv|right hand
"""
POOL: list[Tree] = [
    *VALUES.split("\n")[1].split(" "),
    *[" ".join(pair) for pair in zip(*[iter(VALUES.split("\n")[2].split(" "))] * 2, strict=True)],
    *VALUES.split("\n")[3].split("|"),
    "",
    " ",
    "a" * 3_000,
    "from 1 s to 2 s",
    "one of 1 mm, 2 mm",
    [],
    ["1 mm"],
    ["0 mm"] * 3,
    ["0 deg"] * 6,
    Pairs([]),
    Pairs([["wait", "1 s"]]),
    Pairs([["extends", "base.yaml"]]),
]
KEYS = [
    "extends",
    "matrix",
    "suite",
    "scenario",
    "wait",
    "speed",
    "rate",
    "hand",
    "hands",
    "joints",
    "offset",
    "",
    "x",
]


@st.composite
def spoilt_trees(draw: st.DrawFn) -> tuple[int, Tree]:
    """Which file it was, and its tree with parts dropped, doubled, swapped, renamed, retyped or changed."""
    number = draw(st.integers(0, len(TEXTS) - 1))
    tree = tree_of(parse_tree(TEXTS[number], FILE))
    for _ in range(draw(st.integers(1, 2))):
        inside, at, is_pair = (
            draw(st.sampled_from(list(slots(tree)))) if list(slots(tree)) else ([], 0, False)
        )
        kind = draw(
            st.sampled_from(["drop", "double", "swap", "rename", "wrap", "change", "change", "change"])
        )
        other = draw(st.integers(0, max(len(inside) - 1, 0)))
        if not inside:
            break
        if kind == "drop":
            del inside[at]
        elif kind == "double":
            inside.insert(other, inside[at])
        elif kind == "swap":
            inside[at], inside[other] = inside[other], inside[at]
        elif kind == "rename" and is_pair:
            inside[at] = [draw(st.sampled_from([*KEYS, inside[at][0][1:]])), inside[at][1]]
        else:
            value = (
                [inside[at][1] if is_pair else inside[at]]
                if kind == "wrap"
                else deepcopy(draw(st.sampled_from(POOL)))
            )
            inside[at] = [inside[at][0], value] if is_pair else value
    return number, tree


@quick(250)
@given(spoilt_trees())
def test_a_spoilt_tree_is_refused_or_shows_in_the_scenario(spoilt: tuple[int, Tree]) -> None:
    """No silent default: what was changed and is not refused makes another scenario."""
    number, tree = spoilt
    text = text_of(tree) + "\n"
    found = outcome(text.encode())
    check(found)
    if isinstance(found, Scenario) and found == ORIGINALS[number]:
        same = meaning(parse_tree(text, FILE)), meaning(parse_tree(TEXTS[number], FILE))
        assert without_digest(same[0]) == without_digest(same[1])


def without_digest(said: object) -> object:
    """A file without its recordings' digests means the same as long as the recording is the same."""
    if isinstance(said, dict):
        return {key: without_digest(value) for key, value in said.items() if key != "sha256"}
    return [without_digest(one) for one in said] if isinstance(said, list) else said


@quick(100)
@given(spoilt_bytes())
@example(b"---\n")
@example(b"a: [200 mm starts at: , 0 mm]\nb: {x: , y: 2}\n")
def test_a_spoilt_text_that_is_a_tree_can_be_laid_out_and_means_the_same(data: bytes) -> None:
    try:
        text = decode(data, most=10**6, file=FILE, error=ScenarioError)
        before = meaning(parse_tree(text, FILE))
    except ScenarioError:
        return
    after = laid_out(text, FILE)
    assert meaning(parse_tree(after, FILE)) == before
    assert laid_out(after, FILE) == after


@pytest.mark.parametrize(
    "text",
    [
        "a: " + "[" * 100_000,
        "- " * 50_000,
        "{" * 50_000,
        "? " * 50_000,
        "a: &a [x]\n" + "b: [*a]\n" * 1_000,
        'scenario: "' + "\\x41" * 100_000 + '"\n',
        "k: |\n" + " x\n" * 100_000,
        "".join(f"k{n}: 1\n" for n in range(8_000)),
        "hands: [" + "{}, " * 20_000 + "]\n",
        "duration: " + "9" * 200_000 + " s\n",
        "#" * 900_000,
    ],
    ids=lambda text: text[:12],
)
def test_a_bomb_does_not_go_off(text: str) -> None:
    check(outcome(text.encode()))
