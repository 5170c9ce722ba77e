"""Convert messages in Foxglove's schemas to ROS messages, and stamps to nanoseconds."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

JOINT_STATE = "sensor_msgs/msg/JointState"
POSE_STAMPED = "geometry_msgs/msg/PoseStamped"
POSE_ARRAY = "geometry_msgs/msg/PoseArray"
TF = "tf2_msgs/msg/TFMessage"
_PREFIXES = ("foxglove.", "foxglove_msgs/msg/")


def as_standard(kind: str, content: Any) -> tuple[str, Any]:
    """Convert a Foxglove message to a ROS message, and return its type and its content.

    Foxglove's poses, frames and joints are converted. The content of other messages remains unchanged.
    """
    prefix = next((item for item in _PREFIXES if kind.startswith(item)), None)
    name = "" if prefix is None else kind.removeprefix(prefix)
    if name == "JointStates":
        joints = content.joints
        values = {key: [_number(item, key) for item in joints] for key in ("position", "velocity")}
        names = [item.name for item in joints]
        return JOINT_STATE, SimpleNamespace(header=_header(content), name=names, joints=joints, **values)
    if name == "PoseInFrame":
        return POSE_STAMPED, SimpleNamespace(header=_header(content), pose=content.pose)
    if name == "PosesInFrame":
        return POSE_ARRAY, SimpleNamespace(header=_header(content), poses=content.poses)
    if name in ("FrameTransform", "FrameTransforms"):
        every = content.transforms if name == "FrameTransforms" else [content]
        return TF, SimpleNamespace(transforms=[_transform(item) for item in every])
    return {"tf/msg/tfMessage": TF}.get(kind, kind), content


def nanoseconds(stamp: Any) -> int:
    """Return the time [ns] of a stamp.

    The stamp has the fields of ROS (sec, nanosec), of JSON (sec, nsec) or of Protobuf (seconds, nanos).
    """
    whole, rest = (
        next((int(getattr(stamp, name)) for name in names if hasattr(stamp, name)), 0)
        for names in (("sec", "seconds"), ("nanosec", "nsec", "nanos"))
    )
    return whole * 10**9 + rest


def fields_of(content: Any) -> list[str]:
    """Return the names of the fields of a decoded message in any encoding."""
    if isinstance(content, SimpleNamespace):
        return list(vars(content))
    if (descriptor := getattr(content, "DESCRIPTOR", None)) is not None:
        return [entry.name for entry in descriptor.fields]
    return [name for name in getattr(content, "__dataclass_fields__", ()) if not name.startswith("__")]


def _number(joint: Any, name: str) -> float:
    """Return the number in the field ``name`` of a joint, or NaN if the joint does not have this field."""
    there = joint.HasField(name) if hasattr(joint, "HasField") else getattr(joint, name, None) is not None
    return float(getattr(joint, name)) if there else math.nan


def _header(content: Any, frame: str = "frame_id") -> SimpleNamespace:
    return SimpleNamespace(stamp=content.timestamp, frame_id=getattr(content, frame, ""))


def _transform(frame: Any) -> SimpleNamespace:
    pose = SimpleNamespace(translation=frame.translation, rotation=frame.rotation)
    header = _header(frame, "parent_frame_id")
    return SimpleNamespace(header=header, child_frame_id=frame.child_frame_id, transform=pose)
