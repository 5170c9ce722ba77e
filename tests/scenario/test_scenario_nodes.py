from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import settings as hypothesis_settings
from hypothesis import strategies as st

from safety_harness.base.exceptions import ScenarioError
from safety_harness.scenario.nodes import Mapping, Node, Scalar, Sequence, parse_tree

FILE = Path("example.yaml")


def refusal(text: str) -> ScenarioError:
    with pytest.raises(ScenarioError) as caught:
        parse_tree(text, FILE)
    assert caught.value.place.file == FILE
    return caught.value


def plain(node: Node) -> object:
    """The tree without its lines."""
    if isinstance(node, Scalar):
        return node.text
    if isinstance(node, Sequence):
        return [plain(item) for item in node.items]
    return {key.text: plain(value) for key, value in node.entries}


def test_a_text_is_parsed_once_for_each_file() -> None:
    tree = parse_tree("a: 1 s", FILE)
    assert parse_tree("a: 1 s", FILE) is tree
    assert parse_tree("a: 1 s", None) is not tree


def test_every_node_knows_its_line() -> None:
    tree = parse_tree("a: 1 s\nb:\n  - [1 m,\n     2 m]\n  - c: x\n", FILE)
    assert isinstance(tree, Mapping)
    (a, one), (b, items) = tree.entries
    assert (a.line, b.line) == (1, 2)
    assert one == Scalar("1 s", 1)
    assert isinstance(items, Sequence)
    first, second = items.items
    assert isinstance(first, Sequence)
    assert [item.line for item in first.items] == [3, 4]
    assert second.line == 5


def test_values_stay_text() -> None:
    text = "a: 0x10\nb: yes\nc: 1e3\nd: ~\ne: 2024-01-01\n"
    assert plain(parse_tree(text, FILE)) == {"a": "0x10", "b": "yes", "c": "1e3", "d": "~", "e": "2024-01-01"}


def test_a_missing_value_stands_on_its_keys_line() -> None:
    tree = parse_tree("a:\n\n\nb: 1\n", FILE)
    assert isinstance(tree, Mapping)
    assert tree.entries[0][1] == Scalar("", 1)


@pytest.mark.parametrize(
    ("style", "text"), [("|", "one\ntwo"), (">", "one two"), (">+", "one two"), ("|-", "one\ntwo")]
)
def test_a_block_text_ends_without_a_line_break(style: str, text: str) -> None:
    assert plain(parse_tree(f"a: {style}\n  one\n  two\n\n", FILE)) == {"a": text}


@pytest.mark.parametrize(
    ("text", "line", "field", "expected", "got"),
    [
        ("a: 1\nb: 2\na: 3\n", 3, "a", "each key once", '"a" a second time (first on line 1)'),
        ("a:\n  - {b: 1, b: 2}\n", 2, "a[0].b", "each key once", '"b" a second time (first on line 2)'),
        ("a: 1\nb: &x 2\n", 2, "b", "a value without an anchor", "the anchor &x"),
        ("a: 1\nb: *x\n", 2, "b", "the value itself", "the alias *x"),
        ("a: &x [1]\nb: [*x, *x]\n", 1, "a", "a value without an anchor", "the anchor &x"),
        (
            "a: 1\nb: !!python/object:os.system x\n",
            2,
            "b",
            "a value without a tag",
            "the tag tag:yaml.org,2002:python/",
        ),
        ("a: !here {b: 1}\n", 1, "a", "a value without a tag", "the tag !here"),
        ("? [1, 2]\n: 3\n", 1, None, "a key of plain words", "a list or a mapping as a key"),
        ("a: 1\n---\nb: 2\n", 2, None, "one document", "a second one"),
        ("a: 1\n...\nb: 2\n", 3, None, "one document", "a second one"),
        ("", 1, None, "a scenario", "an empty file"),
        ("# nothing\n", 1, None, "a scenario", "an empty file"),
        ("a: 1\nb:\n\t- 2\n", 3, None, "spaces", "a tab"),
        ("a: 1\nb: [1, 2\nc: 3\n", 3, None, "well-formed YAML", "a syntax error: "),
        (
            "a: b: c\n",
            1,
            None,
            "well-formed YAML",
            "a syntax error: a line that does not continue the lines above",
        ),
        ("a: 1\nb: @x\n", 2, None, "well-formed YAML", "a syntax error: "),
        ("a: 1\nb: 'x\n", 3, None, "well-formed YAML", "a syntax error: "),
        ("a: 1\nb: \x07\n", 2, None, "well-formed YAML", "a syntax error: the character U+0007"),
        ('a: "\\Uffffffff"\n', None, None, "well-formed YAML", "a syntax error: "),
        ("%YAML 3.0\n---\na: 1\n", 1, None, "well-formed YAML", "a syntax error: "),
    ],
)
def test_what_the_language_does_not_need_is_refused(
    text: str, line: int | None, field: str | None, expected: str, got: str
) -> None:
    error = refusal(text)
    assert (error.place.line, error.place.field) == (line, field)
    assert error.expected == expected
    assert error.got.startswith(got)


@pytest.mark.parametrize("opening", ["[", "{a: ", "- "])
def test_deep_nesting_is_refused_before_it_costs_anything(opening: str) -> None:
    assert "levels" in refusal("a:\n  " + opening * 2000).expected


def test_an_alias_bomb_is_refused_at_its_first_anchor() -> None:
    bomb = "a: &a [x, x]\n" + "".join(
        f"{b}: &{b} [*{a}, *{a}]\n" for a, b in zip("abcdef", "bcdefg", strict=True)
    )
    assert refusal(bomb).place.line == 1


@hypothesis_settings(deadline=None, max_examples=300)
@given(st.text(st.sampled_from("ab:-[]{},#&*!|>'\"%@`?\\ \n0\ud800\ufeff\u2028"), max_size=40))
def test_any_text_is_a_tree_or_refused(text: str) -> None:
    try:
        tree = parse_tree(text, FILE)
    except ScenarioError:
        return
    assert isinstance(tree, Scalar | Sequence | Mapping)
