"""Hands whose approaches are drawn from known distributions give a space that has them."""

from __future__ import annotations

import hashlib
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from safety_harness.base.exceptions import LogError
from safety_harness.cell.robot.description import load_arm
from safety_harness.cell.robot.kinematics import links_in_base
from safety_harness.cli.main import app
from safety_harness.extensions.field.hands import HandsFit, fit_hands, space_text
from safety_harness.extensions.field.logs.approaches import approaches_of
from safety_harness.extensions.field.logs.read import read_log
from safety_harness.space.read import parse_space

JOINTS_RAD = np.array([-0.22, -1.27, 1.98, -2.27, -1.57, -0.22])
ARM = load_arm("ur10")
TCP_M = links_in_base(ARM, JOINTS_RAD)[-1][:3, 3]
RATE_HZ = 50.0
TEXT = """\
log: {joints: joints.csv, hands: hands.csv#hand}
clock: {hands are ahead by: 0 ms, known to: 1 ms}
joints: {longest gap: 500 ms}
hands: {forearm: not measured, frame: base, longest gap: 200 ms, moves at most: 2 m/s, known to: 1 mm}
"""


def way(speed_mps: float, hard_mps2: float, length_m: float) -> np.ndarray:
    """(n,) how far along a straight way that speeds up and brakes evenly, from rest to rest."""
    speed_mps = min(speed_mps, np.sqrt(hard_mps2 * length_m))
    rise_s = speed_mps / hard_mps2
    total_s = length_m / speed_mps + rise_s
    t = np.arange(0.0, total_s, 1.0 / RATE_HZ)
    up, down = np.minimum(t, rise_s), np.maximum(t - (total_s - rise_s), 0.0)
    even = np.clip(t - rise_s, 0.0, total_s - 2.0 * rise_s)
    return 0.5 * hard_mps2 * up**2 + speed_mps * even + speed_mps * down - 0.5 * hard_mps2 * down**2


def write(
    folder: Path,
    count: int,
    *,
    humps: bool = False,
    lost: bool = False,
    hard_mps2: float = 4.0,
    seed: int = 0,
) -> Path:
    """So many approaches: 0.9 +- 0.2 m/s, 4 +- 0.7 m/s2, dwells from 0.5 to 2 s, or in two humps."""
    rng, rows, rests = np.random.default_rng(seed), [], None
    for _ in range(count):
        away = np.array([0.3, -1.0, 0.2]) + rng.normal(0.0, 0.15, 3)
        away /= np.linalg.norm(away)
        start, end = TCP_M + rng.normal(0.9, 0.05) * away, TCP_M + rng.normal(0.2, 0.03) * away
        along = way(rng.normal(0.9, 0.2), rng.normal(hard_mps2, 0.7), float(np.linalg.norm(end - start)))
        come = start + (end - start) * (along / np.linalg.norm(end - start))[:, None]
        stay_s = rng.choice([0.4, 3.0]) if humps else rng.uniform(0.5, 2.0)
        stay = np.repeat(end[None], round(stay_s * RATE_HZ), axis=0)
        rest = np.repeat(start[None], round(rng.uniform(0.5, 1.0) * RATE_HZ), axis=0)
        if rests is not None:  # slowly to where the next one begins
            steps = max(round(float(np.linalg.norm(start - rests)) / 0.25 * RATE_HZ), 1)
            rows.append(rests + (start - rests) * (np.arange(steps) / steps)[:, None])
        rests = start
        rows += [rest, come, stay, come[::-1], rest]
    hand = np.concatenate(rows)
    time_s = np.arange(len(hand)) / RATE_HZ
    lines = [f"{t:.4f},{x:.6f},{y:.6f},{z:.6f}" for t, (x, y, z) in zip(time_s, hand, strict=True)]
    if lost:
        lines = lines[: len(lines) // 2] + lines[len(lines) // 2 + 100 :]
    (folder / "hands.csv").write_text("time_s,hand_x_m,hand_y_m,hand_z_m\n" + "\n".join(lines) + "\n")
    told = ",".join(repr(float(angle)) for angle in JOINTS_RAD)
    joints = [f"{t:.3f},{told}" for t in np.arange(0.0, time_s[-1], 0.2)]
    names = ",".join(f"{name}_rad" for name in ARM.joint_names)
    (folder / "joints.csv").write_text(f"time_s,{names}\n" + "\n".join(joints) + "\n")
    (folder / "LOG.yaml").write_text(TEXT)
    return folder / "LOG.yaml"


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write(tmp_path_factory.mktemp("hands"), 80)


@pytest.fixture(scope="module")
def found(log: Path) -> HandsFit:
    return fit_hands([read_log(log)], seed=0)


def test_what_hands_were_drawn_with_is_recovered(found: HandsFit) -> None:
    assert found.approaches == 80
    fits = {one.name: {each.family: each for each in one.fits} for one in found.quantities}
    for name, mean, std, within in (("speed", 0.9, 0.2, 0.06), ("acceleration", 4.0, 0.7, 0.4)):
        assert not fits[name]["normal"].rejected, name
        assert fits[name]["normal"].parameters["mean"] == pytest.approx(mean, abs=within)
        assert fits[name]["normal"].parameters["std"] == pytest.approx(std, abs=within)
    assert fits["dwell"]["uniform"].parameters["low"] == pytest.approx(0.5, abs=0.15)
    assert fits["dwell"]["uniform"].parameters["high"] == pytest.approx(2.0, abs=0.15)
    chosen = {one.name: one.chosen for one in found.quantities}
    assert chosen["dwell"] == fits["dwell"]["uniform"]
    assert chosen["speed"] == fits["speed"]["normal"]
    assert fits["speed"]["uniform"].rejected
    assert fits["distance at the end"]["normal"].parameters["mean"] == pytest.approx(0.2, abs=0.02)
    np.testing.assert_allclose(found.direction.mean, np.array([0.28, -0.94, 0.19]), atol=0.06)
    assert found.direction.any_p_value < 1e-6


def test_approaches_an_hour_have_the_interval_of_their_number(found: HandsFit) -> None:
    low, high = found.per_hour_interval
    assert low < found.per_hour == found.approaches / found.hours < high
    assert (low * found.hours, high * found.hours) == pytest.approx((63.4, 99.6), abs=0.1)  # Garwood's of 80


def test_it_is_a_space_that_draws_such_hands(found: HandsFit, log: Path) -> None:
    space = parse_space(space_text(found))
    scenario = space.draw(seed=1, k=0)
    assert 0.1 <= scenario.hands[0].moves[1].speed_mps <= 2.0
    assert scenario.hands[0].moves[2].duration_s < 3.0
    assert space_text(found) == space_text(fit_hands([read_log(log)], seed=0))
    assert next(one for one in found.quantities if one.name == "speed").text.startswith("normal ")


def test_what_fits_no_family_stands_as_it_was_recorded(tmp_path: Path) -> None:
    found = fit_hands([read_log(write(tmp_path, 30, humps=True))], seed=0)
    dwell = next(one for one in found.quantities if one.name == "dwell")
    assert all(one.rejected for one in dwell.fits)
    assert dwell.text.startswith("one of ")
    assert any("dwell: no family fits" in note for note in found.notes)
    parse_space(space_text(found))


def test_hands_that_speed_up_too_hard_to_be_seen_are_told_of(tmp_path: Path, found: HandsFit) -> None:
    """Over 0.1 s: of 12 m/s2 some 6 are left."""
    hard = fit_hands([read_log(write(tmp_path, 30, hard_mps2=12.0))], seed=0)
    mean = np.mean(next(one.values for one in hard.quantities if one.name == "acceleration"))
    assert 4.0 < mean < 9.0
    assert "30 accelerations are too small" in " ".join(hard.notes)
    assert not any(note.startswith("80 accelerations") for note in found.notes)


def test_a_gap_is_told_and_what_it_cuts_is_left_out(tmp_path: Path) -> None:
    watched = approaches_of(read_log(write(tmp_path, 12, lost=True)))
    assert watched.gaps == 1
    assert watched.cut >= 1 or len(watched.approaches) < 12
    whole_s = float(read_log(tmp_path / "LOG.yaml").hands[0].hand.time_ns[-1]) / 1e9
    assert watched.seconds == pytest.approx(whole_s - 2.0, abs=0.3)


MOST_MISSED = 20


def planted(folder: Path, what: str) -> Path:
    """The log of 20 approaches in which something hides them, or makes the time longer."""
    file = write(folder, MOST_MISSED)
    lines = (folder / "hands.csv").read_text().splitlines()
    rows = np.array([line.split(",") for line in lines[1:]], float)
    near = np.linalg.norm(rows[:, 1:] - TCP_M, axis=1)
    header = lines[0]
    if what == "a second hand rests":
        rest = np.tile([1.5, 1.5, 0.5], (len(rows), 1))
        rows, header = np.hstack([rows, rest]), header + ",other_x_m,other_y_m,other_z_m"
        file.write_text(TEXT.replace("hands.csv#hand", "{one: 'hands.csv#hand', two: 'hands.csv#other'}"))
    coming = np.append(np.diff(near) < -1e-4, False)
    first = np.flatnonzero(coming & ~np.roll(coming, 1) & (near > 0.6))
    lost = np.zeros(len(rows), bool)
    first = [k for k in first if near[k : k + 80].min() < 0.45]
    for k in first[8:] if what.startswith("approaches begin") else []:
        lost[max(k - 5, 0) : k + (11 if what.endswith("gap") else 60)] = True
    if what == "quick reaches":
        still = np.append(np.linalg.norm(np.diff(rows[:, 1:], axis=0), axis=1) < 1e-9, False)
        dwelling = still & (near < 0.5)
        dwelling &= np.cumsum(dwelling & ~np.roll(dwelling, 1)) > 6
        rows = rows[~dwelling]
        rows[:, 0] = np.arange(len(rows)) / RATE_HZ
    text = [",".join(f"{value:.6f}" for value in row) for row in rows[~lost[: len(rows)]]]
    (folder / "hands.csv").write_text("\n".join([header, *text]) + "\n")
    return file


@pytest.mark.parametrize(
    "what",
    ["a second hand rests", "approaches begin in a gap", "approaches begin and end in one", "quick reaches"],
)
def test_the_bound_counts_what_hides_in_a_log(tmp_path: Path, what: str) -> None:
    """Clock time, not hours of hands; cut moves, gaps and reaches that turn back count."""
    log = read_log(planted(tmp_path, what))
    hours = float(log.hands[0].hand.time_ns[-1]) / 3.6e12
    found = fit_hands([log], seed=0)
    assert found.approaches >= MOST_MISSED
    assert found.approaches <= 1.6 * MOST_MISSED
    assert found.hours <= hours
    assert found.per_hour >= MOST_MISSED / hours
    assert any("approaches count as independent" in note for note in found.notes)


def test_one_recording_counts_once(tmp_path: Path) -> None:
    """Named twice, or copied to another folder."""
    one = write(tmp_path, 8)
    (tmp_path / "copy").mkdir()
    for file in list(tmp_path.glob("*.*")):
        (tmp_path / "copy" / file.name).write_bytes(file.read_bytes())
    for other in (one, tmp_path / "copy" / "LOG.yaml"):
        with pytest.raises(LogError, match="expected each recording once"):
            fit_hands([read_log(one), read_log(other)], seed=0)


def test_approaches_of_equal_speed_are_a_space(found: HandsFit) -> None:
    rest = [one for one in found.quantities if one.name != "speed"]
    speed = next(one for one in found.quantities if one.name == "speed")
    equal = replace(found, quantities=(replace(speed, values=(0.8,) * 80, fits=()), *rest))
    assert "reach speed" not in space_text(equal)
    assert parse_space(space_text(equal)).draw(1, 0).hands[0].moves[1].speed_mps == pytest.approx(0.8)


def test_too_few_approaches_are_refused(tmp_path: Path) -> None:
    with pytest.raises(LogError, match=r"5 approaches at least, in all the logs; got 3, among"):
        fit_hands([read_log(write(tmp_path, 3))], seed=0)


def test_from_the_command_line(log: Path, tmp_path: Path) -> None:
    out = tmp_path / "hands.yaml"
    run = CliRunner().invoke(app, ["hands", "fit", str(log), "--out", str(out), "--json"])
    assert run.exit_code == 0, run.output
    told, _ = json.JSONDecoder().raw_decode(run.stdout[run.stdout.index("{") :])  # old runners mix in stderr
    assert told["result"]["fit"]["approaches"] == 80
    digest = hashlib.sha256((log.parent / "hands.csv").read_bytes()).hexdigest()
    assert digest in out.read_text()
    drawn = CliRunner().invoke(app, ["sample", str(out), "--count", "2", "--out", str(tmp_path / "drawn")])
    assert drawn.exit_code == 0, drawn.output
    assert len(list((tmp_path / "drawn").glob("*.yaml"))) == 2
