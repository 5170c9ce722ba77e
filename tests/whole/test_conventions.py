"""What is taken for granted of a command line: versions, help, JSON, pipes, colours, narrow terminals."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from itertools import count
from math import inf, nan
from pathlib import Path

import numpy as np
import pytest
from typer.main import get_command
from typer.testing import CliRunner

from safety_harness.base.compiling import Compilation, Compiled, Pace, watchers
from safety_harness.base.exceptions import Place, ScenarioError
from safety_harness.base.output import where
from safety_harness.cli import console, progress
from safety_harness.cli.console import (
    BAD_INPUT,
    answered_as_json,
    columns_of,
    document,
    explain,
    folded,
    result,
)
from safety_harness.cli.main import app
from safety_harness.cli.progress import EVERY_S, PacedLines

ESCAPE = "\x1b"
OWN = {
    name: value for name, value in os.environ.items() if name not in ("COLUMNS", "NO_COLOR", "FORCE_COLOR")
}


def command(*words: str, **environment: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "safety_harness", *words],
        env=OWN | environment,
        capture_output=True,
        text=True,
    )


def in_shell(line: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        ["bash", "-o", "pipefail", "-c", line.replace("HARNESS", f"{sys.executable} -m safety_harness")],
        env=OWN,
        capture_output=True,
        text=True,
    )


def names_of_commands() -> list[list[str]]:
    found: list[list[str]] = []
    for name, one in get_command(app).commands.items():  # type: ignore[attr-defined]
        found += [[name], *([name, own] for own in getattr(one, "commands", {}) if own != "plan")]
    return found


COMMANDS = names_of_commands()


@pytest.mark.parametrize("option", ["--version", "-V"])
def test_the_version_is_told_and_nothing_slow_is_imported_for_it(option: str) -> None:
    words = f"import sys; sys.argv[1:] = [{option!r}]; from safety_harness.__main__ import main\n"
    words += (
        "try:\n    main()\nfinally:\n    assert not {'numpy', 'numba', 'hypothesis', 'rich'} & {*sys.modules}"
    )
    done = subprocess.run([sys.executable, "-c", words], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert re.fullmatch(r"safety-harness \d+\.\d+\.\d+\S*\n", done.stdout)


@pytest.mark.parametrize("words", COMMANDS, ids=" ".join)
def test_every_command_and_group_has_the_short_option_of_help(words: list[str]) -> None:
    short, long = (CliRunner().invoke(app, [*words, option]) for option in ("-h", "--help"))
    assert short.exit_code == 0
    assert short.output == long.output
    groups = (["campaign"], ["hands"], ["log"], ["robot"], ["scenario"], ["schema"])
    assert words in groups or "--json" in short.output


@pytest.mark.parametrize(
    ("typed", "offered"),
    [
        ("camp", {"campaign"}),
        ("campaign qu", {"query"}),
        ("certify ", {"declare", "delta", "seal"}),
        ("certify plan.yaml --job", {"--jobs"}),
        ("fuzz --bu", {"--budget"}),
    ],
)
def test_a_shell_completes_commands_and_options(typed: str, offered: set[str]) -> None:
    done = command(
        _SAFETY_HARNESS_COMPLETE="complete_bash",
        COMP_WORDS=f"safety-harness {typed}",
        COMP_CWORD=str(len(typed.split(" "))),
    )
    assert set(done.stdout.split()) == offered


def test_the_script_for_a_shell_is_shown() -> None:
    done = command("--show-completion", SHELL="/bin/bash", _TYPER_COMPLETE_TEST_DISABLE_SHELL_DETECTION="")
    assert "_SAFETY_HARNESS_COMPLETE=complete_bash" in done.stdout or "not supported" in done.stderr


@pytest.mark.parametrize(
    ("columns", "commands"), [(40, ([], ["fuzz"], ["campaign"], ["certify"])), (200, (["fuzz"],))]
)
def test_help_fits_the_terminal_and_cuts_nothing(columns: int, commands: tuple[list[str], ...]) -> None:
    for words in commands:
        text = command(*words, "-h", COLUMNS=str(columns)).stdout
        assert max(map(len, text.splitlines())) <= columns
        assert "\N{HORIZONTAL ELLIPSIS}" not in text
        assert not re.search(r"[a-z]\.\.\.$", text, re.MULTILINE)


@pytest.mark.parametrize(
    ("environment", "commands"),
    [
        ({"NO_COLOR": "1"}, (["fuzz", "-h"], ["fuzz"], ["no-such-command"])),
        ({"TERM": "dumb"}, (["fuzz", "-h"],)),
    ],
)
def test_no_escape_codes_where_none_are_wanted_even_if_colours_are_forced(
    environment: dict[str, str], commands: tuple[list[str], ...]
) -> None:
    for words in commands:
        done = command(*words, **environment, FORCE_COLOR="1")
        assert ESCAPE not in done.stdout + done.stderr


def test_no_escape_codes_go_into_a_pipe() -> None:
    assert ESCAPE not in command("fuzz", "-h").stdout


def test_colours_can_be_forced_into_a_pipe() -> None:
    assert ESCAPE in command("fuzz", "-h", FORCE_COLOR="1", TERM="xterm").stdout


@pytest.mark.parametrize(
    ("line", "code"),
    [
        ("HARNESS claims | head -1 >/dev/null", 0),
        ("HARNESS list >&-", 0),
        ("HARNESS list >&- 2>&-", 0),
        ("HARNESS claims >/dev/full", BAD_INPUT),
        ("HARNESS -h >/dev/full", BAD_INPUT),
        ("HARNESS explain <&- >/dev/null", 0),
    ],
)
def test_an_output_that_takes_no_more_is_no_traceback(line: str, code: int) -> None:
    done = in_shell(line)
    assert done.returncode == code
    assert "Traceback" not in done.stderr
    assert "Exception ignored" not in done.stderr
    assert ("No space left" in done.stderr) is (code == BAD_INPUT)


@pytest.fixture
def short(tmp_path: Path) -> Path:
    file = tmp_path / "short.yaml"
    claims = "  joint speeds within limits: holds\n  joint positions within limits: holds\n"
    start = "tcp start:\n  offset: [0 mm, -60 mm, 20 mm]\n"
    file.write_text(f"scenario: short\nduration: 300 ms\n{start}claims:\n{claims}")
    return file


def test_json_of_a_run_is_what_its_report_has_and_judge_says_the_same_again(
    short: Path, tmp_path: Path
) -> None:
    out = tmp_path / "out"
    ran = CliRunner().invoke(app, ["run", str(short), "--out", str(out), "--json"])
    whole = json.loads(ran.stdout)["result"]
    assert whole.pop("failed") == []
    assert whole == json.loads((out / "report.json").read_text("utf-8"))
    again = CliRunner().invoke(app, ["judge", str(out / "traces" / "short.trace"), "--json"])
    (one,) = json.loads(again.stdout)["result"]["runs"]
    assert one["claims"] == whole["runs"][0]["claims"]
    replayed = CliRunner().invoke(app, ["replay", str(out / "traces" / "short.trace"), "--json"])
    assert json.loads(replayed.stdout)["result"]["identical"] is True


def test_a_run_whose_reader_is_gone_goes_on_to_its_report(short: Path, tmp_path: Path) -> None:
    done = in_shell(f"HARNESS run {short} --out {tmp_path / 'out'} | true")
    assert done.returncode == 0
    assert f"report: {tmp_path / 'out' / 'report.html'}" in done.stderr
    assert (tmp_path / "out" / "report.html").is_file()


def test_json_is_one_document_with_the_data_and_no_table(capsys: pytest.CaptureFixture[str]) -> None:
    def work() -> int:
        result("a line for people")
        document(margin_m=-inf, share=np.float64(nan), array=np.array([1.0, inf]), file=Path("a.yaml"))
        return 1

    assert answered_as_json(work) == 1
    out, err = capsys.readouterr()
    found = json.loads(out, parse_constant=pytest.fail)
    assert found["exit_code"] == 1
    assert found["result"] == {"margin_m": None, "share": None, "array": [1.0, None], "file": "a.yaml"}
    assert (found["errors"], err) == ([], "")


@pytest.mark.parametrize("error", [ScenarioError, KeyboardInterrupt])
def test_json_is_a_document_however_a_command_ends(
    error: type[BaseException], capsys: pytest.CaptureFixture[str]
) -> None:
    def work() -> int:
        if error is KeyboardInterrupt:
            raise KeyboardInterrupt
        place = Place(file=Path("a\x9b31m.yaml"), line=3, field="duration")
        raise ScenarioError(place=place, expected="a time", got="6")

    code = answered_as_json(work)
    out, err = capsys.readouterr()
    found = json.loads(out)
    assert found["exit_code"] == code
    assert found["result"] is None
    assert "\x9b" not in out + err
    if error is ScenarioError:
        assert found["errors"][0] | {"line": 3, "expected": "a time", "hint": None} == found["errors"][0]
        assert "expected a time" in err


def test_json_of_a_command_says_what_is_wrong_in_its_errors(tmp_path: Path) -> None:
    done = CliRunner().invoke(app, ["validate", str(tmp_path / "none.yaml"), "--json"])
    found = json.loads(done.stdout)
    assert (done.exit_code, found["exit_code"]) == (BAD_INPUT, BAD_INPUT)
    assert found["errors"][0]["file"] == str(tmp_path / "none.yaml")
    assert found["result"] == {"usable": []}


def test_lines_are_folded_at_a_narrow_width_between_words_and_not_in_pipes() -> None:
    line = "ok   holds            +219.3 mm at   2.376 s  visits: hand distance never below 50 mm"
    assert folded(line, None) == line
    parts = folded(line, 40).split("\n")
    assert max(map(len, parts)) <= 40
    assert " ".join(" ".join(parts).split()) == " ".join(line.split())
    assert not any(re.match(r"\s*(mm|s)\b", part) for part in parts)
    path = "/a/very/long/path/that/somebody/wants/to/copy/whole.yaml"
    assert path in folded(f"page: {path}", 40).split()


@pytest.mark.parametrize(("asked", "columns"), [("40", 40), ("3", 20), ("", None), ("x", None), ("0", None)])
def test_a_width_is_what_columns_says_or_none_for_a_pipe(
    asked: str, columns: int | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", asked)
    with open(os.devnull, "w") as pipe:
        assert columns_of(pipe) == columns
    assert columns_of(None) == columns


def test_a_log_gets_a_line_at_the_start_every_ten_seconds_and_at_the_end(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    said: list[tuple[float, str]] = []
    now_s = 0.0
    monkeypatch.setattr("safety_harness.cli.progress.say", lambda line: said.append((now_s, line)))
    lines = PacedLines(lambda: now_s)
    for step in range(100):
        now_s = step * 0.25
        lines.take(f"step {step}")
    lines.end()
    lines.end()
    assert said == [(0.0, "step 0"), (EVERY_S, "step 40"), (2 * EVERY_S, "step 80"), (24.75, "step 99")]


def test_share_and_time_left_are_told_once_there_is_something_to_tell() -> None:
    clock = [100.0]
    pace = Pace(lambda: clock[0])
    assert where(0, 40, pace) == ""
    clock[0] = 110.0
    assert where(10, 40, pace) == ", 25 %"  # what the first took may be loading
    clock[0] = 120.0
    assert where(20, 40, pace) == ", 50 %, 20 s left"
    clock[0] = 130.0
    assert where(40, 40, pace) == ", 100 %, 30 s"


def test_no_time_left_contains_what_compiling_took(monkeypatch: pytest.MonkeyPatch) -> None:
    """A first run of 100 s that compiled for 99 s said that 48 minutes were left."""
    clock = [0.0]
    pace = Pace(lambda: clock[0])
    for done in (1, 2, 3):
        clock[0] += 1.0
        said = where(done, 40, pace)
    assert said == ", 7 %, 37 s left"
    monkeypatch.setattr(Compiled, "count", Compiled.count + 1)
    clock[0] += 60.0
    assert where(4, 40, pace) == ", 10 %"
    clock[0] += 1.0
    assert where(5, 40, pace) == ", 12 %, 35 s left"


def test_a_bar_drops_its_time_left_when_a_function_is_compiled(monkeypatch: pytest.MonkeyPatch) -> None:
    updates: list[str] = []

    class Bar:
        def __init__(self, *columns: object, **settings: object) -> None:
            """Like Rich's."""

        def __enter__(self) -> Bar:
            return self

        def __exit__(self, *error: object) -> None:
            """Go away."""

        def add_task(self, name: str, **fields: object) -> int:
            return 0

        def update(self, task: int, *, share: str, **fields: object) -> None:
            updates.append(share)

    seconds = count(step=1.0)
    monkeypatch.setattr("time.monotonic", lambda: next(seconds))
    monkeypatch.setattr(progress, "Pace", lambda: Pace(lambda: next(seconds)))
    monkeypatch.setattr(progress, "is_live", lambda: True)
    monkeypatch.setattr(progress, "Progress", Bar)
    before = [*watchers]
    with progress.counting(40, "runs") as show:
        show(1)
        show(2)
        (watcher,) = watchers[len(before) :]
        watcher(Compilation(1, 60.0, going_on=True))
    assert watchers == before
    assert updates == ["2 %", "5 %, 38 s left", ""]


def test_errors_outside_of_json_are_for_people_alone(capsys: pytest.CaptureFixture[str]) -> None:
    explain(ScenarioError(place=Place(field="--seed"), expected="a seed", got="x"))
    assert capsys.readouterr() == ("", "error: --seed\n  expected a seed\n  got      x\n")
    assert not console.asked_for_json()
