"""validate, fmt, explain, new and schema, as their user meets them."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from typer.testing import CliRunner

from safety_harness.base.exceptions import InputError, OutputError
from safety_harness.cli.console import AS_EXPECTED, BAD_INPUT, DIFFERS
from safety_harness.cli.fmt import format_files
from safety_harness.cli.main import app
from safety_harness.cli.scenario_commands import explain as explain_key
from safety_harness.cli.scenario_commands import judge as judge_again
from safety_harness.cli.scenario_commands import replay, run
from safety_harness.cli.validate import validate
from safety_harness.scenario.read import parse_scenario, read_scenario
from safety_harness.scenario.reference_tables import every_table
from safety_harness.scenario.schema import scenario_schema

SCENARIOS = Path(__file__).parents[2] / "scenarios"
GOOD = """\
scenario: a short run
duration: 300 ms
tcp start: {offset: [0 mm, -60 mm, 20 mm]}
avoider: opposite pose
claims: {joint speeds within limits: holds}
"""
Captured = pytest.CaptureFixture[str]


def write(folder: Path, **texts: str) -> None:
    for name, text in texts.items():
        (folder / f"{name}.yaml").write_text(text)


def test_a_suite_of_a_matrix_is_run_and_every_scenario_has_its_trace(
    tmp_path: Path, capsys: Captured
) -> None:
    write(
        tmp_path,
        good=GOOD,
        two="extends: good.yaml\nmatrix: {seed: {one: {seed: 1}, two: {seed: 2}}}\n",
        suite="suite: all\nscenarios: [good.yaml, two.yaml]\n",
    )
    assert run([tmp_path / "suite.yaml"], tmp_path / "out") == AS_EXPECTED
    traces = sorted(file.name for file in (tmp_path / "out/traces").iterdir())
    assert traces == ["good.trace", "two[one].trace", "two[two].trace"]
    assert "3 of 3 scenarios run" in capsys.readouterr().out


def test_the_trace_of_a_matrix_is_complete_in_itself(tmp_path: Path) -> None:

    write(tmp_path, base=GOOD, two="extends: base.yaml\nmatrix: {s: {one: {seed: 1}}}\n")
    run([tmp_path / "two.yaml"], tmp_path / "out")
    (tmp_path / "base.yaml").unlink()
    (tmp_path / "two.yaml").unlink()
    trace = tmp_path / "out/traces/two[one].trace"
    assert judge_again([trace]) == AS_EXPECTED
    assert replay(trace) == AS_EXPECTED


def test_validate_says_ok_of_scenarios_and_spaces(capsys: Captured) -> None:
    files = [SCENARIOS / "second-hand.yaml", SCENARIOS / "spaces/unseen-hand.yaml"]
    assert validate(files) == AS_EXPECTED
    one, other = capsys.readouterr().out.splitlines()
    assert one.startswith(f"ok {files[0]}: 2 hands, ")
    assert other.startswith(f"ok {files[1]}: a space, ")


def test_validate_names_what_no_run_could_try(tmp_path: Path, capsys: Captured) -> None:
    """Beside an arm that stands still; the file is good all the same."""
    visit = (SCENARIOS / "hand-visits-and-leaves.yaml").read_text()
    file = tmp_path / "idle.yaml"
    faults = "faults:\n  - avoider: answers NaN\n    from: 200 ms\n    for: 300 ms\n"
    file.write_text(visit.replace("claims:", faults + "claims:"))
    short = tmp_path / "short.yaml"
    short.write_text(
        f"scenario: cut off\nextends: {SCENARIOS / 'hand-visits-and-leaves.yaml'}\nduration: 2 s\n"
    )
    assert validate([file, short]) == AS_EXPECTED
    one, other, then = capsys.readouterr().err.splitlines()
    assert then == f"next: safety-harness run {file} {short}"
    assert one.endswith("and nothing is known of: fault 1 (avoider answers NaN)")
    assert "'cut off', and nothing is known of: move" in other


def test_validate_names_the_controller_where_no_avoider_is_asked(tmp_path: Path, capsys: Captured) -> None:
    file = tmp_path / "driven.yaml"
    head = "scenario: driven\nduration: 1 s\ncontroller: stop when near\n"
    rest = "tcp start: {offset: [0 mm, 0 mm, 0 mm]}\nclaims: {joint speeds within limits: holds}\n"
    file.write_text(head + rest)
    document = CliRunner().invoke(app, ["validate", str(file), "--json"])
    assert validate([file]) == AS_EXPECTED
    assert capsys.readouterr().out == f"ok {file}: no hands, 1 claim, 1 s, stop when near\n"
    (usable,) = json.loads(document.stdout)["result"]["usable"]
    assert usable["scenarios"][0]["controller"] == "stop when near"


def test_validate_tells_the_mistake_of_every_claim(tmp_path: Path, capsys: Captured) -> None:
    text = (SCENARIOS / "servoing-alone.yaml").read_text()
    head = text[: text.index("claims:")]
    wrong = ("hand distance never below 50", "always hand distnce > 1 mm", "nonsense")
    file = tmp_path / "three.yaml"
    file.write_text(head + "claims:\n" + "".join(f"  {claim}: holds\n" for claim in wrong))
    assert validate([file]) == BAD_INPUT
    error = capsys.readouterr().err
    first = len(head.splitlines()) + 2
    for line in range(first, first + 3):
        assert f"three.yaml:{line}: claims." in error
    assert "3 mistakes" in error


def test_validate_tells_every_mistake_of_every_file(tmp_path: Path, capsys: Captured) -> None:
    write(
        tmp_path,
        bad=GOOD.replace("300 ms", "300 mn"),
        far=GOOD.replace("-60 mm", "-6 m"),
        good=GOOD,
        many=GOOD + "matrix: {a: {x: {seed: 1}, y: {avoider: oposite pose}}}\n",
        space=GOOD.replace("scenario:", "scenario space:"),
    )
    assert validate([tmp_path, tmp_path / "gone.yaml"]) == BAD_INPUT
    out, err = capsys.readouterr()
    assert out.splitlines() == [f"ok {tmp_path / 'good.yaml'}: no hands, 1 claim, 0.3 s, opposite pose"]
    for name in ("bad.yaml:2", "far.yaml:3", "many.yaml", "gone.yaml", "space.yaml"):
        assert f"error: {tmp_path / name}" in err
    assert 'did you mean "min"' in err
    assert err.splitlines()[-1].startswith("5 mistakes; ")


def test_mistakes_are_told_in_the_order_of_the_file(tmp_path: Path, capsys: Captured) -> None:
    slips = (
        GOOD.replace("300 ms", "300 m").replace("tcp start: {", "tcp start: {ofset: 1 mm, ") + "colour: red\n"
    )
    slips = slips.replace("claims:", "settings: {clock: {control perid: 8 ms}}\nclaims:")
    write(tmp_path, a=slips)
    assert validate([tmp_path / "a.yaml"]) == BAD_INPUT
    err = capsys.readouterr().err
    told = [line.split(": ")[2] for line in err.splitlines() if line.startswith("error:")]
    assert told == ["duration", "tcp start.ofset", "settings.clock.control perid", "colour"]


MANY = """\
scenario: many mistakes
duration: 4
seed: -1
tcp start:
  offset: [0, -60 mm, 20 m]
colour: red
settings:
  clock: {wall limt: 1 s, control period: 8 mz}
  avoidance: {critical distance: 400}
hands:
  - hand: right hand
    starts at: [1000 mm, -550 mm]
    elbow toward: [1600 mm, -1200 mm, 300 mm]
    moves:
      - move to: [840 mm, -350 mm, 300 mm]
        speed: 1
      - withdrw: 1.6 m/s
      - wait: 3 kg
  - hand: left hand
    starts at: [1000 mm, -550 mm, 0 mm]
    elbow towards: [1600 mm, -1200 mm, 300 mm]
    moves:
      - move to: [840 mm, -350 mm, 300 mm]
        speed: 30 m/s
faults:
  - camera: blnd
  - hand sensor: freezes
    from: 100
claims:
  hand distance never bellow 50 mm: holds
  joint speed within limits: holds
  joint speeds within limits: hold
"""


def test_every_mistake_of_a_file_is_told_at_once(
    tmp_path: Path, capsys: Captured, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    write(Path(), many=MANY)
    assert validate([Path("many.yaml")]) == BAD_INPUT
    err = capsys.readouterr().err
    told = [line.split(": ")[1:] for line in err.splitlines() if line.startswith("error:")]
    assert [" ".join(one).removeprefix("many.yaml:") for one in told] == [
        "2 duration",
        "3 seed",
        "5 tcp start.offset[0]",
        "5 tcp start.offset[2]",
        "6 colour",
        "8 settings.clock.wall limt",
        "8 settings.clock.control period",
        "9 settings.avoidance.critical distance",
        "12 hands[0].starts at",
        "13 hands[0].elbow toward",
        "16 hands[0].moves[0].speed",
        "17 hands[0].moves[1]",
        "18 hands[0].moves[2].wait",
        "24 hands[1].moves[0].speed",
        "26 faults[0].camera",
        "28 faults[1].from",
        "30 claims.hand distance never bellow 50 mm",
        "31 claims.joint speed within limits",
        "32 claims.joint speeds within limits",
    ]
    assert err.count("\n  expected ") == err.count("\n  got ") == len(told)
    with pytest.raises(InputError, match="colour"):  # a run names the first
        read_scenario(Path("many.yaml"))


def test_a_misspelt_required_key_is_one_mistake_and_hides_no_missing_key(
    tmp_path: Path, capsys: Captured, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    hands = "hands: [{hnd: right hand, elbow: [1 m, 0 m, 0 m], starts at: [1 m, -1 m, 0 m]}]\n"
    wrong = GOOD.replace("\nduration:", "\nduratoin:").replace("tcp start:", "colour:") + hands
    write(Path(), wrong=wrong)
    assert validate([Path("wrong.yaml")]) == BAD_INPUT
    err = capsys.readouterr().err
    told = [line.split(": ")[2] for line in err.splitlines() if line.startswith("error:")]
    hand = ["hands[0].elbow", "hands[0].hnd", "hands[0].moves"]
    assert sorted(told) == ["colour", "duratoin", *hand, "tcp start"]
    assert 'hint     did you mean "duration"?' in err


def test_every_mistake_of_a_suite_is_told_beside_a_wrong_key(
    tmp_path: Path, capsys: Captured, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    suite = "suite: [s]\nabut: a\nabout: [b]\nscenarios:\n- good.yaml\n- [1]\n- gone.yaml\n"
    write(Path(), good=GOOD, suite=suite, misspelt="suite: s\nscenarois: []\ncolour: red\n")
    assert validate([Path("suite.yaml"), Path("misspelt.yaml")]) == BAD_INPUT
    out, err = capsys.readouterr()
    told = [line.split(": ")[1:] for line in err.splitlines() if line.startswith("error:")]
    assert [" ".join(one) for one in told] == [
        "misspelt.yaml:2 scenarois",
        "misspelt.yaml:3 colour",
        "suite.yaml:1 suite",
        "suite.yaml:2 abut",
        "suite.yaml:3 about",
        "suite.yaml:6 scenarios[1]",
        "suite.yaml:7 scenarios[2]",
    ]
    assert out.startswith("ok good.yaml")


def test_an_avoider_is_looked_at_beside_other_mistakes(
    tmp_path: Path, capsys: Captured, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("mine.py").write_text(
        "class Mine:\n    def propose(self): ...\n\nraise SystemExit  # nobody runs this\n"
    )
    wrong = GOOD.replace("opposite pose", "mine.py:Mine").replace(": holds", ": hold")
    write(Path(), wrong=wrong)
    assert validate([Path("wrong.yaml")]) == BAD_INPUT
    err = capsys.readouterr().err
    assert "expected Mine in mine.py to have propose(*, hand_position_in_base_m" in err
    assert "2 mistakes" in err


def test_mistakes_of_a_space_are_told_together(
    tmp_path: Path, capsys: Captured, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    space = GOOD.replace("scenario:", "scenario space:").replace("300 ms", "from 300 ms to 400 ms")
    write(Path(), space=space.replace("-60 mm, 20 mm", "-60, 20"))
    assert validate([Path("space.yaml")]) == BAD_INPUT
    err = capsys.readouterr().err
    assert "tcp start.offset[1]" in err
    assert "tcp start.offset[2]" in err
    assert "2 mistakes" in err


def test_a_refused_draw_of_a_space_is_no_mistake(
    tmp_path: Path, capsys: Captured, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Most draws turn back before they hesitate, and are drawn again."""
    monkeypatch.chdir(tmp_path)
    move = """
      - reach for tcp: 1 m/s
        stop at distance: {one of: [100 mm, 600 mm, 601 mm, 602 mm]}
        give up after: 3 s
        hesitating at: {one of: [1000 mm, 150 mm, 151 mm, 152 mm]}
        for: 300 ms
"""
    hand = "hands:\n  - hand: right hand\n    starts at: [1300 mm, -1000 mm, 400 mm]\n"
    hand += f"    elbow towards: [1700 mm, -1300 mm, 400 mm]\n    moves:{move}"
    space = GOOD.replace("scenario:", "scenario space:").replace("300 ms", "4 s") + hand
    write(Path(), space=space)
    assert validate([Path("space.yaml")]) == AS_EXPECTED
    assert "next: safety-harness fuzz space.yaml" in capsys.readouterr().err
    assert validate([Path("space.yaml")], "nobody") == BAD_INPUT


def test_what_ships_has_no_mistake(capsys: Captured) -> None:
    assert validate([SCENARIOS / "spaces", SCENARIOS.parent / "plans"]) == AS_EXPECTED


def test_no_mistake_is_told_of_what_was_read_beside_an_example(tmp_path: Path, capsys: Captured) -> None:
    short = GOOD.replace("300 ms", "2 ms").replace(
        "claims:", "settings: {clock: {control period: 1 mz}}\nclaims:"
    )
    write(tmp_path, a=short)  # 2 ms would do with the period that was meant
    assert validate([tmp_path / "a.yaml"]) == BAD_INPUT
    assert "duration" not in capsys.readouterr().err
    write(tmp_path, b=GOOD.partition("claims:")[0].replace("300 ms", "300 m"))
    assert validate([tmp_path / "b.yaml"]) == BAD_INPUT
    assert 'expected the key "claims"\n  got      none' in capsys.readouterr().err


def test_a_mistake_in_an_extended_file_is_told_once(tmp_path: Path, capsys: Captured) -> None:
    (tmp_path / "bases").mkdir()
    write(tmp_path / "bases", base=GOOD.replace("300 ms", "300 m"))
    write(tmp_path, a="extends: bases/base.yaml\n", b="extends: bases/base.yaml\n")
    assert validate([tmp_path]) == BAD_INPUT
    assert capsys.readouterr().err.count("base.yaml:2: duration") == 1


def test_fmt_lays_out_and_check_only_says_so(tmp_path: Path, capsys: Captured) -> None:
    untidy = "duration: 1 s\n'scenario': x  # why\n"
    write(tmp_path, a=untidy, b="scenario: x\n")
    file = tmp_path / "a.yaml"
    assert format_files([tmp_path], check=True) == DIFFERS
    assert file.read_text() == untidy
    assert capsys.readouterr().out == f"would change {file}\n"
    assert format_files([tmp_path], check=False) == AS_EXPECTED
    assert capsys.readouterr().out == f"changed {file}\n"
    assert file.read_text() == "scenario: x  # why\nduration: 1 s\n"
    assert format_files([tmp_path], check=True) == AS_EXPECTED
    assert sorted(one.name for one in tmp_path.iterdir()) == ["a.yaml", "b.yaml"]


def test_fmt_says_nothing_of_what_it_could_not_write(
    tmp_path: Path, capsys: Captured, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(file: Path, text: str) -> None:
        raise OutputError.of_file(file, "a place that can be written", "a full disk")

    write(tmp_path, a="scenario:   x\n")
    monkeypatch.setattr("safety_harness.cli.fmt.write_text", refuse)
    assert format_files([tmp_path], check=False) == BAD_INPUT
    assert "changed" not in capsys.readouterr().out


def test_fmt_leaves_what_it_cannot_read_and_goes_on(tmp_path: Path, capsys: Captured) -> None:
    write(tmp_path, a="scenario: b: c\n", b="scenario:   x\n")
    assert format_files([tmp_path / "a.yaml", tmp_path / "b.yaml"], check=False) == BAD_INPUT
    assert (tmp_path / "a.yaml").read_text() == "scenario: b: c\n"
    assert (tmp_path / "b.yaml").read_text() == "scenario: x\n"
    assert f"error: {tmp_path / 'a.yaml'}:1" in capsys.readouterr().err


def test_explain_gives_meaning_unit_bounds_default_and_example(capsys: Captured) -> None:
    assert explain_key(["critical", "distance"]) == AS_EXPECTED
    assert capsys.readouterr().out.splitlines() == [
        "critical distance, of avoidance",
        "  means    from the TCP to a predicted hand; zero is no avoidance at all",
        "  takes    length, 0 m to 3 m (units: m, cm, mm)",
        "  default  400 mm",
        "  example  settings: {avoidance: {critical distance: 400 mm}}",
    ]


def test_a_key_of_several_places_is_explained_for_each_or_for_the_one_that_is_named(capsys: Captured) -> None:
    explain_key(["rate"])
    assert capsys.readouterr().out.count("rate, of ") == 3
    explain_key(["camera.rate"])
    assert capsys.readouterr().out.count("rate, of ") == 1


def test_an_unknown_key_gets_a_near_miss(capsys: Captured) -> None:
    assert explain_key(["critcal distance"]) == BAD_INPUT
    assert 'did you mean "critical distance"' in capsys.readouterr().err


def test_every_key_can_be_explained_and_is_listed(capsys: Captured) -> None:
    explain_key([])
    listed = capsys.readouterr().out
    for table in every_table():
        for key in table.keys:
            assert key.name in listed
            assert explain_key([f"{table.name}.{key.name}"]) == AS_EXPECTED
            out = capsys.readouterr().out
            assert all(f"\n  {word} " in out for word in ("means", "takes", "default", "example")), key
            assert "`" not in out


def test_every_example_of_a_setting_can_be_read() -> None:
    for table in every_table():
        if table.path.startswith(("settings.", "camera", "hand sensor", "tcp start")):
            for key in table.keys:
                base = "\n".join(line for line in GOOD.splitlines() if not line.startswith("tcp start"))
                start = "" if table.path == "tcp start" else "\ntcp start: {offset: [0 mm, 0 mm, 0 mm]}"
                if key.name != "restart delay":
                    parse_scenario(f"{base}{start}\n{key.lines}\n")


def test_the_schema_is_printed_as_json() -> None:
    done = CliRunner().invoke(app, ["schema"])
    assert done.exit_code == AS_EXPECTED
    assert json.loads(done.stdout) == scenario_schema()


@pytest.mark.parametrize("command", ["validate", "fmt", "explain", "schema"])
def test_help_teaches_exit_codes(command: str) -> None:
    done = CliRunner().invoke(app, [command, "--help"])
    assert "Exit codes: 0" in " ".join(done.stdout.split())


def test_the_commands_reach_their_functions(tmp_path: Path) -> None:
    write(tmp_path, a=GOOD)
    file = str(tmp_path / "a.yaml")
    assert CliRunner().invoke(app, ["validate", file]).exit_code == AS_EXPECTED
    assert CliRunner().invoke(app, ["fmt", "--check", file]).exit_code == AS_EXPECTED
    assert CliRunner().invoke(app, ["explain", "seed"]).exit_code == AS_EXPECTED


def test_validate_tells_all_mistakes_of_a_file_and_executes_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("many.yaml").write_text(
        "scenario: many\nduration: 4\ntcp start:\n  offset: [0 mm, -60 mm, 20 mm]\n"
        "settings: {clock: {wall limt: 1 s}}\nclaims:\n  hand distance never bellow 50 mm: holds\n"
        "  joint speed within limits: holds\n"
    )
    assert validate([Path("many.yaml")]) == BAD_INPUT
    err = capsys.readouterr().err
    for place in (
        "2: duration",
        "5: settings.clock.wall limt",
        "7: claims.hand distance",
        "8: claims.joint speed",
    ):
        assert f"error: many.yaml:{place}" in err
    assert "4 mistakes" in err
    Path("missing.yaml").write_text(
        "scenario: one\nduration: 4 s\nclaims:\n  joint speeds within limits: holds\n"
    )
    assert validate([Path("missing.yaml")]) == BAD_INPUT
    assert "hint     safety-harness explain tcp start\n" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("parameters", "fits"),
    [
        ("self, hand, tcp", False),
        ("self, *, hand_position_in_base_m, tcp_position_in_base_m", False),
        ("self, *, hand_position_in_base_m, tcp_position_in_base_m, seed, more", False),
        ("self, hand_position_in_base_m, tcp_position_in_base_m, seed, /", False),
        ("self, *, hand_position_in_base_m, tcp_position_in_base_m, seed", True),
        ("self, hand_position_in_base_m, tcp_position_in_base_m, seed=0, more=1", True),
        ("self, **question", True),
    ],
)
def test_validate_finds_a_propose_without_the_keywords_in_the_files_text(
    parameters: str,
    fits: bool,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("mine.py").write_text(
        f"print('EXECUTED')\nclass Mine:\n    name = 'mine'\n    def propose({parameters}):\n        pass\n"
    )
    Path("short.yaml").write_text(
        "scenario: short\nduration: 300 ms\navoider: mine.py:Mine\n"
        "tcp start:\n  offset: [0 mm, -60 mm, 20 mm]\nclaims:\n  joint speeds within limits: holds\n"
    )
    assert validate([Path("short.yaml")]) == (AS_EXPECTED if fits else BAD_INPUT)
    out, err = capsys.readouterr()
    assert "EXECUTED" not in out + err
    assert (
        fits
        or "Mine in mine.py to have propose(*, hand_position_in_base_m, tcp_position_in_base_m, seed)" in err
    )
