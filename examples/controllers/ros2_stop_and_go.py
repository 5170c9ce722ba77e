r"""Stop and go as a ROS 2 node: it drives a real arm, and the same rule drives the simulated one.

    python3 ros2_stop_and_go.py            subscribes tcp_pose and hands, publishes tcp_velocity
    safety-harness run shipped:hand-visits-and-leaves \
        --controller "exec:python3 ros2_stop_and_go.py --harness"

``wanted`` is the rule, in numbers alone; each of the two ways hands it what it has heard.  In ROS an empty
PoseArray says that no hand is there; a silent topic is no such word, and the arm stands.
"""

import json
import math
import sys

TARGET_IN_BASE_M = (0.7, 0.0, 0.35)
NEAR_M, GAIN = 0.3, 0.5
HELLO = {
    "say": "hello",
    "protocol": "safety-harness controller 1",
    "name": "stop and go of a ROS 2 node",
    "sees": ["joints", "hands"],
}


def wanted(tcp_in_base_m, hands_in_base_m, target_in_base_m):
    """The TCP's velocity [m/s] in the base frame; None to stop."""
    if any(math.dist(hand, tcp_in_base_m) < NEAR_M for hand in hands_in_base_m):
        return None
    return [GAIN * (to - at) for to, at in zip(target_in_base_m, tcp_in_base_m, strict=True)]


def answer(told, target_in_base_m=TARGET_IN_BASE_M):
    """What the harness is told: the protocol of docs/reference/controller-protocol.md."""
    if told["say"] == "hello":
        return HELLO
    if told["say"] == "reset":
        return {"say": "ready"}
    seen = told["seen"]
    hands = [hand["position_in_base_m"] for hand in seen["hands"]]
    velocity_mps = wanted(seen["tcp_position_in_base_m"], hands, target_in_base_m)
    if velocity_mps is None:
        return {"say": "stop", "tick": told["tick"]}
    return {"say": "move", "tick": told["tick"], "tcp_velocity_mps": velocity_mps}


def harness():
    """A JSON object a line, there and back."""
    for line in sys.stdin:
        sys.stdout.write(json.dumps(answer(json.loads(line))) + "\n")
        sys.stdout.flush()  # or the harness waits for what lies in a buffer


def node():
    """The node; needs a ROS 2 installation."""
    import rclpy
    from geometry_msgs.msg import PoseArray, PoseStamped, TwistStamped
    from rclpy.node import Node

    class StopAndGo(Node):
        """At 125 Hz, from the last pose and the last hands."""

        def __init__(self):
            super().__init__("stop_and_go")
            self.tcp = self.hands = None
            self.velocity = self.create_publisher(TwistStamped, "tcp_velocity", 10)
            self.create_subscription(PoseStamped, "tcp_pose", self.hear_tcp, 10)
            self.create_subscription(PoseArray, "hands", self.hear_hands, 10)
            self.create_timer(0.008, self.act)

        def hear_tcp(self, said):
            self.tcp = _position(said.pose)

        def hear_hands(self, said):
            self.hands = [_position(pose) for pose in said.poses]

        def act(self):
            told = TwistStamped()
            told.header.stamp = self.get_clock().now().to_msg()
            told.header.frame_id = "base"
            if self.tcp is not None and self.hands is not None:
                velocity = wanted(self.tcp, self.hands, TARGET_IN_BASE_M) or [0.0, 0.0, 0.0]
                linear = told.twist.linear
                linear.x, linear.y, linear.z = velocity
            self.velocity.publish(told)

    rclpy.init()
    rclpy.spin(StopAndGo())


def _position(pose):
    return [pose.position.x, pose.position.y, pose.position.z]


if __name__ == "__main__":
    harness() if "--harness" in sys.argv else node()
