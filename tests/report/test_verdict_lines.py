"""What a terminal shows of verdicts: a single run in full, of many runs the surprises."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from safety_harness import parse_scenario
from safety_harness.cell.simulation.worlds import KINEMATIC
from safety_harness.cli.scenario_commands import judge, run
from safety_harness.report import verdict_lines
from safety_harness.report.evidence import JudgedRun, answer
from safety_harness.report.run_job import run as run_scenarios
from safety_harness.report.verdict_lines import (
    block_of,
    every_line,
    nearest_hand_words,
    surprise_lines,
)
from safety_harness.scenario.model import Scenario

REACH = """\
scenario: a hand reaches for the tool
duration: 3 s
avoider: opposite pose
tcp start:
  offset: [0 mm, -60 mm, 20 mm]
hands:
  - hand: right hand
    starts at: [1100 mm, -700 mm, 300 mm]
    elbow towards: [1600 mm, -1200 mm, 300 mm]
    moves:
      - wait: 500 ms
      - reach for tcp: 2 m/s
        stop at distance: 20 mm
        give up after: 2 s
claims:
  joint speeds within limits: holds
  uncertain answers fall back within 2 cycles: inconclusive
  hand distance never below 50 mm: violated
"""


@pytest.fixture(scope="module")
def reach() -> JudgedRun:
    (judged,) = run_scenarios(parse_scenario(REACH), world=KINEMATIC).runs
    return judged


def test_a_single_run_shows_claims_worst_first_with_moment_part_and_contact(reach: JudgedRun) -> None:
    tested, *claims, last = block_of(reach)
    assert tested.endswith("avoider opposite pose, in the kinematic world, seed 0")
    assert [line.split("  ")[0] for line in claims if not line.startswith(" ")] == [
        "violated, as expected",
        "inconclusive, as expected",
    ]
    assert claims[1].strip().startswith("contact: right hand: ")
    assert " mm inside wrist 3 at " in claims[1]
    assert "never exercised: " in claims[3]
    assert last.startswith("holds  ")
    other = REACH.partition("claims:")[0] + "claims:\n  joint speeds within limits: holds\n"
    (judged,) = run_scenarios(parse_scenario(other), world=KINEMATIC).runs
    *_, last = block_of(judged)
    assert last.startswith("contact: right hand: ")  # which no claim names


def test_a_hand_that_touches_nothing_is_no_contact(reach: JudgedRun) -> None:
    slow = REACH.replace("2 m/s", "200 mm/s").replace("stop at distance: 20 mm", "stop at distance: 600 mm")
    (judged,) = run_scenarios(parse_scenario(slow), world=KINEMATIC).runs
    assert nearest_hand_words(judged.trace).startswith("nearest hand: right hand: ")
    alone = run_scenarios(
        parse_scenario(REACH.split("hands:")[0] + "claims:\n  joint speeds within limits: holds\n")
    )
    assert nearest_hand_words(alone.trace) == ""


def test_of_many_runs_only_surprises_and_undecided_claims_are_lines(reach: JudgedRun) -> None:
    other = replace(reach, trace=replace(reach.trace, scenario=_expecting_it_to_hold(reach)))
    lines = list(surprise_lines([reach, other]))
    assert [line.split("  ")[0] for line in lines if not line.startswith(" ")] == [
        "VIOLATED",
        "inconclusive, as expected",
        "inconclusive, as expected",
    ]
    assert lines[0].endswith("(expected holds)")
    assert answer([reach, other]) == "5 of 6 verdicts as expected (2 hold, 2 violated, 2 inconclusive)"


def _expecting_it_to_hold(run: JudgedRun) -> Scenario:
    claims = parse_scenario(REACH.replace("50 mm: violated", "50 mm: holds")).claims
    return replace(run.trace.scenario, claims=claims)


def test_a_long_list_is_cut_and_says_how_to_see_the_rest(
    reach: JudgedRun, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(verdict_lines, "MOST_LINES", 2)
    lines = list(surprise_lines([reach] * 5))
    assert len(lines) == 5
    assert lines[-1] == "... 3 more like these; -v prints every verdict"


def test_every_line_has_verdict_margin_and_moment(reach: JudgedRun) -> None:
    *claims, nearest, tested = every_line(reach)
    assert len(claims) == 3
    assert nearest.lstrip().startswith("contact: right hand: ")
    assert claims[2].startswith("violated, as expected ")
    assert tested.startswith("tested in ")


def test_the_commands_end_with_the_next_step(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    for name in ("one", "two"):
        Path(f"{name}.yaml").write_text(REACH)
    assert run([Path("one.yaml")], Path("out"), world="kinematic") == 0
    assert "next: safety-harness attribute out/traces/one.trace    (" in capsys.readouterr().err
    assert run([Path("one.yaml"), Path("two.yaml")], Path("out"), world="kinematic") == 0
    out, err = capsys.readouterr()
    assert "violated" not in out.splitlines()[0]
    assert err.splitlines()[-1] == "next: safety-harness judge out/traces/*.trace -v    (every verdict)"
    assert judge(sorted(Path("out/traces").glob("*.trace")), verbose=True) == 0
    assert capsys.readouterr().out.count("violated, as expected  ") == 2
