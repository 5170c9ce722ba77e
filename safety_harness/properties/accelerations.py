"""The arm changes its speed gently: accelerations of joints and TCP."""

from __future__ import annotations

from dataclasses import dataclass
from math import sqrt

import numpy as np
from numpy.typing import NDArray

from safety_harness.compiled import compiled
from safety_harness.properties.base import Evaluation, Unit, inconclusive, judged, unreadable
from safety_harness.properties.entry import CatalogueEntry, quantity
from safety_harness.properties.least_separation import faster_mps
from safety_harness.properties.true_motion import joint_reach_m, true_motion
from safety_harness.robot.description import load_arm
from safety_harness.robot.kinematics import forward_kinematics, tcp_velocity
from safety_harness.scenario.units import ACCELERATION, ANGULAR_ACCELERATION
from safety_harness.trace.trace import Trace

MOVES_RADPS, MOVES_MPS = 1e-3, 1e-3
ROUNDING_MPS = 1e-9  # by which a bound, computed otherwise, may be off


@dataclass(frozen=True, kw_only=True)
class JointAccelerations:
    """min over time and joints of ``maximum_radps2`` less the mean acceleration from tick to tick."""

    maximum_radps2: float
    unit: Unit = Unit.ANGULAR_ACCELERATION

    @property
    def sentence(self) -> str:
        """As the catalogue writes it."""
        return f"joint accelerations never above {np.degrees(self.maximum_radps2):g} deg/s2"

    def evaluate(self, trace: Trace) -> Evaluation:
        """Judge every joint in every control period."""
        problem = unreadable(trace, ("joint_velocity_radps",))
        if problem is not None:
            return inconclusive(self, problem)
        if len(trace.ticks) < 2:
            return inconclusive(self, "one tick alone has no acceleration")
        period_s = trace.scenario.settings.clock.control_period_s
        hardest_radps2, tick, joint, turning = _hardest_of_joints(true_motion(trace).rates_radps, period_s)
        name = load_arm(trace.scenario.robot.arm_name).joint_names[joint]
        return judged(
            self,
            trace,
            margin=self.maximum_radps2 - hardest_radps2,
            worst_time_s=float(trace.time_s[tick]),
            reason=f"{name} {np.degrees(hardest_radps2):.0f} deg/s2",
            exercised=turning,
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

    def evaluate(self, trace: Trace) -> Evaluation:
        """Judge every control period."""
        problem = unreadable(trace, ("joint_position_rad", "joint_velocity_radps", "tcp_speed_mps"))
        if problem is not None:
            return inconclusive(self, problem)
        if len(trace.ticks) < 2:
            return inconclusive(self, "one tick alone has no acceleration")
        arm, true = load_arm(trace.scenario.robot.arm_name), true_motion(trace)
        change_mps, tick = _hardest_of_tcp(
            arm.joint_origins,
            arm.joint_axes,
            arm.flange,
            joint_reach_m(trace),
            true.joints_rad,
            true.rates_radps,
        )
        hardest_mps2 = change_mps / trace.scenario.settings.clock.control_period_s
        return judged(
            self,
            trace,
            margin=self.maximum_mps2 - hardest_mps2,
            worst_time_s=float(trace.time_s[tick]),
            reason=f"largest {hardest_mps2:.2f} m/s2",
            exercised=int(np.count_nonzero(trace.ticks["tcp_speed_mps"] > MOVES_MPS)),
        )


@compiled
def _hardest_of_joints(
    rates_radps: NDArray[np.float64],  # (n, 6)
    period_s: float,
) -> tuple[float, int, int, int]:
    """(acceleration, tick before it, joint), the first of equals; and how many ticks with a turn."""
    best, tick, joint, turning = -np.inf, 0, 0, 0
    for k in range(rates_radps.shape[0]):
        turns = False
        for j in range(rates_radps.shape[1]):
            turns |= abs(rates_radps[k, j]) > MOVES_RADPS
            if k == rates_radps.shape[0] - 1:
                continue
            size = abs(rates_radps[k + 1, j] - rates_radps[k, j]) / period_s
            if size > best:
                best, tick, joint = size, k, j
        turning += turns
    return best, tick, joint, turning


@compiled
def _hardest_of_tcp(
    joint_origins: NDArray[np.float64],
    joint_axes: NDArray[np.float64],
    flange: NDArray[np.float64],
    reach_m: NDArray[np.float64],  # (6,) of ``chain_lengths``
    joints_rad: NDArray[np.float64],  # (n, 6)
    rates_radps: NDArray[np.float64],  # (n, 6)
) -> tuple[float, int]:
    """The largest change [m/s] of the TCP's velocity from a tick to the next, and the first with it.

    Velocities are formed where the change can be as large as the largest so far, the likeliest tick first.
    """
    n = joints_rad.shape[0]
    most, first = np.empty(n - 1), 0
    for k in range(n - 1):
        most[k] = faster_mps(joints_rad, rates_radps, reach_m, k, k + 1) + ROUNDING_MPS
        if most[k] > most[first]:
            first = k
    links = np.empty((8, 4, 4))
    best, tick, known = -1.0, -1, -1  # the tick whose velocity is (x, y, z)
    x = y = z = 0.0
    for step in range(-1, n - 1):
        k = step if step >= 0 else first
        if most[k] < best:
            continue
        if known != k:
            forward_kinematics(joint_origins, joint_axes, flange, joints_rad[k], links)
            x, y, z = tcp_velocity(joint_axes, links, rates_radps[k])
        before_x, before_y, before_z, known = x, y, z, k + 1
        forward_kinematics(joint_origins, joint_axes, flange, joints_rad[k + 1], links)
        x, y, z = tcp_velocity(joint_axes, links, rates_radps[k + 1])
        change = sqrt((x - before_x) ** 2 + (y - before_y) ** 2 + (z - before_z) ** 2)
        if change > best or (change == best and k < tick):
            best, tick = change, k
        elif np.isnan(change) and step >= 0:
            return change, k
    return best, tick


JOINT_ACCELERATIONS = CatalogueEntry(
    example="joint accelerations never above 500 deg/s2",
    pattern=r"joint accelerations never above (.+)",
    make=lambda match, _, place: JointAccelerations(
        maximum_radps2=quantity(match[1], ANGULAR_ACCELERATION, place)
    ),
    unit=Unit.ANGULAR_ACCELERATION,
    rationale="a jerking joint shakes camera and tool, and wears its gear",
    source="a limit of one's own: the robot's description has none",
    margin="the limit less the largest mean acceleration of a joint from tick to tick",
    parameters="the limit; the control period of the settings",
    exercised="a joint turns",
    inconclusive="a run of one tick",
    scenario="hand-visits-and-leaves",
    broken_by="a controller that turns a joint too fast at once",
)

TCP_ACCELERATION = CatalogueEntry(
    example="TCP acceleration never above 2 m/s2",
    pattern=r"TCP acceleration never above (.+)",
    make=lambda match, _, place: TcpAcceleration(maximum_mps2=quantity(match[1], ACCELERATION, place)),
    unit=Unit.ACCELERATION,
    rationale="a person beside the arm can follow a motion that begins gently",
    source="a limit of one's own; the settings demand at most 1 m/s2 of the arm",
    margin="the limit less the largest mean acceleration of the TCP from tick to tick",
    parameters="the limit; the control period of the settings",
    exercised="the TCP moves",
    inconclusive="a run of one tick",
    scenario="hand-visits-and-leaves",
    broken_by="a controller that turns a joint too fast at once",
)
