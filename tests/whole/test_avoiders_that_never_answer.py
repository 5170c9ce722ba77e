"""Two avoiders that never answer, through every command: exit 1, and headlines that say what was shown."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest

from safety_harness.cli.console import AS_EXPECTED, DIFFERS
from safety_harness.cli.fuzz import fuzz
from safety_harness.cli.new import new
from safety_harness.cli.scenario_commands import judge as judge_again
from safety_harness.cli.scenario_commands import run
from safety_harness.search import session as search_session
from tests.cli.test_own_avoider import VISIT
from tests.search.short_space import TEXT

IN_PLACE = "the avoider did not answer: with the fallback in its place in"
RAISING = """\
class Mine:
    name = "raising"
    def propose(self, *, hand_position_in_base_m, tcp_position_in_base_m, seed):
        raise ZeroDivisionError(f"at {hand_position_in_base_m[0]}")
"""
LISTING = RAISING.replace("raising", "listing").replace(
    'raise ZeroDivisionError(f"at {hand_position_in_base_m[0]}")', "return list(tcp_position_in_base_m)"
)
ANSWERING = LISTING.replace("list(", "Proposal(").replace("m)\n", "m + [0.0, 0.0, 0.07])\n")


@pytest.fixture(autouse=True)
def _here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


@pytest.fixture(
    params=[RAISING, pytest.param(LISTING, marks=pytest.mark.long)], ids=["raises", "returns a list"]
)
def visit(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    (tmp_path / "mine.py").write_text(request.param)
    file = tmp_path / "visit.yaml"
    file.write_text(VISIT)
    return file


def test_run_and_judge_end_with_1_and_every_headline_says_why(
    visit: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run([visit], Path("out"), "mine.py:Mine") == DIFFERS
    shown = capsys.readouterr()
    assert "\nholds  " in shown.out
    assert re.search(r"^VIOLATED  the avoider answered .* \(expected holds\)$", shown.out, re.MULTILINE)
    (closing,) = [line for line in shown.out.splitlines() if "verdicts as expected" in line]
    assert closing.startswith("1 of 2 verdicts as expected")
    assert f"{IN_PLACE} 1 of 1 decision" in closing
    page = Path("out/report.html").read_text()
    assert IN_PLACE in page.split("<title>")[1].split("</title>")[0]
    assert IN_PLACE in page.split("<h1>")[1].split("</h1>")[0]
    assert 'class="banner fine"' not in page
    (found,) = json.loads(Path("out/report.json").read_text())["runs"]
    assert found["avoider_answered"]["verdict"] == "violated"
    assert found["claims"][-1]["claim"] == "the avoider answered"
    trace = Path("out/traces/visit.trace")
    assert judge_again([trace]) == DIFFERS
    assert judge_again([trace], ["TCP speed never above 250 mm/s"]) == DIFFERS


def test_what_a_file_expects_counts(visit: Path, capsys: pytest.CaptureFixture[str]) -> None:
    visit.write_text(VISIT + "  The avoider answered: violated\n")
    assert run([visit], Path("out"), "mine.py:Mine") == AS_EXPECTED
    shown = capsys.readouterr()
    assert shown.out.count("avoider answered") == 1
    assert IN_PLACE in shown.out
    trace = Path("out/traces/visit.trace")
    assert judge_again([trace], ["TCP speed never above 250 mm/s"]) == AS_EXPECTED
    assert run([visit], Path("again"), "opposite pose") == DIFFERS


def test_where_it_answers_or_is_never_asked_there_is_no_line_more(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "mine.py").write_text("from safety_harness import Proposal\n" + ANSWERING)
    (tmp_path / "visit.yaml").write_text(VISIT)
    (tmp_path / "alone.yaml").write_text(VISIT.replace("1.6 s", "200 ms"))
    for name in ("visit", "alone"):
        assert run([Path(f"{name}.yaml")], Path(name), "mine.py:Mine") == AS_EXPECTED
        shown = capsys.readouterr()
        assert "avoider answered" not in shown.out
        assert "fallback" not in shown.out + shown.err
    verdicts = [
        json.loads(Path(name, "report.json").read_text())["runs"][0]["avoider_answered"]["verdict"]
        for name in ("visit", "alone")
    ]
    assert verdicts == ["holds", "inconclusive"]


def test_the_file_of_new_claims_it(capsys: pytest.CaptureFixture[str]) -> None:
    assert new("reaching", Path("mine.yaml")) == AS_EXPECTED
    assert "\n  the avoider answered: holds\n" in Path("mine.yaml").read_text()


def test_fuzz_finds_it_says_it_and_keeps_one_file_that_runs_as_it_says(
    visit: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(search_session, "SHRINKING_RUNS", 12)
    Path("short.yaml").write_text(TEXT)
    claims = ["joint speeds within limits"]
    assert (
        fuzz(Path("short.yaml"), out=Path("out"), avoider="mine.py:Mine", budget=6, claims=claims) == DIFFERS
    )
    shown = capsys.readouterr()
    assert "the avoider answered: the avoider gave no answer: " in shown.out
    assert f"tried 6/6, refused 0, 0 violations, 1 kinds of mishap; {IN_PLACE}" in shown.err
    (file,) = Path("out").glob("*.yaml")
    assert "the avoider answered: violated" in file.read_text()
    assert IN_PLACE in Path("out/fuzz.html").read_text().split("</h1>")[0]
    found = json.loads(Path("out/findings.json").read_text())
    assert found["unanswered"] == found["decisions"] > 0
    assert run([file], Path("again")) == AS_EXPECTED


def test_fuzz_looks_for_it_where_nothing_else_is_claimed(capsys: pytest.CaptureFixture[str]) -> None:
    Path("short.yaml").write_text(TEXT)
    sentence = "the avoider answered"
    assert fuzz(Path("short.yaml"), out=Path("out"), budget=3, claims=[sentence]) == AS_EXPECTED
    assert f"{sentence}: violated 0 of 3 with a verdict" in capsys.readouterr().err
