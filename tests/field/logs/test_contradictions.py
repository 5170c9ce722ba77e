"""A log that contradicts itself, or shows less than its file says, never gives a green verdict."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from cells import NAMES, Cell, Floats, Streams, cell, recorded, said, words_of, write_csv
from log_formats import (
    TURN,
    _transform,
    header,
    joint_messages,
    of,
    pose_array,
    poses,
    sqlite3,
    word_messages,
    write_bag,
)
from rosbags.rosbag2 import StoragePlugin

from safety_harness.admission.trial import judge
from safety_harness.base.exceptions import InputError, LogError
from safety_harness.extensions.field.logs.judging import recorded as judged_log
from safety_harness.scenario.model import Verdict


@pytest.fixture
def streams() -> Streams:
    rng = np.random.default_rng(2)
    return recorded(cell(rng), rng, seconds=1.0)


@pytest.fixture
def log(streams: Streams, tmp_path: Path) -> Path:
    write_csv(streams, tmp_path)
    return with_text(tmp_path, said("joints.csv", "hands.csv#hand", "hands.csv#elbow"))


def with_text(folder: Path, text: str) -> Path:
    (folder / "LOG.yaml").write_text(text)
    return folder / "LOG.yaml"


def of_poses(streams: Streams, folder: Path, frames: list[str], frame: str) -> Path:
    """A bag whose poses name ``frames`` one after another, and the last one to the end."""
    messages = poses(streams)
    for k, (t, _, _, message) in enumerate(messages):
        message.header = header(t, frames[min(k, len(frames) - 1)])
    write_bag(folder / "run", joint_messages(streams) + messages, StoragePlugin.MCAP)
    return with_text(folder, said("run#/joint_states", "run#/hand", "run#/elbow", frame))


def verdict_of(log: Path, claim: str) -> Verdict:
    return next(one for one in judge(judged_log(log).trace) if one.sentence == claim).verdict


DISTANCE = "hand distance never below 50 mm"
CAMERA = "camera_color_optical_frame"


@pytest.mark.parametrize("frames", [[CAMERA], ["base_link"] * 12 + [CAMERA], [""] * 12 + ["world"]])
def test_a_header_of_another_frame_than_the_file_states_is_refused(
    streams: Streams, tmp_path: Path, frames: list[str]
) -> None:
    """Each message is asked, not the first alone, and both names are told."""
    with pytest.raises(LogError) as refused:
        judged_log(of_poses(streams, tmp_path, frames, "frame: base"))
    assert '"base_link", as the file says' in refused.value.expected
    assert f'"{frames[-1]}" in its header' in refused.value.got
    assert f"message {len(frames)} of /hand" in str(refused.value.place)


def test_a_frame_that_changes_on_the_way_is_refused_wherever_it_was_placed(
    streams: Streams, tmp_path: Path
) -> None:
    placed = "frame: {at: [0 m, 0 m, 0 m]}"
    with pytest.raises(LogError, match="as messages before it"):
        judged_log(of_poses(streams, tmp_path, [CAMERA] * 9 + ["world"], placed))


def test_positions_in_the_base_frame_are_in_no_frame_that_is_elsewhere(
    streams: Streams, tmp_path: Path
) -> None:
    with pytest.raises(LogError, match="another frame than the base"):
        judged_log(of_poses(streams, tmp_path, ["base_link"], "frame: {at: [1 m, 0 m, 0 m]}"))


def test_a_decision_in_another_frame_than_is_stated_is_refused(streams: Streams, tmp_path: Path) -> None:
    rng = np.random.default_rng(2)
    told = replace(streams, words=words_of(cell(rng), streams))
    assert told.words is not None
    text = sqlite3(told, tmp_path)
    assert len(told.words.decided_ns) > 0
    write_bag(tmp_path / "elsewhere", [
        (t, topic, kind, replace(message, header=header(t, CAMERA)) if topic == "/decision" else message)
        for t, topic, kind, message in joint_messages(told) + poses(told) + word_messages(told)
    ], StoragePlugin.SQLITE3)  # fmt: skip
    text = text.replace("run#", "elsewhere#")
    with pytest.raises(LogError, match=f'"{CAMERA}" in its header'):
        judged_log(with_text(tmp_path, text))


@pytest.mark.parametrize(
    ("frame", "stated"),
    [
        ("", "frame: base"),
        ("base_link", "frame: base"),
        ("world", "frame: {base: world}"),
        (CAMERA, "frame: {at: [0 m, 0 m, 0 m]}"),
        (CAMERA, f"frame: {{at: [0 m, 0 m, 0 m], of: {CAMERA}}}"),
    ],
)
def test_a_header_that_agrees_with_the_file_is_read(
    streams: Streams, tmp_path: Path, frame: str, stated: str
) -> None:
    assert verdict_of(of_poses(streams, tmp_path, [frame], stated), DISTANCE) is Verdict.HOLDS


@pytest.mark.parametrize(("turned_rad", "refused"), [(0.8e-6, False), (1.2e-6, True)])
def test_a_frame_moves_by_the_angle_that_it_turns(
    streams: Streams, tmp_path: Path, turned_rad: float, refused: bool
) -> None:
    """Up to a millionth of a radian it stands still; the norm of a difference of matrices is no angle."""
    messages, half = pose_array(streams), np.pi / 4.0 + turned_rad / 2.0
    again = _transform(messages[0][0] + 10**9, "base_link", "tracker", [0.5, -0.25, 0.125],
                       (0.0, 0.0, np.sin(half), np.cos(half)))  # fmt: skip
    assert TURN[1, 0] == 1.0
    tf = "tf2_msgs/msg/TFMessage"
    messages.append((messages[0][0] + 10**9, "/tf_static", tf, of(tf, [again])))
    write_bag(tmp_path / "run", joint_messages(streams) + messages, StoragePlugin.MCAP)
    frame = "frame: {tf: 'run#/tf_static'}"
    log = with_text(tmp_path, said("run#/joint_states", "run#/people[0]", "run#/people[1]", frame))
    if not refused:
        assert len(judged_log(log).trace.ticks) > 100
        return
    with pytest.raises(LogError, match=r"moved by 0 mm and turned by 6\.8\d+e-05 deg"):
        judged_log(log)


def at_places(log: Path, places: dict[int, tuple[float, float, float]]) -> None:
    """Write other places of the hand into its table, by the row."""
    rows = log.with_name("hands.csv").read_text().splitlines()
    for at, place in places.items():
        cells = rows[at].split(",")
        rows[at] = ",".join([cells[0], *map(repr, place), *cells[4:]])
    log.with_name("hands.csv").write_text("\n".join(rows) + "\n")


@pytest.mark.parametrize("nowhere", [(0.0, 0.0, 0.0), (-0.0, 0.0, 0.0), (999.0, 999.0, 999.0)])
@pytest.mark.parametrize(
    "frame", ["frame: base", "frame: {at: [1.5 m, 0 m, 1.2 m], turned: [0 deg, 0 deg, 90 deg]}"]
)
def test_a_place_for_not_seen_is_no_measurement(
    log: Path, nowhere: tuple[float, float, float], frame: str
) -> None:
    """Zeros in the sensor's frame, or one far place again and again: a gap, and a word on it."""
    log.write_text(log.read_text().replace("frame: base", frame))
    assert judged_log(log).trace.known.column("hand_position_in_base_m").gaps == ()
    at_places(log, dict.fromkeys(range(12, 20), nowhere))
    found = judged_log(log)
    assert len(found.trace.known.column("hand_position_in_base_m").gaps) == 1
    assert any("hands.csv#hand: 8 of " in note and "are no measurements" in note for note in found.notes)


def test_far_places_that_differ_are_still_a_mistake_of_the_unit(log: Path) -> None:
    at_places(log, {12: (999.0, 999.0, 999.0), 13: (999.0, 999.0, 998.0)})
    with pytest.raises(LogError, match="within 10 m"):
        judged_log(log)


def test_a_hand_that_was_never_seen_has_no_verdict(streams: Streams, tmp_path: Path) -> None:
    """A second hand of zeros in a camera's frame is 1.2 m away from the arm, and nowhere."""
    write_csv(streams, tmp_path)
    times = streams.hand_ns.tolist()
    rows = ["time_ns,left_x_m,left_y_m,left_z_m", *(f"{t},0.0,0.0,0.0" for t in times)]
    (tmp_path / "left.csv").write_text("\n".join(rows) + "\n")
    text = said("joints.csv", "HANDS", "none", "frame: {at: [1.5 m, 0 m, 1.2 m]}")
    text = text.replace('"HANDS"', "{right: 'hands.csv#hand', left: 'left.csv#left'}")
    with pytest.raises(LogError, match=r"two samples at least of left\.csv#left") as refused:
        judged_log(with_text(tmp_path, text))
    assert refused.value.got == f"0 of {len(times)}"


@pytest.mark.parametrize("table", ["joints.csv", "hands.csv"])
@pytest.mark.parametrize("by", [1, 4])
def test_a_table_whose_last_line_is_cut_is_refused(log: Path, table: str, by: int) -> None:
    """A cut number is a number, so the missing line end has to tell."""
    file = log.with_name(table)
    file.write_bytes(file.read_bytes()[:-by])
    with pytest.raises(LogError, match="a line end after the last line") as refused:
        judged_log(log)
    assert refused.value.place.line == len(file.read_text().splitlines())


def test_a_column_of_angles_without_a_unit_is_no_column_of_speeds(streams: Streams, tmp_path: Path) -> None:
    write_csv(streams, tmp_path)
    file = tmp_path / "joints.csv"
    file.write_text(file.read_text().replace("_rad", ""))
    text = said("joints.csv", "hands.csv#hand", "hands.csv#elbow")
    log = with_text(tmp_path, text.replace("joints: {known", "joints: {unit: rad, known"))
    assert verdict_of(log, DISTANCE) is Verdict.HOLDS


def test_a_tf_frame_is_found_with_or_without_a_slash(streams: Streams, tmp_path: Path) -> None:
    tf = "tf2_msgs/msg/TFMessage"
    times, hand = streams.hand_ns.tolist(), zip(streams.hand_m, streams.elbow_m, strict=True)
    messages = [
        (
            t,
            "/tf",
            tf,
            of(tf, [_transform(t, "base_link", f"/{n}", at) for n, at in zip("he", pair, strict=True)]),
        )
        for t, pair in zip(times, hand, strict=True)
    ]
    write_bag(tmp_path / "run", joint_messages(streams) + messages, StoragePlugin.MCAP)
    log = with_text(tmp_path, said("run#/joint_states", "run#/tf:h", "run#/tf:e", ""))
    assert verdict_of(log, DISTANCE) is Verdict.HOLDS


def with_speeds(log: Path, one: Cell, factor: Floats, order: list[int], off_radps: float = 0.0) -> Path:
    """The true speeds of the joints times ``factor`` (6,), in another ``order``, and up to so much off."""
    file, rng = log.with_name("joints.csv"), np.random.default_rng(5)
    rows = file.read_text().splitlines()
    times = np.array([int(row.split(",")[0]) for row in rows[1:]])
    rates = one.rates_radps((times - times[0]) / 1e9)[:, order] * factor
    rates += rng.uniform(-off_radps, off_radps, rates.shape)
    told = [",".join(map(repr, row.tolist())) for row in rates]
    rows = [",".join(pair) for pair in zip(rows, [",".join(f"{n}_radps" for n in NAMES), *told], strict=True)]
    file.write_text("\n".join(rows) + "\n")
    log.write_text(log.read_text().replace("joints: {known", "joints: {speeds known to: 1 deg/s, known"))
    return log


SAME, SIX = [0, 1, 2, 3, 4, 5], np.ones(6)


@pytest.mark.parametrize(
    ("factor", "order"),
    [
        (np.degrees(SIX), SAME),
        (-SIX, SAME),
        (np.array([1.0, 1.0, 1.0, -1.0, 1.0, 1.0]), SAME),
        (SIX, SAME[::-1]),
        (0.0 * SIX, SAME),
        (1.2 * SIX, SAME),
    ],
)
@pytest.mark.parametrize("hardest", [", accelerate at most: 4.0 rad/s2", ""])
def test_speeds_that_do_not_lead_from_angle_to_angle_are_refused(
    log: Path, factor: Floats, order: list[int], hardest: str
) -> None:
    """Degrees for radians, a sign, another joint's speeds, zeros while it moves: with both numbers."""
    log.write_text(log.read_text().replace(", accelerate at most: 4.0 rad/s2", hardest))
    with_speeds(log, cell(np.random.default_rng(2)), factor, order)
    with pytest.raises(LogError, match="by its speeds") as refused:
        judged_log(log)
    assert refused.value.place.file == log.with_name("joints.csv")
    assert "as its positions do, to within" in refused.value.expected


@pytest.mark.parametrize("seed", range(8))
def test_speeds_as_far_off_as_is_said_are_no_contradiction(tmp_path: Path, seed: int) -> None:
    rng = np.random.default_rng(seed)
    one = cell(rng)
    write_csv(recorded(one, rng, seconds=2.0), tmp_path)
    log = with_text(tmp_path, said("joints.csv", "hands.csv#hand", "hands.csv#elbow"))
    judged_log(with_speeds(log, one, SIX, SAME, off_radps=float(np.radians(1.0))))


def with_left(log: Path, hands: str = "hands.csv#hand", more: str = "") -> Path:
    """The hands' table has a second track, 5 cm above the first one."""
    file = log.with_name("hands.csv")
    rows = [row.split(",") for row in file.read_text().splitlines()]
    rows[0] += [f"left_{axis}_m" for axis in "xyz"]
    for row in rows[1:]:
        row += [*row[1:3], repr(float(row[3]) + 0.05)]
    file.write_text("\n".join(map(",".join, rows)) + "\n")
    text = log.read_text().replace('"hands.csv#hand"', f'"{hands}"')
    log.write_text(text.replace("  frame: base", f"  frame: base\n{more}"))
    return log


def test_a_track_that_the_file_does_not_name_leaves_claims_on_any_hand_open(log: Path) -> None:
    assert verdict_of(log, DISTANCE) is Verdict.HOLDS
    with_left(log)
    assert verdict_of(log, DISTANCE) is Verdict.INCONCLUSIVE
    assert verdict_of(log, "joint speeds within limits") is Verdict.HOLDS
    assert any("neither mapped nor left out: hands.csv#left" in note for note in judged_log(log).notes)


def test_a_track_that_the_file_leaves_out_is_told_beside_the_verdict(log: Path) -> None:
    with_left(log, more="  left out: ['hands.csv#left']")
    assert verdict_of(log, DISTANCE) is Verdict.HOLDS
    assert "left out, as the file says: hands.csv#left" in judged_log(log).notes
    log.write_text(log.read_text().replace("hands.csv#left", "hands.csv#lefft"))
    with pytest.raises(InputError, match=r"hands\.csv#left"):
        judged_log(log)


def test_nothing_can_be_left_out_where_all_bodies_are_mapped(log: Path) -> None:
    text = log.read_text().replace("  frame: base", "  frame: base\n  left out: ['hands.csv#left']")
    log.write_text(text)
    with pytest.raises(InputError, match="a stream beside the hands"):
        judged_log(log)


def test_a_pose_that_the_file_does_not_name_leaves_claims_on_any_hand_open(
    streams: Streams, tmp_path: Path
) -> None:
    messages = joint_messages(streams) + pose_array(streams)
    write_bag(tmp_path / "run", messages, StoragePlugin.MCAP)
    frame = "frame: {tf: 'run#/tf_static'}"
    both = with_text(tmp_path, said("run#/joint_states", "run#/people[0]", "run#/people[1]", frame))
    assert verdict_of(both, DISTANCE) is Verdict.HOLDS
    nearest, text = "always nearest hand to TCP > 1 mm", both.read_text()
    both.write_text(text.replace('"run#/people[1]"', "none").replace(DISTANCE, nearest))
    assert verdict_of(both, nearest) is Verdict.INCONCLUSIVE
    assert any("run#/people[1]" in note for note in judged_log(both).notes)


@pytest.mark.parametrize(("kept", "part"), [(slice(0, 90), "to: 0.8 s"), (slice(30, None), "from: 0 s")])
def test_hands_that_go_on_without_joints_leave_claims_on_them_open(
    streams: Streams, tmp_path: Path, kept: slice, part: str
) -> None:
    """Where the arm was then is not known; that part of the hands is left out if the file says so."""
    joints = replace(streams, joint_ns=streams.joint_ns[kept], joints_rad=streams.joints_rad[kept])
    write_csv(joints, tmp_path)
    text = said("joints.csv", "hands.csv#hand", "hands.csv#elbow")
    log = with_text(tmp_path, text)
    assert verdict_of(log, DISTANCE) is Verdict.INCONCLUSIVE
    assert any("joints are left out, and no claim" in note for note in judged_log(log).notes)
    log.write_text(text.replace("log: {", f"log: {{{part}, "))
    assert verdict_of(log, DISTANCE) is Verdict.HOLDS
    assert any(note.endswith("joints are left out") for note in judged_log(log).notes)
