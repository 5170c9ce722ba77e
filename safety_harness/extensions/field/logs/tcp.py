"""Check a log's own TCP against the TCP that follows from the log's joints, the arm and the tool."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from safety_harness.cell.robot.capsules import arm_with
from safety_harness.cell.robot.kinematics import links_in_base
from safety_harness.cell.robot.robots import arm_capsules, arm_model
from safety_harness.extensions.field.logs.model import JointFacts, TcpCheck
from safety_harness.extensions.field.logs.reach import joint_off_rad
from safety_harness.extensions.field.logs.streams import NS, LogSamples
from safety_harness.scenario.robots import AnyRobot

TURNED_RAD = np.radians(5.0)  # a zero position that is wrong by this much has to be detected
POSES_TURNED = 16  # the number of poses in the log at which this is tested
HINT = "another arm, tool, zero position, sign, unit or frame? a UR controller's is turned by 180 deg about z"


def checked_tcp(
    tcp: LogSamples, known_to_m: float, joints: LogSamples, facts: JointFacts, robot: AnyRobot
) -> TcpCheck:
    """Compare all samples of ``tcp`` with the TCP that follows from the joints.

    Raise LogError if a difference exceeds the tolerance. For a time between two samples of the joints, the
    tolerance covers all angles that are possible then.
    """
    arm = arm_model(robot)
    time_s, tcp_s = ((stream.time_ns - joints.time_ns[0]) / NS for stream in (joints, tcp))
    angles = joints.values[:, : len(arm.joint_names)]
    step_s = np.diff(time_s)
    slope, hard = np.diff(angles, axis=0) / step_s[:, None], facts.accelerate_at_most_radps2
    most, known_to_rad = facts.move_at_most_radps, facts.known_to_rad
    off_rad = joint_off_rad(slope, step_s, most=most, hardest=hard, sample_rad=known_to_rad)
    span = np.clip(np.searchsorted(time_s, tcp_s, side="right") - 1, 0, len(step_s) - 1)
    off_rad = np.where(np.isin(tcp.time_ns, joints.time_ns), known_to_rad, off_rad[span])
    off_m = known_to_m + off_rad * float(arm_with(arm, arm_capsules(robot)).reach_m.sum())
    poses = np.column_stack([np.interp(tcp_s, time_s, column) for column in angles.T])
    places = np.array([links_in_base(arm, pose)[-1, :3, 3] for pose in poses])
    apart_m = np.linalg.norm(places - tcp.values, axis=1)
    for index in np.flatnonzero(apart_m > off_m)[:1].tolist():
        by_joints, logged = (", ".join(f"{x:.4f}" for x in rows[index]) for rows in (places, tcp.values))
        raise tcp.error(
            index,
            f"the TCP at {by_joints} m at {tcp_s[index]:.3f} s, where {joints.source.name} has it by the arm "
            f"{robot.label}, to within {off_m[index] * 1e3:.3g} mm",
            f"{logged} m, {apart_m[index] * 1e3:.4g} mm away",
            HINT,
        )
    some, turns = np.linspace(0, len(poses) - 1, POSES_TURNED).astype(int), np.eye(len(arm.joint_names))

    def seen(poses_rad: NDArray[np.float64]) -> bool:
        away = [links_in_base(arm, pose)[-1, :3, 3] for pose in poses_rad] - places[some]
        return bool((np.linalg.norm(away, axis=1) > apart_m[some] + off_m[some]).any())

    turned = zip(arm.joint_names, turns * TURNED_RAD, strict=True)
    unseen = tuple(name for name, turn in turned if not seen(poses[some] + turn))
    unit = seen(np.degrees(poses[some])) and seen(np.radians(poses[some]))
    return TcpCheck(tcp, float(apart_m.max()), float(off_m.max()), unseen, unit)
