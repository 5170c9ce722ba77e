"""The arm stays within its limits: joint positions, joint speeds, TCP speed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from safety_harness.properties.base import Evaluation, Unit, inconclusive, judged, unreadable
from safety_harness.properties.entry import Entry, quantity
from safety_harness.robot.description import load_arm
from safety_harness.scenario.units import SPEED
from safety_harness.trace.trace import Trace, history


@dataclass(frozen=True, kw_only=True)
class JointLimits:
    """min over time and joints of the angle left to the nearer position limit of the URDF."""

    unit: Unit = Unit.ANGLE
    sentence: str = "joint positions within limits"

    def evaluate(self, trace: Trace) -> Evaluation:
        """Judge every joint at every tick."""
        problem = unreadable(trace, ("joint_position_rad",))
        if problem is not None:
            return inconclusive(self, problem)
        arm = load_arm(trace.scenario.robot.arm_name)
        q = history(trace, "joint_position_rad")  # (n, 6)
        left = np.minimum(q - arm.position_lower_rad, arm.position_upper_rad - q)
        tick, joint = np.unravel_index(int(np.argmin(left)), left.shape)
        return judged(
            self,
            trace,
            margin=float(left[tick, joint]),
            worst_time_s=float(trace.time_s[tick]),
            reason=arm.joint_names[joint],
            exercised=len(trace.ticks),
        )


@dataclass(frozen=True, kw_only=True)
class JointSpeedLimits:
    """min over time and joints of the speed left to the velocity limit of the URDF.

    Between ticks the mean speed |q_(k+1) - q_k|/dt counts as well as the speed at the ticks.
    """

    unit: Unit = Unit.ANGULAR_SPEED
    sentence: str = "joint speeds within limits"

    def evaluate(self, trace: Trace) -> Evaluation:
        """Judge every joint at every tick."""
        problem = unreadable(trace, ("joint_position_rad", "joint_velocity_radps"))
        if problem is not None:
            return inconclusive(self, problem)
        arm = load_arm(trace.scenario.robot.arm_name)
        speed = np.abs(history(trace, "joint_velocity_radps"))  # (n, 6)
        if len(trace.ticks) > 1:
            mean = (
                np.abs(np.diff(history(trace, "joint_position_rad"), axis=0)) / np.diff(trace.time_s)[:, None]
            )
            speed[:-1] = np.maximum(speed[:-1], mean)
        left = arm.velocity_limit_radps - speed
        tick, joint = np.unravel_index(int(np.argmin(left)), left.shape)
        return judged(
            self,
            trace,
            margin=float(left[tick, joint]),
            worst_time_s=float(trace.time_s[tick]),
            reason=arm.joint_names[joint],
            exercised=int(np.count_nonzero(speed.max(axis=1) > 1e-3)),
        )


@dataclass(frozen=True, kw_only=True)
class TcpSpeedLimit:
    """min over time of ``maximum_mps`` - |v_tcp|; between ticks the mean speed counts too.

    ISO 10218-1 names 250 mm/s the reduced speed at which a person may be near.
    """

    maximum_mps: float
    unit: Unit = Unit.SPEED

    @property
    def sentence(self) -> str:
        """As the catalogue writes it."""
        return f"TCP speed never above {self.maximum_mps * 1e3:g} mm/s"

    def evaluate(self, trace: Trace) -> Evaluation:
        """Judge the TCP's speed."""
        problem = unreadable(trace, ("tcp_speed_mps", "transform_tcp_to_base"))
        if problem is not None:
            return inconclusive(self, problem)
        speed = history(trace, "tcp_speed_mps").copy()
        if len(trace.ticks) > 1:
            steps = np.diff(history(trace, "transform_tcp_to_base")[:, :3, 3], axis=0)
            mean = np.linalg.norm(steps, axis=1) / np.diff(trace.time_s)
            speed[:-1] = np.maximum(speed[:-1], mean)
        tick = int(np.argmax(speed))
        return judged(
            self,
            trace,
            margin=self.maximum_mps - float(speed[tick]),
            worst_time_s=float(trace.time_s[tick]),
            reason=f"fastest {speed[tick] * 1e3:.1f} mm/s",
            exercised=int(np.count_nonzero(speed > 1e-3)),
        )


JOINT_POSITIONS = Entry(
    example="joint positions within limits",
    pattern="joint positions within limits",
    make=lambda *_: JointLimits(),
    unit=Unit.ANGLE,
    rationale="an arm at a mechanical or safety-rated stop no longer goes where its controller sends it",
    source="the robot's URDF",
    margin="angle left to the nearer limit, least over joints and time",
    parameters="the limits of the robot's description",
    exercised="always",
    inconclusive="-",
    scenario="hand-visits-and-leaves",
    broken_by="a controller that turns a joint on and on",
)

JOINT_SPEEDS = Entry(
    example="joint speeds within limits",
    pattern="joint speeds within limits",
    make=lambda *_: JointSpeedLimits(),
    unit=Unit.ANGULAR_SPEED,
    rationale="beyond them the drives no longer follow",
    source="the robot's URDF",
    margin="speed left to the limit, least over joints and time; the mean speed between ticks counts too",
    parameters="the limits of the robot's description",
    exercised="the arm moves",
    inconclusive="-",
    scenario="hand-visits-and-leaves",
    broken_by="a controller that turns a joint too fast",
)

TCP_SPEED = Entry(
    example="TCP speed never above 250 mm/s",
    pattern=r"TCP speed never above (.+)",
    make=lambda match, _, place: TcpSpeedLimit(maximum_mps=quantity(match[1], SPEED, place)),
    unit=Unit.SPEED,
    rationale="a person beside the robot can still step back from one that moves at reduced speed",
    source="ISO 10218-1, reduced speed",
    margin="speed left to the limit, least over time; the mean speed between ticks counts too",
    parameters="the limit",
    exercised="the arm moves",
    inconclusive="-",
    scenario="hand-visits-and-leaves",
    broken_by="a controller that turns a joint too fast",
)
