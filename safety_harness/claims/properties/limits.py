"""Check that joint positions, and the speeds and accelerations of joints and TCP, keep their limits."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from safety_harness.cell.robot.robots import arm_model
from safety_harness.cell.simulation.worlds import PYBULLET
from safety_harness.claims.properties.base import Evaluation, Unit, Worded, inconclusive, judged
from safety_harness.claims.properties.entry import CatalogueEntry
from safety_harness.claims.properties.measured import Ends, reads
from safety_harness.claims.signals.occasions import MOVES, joints_stood, tcp_stood, went
from safety_harness.claims.signals.speeds import (
    arm_speeds_mps,
    joint_speeds_radps,
    known_to_radps,
    larger,
    tcp_speeds_mps,
)
from safety_harness.claims.signals.true_motion import JOINTS
from safety_harness.claims.signals.uncertainty import (
    TCP,
    ErrorOf,
    by_uncertainty_of,
    of_change,
    of_speed,
    of_tcp_acceleration,
)
from safety_harness.trace.trace import Trace, history

EPSILON = float(np.finfo(np.float64).eps)
POSITION, RATE = JOINTS
SPEED = "tcp_speed_mps"


def _ends_by(error_of: ErrorOf, speed: str = "", place: str = "") -> Ends:
    """Return the function ``ends`` that the decorator ``reads`` requires.

    The returned function computes bounds of the margin: it subtracts the error from the margin, and adds the
    error to the margin. Motion in the column ``speed`` or ``place`` exercises the claim.
    """

    def ends(prop: object, trace: Trace, margin: float) -> tuple[float, float, bool]:
        error = float(error_of(trace)[2])
        fast = not speed or np.abs(trace.ticks[speed]).max() - trace.known.column(speed).uncertainty > MOVES
        moves = fast or (place != "" and went(trace, place, np.isfinite(trace.time_s)))
        return margin - error, margin + error, bool(moves)

    return ends


@dataclass(frozen=True, kw_only=True)
class JointLimits:
    """The claim that every joint stays within the position limits of the URDF.

    The margin is the least angle between a joint and its nearer limit, over time and joints.
    """

    unit: Unit = Unit.ANGLE
    sentence: str = "joint positions within limits"

    @reads(POSITION, ends=_ends_by(by_uncertainty_of(POSITION)))
    def evaluate(self, trace: Trace) -> Evaluation:
        """Judge every joint at every tick."""
        arm, joints_rad = arm_model(trace.scenario.robot), history(trace, POSITION)
        left_rad = np.minimum(joints_rad - arm.position_lower_rad, arm.position_upper_rad - joints_rad)
        tick, joint = divmod(int(left_rad.argmin()), left_rad.shape[1])
        name = arm.joint_names[joint]
        return judged(self, trace, left_rad[tick, joint], trace.time_s[tick], name, len(left_rad))


@dataclass(frozen=True, kw_only=True)
class JointSpeedLimits:
    """The claim that every joint stays below the velocity limit of the URDF.

    The margin is the least difference between a joint's limit and its speed, over time and joints. The speeds
    at the ticks are considered, and the mean speeds |q_(k+1) - q_k|/dt between the ticks k and k+1. An excess
    is uncertain if it is not larger than ``known_to_radps``, the error with which the world's solver follows
    a commanded speed.
    """

    unit: Unit = Unit.ANGULAR_SPEED
    sentence: str = "joint speeds within limits"

    @reads(POSITION, RATE, ends=_ends_by(of_speed(RATE, POSITION), RATE, POSITION))
    def evaluate(self, trace: Trace) -> Evaluation:
        """Judge every joint at every tick.

        If a mean speed exceeds the limit by no more than its rounding error, the mean speed is set to the
        limit.
        """
        arm, (speed_radps, mean_radps) = arm_model(trace.scenario.robot), joint_speeds_radps(trace)
        limit_radps = arm.velocity_limit_radps
        if (mean_radps > limit_radps).any():
            far, time_s = np.abs(history(trace, POSITION)), trace.time_s[:, None]
            # A mean speed is a difference of positions over a difference of times, both rounded. Drives at
            # their limit must not violate it by that rounding.
            rounding = far[:-1] + far[1:] + 2.0 * mean_radps * time_s[1:]
            rounding = limit_radps + EPSILON * rounding / np.diff(time_s, axis=0)
            mean_radps = np.where(mean_radps <= rounding, np.minimum(mean_radps, limit_radps), mean_radps)
        speed_radps = larger(speed_radps, mean_radps)
        left_radps = limit_radps - speed_radps
        tick, joint = divmod(int(left_radps.argmin()), left_radps.shape[1])
        return judged(
            self,
            trace,
            left_radps[tick, joint],
            trace.time_s[tick],
            arm.joint_names[joint],
            int(np.count_nonzero((speed_radps > MOVES).any(axis=1))),
            lambda: joints_stood(trace),
            most=left_radps[tick, joint] + known_to_radps(trace),
            unsure="it is above the limit by no more than the world's motors may miss a commanded speed",
        )


@dataclass(frozen=True, kw_only=True)
class TcpSpeedLimit(Worded):
    """The claim that the TCP's speed never exceeds ``maximum_mps``.

    The margin is the least ``maximum_mps`` - |v_tcp| over time. The speeds at the ticks and the mean speeds
    between the ticks are considered. ISO 10218-1 states 250 mm/s as the reduced speed at which a person may
    be near.
    """

    maximum_mps: float
    unit: Unit = Unit.SPEED
    wording: ClassVar[str] = "TCP speed never above {maximum_mps:mm/s}"

    @reads(SPEED, TCP, ends=_ends_by(of_speed(SPEED, TCP), SPEED, TCP))
    def evaluate(self, trace: Trace) -> Evaluation:
        """Judge the TCP's speed."""
        speed_mps = larger(*tcp_speeds_mps(trace))
        tick, moving = int(speed_mps.argmax()), int(np.count_nonzero(speed_mps > MOVES))
        reason, left_mps = f"fastest {speed_mps[tick] * 1e3:.1f} mm/s", self.maximum_mps - speed_mps[tick]
        return judged(self, trace, left_mps, trace.time_s[tick], reason, moving, lambda: tcp_stood(trace))


JOINT_POSITIONS = CatalogueEntry(
    prop=JointLimits(),
    rationale="an arm at a mechanical or safety-rated stop no longer moves as its controller commands",
    source="the robot's URDF",
    margin="the angle between a joint and its nearer limit; the least value over joints and time",
    parameters="the limits of the robot's description",
    exercised="always",
    broken_by="a controller that keeps turning a joint",
)

JOINT_SPEEDS = CatalogueEntry(
    prop=JointSpeedLimits(),
    rationale="above these limits the drives no longer follow the commands",
    source="the robot's URDF",
    margin=(
        "the limit minus the speed of a joint; the least value over joints and time. The mean "
        "speed between ticks is also checked"
    ),
    parameters="the limits of the robot's description",
    exercised="the arm moves",
    inconclusive="a speed exceeds the limit by no more than the error with which the world's motors "
    f"follow commanded speeds (PyBullet: {np.degrees(PYBULLET.known_to_radps):.2g} deg/s)",
    broken_by="a controller that turns a joint too fast",
)

TCP_SPEED = CatalogueEntry(
    prop=TcpSpeedLimit(maximum_mps=0.25),
    formula="always TCP speed <= {}",
    rationale="a person beside the robot can still step back if it moves at reduced speed",
    source="the reduced speed at which a person may be near",
    margin=(
        "the limit minus the speed of the TCP; the least value over time. The mean speed "
        "between ticks is also checked"
    ),
    parameters="the limit",
    exercised="the arm moves",
    broken_by="a controller that turns a joint too fast",
)


@dataclass(frozen=True, kw_only=True)
class JointAccelerations(Worded):
    """The claim that no joint's mean acceleration from tick to tick exceeds ``maximum_radps2``.

    The margin is ``maximum_radps2`` minus the largest of these accelerations.
    """

    maximum_radps2: float
    unit: Unit = Unit.ANGULAR_ACCELERATION
    wording: ClassVar[str] = "joint accelerations never above {maximum_radps2:deg/s2}"

    @reads(RATE, ends=_ends_by(of_change(RATE), RATE))
    def evaluate(self, trace: Trace) -> Evaluation:
        """Judge every joint in every control period."""
        if len(trace.ticks) < 2:
            return inconclusive(self, "one tick alone has no acceleration")
        rates_radps = history(trace, RATE)
        hard_radps2 = np.abs(np.diff(rates_radps, axis=0)) / trace.scenario.settings.clock.control_period_s
        tick, joint = divmod(int(hard_radps2.argmax()), hard_radps2.shape[1])
        turning, hardest_radps2 = (np.abs(rates_radps) > MOVES).any(axis=1), float(hard_radps2[tick, joint])
        name = arm_model(trace.scenario.robot).joint_names[joint]
        return judged(
            self,
            trace,
            self.maximum_radps2 - hardest_radps2,
            trace.time_s[tick],
            f"{name} {np.degrees(hardest_radps2):.0f} deg/s2",
            int(np.count_nonzero(turning)),
            lambda: joints_stood(trace),
        )


@dataclass(frozen=True, kw_only=True)
class TcpAcceleration(Worded):
    """The claim that the TCP's mean acceleration from tick to tick never exceeds ``maximum_mps2``.

    The margin is ``maximum_mps2`` minus the largest of these accelerations. The TCP's velocity at a tick is
    computed from the joints with the Jacobian. Ticks at which the TCP moves exercise the claim.
    """

    maximum_mps2: float
    unit: Unit = Unit.ACCELERATION
    wording: ClassVar[str] = "TCP acceleration never above {maximum_mps2:m/s2}"

    @reads(POSITION, RATE, SPEED, ends=_ends_by(of_tcp_acceleration, SPEED))
    def evaluate(self, trace: Trace) -> Evaluation:
        """Judge the TCP in every control period."""
        if len(trace.ticks) < 2:
            return inconclusive(self, "one tick alone has no acceleration")
        change_mps = np.linalg.norm(np.diff(arm_speeds_mps(trace)[:, 1:], axis=0), axis=1)
        tick = int(change_mps.argmax())
        hardest_mps2 = change_mps[tick] / trace.scenario.settings.clock.control_period_s
        moving = int(np.count_nonzero(trace.ticks[SPEED] > MOVES))
        reason, left_mps2 = f"largest {hardest_mps2:.2f} m/s2", self.maximum_mps2 - hardest_mps2
        return judged(self, trace, left_mps2, trace.time_s[tick], reason, moving, lambda: tcp_stood(trace))


JOINT_ACCELERATIONS = CatalogueEntry(
    prop=JointAccelerations(maximum_radps2=np.radians(500.0)),
    rationale="a joint that jerks shakes the camera and the tool, and wears its gear",
    source="the user's own limit, because the robot's description has no such limit",
    margin="the limit minus the largest mean acceleration of a joint from tick to tick",
    parameters="the limit; the control period in the settings",
    exercised="a joint turns",
    inconclusive="the run has only one tick",
    broken_by="a controller that accelerates a joint too fast",
)

TCP_ACCELERATION = CatalogueEntry(
    prop=TcpAcceleration(maximum_mps2=2.0),
    rationale="a person beside the arm can follow a motion that begins gently",
    source="the user's own limit; the settings ask the arm for at most 1 m/s2",
    margin="the limit minus the largest mean acceleration of the TCP from tick to tick",
    parameters="the limit; the control period in the settings",
    exercised="the TCP moves",
    inconclusive="the run has only one tick",
    broken_by="a controller that accelerates a joint too fast",
)
