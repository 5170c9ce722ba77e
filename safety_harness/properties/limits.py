"""The arm stays within its limits: joint positions, joint speeds, TCP speed."""

from __future__ import annotations

from dataclasses import dataclass
from math import sqrt

import numpy as np
from numpy.typing import NDArray

from safety_harness.compiled import compiled
from safety_harness.properties.base import Evaluation, Unit, inconclusive, judged, unreadable
from safety_harness.properties.entry import CatalogueEntry, quantity
from safety_harness.properties.true_motion import true_motion
from safety_harness.robot.description import load_arm
from safety_harness.scenario.units import SPEED
from safety_harness.trace.trace import Trace

MOVES = 1e-3  # m/s and rad/s: what is slower stands


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
        left_rad, tick, joint = _least_angle_left(
            true_motion(trace).joints_rad, arm.position_lower_rad, arm.position_upper_rad
        )
        return judged(
            self,
            trace,
            margin=left_rad,
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
        true = true_motion(trace)
        left_radps, tick, joint, turning = _least_speed_left(
            true.joints_rad, true.rates_radps, trace.time_s, arm.velocity_limit_radps
        )
        return judged(
            self,
            trace,
            margin=left_radps,
            worst_time_s=float(trace.time_s[tick]),
            reason=arm.joint_names[joint],
            exercised=turning,
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
        fastest_mps, tick, moving = _fastest(
            trace.ticks["tcp_speed_mps"], true_motion(trace).tcp_m, trace.time_s
        )
        return judged(
            self,
            trace,
            margin=self.maximum_mps - fastest_mps,
            worst_time_s=float(trace.time_s[tick]),
            reason=f"fastest {fastest_mps * 1e3:.1f} mm/s",
            exercised=moving,
        )


@compiled
def _least_angle_left(
    joints_rad: NDArray[np.float64],  # (n, 6)
    lower_rad: NDArray[np.float64],  # (6,)
    upper_rad: NDArray[np.float64],  # (6,)
) -> tuple[float, int, int]:
    """(angle, tick, joint), the first of equals."""
    least, tick, joint = np.inf, 0, 0
    for k in range(joints_rad.shape[0]):
        for j in range(joints_rad.shape[1]):
            left = min(joints_rad[k, j] - lower_rad[j], upper_rad[j] - joints_rad[k, j])
            if left < least:
                least, tick, joint = left, k, j
    return least, tick, joint


@compiled
def _least_speed_left(
    joints_rad: NDArray[np.float64],  # (n, 6)
    rates_radps: NDArray[np.float64],  # (n, 6)
    time_s: NDArray[np.float64],  # (n,)
    limit_radps: NDArray[np.float64],  # (6,)
) -> tuple[float, int, int, int]:
    """(speed, tick, joint), the first of equals; and the number of ticks at which a joint turns."""
    least, tick, joint, turning = np.inf, 0, 0, 0
    for k in range(rates_radps.shape[0]):
        turns = False
        for j in range(rates_radps.shape[1]):
            speed = abs(rates_radps[k, j])
            if k + 1 < rates_radps.shape[0]:
                mean = abs(joints_rad[k + 1, j] - joints_rad[k, j]) / (time_s[k + 1] - time_s[k])
                speed = max(speed, mean)
            turns |= speed > MOVES
            if limit_radps[j] - speed < least:
                least, tick, joint = limit_radps[j] - speed, k, j
        turning += turns
    return least, tick, joint, turning


@compiled
def _fastest(
    speed_mps: NDArray[np.float64],  # (n,)
    tcp_m: NDArray[np.float64],  # (n, 3)
    time_s: NDArray[np.float64],  # (n,)
) -> tuple[float, int, int]:
    """(speed, tick), the first of equals; and the number of ticks at which the TCP moves."""
    fastest, tick, moving = -np.inf, 0, 0
    for k in range(speed_mps.shape[0]):
        speed = speed_mps[k]
        if k + 1 < speed_mps.shape[0]:
            total = 0.0
            for i in range(3):
                total += (tcp_m[k + 1, i] - tcp_m[k, i]) ** 2
            speed = max(speed, sqrt(total) / (time_s[k + 1] - time_s[k]))
        moving += speed > MOVES
        if speed > fastest:
            fastest, tick = speed, k
    return fastest, tick, moving


JOINT_POSITIONS = CatalogueEntry(
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

JOINT_SPEEDS = CatalogueEntry(
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

TCP_SPEED = CatalogueEntry(
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
