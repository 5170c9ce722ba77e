"""One recording in every format that can be read."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from cells import NAMES, Streams, rows_of, said, write_csv
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

WRIST = "float64[3] wrist\nfloat64 quality\n"  # of a message that no ROS installation knows
STORE = get_typestore(Stores.ROS2_HUMBLE)
STATE = """\
std_msgs/Header header
string state
uint8 flags
float64[6] to
"""
DECISION = """\
std_msgs/Header header
float64[3] hand
float64[3] tcp
float64[3] proposed
float64[3] chosen
string result
string why
"""
STORE.register(get_types_from_msg(STATE, "cell_msgs/msg/State"))
STORE.register(get_types_from_msg(DECISION, "cell_msgs/msg/Decision"))
STORE.register(get_types_from_msg("std_msgs/Header header\n" + WRIST, "tracker_msgs/msg/Wrist"))
TURN = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])  # tracker to base: a quarter about z
AT_M = np.array([0.5, -0.25, 0.125])


def of(name: str, *values: Any) -> Any:
    """A message of a type."""
    return STORE.types[name](*values)


def header(time_ns: int, frame: str) -> Any:
    """With a stamp."""
    stamp = of("builtin_interfaces/msg/Time", time_ns // 10**9, time_ns % 10**9)
    return of("std_msgs/msg/Header", stamp, frame)


def _point(at: Any) -> Any:
    return of("geometry_msgs/msg/Point", *map(float, at))


def _pose(at: Any) -> Any:
    return of("geometry_msgs/msg/Pose", _point(at), of("geometry_msgs/msg/Quaternion", 0.0, 0.0, 0.0, 1.0))


def _transform(time_ns: int, parent: str, child: str, at: Any, turn: tuple[float, ...] = (0, 0, 0, 1)) -> Any:
    to = of("geometry_msgs/msg/Vector3", *map(float, at))
    rotation = of("geometry_msgs/msg/Quaternion", *map(float, turn))
    return of(
        "geometry_msgs/msg/TransformStamped",
        header(time_ns, parent),
        child,
        of("geometry_msgs/msg/Transform", to, rotation),
    )


def joint_messages(streams: Streams, names: tuple[str, ...] = NAMES) -> list[tuple[int, str, str, Any]]:
    """(received, topic, type, message); joints in another order than the arm's."""
    order = [3, 1, 0, 2, 5, 4]
    kind = "sensor_msgs/msg/JointState"
    found = []
    for t, row in zip(streams.joint_ns.tolist(), streams.joints_rad, strict=True):
        told = [names[k] for k in order], row[order].copy(), np.zeros(0), np.zeros(0)
        found.append((t, "/joint_states", kind, of(kind, header(t, ""), *told)))
    return found


def poses(streams: Streams) -> list[tuple[int, str, str, Any]]:
    """PoseStamped, a topic for the hand and one for the elbow, in the base frame."""
    kind = "geometry_msgs/msg/PoseStamped"
    return [
        (t, topic, kind, of(kind, header(t, "base_link"), _pose(at)))
        for topic, rows in (("/hand", streams.hand_m), ("/elbow", streams.elbow_m))
        for t, at in zip(streams.hand_ns.tolist(), rows, strict=True)
    ]


def pose_array(streams: Streams) -> list[tuple[int, str, str, Any]]:
    """PoseArray in the frame of a tracker, whose place is in /tf_static."""
    kind, tf = "geometry_msgs/msg/PoseArray", "tf2_msgs/msg/TFMessage"
    first = int(streams.joint_ns[0])
    half = np.sqrt(0.5)
    still = of(tf, [_transform(first, "base_link", "tracker", AT_M, (0.0, 0.0, half, half))])
    both = zip(streams.hand_ns.tolist(), streams.hand_m, streams.elbow_m, strict=True)
    return [(first, "/tf_static", tf, still)] + [
        (t, "/people", kind, of(kind, header(t, "tracker"), [_pose((at - AT_M) @ TURN) for at in pair]))
        for t, *pair in both
    ]


def frames(streams: Streams) -> list[tuple[int, str, str, Any]]:
    """TFMessage: hand and elbow as frames."""
    kind = "tf2_msgs/msg/TFMessage"
    both = zip(streams.hand_ns.tolist(), streams.hand_m, streams.elbow_m, strict=True)
    return [
        (
            t,
            "/tf",
            kind,
            of(kind, [_transform(t, "base_link", n, at) for n, at in (("wrist", hand), ("elbow", elbow))]),
        )
        for t, hand, elbow in both
    ]


def own_messages(streams: Streams) -> list[tuple[int, str, str, Any]]:
    """Messages whose definition only the bag has."""
    kind = "tracker_msgs/msg/Wrist"
    return [
        (t, topic, kind, of(kind, header(t, "base_link"), np.array(at), 1.0))
        for topic, rows in (("/wrist", streams.hand_m), ("/elbow", streams.elbow_m))
        for t, at in zip(streams.hand_ns.tolist(), rows, strict=True)
    ]


def word_messages(streams: Streams) -> list[tuple[int, str, str, Any]]:
    """What the controller told: messages of its own, and predicted hands in an array of poses."""
    if streams.words is None:
        return []
    words, found = streams.words, []
    state, decision, kind = "cell_msgs/msg/State", "cell_msgs/msg/Decision", "geometry_msgs/msg/PoseArray"
    for k, t in enumerate(streams.joint_ns.tolist()):
        told = words.mode[k], words.limits[k], words.commands_radps[k].copy()
        found.append((t, "/state", state, of(state, header(t, ""), *told)))
        seen = [] if np.isnan(words.predicted_m[k]).any() else [_pose(words.predicted_m[k])]
        found.append((t, "/tracks", kind, of(kind, header(t, "base_link"), seen)))
    for k, t in enumerate(words.decided_ns.tolist()):
        places = [words.places_m[name][k].copy() for name in ("hand", "tcp", "proposed", "chosen")]
        told = *places, words.outcome[k], words.trigger[k]
        found.append((t, "/decision", decision, of(decision, header(t, "base_link"), *told)))
    return found


def in_bag(streams: Streams, file: str) -> dict[str, str] | None:
    """The streams of it."""
    topics = {"mode": "/state:state", "limits": "/state:flags", "commands": "/state:to"}
    topics |= {"detections": "/tracks[0]", "decisions": "/decision"}
    return None if streams.words is None else {name: f"{file}#{one}" for name, one in topics.items()}


def in_table(streams: Streams, end: str) -> dict[str, str] | None:
    """The same of tables."""
    columns = {"mode": "state", "limits": "flags", "commands": "to_", "detections": "right"}
    found = {name: f"words.{end}#{one}" for name, one in columns.items()}
    return None if streams.words is None else found | {"decisions": f"decisions.{end}"}


def write_bag(folder: Path, messages: list[tuple[int, str, str, Any]], storage: StoragePlugin) -> Path:
    """A ROS 2 bag."""
    with Writer(folder, version=9, storage_plugin=storage) as bag:
        topics: dict[str, Any] = {}
        for received_ns, topic, kind, message in sorted(messages, key=lambda one: one[0]):
            if topic not in topics:
                topics[topic] = bag.add_connection(topic, kind, typestore=STORE)
            bag.write(topics[topic], received_ns, STORE.serialize_cdr(message, kind))
    return folder


def _told(streams: Streams, hands: list[tuple[int, str, str, Any]]) -> list[tuple[int, str, str, Any]]:
    return joint_messages(streams) + hands + word_messages(streams)


def csv(streams: Streams, folder: Path) -> str:
    """The text of LOG.yaml beside CSV files."""
    write_csv(streams, folder)
    return said(
        "joints.csv",
        "hands.csv#hand",
        "hands.csv#elbow",
        told=in_table(streams, "csv"),
        told_frame="frame: base",
    )


def parquet(streams: Streams, folder: Path) -> str:
    """Beside Parquet files."""
    joints = {f"{n}_rad": column for n, column in zip(NAMES, streams.joints_rad.T, strict=True)}
    pq.write_table(pa.table({"time_ns": streams.joint_ns, **joints}), folder / "joints.parquet")
    both = np.hstack([streams.hand_m, streams.elbow_m]).T
    names = [f"{track}_{axis}_m" for track in ("hand", "elbow") for axis in "xyz"]
    hands = dict(zip(names, both, strict=True))
    pq.write_table(pa.table({"time_ns": streams.hand_ns, **hands}), folder / "hands.parquet")
    if streams.words is not None:
        regular, decided = rows_of(streams.words)
        pq.write_table(pa.table({"time_ns": streams.joint_ns, **regular}), folder / "words.parquet")
        times = {"time_ns": streams.words.decided_ns}
        pq.write_table(pa.table({**times, **decided}), folder / "decisions.parquet")
    told = in_table(streams, "parquet")
    names = "joints.parquet", "hands.parquet#hand", "hands.parquet#elbow"
    return said(*names, told=told, told_frame="frame: base")


def sqlite3(streams: Streams, folder: Path) -> str:
    """Beside a ROS 2 bag, with stamped poses."""
    write_bag(folder / "run", _told(streams, poses(streams)), StoragePlugin.SQLITE3)
    return said("run#/joint_states", "run#/hand", "run#/elbow", "", told=in_bag(streams, "run"))


def bag_mcap(streams: Streams, folder: Path) -> str:
    """Beside a ROS 2 bag in MCAP, with an array of poses in a tracker's frame."""
    write_bag(folder / "run", _told(streams, pose_array(streams)), StoragePlugin.MCAP)
    frame, told = "frame: {tf: 'run#/tf_static'}", in_bag(streams, "run")
    return said("run#/joint_states", "run#/people[0]", "run#/people[1]", frame, told=told)


def mcap(streams: Streams, folder: Path) -> str:
    """Beside an MCAP file alone, with hands as frames."""
    bag = write_bag(folder / "bag", _told(streams, frames(streams)), StoragePlugin.MCAP)
    next(bag.glob("*.mcap")).rename(folder / "run.mcap")
    told = in_bag(streams, "run.mcap")
    return said("run.mcap#/joint_states", "run.mcap#/tf:wrist", "run.mcap#/tf:elbow", told=told)


FORMATS: tuple[Callable[[Streams, Path], str], ...] = (csv, parquet, mcap, sqlite3, bag_mcap)
