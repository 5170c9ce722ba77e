"""A log becomes a scenario in which the same happens again, and a space that is searched around it."""

from __future__ import annotations

import csv
import json
import re
from pathlib import Path

import numpy as np
import pytest
from cells_made import write_log
from typer.testing import CliRunner, Result

from safety_harness.admission.admit import admit
from safety_harness.admission.trial import judge, run_kinematic
from safety_harness.cli.main import app
from safety_harness.scenario.model import RecordedHand, Verdict
from safety_harness.scenario.read import read_scenario
from safety_harness.search.cube import Cube
from safety_harness.search.default import Default
from safety_harness.search.search import find_violations
from safety_harness.search.trials import Trials, in_kinematic
from safety_harness.space.read import read_space
from safety_harness.trace.trace import Trace

NEAR = "hand distance never below 150 mm"


def made(log: Path, cell: Path | None, *words: str, out: str = "made") -> Result:
    """Into a folder beside the log's."""
    options = [] if cell is None else ["--scenario", str(cell)]
    given = ["scenario", "from", str(log), *options, *words, "--out", str(log.parent.parent / out)]
    return CliRunner().invoke(app, given)


@pytest.fixture
def folder(log: Path, cell: Path, tmp_path: Path) -> Path:
    """What ``scenario from`` writes of the log, with the space around it."""
    found = made(log, cell, "--around", "100", "mm", "--speed", "0.8..1.25")  # as a shell splits it
    assert found.exit_code == 0, found.output
    return tmp_path / "made"


def test_an_incident_becomes_a_test_that_fails_until_it_no_longer_happens(
    log: Path, folder: Path, tmp_path: Path
) -> None:
    judged = CliRunner().invoke(app, ["judge", str(log), "--claim", NEAR])
    assert judged.exit_code == 1
    out = tmp_path / "run"
    again = ["run", str(folder / "LOG.yaml"), "--world", "kinematic", "--out", str(out)]
    assert CliRunner().invoke(app, again).exit_code == 1
    (run,) = json.loads((out / "report.json").read_text())["runs"]
    near = next(one for one in run["claims"] if one["claim"] == NEAR)
    assert (near["verdict"], near["expected"]) == ("violated", "holds")


def test_what_happened_is_simulated_again_to_the_last_digits(happened: Trace, folder: Path) -> None:
    run = run_kinematic(admit(read_scenario(folder / "LOG.yaml")))
    for name in ("joint_position_rad", "hand_position_in_base_m", "hand_distance_m"):
        np.testing.assert_allclose(run.ticks[name], happened.ticks[name], rtol=0.0, atol=1e-6)
    assert judge(run)[0].verdict is Verdict.VIOLATED


def test_a_search_around_it_finds_violations(folder: Path) -> None:
    space = read_space(folder / "LOG-around.yaml")
    trials, cube = Trials(space, in_kinematic, seed=0), Cube.from_space(space)
    searcher = Default(cube, claims=len(trials.goals), seed=0)
    found = find_violations(cube, trials.goals, trials, searcher, budget=4)
    assert found.tried == 4
    assert found.violated[0] > 0


def test_every_draw_is_what_happened_elsewhere_and_faster_or_slower(folder: Path) -> None:
    space, what = read_space(folder / "LOG-around.yaml"), read_scenario(folder / "LOG.yaml")
    (hand,) = what.hands
    assert isinstance(hand, RecordedHand)
    draws = [space.draw(seed=1, k=k).hands[0] for k in range(30)]
    shifts = np.array([one.shift_in_base_m for one in draws])
    assert np.abs(shifts).max() <= 0.1
    assert (shifts.min(axis=0) < -0.05).all()
    assert (shifts.max(axis=0) > 0.05).all()
    paces = [one.speed_factor for one in draws if isinstance(one, RecordedHand)]
    assert 0.8 <= min(paces) < 0.9 < 1.15 < max(paces) <= 1.25
    assert {one.motion.sha256 for one in draws if isinstance(one, RecordedHand)} == {hand.motion.sha256}
    assert space.simplest.duration_s == pytest.approx(what.duration_s / 0.8)


def test_the_recording_has_the_samples_of_the_log_and_no_others(
    happened: Trace, cell: Path, tmp_path: Path
) -> None:
    log = write_log(happened, tmp_path / "slow", f"{NEAR}: violated", every=4)
    assert made(log, cell).exit_code == 0
    with (tmp_path / "made" / "LOG-right-hand.csv").open() as file:
        rows = list(csv.DictReader(file))
    times = [float(row["time_s"]) for row in rows]
    np.testing.assert_allclose(times, happened.time_s[::4][: len(times)], atol=1e-12)
    seen = [[float(row[f"hand_{axis}_m"]) for axis in "xyz"] for row in rows]
    assert seen == happened.ticks["hand_position_in_base_m"][::4, 0][: len(seen)].tolist()


def test_comments_say_what_is_the_logs_and_what_is_not(folder: Path) -> None:
    text = (folder / "LOG.yaml").read_text().replace("\n# ", " ")
    assert "From the log: the hands as they were measured (LOG-right-hand.csv), the joints" in text
    assert "Not in the log, but from" in text
    assert "the desired TCP, the object, the camera, the hand sensor, the avoider, opposite pose" in text
    assert f"LOG.yaml expects violated: {NEAR}" in text


def test_without_a_scenario_the_task_ends_where_the_log_does_or_is_said_to(
    happened: Trace, log: Path, tmp_path: Path
) -> None:
    found = made(log, None, "--around", "50", "mm")
    assert found.exit_code == 0, found.output
    assert "desired TCP where the log ends, avoider opposite pose" in found.output
    settings = read_scenario(tmp_path / "made" / "LOG.yaml").settings
    end_m = happened.ticks["transform_tcp_to_base"][-1, :3, 3]
    np.testing.assert_allclose(settings.cell.desired_tcp_position_in_base_m, end_m, atol=2e-4)
    given = made(log, None, "--desired-tcp", "720 mm, 20 mm, 340 mm", out="other")
    assert given.exit_code == 0, given.output
    settings = read_scenario(tmp_path / "other" / "LOG.yaml").settings
    assert settings.cell.desired_tcp_position_in_base_m == (0.72, 0.02, 0.34)
    assert settings.object.position_in_base_m == (0.72, 0.065, -0.3)


def test_two_desired_tcps_are_one_too_many(log: Path, cell: Path) -> None:
    found = made(log, cell, "--desired-tcp", "720 mm, 20 mm, 340 mm")
    assert found.exit_code == 2
    assert "--desired-tcp" in found.output


def test_worlds_are_compared_with_a_scenario_of_the_cell_alone(log: Path) -> None:
    found = CliRunner().invoke(app, ["compare-worlds", str(log)])
    assert found.exit_code == 2
    assert "--scenario" in found.output
    assert "a scenario of the cell" in found.output


@pytest.mark.parametrize("lost_s", [(0.4, 0.8), (0.0, 0.4), (1.5, 3.0)])
def test_a_gap_is_refused_with_the_part_that_has_none(
    happened: Trace, cell: Path, tmp_path: Path, lost_s: tuple[float, float]
) -> None:
    begin, end = lost_s
    log = write_log(happened, tmp_path / "gap", f"{NEAR}: holds", lost_s=(begin - 1e-6, end))
    found = made(log, cell)
    assert found.exit_code == 2
    assert "hands.csv:" in found.output
    assert "the harness does not fill gaps" in found.output
    hint = re.search(r'--(to|from) "([0-9.]+ s)"', found.output)
    assert hint is not None
    again = made(log, cell, f"--{hint[1]}", hint[2])
    assert again.exit_code == 0, again.output
    scenario = read_scenario(tmp_path / "made" / "LOG.yaml")
    assert 0.3 < scenario.duration_s < 1.9


def test_a_forearm_that_was_not_measured_points_where_it_is_said(
    happened: Trace, cell: Path, tmp_path: Path
) -> None:
    log = write_log(happened, tmp_path / "bare", f"{NEAR}: holds", forearms=False)
    nobody = tmp_path / "cells" / "nobody.yaml"
    nobody.write_text(re.sub(r"hands:\n.*(?=claims)", "", cell.read_text(), flags=re.DOTALL))
    found = made(log, nobody)
    assert found.exit_code == 2
    assert "--elbow-towards" in found.output
    assert made(log, nobody, "--elbow-towards", "1 m, -1.2 m, 0.5 m").exit_code == 0
    (hand,) = read_scenario(tmp_path / "made" / "LOG.yaml").hands
    assert isinstance(hand, RecordedHand)
    assert hand.elbow_towards_in_base_m == (1.0, -1.2, 0.5)
    assert made(log, cell, out="as-in-the-cell").exit_code == 0


def test_another_arm_is_another_cell(log: Path, cell: Path) -> None:
    cell.write_text(cell.read_text() + "robot: UR5\n")
    found = made(log, cell)
    assert found.exit_code == 2
    assert "the same robot as in the scenario cell" in found.output


def test_nothing_that_was_edited_is_overwritten(log: Path, cell: Path, folder: Path) -> None:
    assert made(log, cell).exit_code == 0
    edited = folder / "LOG.yaml"
    edited.write_text(edited.read_text() + "# mine\n")
    found = made(log, cell)
    assert found.exit_code == 2
    assert "not there yet" in found.output
    assert edited.read_text().endswith("# mine\n")


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (("--around", "100"), "has no unit"),
        (("--around", "9 m"), "at most 2 m"),
        (("--speed", "1.25"), "0.8..1.25"),
        (("--speed", "1.2..0.8"), "0.8..1.25"),
        (("--from", "soon"), "--from"),
    ],
)
def test_options_that_cannot_be_used_are_named(
    log: Path, cell: Path, words: tuple[str, ...], told: str
) -> None:
    found = made(log, cell, *words)
    assert found.exit_code == 2
    assert told in found.output
    assert not (log.parent.parent / "made").exists()
