"""What a log has twice is compared, what repeats is not measured, and what nothing confirms is listed."""

from __future__ import annotations

import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from cells import MIDDLE_RAD, NAMES, Floats, Streams, cell, recorded, said, tcp_m, write_csv
from log_formats import _pose, header, joint_messages, of, poses, write_bag
from rosbags.rosbag2 import StoragePlugin
from test_contradictions import DISTANCE, verdict_of, with_text
from typer.testing import CliRunner

from safety_harness.base.exceptions import InputError, LogError
from safety_harness.cli.main import app
from safety_harness.extensions.field.logs.approaches import approaches_of
from safety_harness.extensions.field.logs.assumptions import assumptions_of
from safety_harness.extensions.field.logs.frozen import BLOCK, Repeats, frozen
from safety_harness.extensions.field.logs.judging import recorded as judged_log
from safety_harness.extensions.field.logs.read import read_log
from safety_harness.scenario.model import Verdict

STILL = np.zeros((400, 3)) + np.array([0.9, -0.4, 0.3])
TIME_S = np.arange(400)[:, None] / 125.0
SMOOTH = STILL + np.array([0.2, 0.1, 0.05]) * np.sin(1.3 * TIME_S)


@pytest.fixture
def streams() -> Streams:
    rng = np.random.default_rng(2)
    return recorded(cell(rng), rng, seconds=1.6)


@pytest.fixture
def log(streams: Streams, tmp_path: Path) -> Path:
    write_csv(streams, tmp_path)
    return with_text(tmp_path, said("joints.csv", "hands.csv#hand", "hands.csv#elbow"))


def add_columns(file: Path, names: list[str], values: Floats) -> None:
    """Write ``values`` (n, k) as further columns of a table."""
    rows = file.read_text().splitlines()
    more = [",".join(names), *(",".join(map(repr, row)) for row in values.tolist())]
    file.write_text("\n".join(f"{row},{beside}" for row, beside in zip(rows, more, strict=True)) + "\n")


def with_tcp(log: Path, streams: Streams, off_m: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> Path:
    """The place of the TCP beside the joints, ``off_m`` away from it in the base frame."""
    add_columns(
        log.with_name("joints.csv"), [f"tool_{a}_m" for a in "xyz"], tcp_m(streams.joints_rad) + off_m
    )
    text = log.read_text().replace('joints: "joints.csv"', 'joints: "joints.csv", tcp: "joints.csv#tool"')
    log.write_text(text + "tcp: {known to: 2 mm, frame: base}\n")
    return log


def test_a_tcp_that_the_joints_lead_to_confirms_the_arm(log: Path, streams: Streams) -> None:
    found = read_log(with_tcp(log, streams))
    assert found.tcp is not None
    assert found.tcp.apart_m < 2e-3
    assert found.tcp.unseen == ("wrist_3_joint",)
    assert verdict_of(log, DISTANCE) is Verdict.HOLDS
    confirmed = {one.what: bool(one.confirmed_by) for one in assumptions_of(found)}
    assert confirmed["the arm, UR10"]
    assert confirmed["where its tool ends"]
    assert not confirmed["the shape of its tool"]
    assert not confirmed["the zero positions of wrist_3_joint, to within 5 deg: they hardly move the TCP"]


@pytest.mark.parametrize(
    "change",
    [
        ("robot: UR10", "robot: UR5"),
        ("frame: base}", "frame: {at: [0 m, 0 m, 0 m], turned: [0 deg, 0 deg, 180 deg]}}"),
        ("joints: {known", f"joints: {{names: {{{NAMES[3]}: {NAMES[4]}, {NAMES[4]}: {NAMES[3]}}}, known"),
    ],
)
def test_another_arm_frame_or_order_than_the_tcp_shows_is_refused(
    log: Path, streams: Streams, change: tuple[str, str]
) -> None:
    """``robot: UR5`` for the log of a UR10 was a false green."""
    text = with_tcp(log, streams).read_text()
    assert change[0] in text
    log.write_text(text.replace(*change))
    with pytest.raises(LogError, match="mm away") as refused:
        judged_log(log)
    assert (refused.value.place.line, refused.value.place.field) == (2, "tool")
    assert "at 0.000 s, where joints.csv has it" in refused.value.expected


@pytest.mark.parametrize(("off_m", "refused"), [((0.0, 0.0, 0.0015), False), ((0.0, 0.0, -0.17), True)])
def test_another_tool_than_the_tcp_shows_is_refused(
    log: Path, streams: Streams, off_m: tuple[float, float, float], refused: bool
) -> None:
    """A gripper that is forgotten; within what is said of the TCP nothing is."""
    with_tcp(log, streams, off_m)
    if not refused:
        judged_log(log)
        return
    with pytest.raises(LogError, match=r"17\d\.?\d* mm away"):
        judged_log(log)


@pytest.mark.parametrize("joint", range(5))
def test_another_zero_position_than_the_tcp_shows_is_refused(
    tmp_path: Path, streams: Streams, joint: int
) -> None:
    turned = replace(streams, joints_rad=streams.joints_rad + np.radians(10.0) * np.eye(6)[joint])
    write_csv(turned, tmp_path)
    log = with_text(tmp_path, said("joints.csv", "hands.csv#hand", "hands.csv#elbow"))
    with pytest.raises(LogError, match="mm away"):
        judged_log(with_tcp(log, streams))


def test_a_tcp_between_the_samples_of_the_joints_is_compared_with_what_they_may_have_done(
    log: Path, streams: Streams
) -> None:
    """Of a cell whose TCP is recorded on its own times, the sample that begins to differ is named."""
    rng = np.random.default_rng(2)
    one, time_s = cell(rng), np.arange(0.003, 1.5, 0.011)
    places = tcp_m(one.joints_rad(time_s))
    file = log.with_name("tcp.csv")
    log.write_text(log.read_text().replace('"joints.csv"', '"joints.csv", tcp: "tcp.csv#tcp"')
                   + "tcp: {known to: 1 mm, frame: base}\n")  # fmt: skip
    for more_m, ok in ((0.0, True), (0.02, False)):
        moved = places + (time_s > 0.8)[:, None] * more_m
        rows = [f"{streams.joint_ns[0] + round(t * 1e9)},{','.join(map(repr, at))}"
                for t, at in zip(time_s.tolist(), moved.tolist(), strict=True)]  # fmt: skip
        file.write_text("\n".join(["time_ns,tcp_x_m,tcp_y_m,tcp_z_m", *rows]) + "\n")
        if ok:
            judged_log(log)
            continue
        with pytest.raises(LogError, match="mm away") as refused:
            judged_log(log)
        assert refused.value.place.line == 2 + int(np.argmax(time_s > 0.8))


def test_a_tcp_of_a_bag_is_compared_too(streams: Streams, tmp_path: Path) -> None:
    kind = "geometry_msgs/msg/PoseStamped"
    tcp = zip(streams.joint_ns.tolist(), tcp_m(streams.joints_rad), strict=True)
    messages = [(t, "/tcp", kind, of(kind, header(t, "base_link"), _pose(at))) for t, at in tcp]
    write_bag(tmp_path / "run", joint_messages(streams) + poses(streams) + messages, StoragePlugin.MCAP)
    text = said("run#/joint_states", "run#/hand", "run#/elbow", "")
    text = text.replace("log: {", 'log: {tcp: "run#/tcp", ') + "tcp: {known to: 2 mm}\n"
    log = with_text(tmp_path, text)
    assert verdict_of(log, DISTANCE) is Verdict.HOLDS
    frames = [one for one in assumptions_of(read_log(log)) if one.what.endswith(" of hand")]
    assert len(frames) == 2
    assert all("the frames that headers of run#/hand name" in one.confirmed_by for one in frames)
    log.write_text(text.replace("UR10", "UR5"))
    with pytest.raises(LogError, match="message 1 of /tcp"):
        judged_log(log)


def test_a_tcp_without_a_stream_is_refused(log: Path) -> None:
    log.write_text(log.read_text() + "tcp: {known to: 2 mm}\n")
    with pytest.raises(InputError, match="a stream of tcp below log"):
        judged_log(log)


def hand_speeds(streams: Streams) -> Floats:
    """The true velocities of the hand at its samples."""
    one = cell(np.random.default_rng(2))
    time_s = (streams.hand_ns - streams.joint_ns[0]) / 1e9 - 0.137
    return np.asarray((one.hand_m(time_s + 1e-4) - one.hand_m(time_s - 1e-4)) / 2e-4)


def with_hand_speeds(log: Path, speeds: Floats, more: str = "") -> Path:
    names = [f"hand_{more}{axis}_mps" for axis in "xyz"]
    add_columns(log.with_name("hands.csv"), names, speeds)
    field = f", field: {more[:-1]}" * bool(more)
    text = log.read_text().replace("  frame: base", f"  frame: base\n  speeds: {{known to: 50 mm/s{field}}}")
    log.write_text(text)
    return log


@pytest.mark.parametrize("more", ["", "velocity_"])
def test_speeds_of_a_hand_that_lead_from_place_to_place_are_read(
    log: Path, streams: Streams, more: str
) -> None:
    rng = np.random.default_rng(3)
    speeds = hand_speeds(streams)
    with_hand_speeds(log, speeds + rng.uniform(-0.05, 0.05, speeds.shape), more)
    assert verdict_of(log, DISTANCE) is Verdict.HOLDS


@pytest.mark.parametrize("factor", [-1.0, 0.0, 0.1, np.array([1.0, -1.0, 1.0]), 1.8])
def test_speeds_of_a_hand_that_do_not_lead_from_place_to_place_are_refused(
    log: Path, streams: Streams, factor: float | Floats
) -> None:
    with pytest.raises(LogError, match="by its speeds") as refused:
        judged_log(with_hand_speeds(log, hand_speeds(streams) * factor))
    assert "as its positions do, to within" in refused.value.expected
    assert refused.value.place.file == log.with_name("hands.csv")


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_speeds_of_a_hand_in_a_bag_are_a_field_in_the_frame_of_its_positions(
    streams: Streams, tmp_path: Path, sign: float
) -> None:
    odometry, twist = "nav_msgs/msg/Odometry", "geometry_msgs/msg/Twist"
    pose, moved = "geometry_msgs/msg/PoseWithCovariance", "geometry_msgs/msg/TwistWithCovariance"
    vector, none = "geometry_msgs/msg/Vector3", np.zeros(36)
    messages = [
        (t, "/hand", odometry, of(odometry, header(t, "base_link"), "hand", of(pose, _pose(at), none),
         of(moved, of(twist, of(vector, *(sign * v).tolist()), of(vector, 0.0, 0.0, 0.0)), none)))
        for t, at, v in zip(streams.hand_ns.tolist(), streams.hand_m, hand_speeds(streams), strict=True)
    ]  # fmt: skip
    write_bag(tmp_path / "run", joint_messages(streams) + messages, StoragePlugin.MCAP)
    text = said("run#/joint_states", "run#/hand:pose.pose.position", "none", "frame: base")
    field = "frame: base\n  speeds: {known to: 50 mm/s, field: twist.twist.linear}"
    log = with_text(tmp_path, text.replace('"none"', "none").replace("frame: base", field))
    if sign > 0.0:
        assert verdict_of(log, DISTANCE) is Verdict.HOLDS
        return
    with pytest.raises(LogError, match="by its speeds"):
        judged_log(log)


def noise(values: Floats, size: float = 1e-3, seed: int = 1) -> Floats:
    return np.asarray(values + np.random.default_rng(seed).normal(0.0, size, values.shape))


def rest_after(values: Floats, first: int, after: int) -> Floats:
    """The same, which stands exactly in between."""
    found = values.copy()
    found[first:after] = found[first]
    return found


@pytest.mark.parametrize(
    "values",
    [
        STILL,
        rest_after(SMOOTH, 100, 200),  # no noise, and stands still exactly
        rest_after(np.round(SMOOTH, 4), 100, 200),
        rest_after(np.round(SMOOTH * np.sin(40.0 * TIME_S), 6), 100, 200),
        rest_after(noise(SMOOTH * 4.0, 1e-4), 100, 200),  # jitter of a motion: no noise where it is slow
        np.round(noise(STILL, 1e-5), 4),  # a resolution that hides the noise
        np.round(noise(STILL, 3e-5), 4),
        noise(STILL),
        np.repeat(noise(STILL)[::16], 16, axis=0),  # a slower stream, held in a table
        np.repeat(noise(STILL)[::4], 4, axis=0),
        rest_after(noise(STILL), 100, 104),  # three repetitions
    ],
)
def test_a_stream_that_may_repeat_itself_is_not_frozen(values: Floats) -> None:
    assert not frozen(values).any()


@pytest.mark.parametrize(("first", "after"), [(0, 40), (100, 105), (100, 200), (380, 400)])
@pytest.mark.parametrize("values", [noise(STILL), np.round(noise(SMOOTH, 5e-3), 4), noise(SMOOTH, 5e-3)])
def test_a_stream_with_noise_that_repeats_itself_is_frozen(values: Floats, first: int, after: int) -> None:
    found = np.flatnonzero(frozen(rest_after(values, first, after)))
    assert found.tolist() == list(range(first + 1, after))


@pytest.mark.parametrize("values", [noise(STILL), SMOOTH, np.round(noise(SMOOTH, 5e-3), 4)])
@pytest.mark.parametrize("first", [0, 120])
def test_sample_by_sample_it_is_frozen_where_the_whole_stream_is(values: Floats, first: int) -> None:
    values, repeats = rest_after(values, first, first + 60), Repeats()
    since = [repeats.since(k, tuple(row)) for k, row in enumerate(values.tolist())]
    whole = np.flatnonzero(frozen(values))
    told = [k for k, at in enumerate(since) if at is not None]
    if first == 0 and len(whole):  # told when the noise is known, for what was before
        assert len(told) == 1
        assert told[0] <= 60 + 6 * BLOCK
        return
    assert told == [k for k in whole if k >= first + 4]
    assert {since[k] for k in told} <= {first}


def test_a_hand_that_freezes_leaves_claims_on_it_open(log: Path, streams: Streams) -> None:
    """A tracker that hangs for 0.6 s, within whose gap the hand may be anywhere."""
    still = noise(streams.hand_m * 0.0 + streams.hand_m[0], 2e-3)
    hangs = rest_after(still, 20, 38)
    write_csv(replace(streams, hand_m=still), log.parent)
    assert verdict_of(log, DISTANCE) is Verdict.HOLDS
    write_csv(replace(streams, hand_m=hangs), log.parent)
    assert verdict_of(log, DISTANCE) is Verdict.INCONCLUSIVE
    assert verdict_of(log, "joint speeds within limits") is Verdict.HOLDS
    assert approaches_of(read_log(log)).gaps == 1
    (note,) = [one for one in judged_log(log).notes if "to the last bit" in one]
    first_s, last_s = streams.hand_ns[[20, 37]] / 1e9
    assert f"hands.csv#hand: repeats its values to the last bit from {first_s:.3f} to {last_s:.3f} s" in note
    log.write_text(log.read_text().replace("  frame: base", "  frame: base\n  repeats: at rest"))
    assert verdict_of(log, DISTANCE) is Verdict.HOLDS
    assert any("at rest, as the file says" in one for one in judged_log(log).notes)


@pytest.mark.parametrize("end", [False, True])
def test_a_joint_that_freezes_leaves_claims_on_the_arm_open(log: Path, streams: Streams, end: bool) -> None:
    """Also at the end of a log, where nothing shows that it goes on."""
    count = len(streams.joint_ns)
    still = noise(np.zeros((count, 6)) + MIDDLE_RAD, 5e-5)
    one = still.copy()
    first = count - 40 if end else 80
    one[:, 1:2] = rest_after(still[:, 1:2], first, first + 40)
    text = log.read_text().replace(", accelerate at most: 4.0 rad/s2", "")
    log.write_text(text)
    claim = "always TCP height > 1 mm"
    log.write_text(text + f"  - {claim}\n")
    for joints, expected in ((still, Verdict.HOLDS), (one, Verdict.INCONCLUSIVE)):
        write_csv(replace(streams, joints_rad=joints), log.parent)
        assert verdict_of(log, claim) is expected
    log.write_text(log.read_text().replace("joints: {known", "joints: {repeats: at rest, known"))
    assert verdict_of(log, claim) is Verdict.HOLDS


def with_columns(
    streams: Streams, folder: Path, unit: str, rate: str, factor: float, of_speeds: float
) -> Path:
    """Angles in rad times ``factor`` in columns that end in ``unit``, beside speeds in ``rate``."""
    write_csv(streams, folder)
    log = with_text(folder, said("joints.csv", "hands.csv#hand", "hands.csv#elbow"))
    table, angles = folder / "joints.csv", streams.joints_rad * factor
    times = [row.split(",")[0] for row in table.read_text().splitlines()]
    names = [times[0], *(f"{name}_{unit}" for name in NAMES)]
    rows = [",".join([time, *map(repr, row)]) for time, row in zip(times[1:], angles.tolist(), strict=True)]
    table.write_text("\n".join([",".join(names), *rows]) + "\n")
    speeds = np.gradient(streams.joints_rad, streams.joint_ns / 1e9, axis=0) * of_speeds
    add_columns(table, [f"{name}_{rate}" for name in NAMES], speeds)
    return log


DEG = 180.0 / np.pi


@pytest.mark.parametrize(
    ("unit", "rate", "factor", "of_speeds", "refused"),
    [
        ("deg", "radps", 1.0, 1.0, "57.3 times their way"),
        ("rad", "degps", 1.0, 1.0, "0.0175 times their way"),
        ("deg", "radps", DEG, 1.0, ""),
        ("deg", "degps", DEG, 0.0, ""),  # a column that nobody fills
        ("deg", "degps", 1.0, 1.0, ""),  # one mistake in both: nothing in the log shows it
    ],
)
def test_speeds_in_another_unit_than_the_angles_are_refused_and_the_unit_is_named(
    streams: Streams, tmp_path: Path, unit: str, rate: str, factor: float, of_speeds: float, refused: str
) -> None:
    log = with_columns(streams, tmp_path, unit, rate, factor, of_speeds)
    if refused:
        with pytest.raises(LogError, match=refused):
            read_log(log)
        return
    words = [note for note in judged_log(log).notes if note.startswith("the log does not confirm")]
    most = np.degrees(np.ptp(streams.joints_rad, axis=0).max()) * factor / DEG
    assert f"the unit of its angles, in which no joint turns by more than {most:.3g} deg" in words[0]
    assert "the unit of length for hand" in words[0]


def test_one_column_of_another_unit_is_refused_with_its_name(streams: Streams, tmp_path: Path) -> None:
    """Others, whose columns are right, move farther."""
    log = with_columns(streams, tmp_path, "rad", "radps", 1.0, 1.0)
    table = log.with_name("joints.csv")
    table.write_text(table.read_text().replace(f"{NAMES[1]}_rad,", f"{NAMES[1]}_deg,", 1))
    with pytest.raises(LogError, match=f"lead along {NAMES[1]}"):
        read_log(log)


def test_noise_at_rest_is_no_other_unit(streams: Streams, tmp_path: Path) -> None:
    """In two samples of one joint whose angle and speed have noise, the one may be 57 times the other."""
    log, at = with_text(tmp_path, "log: {joints: joints.csv}\nclaims: [joint speeds within limits]\n"), 1e-4
    names = ["time_s", *(f"{name}_rad" for name in NAMES), f"{NAMES[0]}_radps"]
    rows = [[0.0, *[0.0] * 6, 0.7], [0.008, at, *[0.0] * 5, 0.7]]
    lines = [",".join(map(str, row)) for row in (names, *rows)]
    log.with_name("joints.csv").write_text("\n".join(lines) + "\n")
    assert read_log(log)


def test_a_tcp_confirms_the_unit_of_the_angles(log: Path, streams: Streams) -> None:
    units = [
        one for one in assumptions_of(read_log(with_tcp(log, streams))) if one.what.startswith("the unit")
    ]
    assert [bool(one.confirmed_by) for one in units] == [True, False]


def test_what_nothing_reads_is_told_beside_the_verdict(log: Path, streams: Streams) -> None:
    names = ["actual_tcp_x_m", "payload_kg"]
    add_columns(log.with_name("joints.csv"), names, np.zeros((len(streams.joint_ns), 2)))
    wanted = "unread columns, topics and joints: joints.csv#actual_tcp_x_m, joints.csv#payload_kg"
    assert wanted in judged_log(log).notes
    (arm,) = [one for one in assumptions_of(read_log(log)) if one.what.startswith("the arm")]
    assert arm.would == "a track of the TCP: log: {tcp: FILE#TRACK}, perhaps joints.csv#actual_tcp_x_m"


def test_topics_and_joints_that_nothing_reads_are_told(streams: Streams, tmp_path: Path) -> None:
    text, finger = "std_msgs/msg/String", "sensor_msgs/msg/JointState"
    first, messages = int(streams.joint_ns[0]), joint_messages(streams)
    messages[0][3].name.append("finger_joint")
    messages[0][3].position = np.append(messages[0][3].position, 0.0)
    assert messages[0][2] == finger
    messages.append((first, "/state", text, of(text, "RUN")))
    write_bag(tmp_path / "run", messages + poses(streams), StoragePlugin.MCAP)
    log = with_text(tmp_path, said("run#/joint_states", "run#/hand", "run#/elbow", ""))
    assert read_log(log).unused == ("run#/state", "run#finger_joint")


def test_log_check_lists_what_is_assumed_and_the_column_that_would_confirm_it(
    log: Path, streams: Streams
) -> None:
    found = CliRunner().invoke(app, ["log", "check", str(log)])
    lines = found.stdout.splitlines()
    assert found.exit_code == 0
    assert "ASSUMED    the arm, UR10" in lines
    assert "           would confirm it: a track of the TCP: log: {tcp: FILE#TRACK}" in lines
    for what in ("the direction of the axes of hand", "the origin of the heights of hand"):
        assert f"ASSUMED    {what}" in lines
    assert "the log does not confirm the arm, UR10; the zero positions" in found.stderr
    found = CliRunner().invoke(app, ["log", "check", str(with_tcp(log, streams))])
    assert "confirmed  the arm, UR10" in found.stdout.splitlines()
    assert "the zero positions of wrist_3_joint" in found.stderr
    data = json.loads(CliRunner().invoke(app, ["log", "check", str(log), "--json"]).stdout)
    assert data["result"]["assumptions"][0]["what"] == "the arm, UR10"


def test_in_pytest_each_claim_of_a_log_has_what_was_left_out_in_junit(log: Path, streams: Streams) -> None:
    add_columns(log.with_name("joints.csv"), ["payload_kg"], np.zeros((len(streams.joint_ns), 1)))
    text = log.read_text()
    log.write_text(text[: text.index("claims:")] + f"claims: [{DISTANCE}]\n")
    command = [sys.executable, "-m", "pytest", "-q", f"--junitxml={log.parent / 'junit.xml'}", str(log)]
    ran = subprocess.run(command, cwd=log.parent, capture_output=True, text=True, check=False)
    assert ran.returncode == 0, ran.stdout
    properties = ElementTree.parse(log.parent / "junit.xml").iter("property")
    notes = [one.get("value") for one in properties if one.get("name") == "note"]
    assert "unread columns, topics and joints: joints.csv#payload_kg" in notes
    assert any(str(note).startswith("the log does not confirm the arm, UR10;") for note in notes)
