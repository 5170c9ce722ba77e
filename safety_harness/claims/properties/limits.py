"""Judge that the arm keeps its limits: joint positions, and speeds and accelerations of joints and TCP."""

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
    """Return ``ends`` for ``reads`` by a margin's error; motion of ``speed`` or ``place`` exercises it."""

    def ends(prop: object, trace: Trace, margin: float) -> tuple[float, float, bool]:
        error = float(error_of(trace)[2])
        fast = not speed or np.abs(trace.ticks[speed]).max() - trace.known.column(speed).uncertainty > MOVES
        moves = fast or (place != "" and went(trace, place, np.isfinite(trace.time_s)))
        return margin - error, margin + error, bool(moves)

    return ends


@dataclass(frozen=True, kw_only=True)
class JointLimits:
    """The least angle, over time and joints, that is left to the nearer position limit of the URDF."""

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
    """The least speed, over time and joints, that is left to the velocity limit of the URDF.

    The speeds at the ticks and the mean speeds |q_(k+1) - q_k|/dt between ticks k and k+1 both count. An
    excess is uncertain if it is at most the solver's error in following a commanded speed
    (``known_to_radps``).
    """

    unit: Unit = Unit.ANGULAR_SPEED
    sentence: str = "joint speeds within limits"

    @reads(POSITION, RATE, ends=_ends_by(of_speed(RATE, POSITION), RATE, POSITION))
    def evaluate(self, trace: Trace) -> Evaluation:
        """Judge every joint at every tick.

        A mean speed that exceeds the limit by at most the rounding of its difference counts as the limit.
        """
        arm, (speed_radps, mean_radps) = arm_model(trace.scenario.robot), joint_speeds_radps(trace)
        limit_radps = arm.velocity_limit_radps
        if (mean_radps > limit_radps).any():
            far, time_s = np.abs(history(trace, POSITION)), trace.time_s[:, None]
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
    """The least ``maximum_mps`` - |v_tcp| over time, at the ticks and for the mean speed between them.

    ISO 10218-1 states 250 mm/s as the reduced speed at which a person may be near.
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
    margin="angle between a joint and its nearer limit, least over joints and time",
    parameters="the limits of the robot's description",
    exercised="always",
    broken_by="a controller that keeps turning a joint",
)

JOINT_SPEEDS = CatalogueEntry(
    prop=JointSpeedLimits(),
    rationale="above these limits the drives no longer follow the commands",
    source="the robot's URDF",
    margin="the limit less the speed of a joint, least over joints and time; the mean speed between "
    "ticks is checked too",
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
    margin="the limit less the speed of the TCP, least over time; the mean speed between ticks is "
    "checked too",
    parameters="the limit",
    exercised="the arm moves",
    broken_by="a controller that turns a joint too fast",
)


@dataclass(frozen=True, kw_only=True)
class JointAccelerations(Worded):
    """The least of ``maximum_radps2`` less a joint's mean acceleration from tick to tick."""

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
    """The least of ``maximum_mps2`` less the TCP's mean acceleration from tick to tick.

    The TCP's velocity at a tick follows from the joints by the Jacobian. Ticks at which the TCP moves
    exercise the claim.
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
    source="a limit of one's own: the robot's description has none",
    margin="the limit less the largest mean acceleration of a joint from tick to tick",
    parameters="the limit; the control period in the settings",
    exercised="a joint turns",
    inconclusive="the run has only one tick",
    broken_by="a controller that accelerates a joint too fast",
)

TCP_ACCELERATION = CatalogueEntry(
    prop=TcpAcceleration(maximum_mps2=2.0),
    rationale="a person beside the arm can follow a motion that begins gently",
    source="a limit of one's own; the settings demand at most 1 m/s2 of the arm",
    margin="the limit less the largest mean acceleration of the TCP from tick to tick",
    parameters="the limit; the control period in the settings",
    exercised="the TCP moves",
    inconclusive="the run has only one tick",
    broken_by="a controller that accelerates a joint too fast",
)
