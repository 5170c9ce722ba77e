"""Files as recorders and vendors' tools write them: what is read of each, and what stays out."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from io import BytesIO
from pathlib import Path
from struct import pack
from typing import Any

import numpy as np
import pytest
from cells import NAMES, Streams, cell, endless_arm, recorded, said, tcp_m, wrapped, write_csv
from log_formats import STORE, frames, header, joint_messages, of, poses, write_bag
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin
from rosbags.typesys import Stores, get_typestore

from safety_harness.admission.trial import judge
from safety_harness.base.exceptions import InputError, LogError
from safety_harness.extensions.field.logs.judging import recorded as judged_log
from safety_harness.extensions.field.logs.model import CellLog
from safety_harness.extensions.field.logs.read import read_log
from safety_harness.extensions.field.recorded.scenario import scenario_from, usual_cell
from safety_harness.scenario.model import Verdict

JOINT_STATE = "sensor_msgs/msg/JointState"
BAG = said("run#/joint_states", "run#/hand", "run#/elbow", "")
TABLES = said("joints.csv", "hands.csv#hand", "hands.csv#elbow")


@pytest.fixture(scope="module")
def streams() -> Streams:
    rng = np.random.default_rng(2)
    return recorded(cell(rng), rng, seconds=0.6)


def with_text(folder: Path, text: str) -> Path:
    (folder / "LOG.yaml").write_text(text)
    return folder / "LOG.yaml"


def bag(streams: Streams, folder: Path, more: list[tuple[int, str, str, Any]] = []) -> Path:  # noqa: B006
    return write_bag(folder / "run", [*joint_messages(streams), *poses(streams), *more], StoragePlugin.MCAP)


def the_same(log: CellLog, streams: Streams) -> None:
    np.testing.assert_allclose(log.joints.values[:, :6], streams.joints_rad, atol=1e-12)
    np.testing.assert_array_equal(log.joints.time_ns, streams.joint_ns)
    np.testing.assert_allclose(
        log.hands[0].hand.values, streams.hand_m[: len(log.hands[0].hand.values)], atol=1e-9
    )


def gripper(streams: Streams, names: list[str]) -> list[tuple[int, str, str, Any]]:
    return [
        (t + 1, "/joint_states", JOINT_STATE,
         of(JOINT_STATE, header(t + 1, ""), names, np.zeros(len(names)), np.zeros(0), np.zeros(0)))
        for t in streams.joint_ns.tolist()[::2]
    ]  # fmt: skip


def test_messages_of_other_joints_on_the_topic_are_skipped_and_counted(
    streams: Streams, tmp_path: Path
) -> None:
    bag(streams, tmp_path, gripper(streams, ["left_finger", "right_finger"]))
    found = read_log(with_text(tmp_path, BAG))
    the_same(found, streams)
    count = len(streams.joint_ns[::2])
    assert (
        f"run#/joint_states: {count} messages that name no joint of the arm are skipped: "
        in found.joints.notes[0]
    )
    assert "run#left_finger" in found.unused


def test_a_message_that_names_some_joints_of_the_arm_is_refused(streams: Streams, tmp_path: Path) -> None:
    bag(streams, tmp_path, gripper(streams, [*NAMES[:5], "left_finger"]))
    with pytest.raises(LogError, match='expected the joint "wrist_3_joint"'):
        read_log(with_text(tmp_path, BAG))


@contextmanager
def mcap(file: Path, profile: str = "") -> Iterator[Callable[..., None]]:
    """Write an MCAP file record by record, its messages in one chunk, as the format's specification says."""
    text = lambda one: pack("<I", len(one)) + (one if isinstance(one, bytes) else one.encode())  # noqa: E731
    record = lambda kind, body: pack("<BQ", kind, len(body)) + body  # noqa: E731
    inner, channels = BytesIO(), dict[str, int]()

    def write(
        topic: str, encoding: str, name: str, form: str, definition: bytes, t: int, data: bytes
    ) -> None:
        if topic not in channels:
            channels[topic] = n = len(channels) + 1
            inner.write(record(0x03, pack("<H", n) + text(name) + text(form) + text(definition)))
            inner.write(record(0x04, pack("<HH", n, n) + text(topic) + text(encoding) + text("")))
        if data:
            inner.write(record(0x05, pack("<HIQQ", channels[topic], 0, t, t) + data))

    yield write
    raw = inner.getvalue()
    chunk = pack("<QQQI", 0, 2**62, len(raw), 0) + text("") + pack("<Q", len(raw)) + raw
    magic = b"\x89MCAP0\r\n"
    end = record(0x0F, pack("<I", 0)) + record(0x02, pack("<QQI", 0, 0, 0)) + magic
    file.write_bytes(magic + record(0x01, text(profile) + text("test")) + record(0x06, chunk) + end)


EVENT = """\
service_msgs/ServiceEventInfo info
my_interfaces/Go_Request[<=1] request
my_interfaces/Go_Response[<=1] response
{bar}
MSG: my_interfaces/srv/Go
int64 a
---
int64 b
""".format(bar="=" * 80)


@pytest.mark.parametrize("profile", ["ros2", ""])
@pytest.mark.parametrize("asked", [False, True])
def test_a_definition_that_nobody_asked_for_need_not_be_read(
    streams: Streams, tmp_path: Path, profile: str, asked: bool
) -> None:
    definition = STORE.generate_msgdef(JOINT_STATE, ros_version=2)[0].encode()
    with mcap(tmp_path / "run.mcap", profile) as write:
        event = "/go/_service_event", "cdr", "my_interfaces/srv/Go_Event", "ros2msg", EVENT.encode()
        write(*event, 0, b"\0" * 8 if asked else b"")
        for t, topic, kind, message in joint_messages(streams):
            write(topic, "cdr", kind, "ros2msg", definition, t, bytes(STORE.serialize_cdr(message, kind)))
    text = "log: {joints: 'run.mcap#/joint_states'}\nclaims: [joint positions within limits]\n"
    if asked:
        text = text.replace("/joint_states", "/go/_service_event")
        with pytest.raises(LogError, match="a definition of the messages of /go/_service_event") as refused:
            read_log(with_text(tmp_path, text))
        assert "recover" not in refused.value.hint
        return
    found = read_log(with_text(tmp_path, text))
    np.testing.assert_array_equal(found.joints.values[:, :6], streams.joints_rad)
    assert "run.mcap#/go/_service_event" in found.unused


@pytest.mark.parametrize("storage", [StoragePlugin.MCAP, StoragePlugin.SQLITE3])
def test_a_bag_whose_metadata_names_no_storage_is_read_by_the_ending_of_its_file(
    streams: Streams, tmp_path: Path, storage: StoragePlugin
) -> None:
    folder = write_bag(tmp_path / "run", joint_messages(streams) + poses(streams), storage)
    told = (folder / "metadata.yaml").read_text()
    told = told.replace(f"storage_identifier: {storage.name.lower()}", "storage_identifier: ''")
    assert "identifier: ''" in told
    (folder / "metadata.yaml").write_text(told)
    the_same(read_log(with_text(tmp_path, BAG)), streams)


@pytest.mark.parametrize("slashed", [True, False])
def test_a_leading_slash_of_a_frame_is_no_part_of_its_name(
    streams: Streams, tmp_path: Path, slashed: bool
) -> None:
    messages = frames(streams)
    for _, _, _, message in messages if slashed else ():
        for one in message.transforms:
            one.child_frame_id, one.header.frame_id = f"/{one.child_frame_id}", "/base_link"
    write_bag(tmp_path / "run", joint_messages(streams) + messages, StoragePlugin.MCAP)
    wrist = "/tf:wrist" if slashed else "/tf:/wrist"
    the_same(
        read_log(with_text(tmp_path, said("run#/joint_states", f"run#{wrist}", "run#/tf:elbow", ""))), streams
    )


@pytest.mark.parametrize(("asked", "meant"), [("/elbwo", 'did you mean "elbow"? '), ("x", "")])
def test_a_frame_that_no_message_has_is_refused_with_those_that_there_are(
    streams: Streams, tmp_path: Path, asked: str, meant: str
) -> None:
    write_bag(tmp_path / "run", joint_messages(streams) + frames(streams), StoragePlugin.MCAP)
    text = said("run#/joint_states", "run#/tf:wrist", f"run#/tf:{asked}", "")
    with pytest.raises(LogError) as refused:
        read_log(with_text(tmp_path, text))
    assert refused.value.got == "no sample in the file"
    assert refused.value.hint == f"{meant}its messages have the frames elbow, wrist"


def test_a_ros_1_bag(streams: Streams, tmp_path: Path) -> None:
    store = get_typestore(Stores.ROS1_NOETIC)
    with Writer1(tmp_path / "run.bag") as file:
        topics: dict[str, Any] = {}
        every = sorted(joint_messages(streams) + poses(streams), key=lambda one: one[0])
        for at, (t, topic, kind, message) in enumerate(every):
            if topic not in topics:
                topics[topic] = file.add_connection(topic, kind, typestore=store)
            head = store.types["std_msgs/msg/Header"](at, message.header.stamp, message.header.frame_id)
            file.write(topics[topic], t, store.serialize_ros1(replace(message, header=head), kind))
    the_same(read_log(with_text(tmp_path, BAG.replace("run#", "run.bag#"))), streams)
    data = tmp_path / "run.bag"
    data.write_bytes(data.read_bytes()[: data.stat().st_size // 2])
    with pytest.raises(LogError, match="a bag, whole"):
        read_log(tmp_path / "LOG.yaml")


def test_an_mcap_file_with_ros_1_messages(streams: Streams, tmp_path: Path) -> None:
    store = get_typestore(Stores.ROS1_NOETIC)
    with mcap(tmp_path / "run.mcap", "ros1") as write:
        for at, (t, topic, kind, message) in enumerate(joint_messages(streams) + poses(streams)):
            head = store.types["std_msgs/msg/Header"](at, message.header.stamp, message.header.frame_id)
            raw = bytes(store.serialize_ros1(replace(message, header=head), kind))
            definition = store.generate_msgdef(kind)[0].encode()
            write(topic, "ros1", kind.replace("/msg/", "/"), "ros1msg", definition, t, raw)
    the_same(read_log(with_text(tmp_path, BAG.replace("run#", "run.mcap#"))), streams)


def json_messages(streams: Streams) -> Iterator[tuple[str, str, int, dict[str, Any]]]:
    """In Foxglove's schemas."""
    stamp = lambda t: {"sec": t // 10**9, "nsec": t % 10**9}  # noqa: E731
    for t, row in zip(streams.joint_ns.tolist(), streams.joints_rad.tolist(), strict=True):
        joints = [{"name": name, "position": a} for name, a in zip(NAMES, row, strict=True)]
        yield "/joint_states", "foxglove.JointStates", t, {"timestamp": stamp(t), "joints": joints}
    turn = {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}
    for t, *both in zip(streams.hand_ns.tolist(), streams.hand_m, streams.elbow_m, strict=True):
        hand, elbow = (dict(zip("xyz", at.tolist(), strict=True)) for at in both)
        pose = {"position": hand, "orientation": turn}
        told = {"timestamp": stamp(t), "frame_id": "base_link", "pose": pose}
        yield "/hand", "foxglove.PoseInFrame", t, told
        one = {"timestamp": stamp(t), "parent_frame_id": "base_link", "child_frame_id": "elbow",
               "translation": elbow, "rotation": turn}  # fmt: skip
        yield "/tf", "foxglove.FrameTransforms", t, {"transforms": [one]}
        yield "/both", "foxglove.PosesInFrame", t, {**told, "poses": [pose]}


FOXGLOVE = said("run.mcap#/joint_states", "run.mcap#/hand", "run.mcap#/tf:elbow", "")


@pytest.mark.parametrize("hand", ["/hand", "/both[0]", "/hand:pose.position"])
def test_an_mcap_file_with_json_in_foxgloves_schemas(streams: Streams, tmp_path: Path, hand: str) -> None:
    with mcap(tmp_path / "run.mcap") as write:
        for topic, name, t, content in json_messages(streams):
            write(topic, "json", name, "jsonschema", b"{}", t, json.dumps(content).encode())
    found = read_log(with_text(tmp_path, FOXGLOVE.replace("/hand", hand)))
    the_same(found, streams)
    elbow = found.hands[0].elbow
    assert elbow is not None
    np.testing.assert_allclose(elbow.values, streams.elbow_m[: len(elbow.values)], atol=1e-9)
    data = (tmp_path / "run.mcap").read_bytes()
    (tmp_path / "run.mcap").write_bytes(data[:-50])
    with pytest.raises(LogError, match="a bag, whole"):
        read_log(tmp_path / "LOG.yaml")


def test_a_pose_of_another_frame_in_json_is_refused(streams: Streams, tmp_path: Path) -> None:
    with mcap(tmp_path / "run.mcap") as write:
        for topic, name, t, content in json_messages(streams):
            if topic == "/hand":
                content["frame_id"] = "camera"
            write(topic, "json", name, "jsonschema", b"{}", t, json.dumps(content).encode())
    with pytest.raises(LogError, match='the frame "camera"'):
        read_log(with_text(tmp_path, FOXGLOVE))


def test_a_message_that_lacks_a_field_of_its_schema_is_named(streams: Streams, tmp_path: Path) -> None:
    with mcap(tmp_path / "run.mcap") as write:
        for topic, name, t, content in json_messages(streams):
            content.pop("pose", None)
            write(topic, "json", name, "jsonschema", b"{}", t, json.dumps(content).encode())
    with pytest.raises(LogError, match=r"message 1 of /hand.*fields of a message of foxglove\.PoseInFrame"):
        read_log(with_text(tmp_path, FOXGLOVE))


def protobuf_schemas() -> tuple[bytes, Callable[[str], Any]]:
    """Foxglove's poses and joints in Protobuf: the descriptors of their files, and messages by their name."""
    from google.protobuf import descriptor_pb2, descriptor_pool, message_factory, timestamp_pb2

    kinds = {"double": 1, "string": 9}
    file = descriptor_pb2.FileDescriptorProto(
        name="all.proto", package="foxglove", syntax="proto3", dependency=["google/protobuf/timestamp.proto"]
    )
    for name, fields in {
        "Vector3": "double x, double y, double z",
        "Pose": "Vector3 position",
        "PoseInFrame": "google.protobuf.Timestamp timestamp, string frame_id, Pose pose",
        "JointState": "string name, double position, double velocity",
        "JointStates": "google.protobuf.Timestamp timestamp, JointState* joints",
    }.items():
        message = file.message_type.add(name=name)
        for number, (kind, field) in enumerate((one.split() for one in fields.split(", ")), start=1):
            own = message.field.add(name=field, number=number, label=3 if kind.endswith("*") else 1)
            own.type = kinds.get(kind, 11)
            if own.type == 11:
                own.type_name = f".{kind}" if "." in kind else f".foxglove.{kind.rstrip('*')}"
            elif name == "JointState" and kind == "double":  # "optional", as in the schema
                own.proto3_optional, own.oneof_index = True, len(message.oneof_decl)
                message.oneof_decl.add(name=f"_{field}")
    stamps = descriptor_pb2.FileDescriptorProto()
    timestamp_pb2.DESCRIPTOR.CopyToProto(stamps)
    pool = descriptor_pool.DescriptorPool()
    for one in (stamps, file):
        pool.Add(one)
    every = descriptor_pb2.FileDescriptorSet(file=[stamps, file]).SerializeToString()
    return every, lambda name: message_factory.GetMessageClass(pool.FindMessageTypeByName(name))()


def test_an_mcap_file_with_protobuf_in_foxgloves_schemas(streams: Streams, tmp_path: Path) -> None:
    definition, message = protobuf_schemas()
    with mcap(tmp_path / "run.mcap") as write:
        for topic, name, t, content in json_messages(streams):
            if name not in ("foxglove.JointStates", "foxglove.PoseInFrame"):
                continue
            told = message(name)
            told.timestamp.FromNanoseconds(t)
            if topic == "/hand":
                told.frame_id = content["frame_id"]
                for axis, value in content["pose"]["position"].items():
                    setattr(told.pose.position, axis, value)
            for joint in content.get("joints", ()):
                told.joints.add(**joint)
            write(topic, "protobuf", name, "protobuf", definition, t, told.SerializeToString())
    found = read_log(with_text(tmp_path, said("run.mcap#/joint_states", "run.mcap#/hand", "none", "")))
    the_same(found, streams)
    assert np.isnan(found.joints.values[:, 6:]).all()  # no speeds were told


def test_a_wrap_of_a_joint_with_ends_is_named(streams: Streams, tmp_path: Path) -> None:
    write_csv(wrapped(streams, 5), tmp_path)
    with pytest.raises(LogError, match="a jump of 3") as refused:
        read_log(with_text(tmp_path, TABLES))
    assert "its angles wrap at a turn" in refused.value.hint


def test_a_joint_without_ends_goes_the_short_way(streams: Streams, tmp_path: Path, endless: str) -> None:
    write_csv(wrapped(streams, 5), tmp_path)
    found = read_log(with_text(tmp_path, TABLES.replace("robot: UR10", f"robot: {{arm: {endless}}}")))
    assert np.abs(np.diff(found.joints.values[:, 5])).max() < 0.1
    assert "wrist_3_joint wraps at a turn" in found.joints.notes[0]


@pytest.fixture(scope="module")
def endless(tmp_path_factory: pytest.TempPathFactory) -> str:
    return endless_arm(tmp_path_factory.mktemp("arm"))


@pytest.mark.parametrize("late", [False, True])
def test_a_joint_slightly_beyond_its_end_is_the_logs_wherever_it_is(
    streams: Streams, tmp_path: Path, late: bool
) -> None:
    """At the first sample as later: it is read, judged, and named; a scenario of it can be tried."""
    angles = streams.joints_rad.copy()
    angles[:, 2] += np.pi + 0.001 - angles[:, 2].max()
    peak = int(np.argmax(angles[:, 2]))
    log = with_text(tmp_path, TABLES if late else TABLES.replace("log: {", f"log: {{from: {peak * 8} ms, "))
    write_csv(replace(streams, joints_rad=angles), tmp_path)
    found = judged_log(log)
    (note,) = (one for one in found.notes if "beyond its end" in one)
    assert note.startswith("joints.csv: elbow_joint is up to 0.0573 deg beyond its end")
    verdicts = {one.sentence: one.verdict for one in judge(found.trace)}
    assert verdicts["joint positions within limits"] is Verdict.VIOLATED
    read = read_log(log)
    start = scenario_from(read, usual_cell(read), elbow_towards_in_base_m=(1.0, 1.0, 1.0)).scenario.start
    assert start.joint_position_rad[2] < np.pi + 1e-9  # type: ignore[union-attr]


@pytest.mark.parametrize("separator", [",", ";", "\t", " ", "  "])
def test_separators_of_tables(streams: Streams, tmp_path: Path, separator: str) -> None:
    write_csv(streams, tmp_path)
    for name in ("joints", "hands"):
        text = (tmp_path / f"{name}.csv").read_text()
        (tmp_path / f"{name}.csv").write_text(text.replace(",", separator))
    the_same(read_log(with_text(tmp_path, TABLES)), streams)


def test_a_semicolon_in_a_name_separates_nothing(streams: Streams, tmp_path: Path) -> None:
    write_csv(streams, tmp_path)
    rows = (tmp_path / "joints.csv").read_text().splitlines()
    rows = [f"{row},{'force; N or m' if k == 0 else 1.5}" for k, row in enumerate(rows)]
    (tmp_path / "joints.csv").write_text("\n".join(rows) + "\n")
    the_same(read_log(with_text(tmp_path, TABLES)), streams)


def test_decimal_commas_are_no_numbers(streams: Streams, tmp_path: Path) -> None:
    write_csv(streams, tmp_path)
    text = (tmp_path / "hands.csv").read_text().replace(",", ";").replace(".", ",")
    (tmp_path / "hands.csv").write_text(text)
    with pytest.raises(LogError, match="a number, or an empty cell"):
        read_log(with_text(tmp_path, TABLES))


def test_file_names_with_capitals_and_a_hash(streams: Streams, tmp_path: Path) -> None:
    write_csv(streams, tmp_path)
    (tmp_path / "joints.csv").rename(tmp_path / "Run #3.CSV")
    (tmp_path / "hands.csv").rename(tmp_path / "Hands #3.CSV")
    the_same(
        read_log(with_text(tmp_path, said("Run #3.CSV", "Hands #3.CSV#hand", "Hands #3.CSV#elbow"))), streams
    )
    (data,) = bag(streams, tmp_path).glob("*.mcap")
    data.rename(tmp_path / "A#1.MCAP")
    text = said("A#1.MCAP#/joint_states", "A#1.MCAP#/hand", "A#1.MCAP#/elbow", "")
    the_same(read_log(with_text(tmp_path, text)), streams)


def rtde(streams: Streams, file: Path) -> None:
    """As the UR recorder writes its table: spaces, seconds since the controller began, no units."""
    names = [f"{what}_{k}" for what in ("actual_q", "actual_qd") for k in range(6)]
    seconds = (streams.joint_ns - streams.joint_ns[0]) / 1e9 + 5211.5
    rates = np.gradient(streams.joints_rad, seconds, axis=0)
    rows = [f"{t:.6f} " + " ".join(map(repr, map(float, row))) for t, row in
            zip(seconds, np.hstack([streams.joints_rad, rates]), strict=True)]  # fmt: skip
    file.write_text("\n".join(["timestamp " + " ".join(names), *rows]) + "\n")


def test_the_table_of_the_ur_recorder(streams: Streams, tmp_path: Path) -> None:
    rtde(streams, tmp_path / "robot.csv")
    text = "log: {joints: robot.csv}\njoints: {format: rtde}\nclaims: [joint positions within limits]\n"
    found = read_log(with_text(tmp_path, text)).joints
    np.testing.assert_array_equal(found.values[:, :6], streams.joints_rad)
    assert np.isfinite(found.values[:, 6:]).all()
    assert found.time_ns[0] == 5_211_500_000_000
    (tmp_path / "robot.csv").write_text(
        (tmp_path / "robot.csv").read_text().replace("actual_q_3", "target_q_3")
    )
    with pytest.raises(LogError, match="actual_q_3_rad"):
        read_log(tmp_path / "LOG.yaml")


@pytest.mark.parametrize(
    "robot", ["UR10", "{arm: UR10, seated at: {position: [0 m, 0 m, 1 m], yaw: 90 deg}}"]
)
def test_the_tcp_of_the_ur_recorder_confirms_arm_and_tool(
    streams: Streams, tmp_path: Path, robot: str
) -> None:
    """The controller's base frame is turned by 180 deg about z against the arm's, wherever that is seated."""
    names = ["timestamp", *(f"actual_q_{k}" for k in range(6)), *(f"actual_TCP_pose_{k}" for k in range(6))]
    turned_m = tcp_m(streams.joints_rad) * [-1.0, -1.0, 1.0]
    seconds = (streams.joint_ns - streams.joint_ns[0])[:, None] / 1e9
    rows = np.hstack([seconds, streams.joints_rad, turned_m, np.zeros_like(turned_m)])
    lines = [" ".join(names), *(" ".join(map(repr, map(float, row))) for row in rows)]
    (tmp_path / "robot.csv").write_text("\n".join(lines) + "\n")
    text = f"log: {{joints: robot.csv, tcp: robot.csv}}\njoints: {{format: rtde}}\nrobot: {robot}\n"
    text += "claims: [joint positions within limits]\ntcp: {known to: 1 mm, format: rtde}\n"
    found = read_log(with_text(tmp_path, text)).tcp
    assert found is not None
    assert found.apart_m < 1e-6
    assert len(found.samples.time_ns) == len(rows)
    with pytest.raises(LogError, match="the TCP at"):
        read_log(with_text(tmp_path, text.replace("UR10", "UR5")))


@pytest.mark.parametrize("of", ["joints", "tcp"])
def test_the_format_of_the_ur_recorder_is_refused_of_a_bag(streams: Streams, tmp_path: Path, of: str) -> None:
    bag(streams, tmp_path)
    text = 'log: {joints: "run#/joint_states", tcp: "run#/hand"}\ntcp: {known to: 1 mm}\njoints: {}\n'
    text = text.replace(f"{of}: {{", f"{of}: {{format: rtde, ") + "claims: [joint positions within limits]\n"
    with pytest.raises(InputError, match=rf"{of}\.format: expected a table of the UR recorder"):
        read_log(with_text(tmp_path, text))


def test_optical_tracking_without_times_a_file_a_marker(streams: Streams, tmp_path: Path) -> None:
    write_csv(streams, tmp_path)
    count = 72
    at_m = streams.hand_m[0] + np.linspace(0.0, 1.0, count)[:, None] * (
        streams.hand_m[-1] - streams.hand_m[0]
    )
    rows = [",".join(f"{1e3 * x:.6f}" for x in row) for row in at_m]
    rows[40] = ",,"
    (tmp_path / "hand.csv").write_text("\n".join(["x_mm,y_mm,z_mm", *rows]) + "\n")
    start_s = streams.joint_ns[0] / 1e9
    text = said("joints.csv", "hand.csv", "none", "frame: base\n  rate: 120 Hz")
    text = text.replace("ahead by: 137 ms", f"ahead by: -{start_s:.3f} s").replace(
        "known to: 5 ms", "known to: 1 ms"
    )
    (body,) = read_log(with_text(tmp_path, text)).hands
    there = np.delete(np.arange(count), 40)
    np.testing.assert_array_equal(body.hand.time_ns, np.round(there * 1e9 / 120.0).astype(int))
    np.testing.assert_allclose(body.hand.values, at_m[there], atol=1e-8)
    (tmp_path / "hand.csv").write_text(
        "\n".join(["time_s,x_mm,y_mm,z_mm", *(f"0,{row}" for row in rows)]) + "\n"
    )
    with pytest.raises(LogError, match='no column of times, where the file says a "rate"'):
        read_log(tmp_path / "LOG.yaml")


@pytest.mark.parametrize("begin", ["", "from: 200 ms, "])
def test_samples_before_from_need_no_valid_stamp(streams: Streams, tmp_path: Path, begin: str) -> None:
    messages = joint_messages(streams)
    for _, _, _, message in messages[:3]:
        message.header = header(0, "")
    write_bag(tmp_path / "run", messages + poses(streams), StoragePlugin.MCAP)
    log = with_text(tmp_path, BAG.replace("log: {", f"log: {{{begin}"))
    if not begin:
        with pytest.raises(LogError, match="a stamp in its header"):
            read_log(log)
        return
    found = read_log(log).joints
    assert found.time_ns[0] >= streams.joint_ns[3] + 200_000_000
    assert '3 samples before "from" have no valid time' in found.notes[0]


def test_a_stamp_that_is_lost_later_is_refused_with_from_too(streams: Streams, tmp_path: Path) -> None:
    messages = joint_messages(streams)
    messages[50][3].header = header(0, "")
    write_bag(tmp_path / "run", messages + poses(streams), StoragePlugin.MCAP)
    with pytest.raises(LogError, match="a stamp in its header"):
        read_log(with_text(tmp_path, BAG.replace("log: {", "log: {from: 200 ms, ")))


SPEEDS = ("always joint speed < 30 deg/s", "joint speeds within limits", "TCP speed never above 900 mm/s")


def slow_base(folder: Path, rad: Callable[[float], float], *claims: str) -> tuple[Verdict, ...]:
    """Verdicts on a table of bare columns: the base joint at -0.4 rad and ``rad(t)``, the others at rest."""
    rows = [f"{k * 0.008:.3f},{-0.4 + rad(k * 0.008)!r},-1.3,2.1,-2.4,-1.5,0" for k in range(250)]
    (folder / "j.csv").write_text("\n".join(["time_s," + ",".join(NAMES), *rows]) + "\n")
    text = "log: {joints: j.csv}\njoints: {unit: rad, known to: 0.25 mrad, accelerate at most: 4 rad/s2}\n"
    log = with_text(folder, text + f"robot: UR10\nclaims: [{', '.join(claims)}]\n")
    return tuple(found.verdict for found in judge(judged_log(log).trace))


def test_bare_columns_of_a_joint_that_moves_for_certain_by_the_way_that_it_went(tmp_path: Path) -> None:
    """2.9 deg/s, which each tick alone knows to 4.5 deg/s: the limit is kept, and the arm moved."""
    assert set(slow_base(tmp_path, lambda t: 0.05 * float(np.sin(t)), *SPEEDS)) == {Verdict.HOLDS}


def test_a_joint_that_moves_within_its_uncertainty_may_have_stood(tmp_path: Path) -> None:
    jitter = slow_base(tmp_path, lambda t: 0.00024 * float(np.sin(40.0 * t)), *SPEEDS)
    assert set(jitter) == {Verdict.INCONCLUSIVE}


def test_a_way_gone_outside_of_a_window_is_no_occasion_within_it(tmp_path: Path) -> None:
    """It stands for 1 s, and turns afterwards."""
    windows = [f"always from {when} joint speed < 30 deg/s" for when in ("0 s to 0.9 s", "1 s to 1.9 s")]
    stood, moved = slow_base(tmp_path, lambda t: 0.05 * max(t - 1.0, 0.0), *windows)
    assert (stood, moved) == (Verdict.INCONCLUSIVE, Verdict.HOLDS)
