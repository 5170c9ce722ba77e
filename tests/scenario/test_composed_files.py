"""``extends``, ``without``, ``matrix`` and suites: what they mean, and where their mistakes are shown."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
from scenario_strategies import RECORDING
from scenario_texts import VALID

from safety_harness.base.exceptions import InputError, Place
from safety_harness.scenario import compose, expand
from safety_harness.scenario.compose import MOST_COMBINATIONS
from safety_harness.scenario.expand import gather, read_all_scenarios
from safety_harness.scenario.model import MovingHand, OffsetStart, RecordedHand, Verdict
from safety_harness.scenario.read import parse_scenario, read_scenario
from safety_harness.scenario.write import write_scenario

BASE = """\
scenario: the base
duration: 1 s
seed: 3
tcp start: {offset: [10 mm, 0 mm, 0 mm], tilt: [0 deg, 1 deg, 0 deg]}
settings:
  avoidance: {critical distance: 300 mm, radius: 90 mm}
hand sensor: {kind: overhead, rate: 30 Hz}
claims:
  gain switch reached: holds
  joint speeds within limits: holds
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    write(tmp_path, base=BASE)
    return tmp_path


def write(folder: Path, **texts: str) -> None:
    for name, text in texts.items():
        (folder / f"{name}.yaml").write_text(text)


def refusal(path: Path) -> InputError:
    with pytest.raises(InputError) as caught:
        read_all_scenarios(path)
    return caught.value


def test_what_a_file_does_not_say_is_what_the_extended_file_says(folder: Path) -> None:
    write(folder, more="extends: base.yaml\nscenario: more\nseed: 4\n")
    base, more = read_scenario(folder / "base.yaml"), read_scenario(folder / "more.yaml")
    assert (more.name, more.title, more.seed) == ("more", "more", 4)
    assert replace(more, name=base.name, title=base.title, seed=base.seed) == base


def test_mappings_are_merged_key_by_key_and_lists_replaced(folder: Path) -> None:
    write(
        folder,
        more="extends: base.yaml\ntcp start: {offset: [0 mm, 0 mm, 5 mm]}\n"
        "settings: {avoidance: {radius: 80 mm}}\nclaims: {gain switch reached: violated}\n",
    )
    more = read_scenario(folder / "more.yaml")
    assert isinstance(more.start, OffsetStart)
    assert more.start.offset_in_base_m == (0.0, 0.0, 0.005)
    assert more.start.tilt_in_tcp_rad[1] > 0.0
    assert more.settings.avoidance.radius_m == 0.08
    assert more.settings.avoidance.critical_distance_m == 0.3
    assert [(claim.sentence, claim.expected) for claim in more.claims] == [
        ("gain switch reached", Verdict.VIOLATED),
        ("joint speeds within limits", Verdict.HOLDS),
    ]


def test_without_drops_keys_and_claims_of_the_extended_file(folder: Path) -> None:
    write(
        folder,
        more="extends: base.yaml\nwithout: [hand sensor, tcp start, gain switch reached]\n"
        "tcp start: {joints: [-12 deg, -73 deg, 113 deg, -130 deg, -90 deg, -103 deg]}\n",
    )
    more = read_scenario(folder / "more.yaml")
    assert more.settings.hand_sensor.rate_hz is None
    assert not isinstance(more.start, OffsetStart)
    assert [claim.sentence for claim in more.claims] == ["joint speeds within limits"]


@pytest.mark.parametrize(
    ("text", "place", "got"),
    [
        ("seed: 1\nduration: 1 m\n", ("more", 3, "duration"), "1 m"),
        ("tcp start: {offset: [0 m]}\n", ("more", 2, "tcp start.offset"), "a list of 1"),
        ("tcp start:\n  joints: []\n", ("more", 3, "tcp start.joints"), "both"),
        ("settings: {avoidance: {radios: 1 mm}}\n", ("more", 2, "settings.avoidance.radios"), "the key"),
        ("without: [duration]\n", ("more", 1, "duration"), "only scenario"),
        ("without: [sed]\n", ("more", 2, "without[0]"), "sed"),
        ("without: []\n", ("more", 2, "without"), "an empty list"),
        ("settings: {avoidance: 3}\n", ("more", 2, "settings.avoidance"), "3"),
    ],
)
def test_a_mistake_is_shown_in_the_file_and_line_where_it_stands(
    folder: Path, text: str, place: tuple[str, int, str], got: str
) -> None:
    write(folder, more="extends: base.yaml\n" + text)
    error = refusal(folder / "more.yaml")
    file, line, field = place
    assert error.place == Place(folder / f"{file}.yaml", line, field)
    assert error.got.startswith(got)


def test_places_of_an_extended_scenario_name_both_files(folder: Path) -> None:
    write(folder, more="extends: base.yaml\nscenario: more\n")
    more = read_scenario(folder / "more.yaml")
    assert more.place("duration") == Place(folder / "base.yaml", 2, "duration")
    assert more.place("scenario") == Place(folder / "more.yaml", 2, "scenario")
    assert more.claims[0].place.file == folder / "base.yaml"


@pytest.mark.parametrize(
    ("text", "expected", "got"),
    [
        ("extends: more.yaml\n", "in a circle", "more.yaml extends more.yaml"),
        ("extends: gone.yaml\n", "a file that can be read", "no such file"),
        ("extends: [base.yaml]\n", "the file that this one extends", "a list of 1"),
        ("extends: suite.yaml\n", "a scenario file", "suite.yaml, which is none"),
        ("extends: list.yaml\n", "a scenario file", "list.yaml, which is none"),
        ("without: [seed]\n" + BASE, 'the key "extends"', '"without" alone'),
    ],
)
def test_what_cannot_be_extended_is_refused(folder: Path, text: str, expected: str, got: str) -> None:
    write(folder, more=text, suite="suite: s\nscenarios: [base.yaml]\n", list="[1]\n")
    error = refusal(folder / "more.yaml")
    assert (error.place.file, error.place.line) == (folder / "more.yaml", 1)
    assert expected in error.expected
    assert got in error.got


def test_a_circle_is_refused_by_the_names_in_it(folder: Path) -> None:
    write(folder, a="extends: b.yaml\n", b="extends: c.yaml\n", c="extends: a.yaml\n")
    error = refusal(folder / "a.yaml")
    assert error.got == "a.yaml extends b.yaml extends c.yaml extends a.yaml"
    assert error.place == Place(folder / "c.yaml", 1, "extends")


def test_eight_files_may_extend_each_other_and_nine_not(folder: Path) -> None:
    for number in range(1, 9):
        below = "base" if number == 1 else f"n{number - 1}"
        write(folder, **{f"n{number}": f"extends: {below}.yaml\n"})
    assert read_scenario(folder / "n7.yaml").title == "the base"
    assert "at most 8 files" in refusal(folder / "n8.yaml").expected


def test_files_that_a_base_names_are_sought_from_where_the_base_stands(tmp_path: Path) -> None:
    (tmp_path / "bases" / "walks").mkdir(parents=True)
    (tmp_path / "bases" / "walks" / "walk.csv").write_bytes(RECORDING)
    text = VALID.replace("avoider: nearest candidate", "avoider: mine/own.py:Own")
    write(tmp_path / "bases", base=text)
    write(tmp_path, more="extends: bases/base.yaml\nscenario: more\n")
    more = read_scenario(tmp_path / "more.yaml")
    assert more.avoider == "bases/mine/own.py:Own"
    assert isinstance(more.hands[1], RecordedHand)
    assert more.hands[1].recording == Path("bases/walks/walk.csv")
    assert more.hands[1].motion == read_scenario(tmp_path / "bases/base.yaml").hands[1].motion


MATRIX = """\
extends: base.yaml
scenario: several
matrix:
  sensor:
    ideal: {hand sensor: {kind: ideal, rate: every tick}}
    late:
      hand sensor:
        latency: 50 ms
  seed:
    one: {seed: 1}
    two: {seed: 2}
    three: {seed: 3}
"""


def test_a_matrix_is_one_scenario_for_each_combination(folder: Path) -> None:
    write(folder, several=MATRIX)
    found = read_all_scenarios(folder / "several.yaml")
    assert [one.name for one in found] == [
        f"several[{sensor},{seed}]" for sensor in ("ideal", "late") for seed in ("one", "two", "three")
    ]
    assert [one.seed for one in found] == [1, 2, 3, 1, 2, 3]
    assert [one.settings.hand_sensor.latency_s for one in found] == [0.0] * 3 + [0.05] * 3
    assert all(one.file == folder / "several.yaml" for one in found)


def test_an_expanded_scenario_is_written_complete_in_itself(folder: Path) -> None:
    write(folder, several=MATRIX)
    for one in read_all_scenarios(folder / "several.yaml"):
        again = parse_scenario(write_scenario(one), one.file, name=one.name)
        assert again == one


def test_a_matrix_is_not_one_scenario(folder: Path) -> None:
    write(folder, several=MATRIX)
    with pytest.raises(InputError, match="a matrix of 6"):
        read_scenario(folder / "several.yaml")


def test_a_matrix_of_an_extended_file_is_extended_with_it(folder: Path) -> None:
    write(folder, several=MATRIX, more="extends: several.yaml\nmatrix: {seed: {four: {seed: 4}}}\n")
    assert len(read_all_scenarios(folder / "more.yaml")) == 8
    write(folder, less="extends: several.yaml\nwithout: [matrix]\n")
    assert [one.name for one in read_all_scenarios(folder / "less.yaml")] == ["less"]


@pytest.mark.parametrize(
    ("matrix", "line", "field", "expected", "got"),
    [
        ("{}", 2, "matrix", "a mapping of axes", "an empty mapping"),
        ("[a]", 2, "matrix", "a mapping of axes", "a list of 1"),
        ("{a: {}}", 2, "matrix.a", "at least one label", "an empty mapping"),
        ("{a: {b: 1}}", 2, "matrix.a.b", "a mapping of the changes", "1"),
        ("{a: {b: }}", 2, "matrix.a.b", "a mapping of the changes", "nothing"),
        ("{a: {b/c: {}}}", 2, "matrix.a.b/c", "a label", "b/c"),
        ("{a: {..: {matrix: {}}}}", 2, "matrix.a....matrix", "keys of a scenario", 'the key "matrix"'),
        ("{a: {b: {extends: x}}}", 2, "matrix.a.b.extends", "keys of a scenario", 'the key "extends"'),
        (
            "{a: {b: {seed: 1}}, c: {d: {seed: 2}}}",
            2,
            "matrix.c",
            'axes that change different values; "a" changes seed',
            '"c", which changes seed',
        ),
        (
            "{a: {b: {settings: {servo: {}}}}, c: {d: {settings: {servo: {gain far: 1}}}}}",
            2,
            "matrix.c",
            'axes that change different values; "a" changes settings.servo',
            '"c", which changes settings.servo.gain far',
        ),
        ("\n  a:\n    b:\n      seed: x\n", 5, "seed", "a whole number", "x"),
        ("\n  a:\n    b:\n      sed: 1\n", 5, "sed", "one of the keys", 'the key "sed"'),
    ],
)
def test_a_matrix_that_cannot_be_used_is_refused(
    folder: Path, matrix: str, line: int, field: str, expected: str, got: str
) -> None:
    write(folder, more=f"extends: base.yaml\nmatrix: {matrix}\n")
    error = refusal(folder / "more.yaml")
    assert error.place == Place(folder / "more.yaml", line, field)
    assert error.expected.startswith(expected)
    assert error.got.startswith(got)


def test_a_matrix_has_at_most_a_thousand_combinations(folder: Path) -> None:
    def text(third: int) -> str:
        axes = {"seed": 10, "duration": 10, "avoider": third}
        lines = ["extends: base.yaml", "matrix:"]
        for key, count in axes.items():
            lines.append(f"  {key}:")
            lines += [
                f"    n{n}: {{{key}: {n + 1}{' s' if key == 'duration' else ''}}}" for n in range(count)
            ]
        return "\n".join(lines) + "\n"

    write(folder, full=text(10), over=text(11))
    assert len(read_all_scenarios(folder / "full.yaml")) == MOST_COMBINATIONS
    error = refusal(folder / "over.yaml")
    assert error.place == Place(folder / "over.yaml", 2, "matrix")
    assert (error.expected, error.got) == ("at most 1,000 combinations", "1,100")


def test_a_matrix_of_more_combinations_than_a_number_holds_is_refused_at_once(folder: Path) -> None:
    axis = "{x: {seed: 1}, y: {seed: 2}}"
    lines = "".join(f"  a{n}: {axis.replace('seed', f'k{n}')}\n" for n in range(300))
    write(folder, bomb=f"extends: base.yaml\nmatrix:\n{lines}")
    assert "at most 1,000 combinations" in refusal(folder / "bomb.yaml").expected


def test_a_matrix_of_a_large_file_is_bounded_by_its_values(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(compose, "MOST_VALUES", 100)
    write(folder, several=MATRIX)
    error = refusal(folder / "several.yaml")
    assert error.expected == "at most 100 values in all combinations"


def test_a_suite_names_files_folders_and_other_suites(folder: Path) -> None:
    (folder / "some").mkdir()
    write(folder / "some", a=BASE, b=BASE, c="suite: inner\nscenarios: [b.yaml, ../deep]\n")
    (folder / "deep").mkdir()
    write(folder / "deep", d=BASE)
    write(folder, several=MATRIX, all="suite: all\nabout: |\n  Why\n  so\nscenarios: [some, several.yaml]\n")
    names = [one.name for one in read_all_scenarios(folder / "all.yaml")]
    assert names[:3] == ["a", "b", "d"]
    assert len(names) == 9


def test_a_file_that_is_named_twice_counts_once(folder: Path) -> None:
    write(folder, all="suite: all\nscenarios: [base.yaml, ./base.yaml, .]\n")
    assert [one.name for one in read_all_scenarios(folder)] == ["base"]


@pytest.mark.parametrize(
    ("text", "line", "field", "expected", "got"),
    [
        ("suite: s\nscenarios: [all.yaml]\n", 2, "scenarios[0]", "suites that do not", "all.yaml names all"),
        ("suite: s\nscenarios:\n - gone.yaml\n", 3, "scenarios[0]", "a file that can be read", "no such"),
        ("suite: s\nscenarios: []\n", 2, "scenarios", "a list of files", "an empty list"),
        ("suite: s\n", 1, "scenarios", 'the key "scenarios"', "only suite"),
        ("suite: ''\nscenarios: [base.yaml]\n", 1, "suite", "a title", "nothing"),
        ("suite: s\nscenarois: []\n", 2, "scenarois", "one of the keys", 'the key "scenarois"'),
        ("suite: s\nscenarios: [empty]\n", 2, "scenarios[0]", "a folder with scenario files", "none in"),
    ],
)
def test_a_suite_that_cannot_be_used_is_refused(
    folder: Path, text: str, line: int, field: str, expected: str, got: str
) -> None:
    (folder / "empty").mkdir()
    write(folder, all=text)
    error = refusal(folder / "all.yaml")
    assert error.place.line == line
    assert error.place.field == (None if "do not name" in expected and error.place.field is None else field)
    assert error.expected.startswith(expected)
    assert error.got.startswith(got)


def test_every_mistake_of_a_suite_is_told(folder: Path) -> None:
    write(
        folder,
        bad=BASE.replace("1 s", "1 m"),
        worse=BASE.replace("seed", "sed"),
        all="suite: s\nscenarios: [bad.yaml, base.yaml, worse.yaml, gone.yaml]\n",
    )
    gathered = gather([folder / "all.yaml"])
    assert [one.name for one in gathered.scenarios] == ["base"]
    assert [error.place.field for error in gathered.errors] == ["duration", "sed", "scenarios[3]"]


def test_files_and_bytes_and_scenarios_are_bounded(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write(folder, other=BASE, third=BASE)
    for module, name, bound, expected in (
        (expand, "MOST_FILES", 2, "at most 2 files"),
        (expand, "MOST_SCENARIOS", 2, "at most 2 scenarios"),
        (compose, "MOST_BYTES", 2 * len(BASE), f"at most {2 * len(BASE)} bytes"),
    ):
        with monkeypatch.context() as patch:
            patch.setattr(module, name, bound)
            gathered = gather([folder])
            assert [error.expected for error in gathered.errors] == [expected], name
            assert len(gathered.scenarios) == 2


def test_a_text_cannot_lead_to_files() -> None:
    with pytest.raises(InputError, match="a text is none"):
        parse_scenario("extends: base.yaml\n" + BASE)


def test_a_hand_may_come_from_the_extended_file(folder: Path) -> None:
    hand = "hands:\n  - {hand: h, starts at: [1 m, 0 m, 0 m], elbow towards: [2 m, 0 m, 0 m], moves: []}\n"
    write(folder, base=BASE + hand, more="extends: base.yaml\nduration: 2 s\n")
    more = read_scenario(folder / "more.yaml")
    assert isinstance(more.hands[0], MovingHand)
    assert more.place("hands[0].moves") == Place(folder / "base.yaml", 12, "hands[0].moves")
