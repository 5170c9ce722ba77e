"""The examples of sources: a log as it ran, and a ROS 2 node whose lines need no ROS."""

from __future__ import annotations

import subprocess
import sys
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from types import SimpleNamespace

import msgspec

from safety_harness.monitoring.cell import read_cell
from safety_harness.monitoring.monitor import Monitor
from safety_harness.monitoring.sample import read_sample
from safety_harness.scenario.model import Verdict

EXAMPLES = Path(__file__).parents[2] / "examples"
LOG = EXAMPLES / "logs" / "LOG.yaml"


def test_a_log_as_it_ran_has_the_verdict_of_judge() -> None:
    words = [sys.executable, str(EXAMPLES / "monitor" / "replay.py"), str(LOG), "--fast"]
    stream = subprocess.run(words, capture_output=True, check=True).stdout.splitlines()
    own = Monitor(cell=read_cell(LOG), some=True)
    for line in stream:
        list(own.take(line))
    list(own.end())
    (told,) = own.verdicts()
    assert told.claim == "always hand distance > 200 mm"
    assert told.verdict is Verdict.INCONCLUSIVE  # -20 to +50 mm by judge, which the file says too
    assert told.margin is not None
    assert -21.0 < told.margin < -19.0
    assert len(own.unwatched) == 3
    assert (own.counts.refused, own.counts.late, own.counts.ticks) == (0, 0, 375)


def test_lines_of_the_ros_2_node_are_lines_of_a_stream() -> None:
    spec = spec_from_file_location("ros2_node", EXAMPLES / "monitor" / "ros2_node.py")
    assert spec is not None
    assert spec.loader is not None
    node = module_from_spec(spec)
    spec.loader.exec_module(node)
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
