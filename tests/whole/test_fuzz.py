"""fuzz: what it finds it keeps, as files that run takes; its exit codes; its words when there is nothing."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from safety_harness.base.exceptions import OutputError
from safety_harness.cli.console import AS_EXPECTED, BAD_INPUT, DIFFERS, INTERRUPTED
from safety_harness.cli.fuzz import fuzz
from safety_harness.cli.sample import sample
from safety_harness.cli.scenario_commands import replay, run
from safety_harness.extensions.attribution import search_attribution
from safety_harness.scenario.expand import gather
from safety_harness.search import session as search_session
from safety_harness.search.findings import Outcomes
from safety_harness.search.trials import Trials
from tests.search.short_space import CRASHING, TEXT


@pytest.fixture
def space(tmp_path: Path) -> Path:
    file = tmp_path / "short.yaml"
    file.write_text(TEXT)
    return file


@pytest.fixture(autouse=True)
def _little_shrinking(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(search_session, "SHRINKING_RUNS", 25)
    monkeypatch.setattr(search_session, "MOST_SHRUNK", 1)
    monkeypatch.setattr(search_attribution, "MOST_ATTRIBUTED", 2)


def counterexamples(folder: Path) -> list[Path]:
    return sorted(folder.glob("*.yaml"))


def test_a_violation_becomes_a_file_that_runs_and_replays_as_it_says(
    space: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    assert fuzz(space, out=out, budget=12) == DIFFERS
    shown = capsys.readouterr()
    (file,) = counterexamples(out)
    assert "violated" in shown.out
    assert str(file) in shown.out
    assert "joint speeds within limits: violated 0 of 12" in shown.err
    text = file.read_text()
    for evidence in ("VIOLATED", "in SI", "seed", "source ", "robot ", "claims ", "world pybullet", "numpy"):
        assert evidence in text.partition("\nscenario:")[0]
    assert run([file], tmp_path / "again") == AS_EXPECTED
    assert replay(file.with_suffix(".trace")) == AS_EXPECTED
    found = json.loads((out / "findings.json").read_text())
    assert found["tried"] == 12
    assert found["counterexamples"] == [file.name]
    assert sum(found["coverage"].values()) == 12
    as_found = gather([out / "as-found"])
    assert not as_found.errors
    assert as_found.scenarios


def test_the_same_seed_finds_the_same_files(space: Path, tmp_path: Path) -> None:
    for name in ("first", "second"):
        fuzz(space, out=tmp_path / name, budget=6, seed=5)
    first, second = (counterexamples(tmp_path / name) for name in ("first", "second"))
    assert [file.name for file in first] == [file.name for file in second]
    assert [file.read_text() for file in first] == [file.read_text() for file in second]


def test_a_space_in_which_nothing_is_violated_ends_well_and_says_what_that_is_worth(
    space: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert fuzz(space, out=tmp_path / "out", budget=3, claims=["joint speeds within limits"]) == AS_EXPECTED
    err = capsys.readouterr().err
    touching = json.loads((tmp_path / "out" / "findings.json").read_text())["coverage"]
    runs = sum(n for cell, n in touching.items() if "touching" in cell)
    assert f"in {runs} of 3 runs a hand touched the arm" in err
    assert "nothing found" not in err
    assert counterexamples(tmp_path / "out") == []


def test_a_claim_that_every_run_violates_is_said_to_be_no_corner(
    space: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert fuzz(space, out=tmp_path / "out", budget=20, claims=["hand distance never below 2 m"]) == DIFFERS
    assert "every run violates 'hand distance never below 2000 mm'" in capsys.readouterr().err


def test_a_claim_that_is_never_put_to_the_test_is_named(
    space: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert fuzz(space, out=tmp_path / "out", budget=2, claims=["gain switch reached"]) == DIFFERS
    assert "no run put 'gain switch reached' to the test" in capsys.readouterr().err


def test_what_no_run_tried_is_named_and_a_space_without_an_occasion_is_no_success(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The hand works two metres off, and its last move would begin after the run."""
    file = tmp_path / "far.yaml"
    text = TEXT.replace("[from 700 mm to 900 mm, -500 mm, 400 mm]", "[2.2 m, -1.9 m, 300 mm]")
    moves = "      - wait: 1 s\n      - withdraw: from 0.3 m/s to 0.5 m/s\n"
    file.write_text(text[: text.index("      - reach")] + moves + text[text.index("claims:") :])
    assert fuzz(file, out=tmp_path / "out", budget=4) == DIFFERS
    err = capsys.readouterr().err
    assert "no run put 'hand distance never below 150 mm' to the test" in err
    assert (
        "nothing is known of: move 2 of right hand (withdraw); hands[0].moves[1].withdraw, which varies"
        in err
    )


def test_a_limit_that_no_run_comes_near_to_is_noted(
    space: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    claims = ["TCP speed never above 9 m/s", "TCP speed never above 300 mm/s"]
    fuzz(space, out=tmp_path / "out", budget=4, claims=claims)
    notes = [line for line in capsys.readouterr().err.splitlines() if "near its limit" in line]
    assert len(notes) == 1
    assert notes[0].startswith("TCP speed never above 9000 mm/s: ")


def test_an_avoider_that_crashes_in_a_corner_is_found_counted_and_saved(
    space: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "mine.py").write_text(CRASHING)
    avoider = str(tmp_path / "mine.py") + ":Crashing"
    claims = ["joint speeds within limits"]
    assert fuzz(space, out=tmp_path / "out", avoider=avoider, budget=15, claims=claims) == DIFFERS
    out, err = capsys.readouterr()
    assert "the avoider gave no answer: ZeroDivisionError" in out
    assert "1 kinds of mishap" in err
    (file,) = counterexamples(tmp_path / "out")
    assert run([file], tmp_path / "again") == AS_EXPECTED


def test_how_long_answers_take_changes_nothing_that_is_found(space: Path, tmp_path: Path) -> None:
    seconds_there = "float(Path(__file__).with_suffix('.s').read_text())"
    sleeps = f"import time; from pathlib import Path; time.sleep({seconds_there})"
    (tmp_path / "mine.py").write_text(
        CRASHING.replace("        if hand_position", f"        {sleeps}\n        if hand_position")
    )
    for seconds in ("0", "0.12"):
        (tmp_path / "mine.s").write_text(seconds)
        fuzz(space, out=tmp_path / seconds, avoider=str(tmp_path / "mine.py") + ":Crashing", budget=2)
    quick, slow = (
        json.loads((tmp_path / seconds / "findings.json").read_text()) for seconds in ("0", "0.12")
    )
    quick.pop("computing_time")  # of this machine, and it may be busy
    assert "2 of 2 answers (100 %) took longer than the 8 ms" in slow.pop("computing_time")
    assert quick == slow
    assert "it was tested as if it answered in time" in (tmp_path / "0.12" / "fuzz.html").read_text()


def test_ctrl_c_keeps_what_was_found(
    space: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    evaluate = Trials.__call__

    def interrupted(self: Trials, points: object, first: int) -> object:
        if first >= 8:
            raise KeyboardInterrupt
        return evaluate(self, points, first)  # type: ignore[arg-type]

    monkeypatch.setattr(Trials, "__call__", interrupted)
    assert fuzz(space, out=tmp_path / "out", budget=500) == INTERRUPTED
    out, err = capsys.readouterr()
    assert "kept as found" in err
    assert "NOT FOUND" not in out
    (then,) = [line for line in err.splitlines() if line.startswith("next: ")]
    assert then.startswith("next: safety-harness fuzz short.yaml ")
    assert then.endswith(" --out out    (the whole search again)")
    assert list((tmp_path / "out" / "as-found").glob("*.yaml"))
    assert json.loads((tmp_path / "out" / "findings.json").read_text())["interrupted"]


def test_groups_beyond_the_files_as_found_are_counted(
    space: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(search_session, "_MOST_AS_FOUND", 1)
    assert fuzz(space, out=tmp_path, budget=12) == DIFFERS
    alone = len(json.loads((tmp_path / "findings.json").read_text())["distinct"]) - 1
    assert alone > 0
    assert len(list((tmp_path / "as-found").glob("*.yaml"))) == 1
    assert f"as-found has the first 1 groups; {alone} are in findings.json alone" in capsys.readouterr().err


@pytest.mark.parametrize("earlier", ["one.yaml", "as-found/one.yaml", "as-found/baseline/one.yaml"])
def test_files_of_an_earlier_search_stay_and_that_is_said(
    space: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], earlier: str
) -> None:
    file = tmp_path / "out" / earlier
    file.parent.mkdir(parents=True)
    file.write_text("scenario: of then\n")
    (tmp_path / "out" / "findings.json").write_text("{}")
    fuzz(space, out=tmp_path / "out", budget=2)
    assert "keeps the files of an earlier search, one.yaml among them" in capsys.readouterr().err
    assert file.read_text() == "scenario: of then\n"


def test_a_full_disk_costs_no_finding(
    space: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def full(path: Path, text: str) -> None:
        raise OutputError.from_os_error(path, OSError(28, "No space left on device"))

    monkeypatch.setattr(search_session, "write_text", full)
    assert fuzz(space, out=tmp_path / "out", budget=50) == BAD_INPUT
    out, err = capsys.readouterr()
    assert "No space left on device" in err
    assert "scenario: a hand nearby" in out
    assert "hand distance never below 150 mm: violated" in out


def test_what_pybullet_does_not_confirm_is_listed_and_is_no_violation(
    space: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def lies(self: Trials, points: np.ndarray, first: int) -> Outcomes:
        return Outcomes.of_margins(np.full((len(points), 1), -0.1))

    monkeypatch.setattr(Trials, "__call__", lies)
    out = tmp_path / "out"
    assert fuzz(space, out=out, budget=2, claims=["joint speeds within limits"]) == AS_EXPECTED
    assert "not confirmed in PyBullet" in capsys.readouterr().err
    assert counterexamples(out) == []
    assert json.loads((out / "findings.json").read_text())["not_confirmed"]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"budget": 0}, "at least 1 run"),
        ({"searcher": "dfault"}, "one of default, uniform"),
        ({"claims": ["hands are happy"]}, "a claim of the catalogue"),
        ({"avoider": "nobody"}, "nobody"),
    ],
)
def test_bad_input_is_explained_before_anything_runs(
    options: dict[str, object],
    message: str,
    space: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert fuzz(space, out=tmp_path / "out", **options) == BAD_INPUT  # type: ignore[arg-type]
    assert message in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_a_scenario_is_no_space(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "one.yaml"
    file.write_text(TEXT.replace("scenario space:", "scenario:"))
    assert fuzz(file, out=tmp_path / "out") == BAD_INPUT
    assert "one.yaml" in capsys.readouterr().err


def expecting(space: Path, verdict: str, claim: str = "hand distance never below 150 mm") -> Path:
    space.write_text(TEXT.replace(f"{claim}: holds", f"{claim}: {verdict}"))
    return space


def test_what_the_space_expects_to_be_violated_is_searched_and_found_as_expected(
    space: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert fuzz(expecting(space, "violated"), out=tmp_path / "out", budget=12) == AS_EXPECTED
    assert "hand distance never below 150 mm (as the space expects)" in capsys.readouterr().out
    (file,) = counterexamples(tmp_path / "out")
    assert run([file], tmp_path / "again") == AS_EXPECTED


def test_what_the_space_expects_to_be_violated_and_is_not_found_differs(
    space: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out, claim = tmp_path / "out", "joint speeds within limits"
    space = expecting(expecting(space, "violated"), "violated", claim)
    space.write_text(space.read_text().replace("150 mm: holds", "150 mm: violated"))
    assert fuzz(space, out=out, budget=12) == DIFFERS
    assert f"NOT FOUND  {claim}: the space expects it to be violated" in capsys.readouterr().out
    assert json.loads((out / "findings.json").read_text())["expected_and_not_found"] == [claim]
    assert "<strong>Not found.</strong> joint speeds within limits" in (out / "fuzz.html").read_text()


def test_a_draw_of_a_space_is_to_keep_what_the_space_has_violated_somewhere(
    space: Path, tmp_path: Path
) -> None:
    assert sample(expecting(space, "violated"), out=tmp_path, count=1, seed=0) == AS_EXPECTED
    (file,) = tmp_path.glob("*-0.yaml")
    assert "hand distance never below 150 mm: holds" in file.read_text()
