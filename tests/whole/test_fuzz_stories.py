"""fuzz tells one story once: what shrinks to one structure is one counterexample, however it was met."""

from __future__ import annotations

import json
import shlex
from itertools import count
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from safety_harness.cli import progress
from safety_harness.cli.console import DIFFERS
from safety_harness.cli.fuzz import fuzz
from safety_harness.cli.main import app
from safety_harness.search import session as search_session
from safety_harness.search.counterexample import STARTS_S

# A hand on either side is too fast to be given way to: one story, met from the right and from the left.
TWO_SIDES = """\
scenario space: a hand nearby, on either side
duration: 400 ms
avoider: opposite pose
choices:
  side: one of right, left
tcp start:
  offset: [0 mm, from -40 mm to 40 mm, 20 mm]
hands:
  - hand: a hand
    starts at:
      by: side
      right: [from 700 mm to 900 mm, -500 mm, 400 mm]
      left: [from 700 mm to 900 mm, 500 mm, 400 mm]
    elbow towards:
      by: side
      right: [1000 mm, -1200 mm, 500 mm]
      left: [1000 mm, 1200 mm, 500 mm]
    moves:
      - reach for tcp: from 1 m/s to 2 m/s
        stop at distance: 50 mm
        give up after: 2 s
claims:
  hand distance never below 150 mm: holds
"""
TWO_BUGS = """\
from safety_harness import Proposal


class TwoBugs:
    name = "two bugs"

    def propose(self, *, hand_position_in_base_m, tcp_position_in_base_m, seed):
        if hand_position_in_base_m[1] > 0.0:
            raise ZeroDivisionError(f"at {hand_position_in_base_m[1]}")
        return list(tcp_position_in_base_m)
"""


@pytest.fixture
def space(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    Path("two.yaml").write_text(TWO_SIDES)
    return Path("two.yaml")


def found_in(out: Path) -> dict[str, Any]:
    found: dict[str, Any] = json.loads((out / "findings.json").read_text())
    return found


def test_one_story_from_two_sides_is_one_counterexample_with_all_its_runs(
    space: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(search_session, "SHRINKING_RUNS", 60)
    monkeypatch.setattr(search_session, "MOST_SHRUNK", 2)
    monkeypatch.setattr(progress, "EVERY_S", 0.0)  # else lines of a pipe come every ten seconds
    assert fuzz(space, out=Path("out"), budget=12, explain="all") == DIFFERS
    (file,) = Path("out").glob("*.yaml")
    distinct = found_in(Path("out"))["distinct"]
    assert isinstance(distinct, list)
    assert {group["kind"].split(",")[0] for group in distinct} == {"right", "left"}
    shrunk = [group for group in distinct if group["counterexample"]]
    assert {group["counterexample"] for group in shrunk} == {file.name}
    assert {group["kind"].split(",")[0] for group in shrunk} == {"right", "left"}
    runs = sum(group["runs"] for group in shrunk)
    out, err = capsys.readouterr()
    assert f"{runs} violations led to it, the worst by " in out
    assert out.count("violated  ") == 1
    at = f"{distinct[0]['complaint']}, example 1"
    for step in ("confirming", "shrinking, run 1 of at most 60", "asking whose fault it is"):
        assert f"{at}: {step}\n" in err
    assert f"whose fault: 0 of {len(distinct)} groups of violations\n" in err
    assert f"VIOLATED  {found_in(Path('out'))['counted']}; " in out
    assert "(explains the rest)" not in err
    page = Path("out/fuzz.html").read_text()
    assert f"{runs} violations of searcher default led to it, in {len(shrunk)} groups" in page


def test_two_ways_not_to_answer_are_two_stories(space: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(search_session, "SHRINKING_RUNS", 8)
    Path("mine.py").write_text(TWO_BUGS)
    claims = ["joint speeds within limits"]
    assert fuzz(space, out=Path("out"), avoider="mine.py:TwoBugs", budget=12, claims=claims) == DIFFERS
    texts = [file.read_text() for file in Path("out").glob("*.yaml")]
    assert len(texts) == 2
    assert sum("ZeroDivisionError" in text for text in texts) == 1
    assert sum("got list" in text for text in texts) == 1


def test_what_is_left_when_enough_was_shrunk_is_said_with_its_runs(
    space: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(search_session, "SHRINKING_RUNS", 2)
    monkeypatch.setattr(search_session, "MOST_SHRUNK", 1)
    assert fuzz(space, out=Path("out"), budget=12) == DIFFERS
    distinct = found_in(Path("out"))["distinct"]
    assert isinstance(distinct, list)
    left = [group for group in distinct if group["counterexample"] is None]
    assert left
    out, err = capsys.readouterr()
    said = found_in(Path("out"))["counted"]
    assert f"VIOLATED  {said}; " in out
    assert said in Path("out/fuzz.html").read_text()
    rest = next(line for line in err.splitlines() if line.endswith("    (explains the rest)"))
    command = shlex.split(rest.removeprefix("next: ").removesuffix("    (explains the rest)"))
    assert CliRunner().invoke(app, command[1:]).exit_code == DIFFERS
    assert "--explain all" not in Path("out/fuzz.html").read_text().partition("Not explained yet")[2]


def test_explanations_simulate_no_more_than_the_search_whatever_the_clock_says(
    space: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(search_session, "SHRINKING_RUNS", 20)
    monkeypatch.setattr(search_session, "MOST_SHRUNK", 2)
    sessions = []
    explained = search_session.SearchSession._explain_groups
    monkeypatch.setattr(
        search_session.SearchSession,
        "_explain_groups",
        lambda session: (sessions.append(session), explained(session)),
    )
    few, slowly, every = Path("few"), Path("slowly"), Path("every")
    assert fuzz(space, out=few, budget=120) == DIFFERS
    said = capsys.readouterr()
    (allowance,) = [session.allowance for session in sessions]
    assert allowance.total_s == 120 * (0.4 + STARTS_S)
    assert 0.0 < allowance.spent_s < allowance.total_s
    begun = count(step=1000.0)
    with monkeypatch.context() as patch:
        patch.setattr("time.monotonic", lambda: next(begun))
        assert fuzz(space, out=slowly, budget=120) == DIFFERS
    assert [file.read_text().replace("slowly", "few") for file in sorted(slowly.glob("*.yaml"))] == [
        file.read_text() for file in sorted(few.glob("*.yaml"))
    ]
    assert fuzz(space, out=every, budget=120, explain="all") == DIFFERS
    one, several = (
        [group for group in found_in(out)["distinct"] if group["counterexample"]] for out in (few, every)
    )
    assert len(one) == 1 < len(several)
    line = found_in(few)["counted"]
    assert line.endswith(f"{found_in(few)['examples_not_explained']} examples not explained yet")
    assert f"VIOLATED  {line}; 120 violations in 120 runs\n" in said.out
    assert line in (few / "fuzz.html").read_text()
    assert found_in(few)["attribution"] is None
    assert found_in(every)["attribution"] is not None


def test_the_page_is_there_before_anything_is_explained(space: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def killed(session: search_session.SearchSession) -> None:
        raise SystemExit((session.out / "fuzz.html").read_text())

    monkeypatch.setattr(search_session.SearchSession, "_explain_groups", killed)
    with pytest.raises(SystemExit, match="hand distance never below"):
        fuzz(space, out=Path("out"), budget=12)
