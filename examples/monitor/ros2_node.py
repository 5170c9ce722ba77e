#!/usr/bin/env python3
"""A source for ``safety-harness monitor``: ROS 2 topics as JSON lines on standard output.

    source /opt/ros/humble/setup.bash
    python3 ros2_node.py | safety-harness monitor --robot ur10 --claim "always hand distance > 50 mm"

Reads ``sensor_msgs/JointState`` from /joint_states and ``geometry_msgs/PoseStamped`` of a hand and its
elbow from /hand and /elbow; other topics by remapping: ``--ros-args -r /hand:=/tracker/right``. Poses have
to be in the robot's base frame: one in another frame is left out, with a warning, so that the hand counts
as lost. Times are those of the headers, not of the arrival. It needs rclpy of a ROS installation, and
nothing of the harness.
"""

from __future__ import annotations

import json
import sys
from typing import Any

JOINTS = (
    "shoulder_pan_joint",
    "shoulder_lift_joint",
    "elbow_joint",
    "wrist_1_joint",
    "wrist_2_joint",
    "wrist_3_joint",
)
BASE = "base_link"
HAND = "hand"


def seconds(stamp: Any) -> float:
    """Of a header's stamp."""
    return stamp.sec + stamp.nanosec * 1e-9


def line_of_joints(message: Any) -> str | None:
    """A line of a JointState, whose joints may stand in any order; None if one of the arm's is not in it."""
    at = dict(zip(message.name, message.position, strict=False))
    if any(name not in at for name in JOINTS):
        return None  # of a gripper, say
    position = [float(at[name]) for name in JOINTS]
    return json.dumps({"time_s": seconds(message.header.stamp), "joint_position_rad": position})


def line_of_hand(hand: Any, elbow: Any | None) -> str:
    """A line of a hand's PoseStamped, with its elbow's if that is of the same time."""
    place = {"hand_position_in_base_m": point(hand)}
    if elbow is not None and elbow.header.stamp == hand.header.stamp:
        place["elbow_position_in_base_m"] = point(elbow)
    return json.dumps({"time_s": seconds(hand.header.stamp), "hands": {HAND: place}})


def point(pose: Any) -> list[float]:
    """Of a PoseStamped."""
    at = pose.pose.position
    return [float(at.x), float(at.y), float(at.z)]


def main() -> None:
    """Until Ctrl-C, or until nobody reads."""
    import rclpy
    from geometry_msgs.msg import PoseStamped
    from rclpy.qos import qos_profile_sensor_data
    from sensor_msgs.msg import JointState

    rclpy.init()
    node = rclpy.create_node("safety_harness_source")
    latest: dict[str, Any] = {}

    def tell(line: str | None) -> None:
        if line is not None:
            sys.stdout.write(line + "\n")
            sys.stdout.flush()

    def see(what: str, pose: Any) -> None:
        if pose.header.frame_id != BASE:
            node.get_logger().warning(
                f"{what} in {pose.header.frame_id}, not {BASE}", throttle_duration_sec=5.0
            )
            return
        latest[what] = pose
        both = latest.get("hand"), latest.get("elbow")
        if both[0] is not None and both[1] is not None and both[0].header.stamp == both[1].header.stamp:
            tell(line_of_hand(*both))

    node.create_subscription(
        JointState, "/joint_states", lambda message: tell(line_of_joints(message)), qos_profile_sensor_data
    )
    for what in ("hand", "elbow"):
        node.create_subscription(
            PoseStamped, f"/{what}", lambda pose, what=what: see(what, pose), qos_profile_sensor_data
        )
    try:
        rclpy.spin(node)
    except (KeyboardInterrupt, BrokenPipeError):
        pass
    finally:
        node.destroy_node()
        rclpy.try_shutdown()


if __name__ == "__main__":
    main()
