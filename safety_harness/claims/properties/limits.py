"""The arm stays within its limits: joint positions, speeds of joints and TCP, accelerations of both."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import sqrt

import numpy as np
from numpy.typing import NDArray

from safety_harness.base.compiled import compiled
from safety_harness.cell.robot.capsules import Arm
from safety_harness.cell.robot.kinematics import forward_kinematics, tcp_velocity
from safety_harness.cell.robot.robots import arm_model
from safety_harness.cell.simulation.worlds import PYBULLET
from safety_harness.claims.properties.base import Evaluation, Unit, inconclusive, judged
from safety_harness.claims.properties.entry import CatalogueEntry, quantity
from safety_harness.claims.properties.measured import Ends, reads
from safety_harness.claims.properties.separation import faster_mps
from safety_harness.claims.signals.occasions import MOVES, joints_stood, tcp_stood, went
from safety_harness.claims.signals.speeds import known_to_radps
from safety_harness.claims.signals.true_motion import arm_of, tcp_velocity_moved_mps, true_motion
from safety_harness.scenario.units import ACCELERATION, ANGULAR_ACCELERATION, SPEED
from safety_harness.trace.trace import Trace

EPSILON = float(np.finfo(np.float64).eps)

ROUNDING_MPS = 1e-9  # by which a bound, computed otherwise, may be off


def _by(moved: Callable[[Trace], float], speed: str = "", place: str = "") -> Ends:
    """For ``reads``: how far a margin moves; exercised if the column ``speed`` or ``place`` says so."""

    def ends(prop: object, trace: Trace, margin: float) -> tuple[float, float, bool]:
        by = moved(trace)
        fast = not speed or float(np.abs(trace.ticks[speed]).max()) - _off(trace, speed) > MOVES
        return (
            margin - by,
            margin + by,
            fast or (place != "" and went(trace, place, np.isfinite(trace.time_s))),
        )

    return ends


def _off(trace: Trace, column: str) -> float:
    return trace.known.of(column).uncertainty


def _mean_off(trace: Trace, at_ticks: str, way: str) -> float:
    """By how much a speed may be off at the ticks, or its mean from one to the next."""
    return max(_off(trace, at_ticks), _changed(trace, way))


def _changed(trace: Trace, column: str) -> float:
    """By how much the mean change of a column from tick to tick may be off, in its unit a second."""
    return 2.0 * _off(trace, column) / trace.scenario.settings.clock.control_period_s


def _tcp_changed_mps2(trace: Trace) -> float:
    """The same of the TCP's velocity, as joints and their speeds are uncertain."""
    off_mps = float(tcp_velocity_moved_mps(trace).max())
    return 2.0 * off_mps / trace.scenario.settings.clock.control_period_s


@dataclass(frozen=True, kw_only=True)
class JointLimits:
    """min over time and joints of the angle left to the nearer position limit of the URDF."""

    unit: Unit = Unit.ANGLE
    sentence: str = "joint positions within limits"

    @reads("joint_position_rad", ends=_by(lambda trace: _off(trace, "joint_position_rad")))
    def evaluate(self, trace: Trace) -> Evaluation:
        """Judge every joint at every tick."""
        arm = arm_model(trace.scenario.robot)
        left_rad, tick, joint = _least_angle_left(
            true_motion(trace).joints_rad, arm.position_lower_rad, arm.position_upper_rad
        )
        return judged(self, trace, left_rad, trace.time_s[tick], arm.joint_names[joint], len(trace.ticks))


@dataclass(frozen=True, kw_only=True)
class JointSpeedLimits:
    """min over time and joints of the speed left to the velocity limit of the URDF.

    Between ticks the mean speed |q_(k+1) - q_k|/dt counts as well as the speed at the ticks.  What is above a
    limit by no more than the world's solver may miss a commanded speed (``known_to_radps``) is not certain.
    """

    unit: Unit = Unit.ANGULAR_SPEED
    sentence: str = "joint speeds within limits"

    @reads(
        "joint_position_rad",
        "joint_velocity_radps",
        ends=_by(
            lambda trace: _mean_off(trace, "joint_velocity_radps", "joint_position_rad"),
            "joint_velocity_radps",
            "joint_position_rad",
        ),
    )
    def evaluate(self, trace: Trace) -> Evaluation:
        """Judge every joint at every tick."""
        arm = arm_model(trace.scenario.robot)
        true = true_motion(trace)
        left_radps, tick, joint, turning = _least_speed_left(
            true.joints_rad, true.rates_radps, trace.time_s, arm.velocity_limit_radps
        )
        return judged(
            self,
            trace,
            left_radps,
            trace.time_s[tick],
            arm.joint_names[joint],
            turning,
            lambda: joints_stood(trace),
            most=left_radps + known_to_radps(trace),
            unsure="it is above the limit by no more than the world's motors may miss a commanded speed",
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

    @reads(
        "tcp_speed_mps",
        "transform_tcp_to_base",
        ends=_by(
            lambda trace: _mean_off(trace, "tcp_speed_mps", "transform_tcp_to_base"),
            "tcp_speed_mps",
            "transform_tcp_to_base",
        ),
    )
    def evaluate(self, trace: Trace) -> Evaluation:
        """Judge the TCP's speed."""
        fastest_mps, tick, moving = _fastest(
            trace.ticks["tcp_speed_mps"], true_motion(trace).tcp_m, trace.time_s
        )
        reason = f"fastest {fastest_mps * 1e3:.1f} mm/s"
        margin_mps = self.maximum_mps - fastest_mps
        return judged(self, trace, margin_mps, trace.time_s[tick], reason, moving, lambda: tcp_stood(trace))


@compiled
def _least_angle_left(
    joints_rad: NDArray[np.float64],  # (n, joints)
    lower_rad: NDArray[np.float64],  # (joints,)
    upper_rad: NDArray[np.float64],  # (joints,)
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
    joints_rad: NDArray[np.float64],  # (n, joints)
    rates_radps: NDArray[np.float64],  # (n, joints)
    time_s: NDArray[np.float64],  # (n,)
    limit_radps: NDArray[np.float64],  # (joints,)
) -> tuple[float, int, int, int]:
    """(speed, tick, joint), the first of equals; and the number of ticks at which a joint turns.

    A mean speed over the limit by no more than the rounding of its differences is taken for the limit.
    """
    least, tick, joint, turning = np.inf, 0, 0, 0
    for k in range(rates_radps.shape[0]):
        turns = False
        for j in range(rates_radps.shape[1]):
            speed = abs(rates_radps[k, j])
            if k + 1 < rates_radps.shape[0]:
                before, after, dt = joints_rad[k, j], joints_rad[k + 1, j], time_s[k + 1] - time_s[k]
                mean = abs(after - before) / dt
                if limit_radps[j] < mean:
                    rounding = EPSILON * (abs(before) + abs(after) + 2.0 * mean * abs(time_s[k + 1])) / dt
                    mean = limit_radps[j] if mean <= limit_radps[j] + rounding else mean
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
    prop=JointLimits(),
    rationale="an arm at a mechanical or safety-rated stop no longer goes where its controller sends it",
    source="the robot's URDF",
    margin="angle left to the nearer limit, least over joints and time",
    parameters="the limits of the robot's description",
    exercised="always",
    broken_by="a controller that turns a joint on and on",
)

JOINT_SPEEDS = CatalogueEntry(
    prop=JointSpeedLimits(),
    rationale="beyond them the drives no longer follow",
    source="the robot's URDF",
    margin="speed left to the limit, least over joints and time; the mean speed between ticks counts too",
    parameters="the limits of the robot's description",
    exercised="the arm moves",
    inconclusive="a speed above the limit by no more than a world's motors miss commanded speeds (PyBullet: "
    f"{np.degrees(PYBULLET.known_to_radps):.2g} deg/s)",
    broken_by="a controller that turns a joint too fast",
)

TCP_SPEED = CatalogueEntry(
    prop=TcpSpeedLimit(maximum_mps=0.25),
    pattern=r"TCP speed never above (.+)",
    make=lambda match, _, place: TcpSpeedLimit(maximum_mps=quantity(match[1], SPEED, place)),
    rationale="a person beside the robot can still step back from one that moves at reduced speed",
    source="the reduced speed at which a person may be near",
    margin="speed left to the limit, least over time; the mean speed between ticks counts too",
    parameters="the limit",
    exercised="the arm moves",
    broken_by="a controller that turns a joint too fast",
)


@dataclass(frozen=True, kw_only=True)
class JointAccelerations:
    """min over time and joints of ``maximum_radps2`` less the mean acceleration from tick to tick."""

    maximum_radps2: float
    unit: Unit = Unit.ANGULAR_ACCELERATION

    @property
    def sentence(self) -> str:
        """As the catalogue writes it."""
        return f"joint accelerations never above {np.degrees(self.maximum_radps2):g} deg/s2"

    @reads(
        "joint_velocity_radps",
        ends=_by(lambda trace: _changed(trace, "joint_velocity_radps"), "joint_velocity_radps"),
    )
    def evaluate(self, trace: Trace) -> Evaluation:
        """Judge every joint in every control period."""
        if len(trace.ticks) < 2:
            return inconclusive(self, "one tick alone has no acceleration")
        period_s = trace.scenario.settings.clock.control_period_s
        hardest_radps2, tick, joint, turning = _hardest_of_joints(true_motion(trace).rates_radps, period_s)
        name = arm_model(trace.scenario.robot).joint_names[joint]
        reason = f"{name} {np.degrees(hardest_radps2):.0f} deg/s2"
        margin_radps2 = self.maximum_radps2 - hardest_radps2
        return judged(
            self, trace, margin_radps2, trace.time_s[tick], reason, turning, lambda: joints_stood(trace)
        )


@dataclass(frozen=True, kw_only=True)
class TcpAcceleration:
    """min over time of ``maximum_mps2`` less the mean acceleration of the TCP from tick to tick.

    Its velocity at a tick is that of the joints, by the Jacobian.  Exercised by ticks at which it moves.
    """

    maximum_mps2: float
    unit: Unit = Unit.ACCELERATION

    @property
    def sentence(self) -> str:
        """As the catalogue writes it."""
        return f"TCP acceleration never above {self.maximum_mps2:g} m/s2"

    @reads(
        "joint_position_rad",
        "joint_velocity_radps",
        "tcp_speed_mps",
        ends=_by(_tcp_changed_mps2, "tcp_speed_mps"),
    )
    def evaluate(self, trace: Trace) -> Evaluation:
        """Judge every control period."""
        if len(trace.ticks) < 2:
            return inconclusive(self, "one tick alone has no acceleration")
        true = true_motion(trace)
        change_mps, tick = _hardest_of_tcp(arm_of(trace), true.joints_rad, true.rates_radps)
        hardest_mps2 = change_mps / trace.scenario.settings.clock.control_period_s
        moving = int(np.count_nonzero(trace.ticks["tcp_speed_mps"] > MOVES))
        reason = f"largest {hardest_mps2:.2f} m/s2"
        margin_mps2 = self.maximum_mps2 - hardest_mps2
        return judged(self, trace, margin_mps2, trace.time_s[tick], reason, moving, lambda: tcp_stood(trace))


@compiled
def _hardest_of_joints(
    rates_radps: NDArray[np.float64],  # (n, joints)
    period_s: float,
) -> tuple[float, int, int, int]:
    """(acceleration, tick before it, joint), the first of equals; and how many ticks with a turn."""
    best, tick, joint, turning = -np.inf, 0, 0, 0
    for k in range(rates_radps.shape[0]):
        turns = False
        for j in range(rates_radps.shape[1]):
            turns |= abs(rates_radps[k, j]) > MOVES
            if k == rates_radps.shape[0] - 1:
                continue
            size = abs(rates_radps[k + 1, j] - rates_radps[k, j]) / period_s
            if size > best:
                best, tick, joint = size, k, j
        turning += turns
    return best, tick, joint, turning


@compiled
def _hardest_of_tcp(
    arm: Arm,
    joints_rad: NDArray[np.float64],  # (n, joints)
    rates_radps: NDArray[np.float64],  # (n, joints)
) -> tuple[float, int]:
    """The largest change [m/s] of the TCP's velocity from a tick to the next, and the first with it.

    Velocities are formed where the change can be as large as the largest so far, the likeliest tick first.
    """
    n = joints_rad.shape[0]
    most, first = np.empty(n - 1), 0
    for k in range(n - 1):
        most[k] = faster_mps(arm, joints_rad, rates_radps, k, k + 1) + ROUNDING_MPS
        if most[k] > most[first]:
            first = k
    links = np.empty((arm.chain[0].joint_axes.shape[0] + 2, 4, 4))
    best, tick, known = -1.0, -1, -1  # the tick whose velocity is (x, y, z)
    x = y = z = 0.0
    for step in range(-1, n - 1):
        k = step if step >= 0 else first
        if most[k] < best:
            continue
        if known != k:
            forward_kinematics(arm.chain[0], joints_rad[k], links)
            x, y, z = tcp_velocity(arm.chain[0].joint_axes, links, rates_radps[k])
        before_x, before_y, before_z, known = x, y, z, k + 1
        forward_kinematics(arm.chain[0], joints_rad[k + 1], links)
        x, y, z = tcp_velocity(arm.chain[0].joint_axes, links, rates_radps[k + 1])
        change = sqrt((x - before_x) ** 2 + (y - before_y) ** 2 + (z - before_z) ** 2)
        if change > best or (change == best and k < tick):
            best, tick = change, k
        elif np.isnan(change) and step >= 0:
            return change, k
    return best, tick


JOINT_ACCELERATIONS = CatalogueEntry(
    prop=JointAccelerations(maximum_radps2=np.radians(500.0)),
    pattern=r"joint accelerations never above (.+)",
    make=lambda match, _, place: JointAccelerations(
        maximum_radps2=quantity(match[1], ANGULAR_ACCELERATION, place)
    ),
    rationale="a jerking joint shakes camera and tool, and wears its gear",
    source="a limit of one's own: the robot's description has none",
    margin="the limit less the largest mean acceleration of a joint from tick to tick",
    parameters="the limit; the control period of the settings",
    exercised="a joint turns",
    inconclusive="a run of one tick",
    broken_by="a controller that turns a joint too fast at once",
)

TCP_ACCELERATION = CatalogueEntry(
    prop=TcpAcceleration(maximum_mps2=2.0),
    pattern=r"TCP acceleration never above (.+)",
    make=lambda match, _, place: TcpAcceleration(maximum_mps2=quantity(match[1], ACCELERATION, place)),
    rationale="a person beside the arm can follow a motion that begins gently",
    source="a limit of one's own; the settings demand at most 1 m/s2 of the arm",
    margin="the limit less the largest mean acceleration of the TCP from tick to tick",
    parameters="the limit; the control period of the settings",
    exercised="the TCP moves",
    inconclusive="a run of one tick",
    broken_by="a controller that turns a joint too fast at once",
)
