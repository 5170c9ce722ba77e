"""The examples of sources: a log as it ran, and a ROS 2 node whose lines need no ROS."""

from __future__ import annotations

import subprocess
import sys
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import msgspec
import numpy as np
import pytest
from cells import cell, recorded
from log_formats import STORE, joint_messages, poses

from safety_harness.extensions.field.monitoring.cell import read_cell
from safety_harness.extensions.field.monitoring.monitor import Monitor
from safety_harness.extensions.field.monitoring.sample import read_sample
from safety_harness.scenario.model import Verdict

EXAMPLES = Path(__file__).parents[3] / "examples"
LOG = EXAMPLES / "logs" / "LOG.yaml"


def test_a_log_as_it_ran_has_the_verdict_of_judge() -> None:
    words = [sys.executable, str(EXAMPLES / "monitor" / "replay.py"), str(LOG), "--fast"]
    stream = subprocess.run(words, capture_output=True, check=True).stdout.splitlines()
    own = Monitor(cell=read_cell(LOG), some=True)
    for line in stream:
        list(own.take(line))
    list(own.end())
    never_below, told = own.verdicts()
    assert (never_below.claim, never_below.verdict) == ("hand distance never below 50 mm", Verdict.HOLDS)
    assert told.claim == "always hand distance > 200 mm"
    assert told.verdict is Verdict.INCONCLUSIVE  # -20 to +50 mm by judge, which the file says too
    assert told.margin is not None
    assert -21.0 < told.margin < -19.0
    assert len(own.unwatched) == 2
    assert (own.counts.refused, own.counts.late, own.counts.ticks) == (0, 0, 375)


def the_node() -> Any:
    spec = spec_from_file_location("ros2_node", EXAMPLES / "monitor" / "ros2_node.py")
    assert spec is not None
    assert spec.loader is not None
    node = module_from_spec(spec)
    spec.loader.exec_module(node)
    return node


def test_the_ros_2_node_tells_of_every_message_that_it_takes(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """With messages of the types of ROS, and a middleware that stands in for its own."""
    streams = recorded(cell(np.random.default_rng(1)), np.random.default_rng(1), seconds=0.2)
    sent = sorted([*joint_messages(streams), *poses(streams)], key=lambda one: one[0])
    *_, elsewhere = (message for _, topic, _, message in sent if topic == "/elbow")
    elsewhere.header.frame_id = "camera"  # that one is left out, with the hand of its time
    heard: dict[str, tuple[Any, Any]] = {}
    warned: list[str] = []

    def spin(_: object) -> None:
        for _, topic, kind, message in sent:
            wanted, callback = heard[topic]
            assert wanted is STORE.types[kind]
            callback(message)

    logger = SimpleNamespace(warning=lambda text, **_: warned.append(text))
    node = SimpleNamespace(
        create_subscription=lambda kind, topic, callback, _: heard.update({topic: (kind, callback)}),
        get_logger=lambda: logger,
        destroy_node=lambda: None,
    )
    ros = {"init": lambda: None, "create_node": lambda _: node, "spin": spin, "try_shutdown": lambda: None}
    for name, members in {
        "rclpy": ros,
        "rclpy.qos": {"qos_profile_sensor_data": 10},
        "sensor_msgs.msg": {"JointState": STORE.types["sensor_msgs/msg/JointState"]},
        "geometry_msgs.msg": {"PoseStamped": STORE.types["geometry_msgs/msg/PoseStamped"]},
    }.items():
        module = ModuleType(name)
        vars(module).update(members)
        monkeypatch.setitem(sys.modules, name, module)
    the_node().main()
    samples = [
        read_sample(line.encode(), k, joints=6, hands=["hand"], speeds=False)
        for k, line in enumerate(capsys.readouterr().out.splitlines())
    ]
    joints = [one.joint_position_rad for one in samples if one.joint_position_rad is not None]
    np.testing.assert_allclose(joints, streams.joints_rad)
    hands = [one.hands["hand"] for one in samples if one.hands]
    np.testing.assert_allclose([one.hand_position_in_base_m for one in hands], streams.hand_m[:-1])
    np.testing.assert_allclose([one.elbow_position_in_base_m for one in hands], streams.elbow_m[:-1])
    assert warned == ["elbow in camera, not base_link"]


def test_lines_of_the_ros_2_node_are_lines_of_a_stream() -> None:
    node = the_node()
    header = SimpleNamespace(stamp=SimpleNamespace(sec=12, nanosec=344_000_000), frame_id="base_link")
    order = [*reversed(node.JOINTS), "finger_joint"]
    joints = SimpleNamespace(header=header, name=order, position=[float(k) for k in range(7)])

    def pose(x: float) -> SimpleNamespace:
        at = SimpleNamespace(position=SimpleNamespace(x=x, y=0.0, z=0.5))
        return SimpleNamespace(header=header, pose=at)

    def read(line: str) -> dict[str, object]:
        sample = read_sample(line.encode(), 1, joints=6, hands=["hand"], speeds=False)
        told = msgspec.to_builtins(sample)
        assert isinstance(told, dict)
        return told

    assert read(node.line_of_joints(joints)) == {
        "time_s": 12.344,
        "joint_position_rad": (5.0, 4.0, 3.0, 2.0, 1.0, 0.0),
    }
    assert node.line_of_joints(SimpleNamespace(header=header, name=["finger_joint"], position=[1.0])) is None
    places = {"hand_position_in_base_m": (1.0, 0.0, 0.5), "elbow_position_in_base_m": (1.3, 0.0, 0.5)}
    assert read(node.line_of_hand(pose(1.0), pose(1.3))) == {"time_s": 12.344, "hands": {"hand": places}}
