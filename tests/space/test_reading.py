"""What a space may say and what not: each mistake has its line, its field and what to write instead."""

from __future__ import annotations

from pathlib import Path

import pytest
from spaces import EVERYTHING, FILES, HEAD, everything, of_duration

from safety_harness import parse_scenario
from safety_harness.base.exceptions import InputError, ScenarioError
from safety_harness.scenario.nodes import parse_tree
from safety_harness.space.distributions import Choice, InBox, InRegion, InShell, TruncatedNormal, Uniform
from safety_harness.space.read import parse_space, read_space
from safety_harness.space.template import Parameter


def parameters(text: str) -> dict[str, Parameter]:
    return {parameter.name: parameter for parameter in parse_space(text).parameters}


def with_start(start: str) -> str:
    return HEAD.replace("tcp start: {offset: [0 mm, 0 mm, 0 mm]}", f"tcp start: {start}")


def test_the_sentences_mean_what_they_say() -> None:
    assert of_duration("from 500 ms to 2 s").parameters[0].distribution == Uniform(0.5, 2.0, "s")
    normal = of_duration("normal 1 s +- 200 ms from 0.5 s to 2 s").parameters[0].distribution
    assert normal == TruncatedNormal(1.0, 0.2, 0.5, 2.0, "s")
    assert of_duration("normal 1 s ± 200 ms from 0.5 s to 2 s").parameters[0].distribution == normal
    assert of_duration("one of 1 s, 2 s").parameters[0].distribution == Choice.even(("1 s", "2 s"))


def test_the_mappings_mean_what_they_say() -> None:
    (box,) = parameters(with_start("{offset: {box: [[-1 cm, 0 mm, 0 mm], [1 cm, 2 cm, 3 cm]]}}")).values()
    assert box.distribution == InBox((-0.01, 0.0, 0.0), (0.01, 0.02, 0.03), "m")
    (shell,) = parameters(with_start("{offset: {shell: [0 mm, 0 mm, 5 cm], from: 1 cm, to: 2 cm}}")).values()
    assert shell.distribution == InShell((0.0, 0.0, 0.05), 0.01, 0.02, "m")
    (region,) = parameters(with_start("{offset: {in: seen tcp}}")).values()
    assert isinstance(region.distribution, InRegion)
    assert region.distribution.known.outer.high_m == (0.06, 0.15, 0.1)  # a shift from the desired TCP


def test_a_region_of_hands_is_where_the_hands_are() -> None:
    space = read_space(next(file for file in FILES if file.stem == "nominal"))
    (place,) = (p.distribution for p in space.parameters if p.name == "hands[0].moves[1].move to")
    assert isinstance(place, InRegion)
    assert place.known.outer.low_m == pytest.approx((0.54, -0.65, -0.295))


def test_parameters_are_named_by_their_path_in_the_file() -> None:
    names = [parameter.name for parameter in everything().parameters]
    assert names[:3] == ["choices.side", "choices.reach speed", "choices.start.right[1]"]
    assert "hands[0].moves[1].moves[1].one of[1].stop at distance, time 2" in names
    assert len(set(names)) == len(names)


def test_the_dimension_is_that_of_all_alternatives_and_repetitions() -> None:
    space = everything()
    repetition = 3 + 1 + 1 + 1 + 1  # a point, which move, its wait, its reach, its withdrawal
    # Duration, sensor and its noise, side, speed, two starts, offset, tilt, radius, name, wait, times, shell.
    assert space.dimension == 1 + 2 + 1 + 1 + 2 + 3 + 3 + 1 + 1 + 1 + 1 + 3 * repetition + 3


@pytest.mark.parametrize(
    ("sentence", "hint"),
    [
        ("from 2 s to 1 s", "from 1 s to 2 s"),
        ("from 1 s to 1 s", ""),
        ("from 1 to 2 s", "a number alone has no unit: from 0.5 m/s to 2 m/s"),
    ],
)
def test_a_mistaken_range_gets_a_hint(sentence: str, hint: str) -> None:
    with pytest.raises(ScenarioError) as caught:
        parse_space(HEAD.replace("duration: 5 s", f"duration: {sentence}"))
    assert caught.value.hint == hint


@pytest.mark.parametrize(
    ("sentence", "line", "field", "words"),
    [
        ("from 1 s", 2, "duration", "both ends, such as"),
        ("from 2 s to 1 s", 2, "duration", "a lower end, then a higher one"),
        ("from 1 s to 1 s", 2, "duration", "a lower end, then a higher one"),
        ("from 1 to 2 s", 2, "duration", "quantities of one kind"),
        ("from 1 s to 2 m", 2, "duration", "quantities of one kind"),
        ("from 1 s to 2 sec", 2, "duration", "a quantity such as"),
        ("from 1 m/s to 2 m/s", 2, "duration", "expected a time such as"),
        ("from 0 s to 2 s", 2, "duration", "above 0"),
        ("from 1 s to 2 s to 3 s", 2, "duration", "a quantity such as"),
        ("from 1 s to 9999 s", 2, "duration", "at most 3600"),
        ("from 1 s to nan s", 2, "duration", "a quantity such as"),
        ("normal 1 s +- 0 s from 0.5 s to 2 s", 2, "duration", "a deviation above zero"),
        ("normal 1 s from 0.5 s to 2 s", 2, "duration", "a mean, a deviation and both ends"),
        ("normal 1 s +- 0.1 s from 3 s to 4 s", 2, "duration", "at least 1e-06"),
        ("one of 1 s", 2, "duration", "from 2 to 100 options; got 1"),
        ("one of 1 s,", 2, "duration", "two or more"),
        ("one of 1 s, 1 s", 2, "duration", "options that differ"),
        ("one of 1 s, 2 m", 2, "duration", "expected a time such as"),
        ("one of " + ", ".join(f"{k} s" for k in range(1, 102)), 2, "duration", "from 2 to 100 options"),
        ("the reach time", 2, "duration", "a name below choices, which has none"),
        ("{one of: [1 s, 2 s], chances: [1]}", 2, "duration.chances", "a list of 2 chances"),
        ("{one of: [1 s, 2 s], chances: [1, 0]}", 2, "duration.chances[1]", "a list of 2 chances"),
        ("{one of: [1 s, 2 s], chance: [1, 2]}", 2, "duration.chance", 'did you mean "chances"?'),
        ("{one of: []}", 2, "duration.one of", "from 2 to 100 options"),
        ("{by: side, left: 1 s}", 2, "duration.by", "a name below choices"),
        ("{box: [[1 m, 1 m, 1 m]]}", 2, "duration.box", "two corners"),
        (
            "{box: [[1 m, 1 m, 1 m], [2 m, 1 m, 2 m]]}",
            2,
            "duration.box",
            "each coordinate of the second larger",
        ),
        ("{box: [[1 m, 1 m, 1 s], [2 m, 2 m, 2 s]]}", 2, "duration.box[0]", "three quantities of one kind"),
        ("{in: unseen hands}", 2, "duration.in", 'did you mean "unseen hand"?'),
        ("{shell: [0 m, 0 m, 0 m], from: 2 m, to: 1 m}", 2, "duration", "two radii"),
        ("{shell: [0 m, 0 m, 0 m], from: 2 m}", 2, "duration.to", 'the key "to"'),
    ],
)
def test_a_mistake_has_its_line_its_field_and_what_is_expected(
    sentence: str, line: int, field: str, words: str
) -> None:
    text = HEAD.replace("duration: 5 s", f"duration: {sentence}")
    with pytest.raises(ScenarioError) as caught:
        parse_space(text, Path("a.yaml"))
    assert (caught.value.place.line, caught.value.place.field) == (line, field)
    assert words in str(caught.value)


CHOICES = HEAD + "choices: {side: 'one of left, right', speed: from 1 m/s to 2 m/s}\n"


@pytest.mark.parametrize(
    ("text", "field", "words"),
    [
        (HEAD, None, "values that vary"),
        (HEAD.replace("scenario space", "scenario"), None, 'the key "scenario space"'),
        (HEAD + "scenario: both\n", "scenario", 'the key "scenario space" alone'),
        (HEAD.replace("a test", "''").replace("5 s", "one of 1 s, 2 s"), "scenario", "a title"),
        (CHOICES, "choices.side", "a choice that is used below"),
        (HEAD + "choices: {side: left}\n", "choices.side", "a value that varies"),
        (HEAD + "choices: [left]\n", "choices", "a mapping of names and values"),
        (HEAD + "choices: {a: {in: seen hand}}\n", "choices.a.in", "where the point itself stands"),
        (
            CHOICES.replace("5 s", "{by: side, left: 1 s, rihgt: 2 s}"),
            "duration.rihgt",
            'did you mean "right"?',
        ),
        (CHOICES.replace("5 s", "{by: side, left: 1 s}"), "duration", "a value for each of left, right"),
        (CHOICES.replace("5 s", "{by: speed, left: 1 s}"), "duration.by", "a choice of words"),
        (CHOICES.replace("5 s", "the sped"), "duration", 'did you mean "speed"?'),
        (
            CHOICES.replace("side: 'one of left, right', ", "").replace("5 s", "the speed"),
            "duration",
            "expected a time such as",
        ),
        (HEAD + "sede: one of 1, 2\n", "sede", 'did you mean "seed"?'),
        (HEAD + "seed: from 1 to 2\n", "seed", "a whole number"),
        (HEAD + "camera: {width: from 100 px to 200 px}\n", "camera.width", "a whole number of pixels"),
        (with_start("{offset: {in: seen tcp}}") + "avoider: one of optimum, ensemble\n", None, "that varies"),
        (
            with_start("{offset: {in: seen tcp}}")
            + "settings: {cell: {desired tcp position: [from 0.6 m to 0.7 m, 0 m, 0.3 m]}}\n",
            None,
            "that varies",
        ),
    ],
)
def test_a_mistake_of_the_whole_is_told(text: str, field: str | None, words: str) -> None:
    with pytest.raises(ScenarioError) as caught:
        parse_space(text)
    assert words in str(caught.value)
    if field is not None:
        assert caught.value.place.field == field


HANDS = (
    HEAD
    + """\
hands:
  - hand: right
    starts at: [1.2 m, -0.7 m, 100 mm]
    elbow towards: [1.6 m, -1.2 m, 300 mm]
    moves:
      - wait: 1 s
      - {repeat: TIMES, moves: [{wait: from 1 s to 2 s}]}
"""
)


@pytest.mark.parametrize(
    "times", ["from 2 to 1 times", "often", "21 times", "from 0 to 21 times", "0 times", "from 1 s to 2 s"]
)
def test_repetitions_are_bounded(times: str) -> None:
    with pytest.raises(ScenarioError, match=r"from 1 to 4 times") as caught:
        parse_space(HANDS.replace("TIMES", times))
    assert caught.value.place == caught.value.place.__class__(None, 11, "hands[0].moves[1].repeat")


@pytest.mark.parametrize(
    ("times", "dimension"), [("3 times", 3), ("from 3 to 3 times", 3), ("from 0 to 1 times", 2)]
)
def test_repetitions_are_counted(times: str, dimension: int) -> None:
    assert parse_space(HANDS.replace("TIMES", times)).dimension == dimension


def test_only_moves_are_repeated_and_something_is() -> None:
    with pytest.raises(ScenarioError, match='did you mean "moves"'):
        parse_space(HANDS.replace("TIMES, moves", "2 times, mvoes"))
    with pytest.raises(ScenarioError, match="the list that is repeated"):
        parse_space(HANDS.replace("[{wait: from 1 s to 2 s}]", "[]").replace("TIMES", "2 times"))


def test_a_space_is_bounded() -> None:
    repeated = "{repeat: 20 times, moves: [{wait: from 1 s to 2 s}]}"
    for _ in range(2):
        repeated = f"{{repeat: 20 times, moves: [{repeated}]}}"
    with pytest.raises(ScenarioError, match="at most 256 values that vary"):
        parse_space(HANDS.replace("{repeat: TIMES, moves: [{wait: from 1 s to 2 s}]}", repeated))


def test_what_would_grow_without_end_is_refused() -> None:
    repeated = "{wait: 1 s}"
    for _ in range(5):
        repeated = f"{{repeat: 20 times, moves: [{repeated}]}}"
    with pytest.raises(ScenarioError, match="at most 5,000 moves by repeating"):
        parse_space(HANDS.replace("{repeat: TIMES, moves: [{wait: from 1 s to 2 s}]}", repeated))
    words = [f"w{k}" for k in range(50)]
    lines = [f"  word: one of {', '.join(words)}", "  v0: from 1 s to 2 s"]
    for k in range(1, 5):
        options = ", ".join(f"{word}: the v{k - 1}" for word in words)
        lines.append(f"  v{k}: {{by: word, {options}}}")
    with pytest.raises(ScenarioError, match="at most 2,000 uses of named values"):
        parse_space(HEAD.replace("5 s", "the v4") + "choices:\n" + "\n".join(lines) + "\n")


def test_what_only_two_values_together_make_impossible_is_refused() -> None:
    text = HANDS.replace("[1.6 m, -1.2 m, 300 mm]", "[from 1.2 m to 1.3 m, -0.7 m, 100 mm]")
    with pytest.raises(ScenarioError, match="a point other than where the hand starts"):
        parse_space(text.replace("TIMES", "2 times"))


def test_a_line_of_the_file_is_named_also_below_alternatives_and_repetitions() -> None:
    text = EVERYTHING.replace("from 0.2 m/s to 0.4 m/s", "from 0.2 m/s to 40 m/s")
    line = 1 + next(k for k, row in enumerate(text.splitlines()) if "40 m/s" in row)
    with pytest.raises(ScenarioError, match="at most 20") as caught:
        parse_space(text, Path("a.yaml"))
    assert (caught.value.place.file, caught.value.place.line) == (Path("a.yaml"), line)


@pytest.mark.parametrize("file", FILES, ids=lambda file: file.stem)
def test_a_space_is_no_scenario(file: Path) -> None:
    with pytest.raises(ScenarioError, match="a scenario space") as caught:
        parse_scenario(file.read_text(), file)
    assert "sample" in caught.value.hint
    assert caught.value.place.line == 1


@pytest.mark.parametrize(
    ("value", "field"),
    [
        ("from 1 s to 2 s", "duration"),
        ("normal 1 s +- 0.2 s from 0.5 s to 2 s", "duration"),
        ("one of 1 s, 2 s", "duration"),
        ("{one of: [1 s, 2 s]}", "duration"),
        ("{in: seen hand}", "duration"),
    ],
)
def test_a_distribution_in_a_scenario_file_is_refused_with_a_hint(value: str, field: str) -> None:
    text = HEAD.replace("scenario space", "scenario").replace("duration: 5 s", f"duration: {value}")
    with pytest.raises(ScenarioError, match="expected one value") as caught:
        parse_scenario(text)
    assert (caught.value.place.line, caught.value.place.field) == (2, field)
    assert 'begins with "scenario space:"' in caught.value.hint


def test_titles_and_notes_may_say_anything() -> None:
    text = HEAD.replace("a test", "from 1 s to 2 s").replace("scenario space", "scenario")
    assert parse_scenario(text + "about: one of many, or the first\n").title == "from 1 s to 2 s"


@pytest.mark.parametrize("text", ["", "- 1\n", "a\n", "scenario space\n", "? [a]\n: b\n"])
def test_what_is_no_mapping_is_refused(text: str) -> None:
    with pytest.raises(InputError):
        parse_space(text)


def test_a_missing_file_and_a_wrong_one_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ScenarioError, match=r"none\.yaml"):
        read_space(tmp_path / "none.yaml")
    (tmp_path / "bytes.yaml").write_bytes(b"\xff\xfe")
    with pytest.raises(ScenarioError, match=r"bytes\.yaml"):
        read_space(tmp_path / "bytes.yaml")


def test_the_tree_is_kept_as_it_was_written() -> None:
    assert everything().tree == parse_tree(EVERYTHING, None)
