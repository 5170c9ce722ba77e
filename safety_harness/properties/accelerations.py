"""The arm changes its speed gently: accelerations of joints and TCP."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from safety_harness.compiled import compiled
from safety_harness.properties.base import Evaluation, Unit, inconclusive, judged, unreadable
from safety_harness.properties.entry import Entry, quantity
from safety_harness.properties.true_motion import true_motion
from safety_harness.robot.description import load_arm
from safety_harness.robot.kinematics import forward_kinematics, geometric_jacobian
from safety_harness.scenario.units import ACCELERATION, ANGULAR_ACCELERATION
from safety_harness.trace.trace import Trace, history

MOVES_RADPS, MOVES_MPS = 1e-3, 1e-3


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
        velocity = history(trace, "joint_velocity_radps")
        if len(velocity) < 2:
            return inconclusive(self, "one tick alone has no acceleration")
        size = np.abs(np.diff(velocity, axis=0)) / trace.scenario.settings.clock.control_period_s  # (n-1, 6)
        tick, joint = np.unravel_index(int(np.argmax(size)), size.shape)
        name = load_arm(trace.scenario.robot.arm_name).joint_names[joint]
        return judged(
            self,
            trace,
            margin=self.maximum_radps2 - float(size[tick, joint]),
            worst_time_s=float(trace.time_s[tick]),
            reason=f"{name} {np.degrees(size[tick, joint]):.0f} deg/s2",
            exercised=int(np.count_nonzero(np.abs(velocity).max(axis=1) > MOVES_RADPS)),
        )


@dataclass(frozen=True, kw_only=True)
class TcpAcceleration:
    """min over time of ``maximum_mps2`` less the mean acceleration of the TCP from tick to tick.

    Its velocity at a tick is that of the joints, by the Jacobian.
    """

    maximum_mps2: float
    unit: Unit = Unit.ACCELERATION

    @property
    def sentence(self) -> str:
        """As the catalogue writes it."""
        return f"TCP acceleration never above {self.maximum_mps2:g} m/s2"

    def evaluate(self, trace: Trace) -> Evaluation:
        """Judge every control period."""
        problem = unreadable(trace, ("joint_position_rad", "joint_velocity_radps"))
        if problem is not None:
            return inconclusive(self, problem)
        velocity = tcp_velocity_in_base_mps(trace)
        if len(velocity) < 2:
            return inconclusive(self, "one tick alone has no acceleration")
        change = np.linalg.norm(np.diff(velocity, axis=0), axis=1)
        size = change / trace.scenario.settings.clock.control_period_s
        tick = int(np.argmax(size))
        return judged(
            self,
            trace,
            margin=self.maximum_mps2 - float(size[tick]),
            worst_time_s=float(trace.time_s[tick]),
            reason=f"largest {size[tick]:.2f} m/s2",
            exercised=int(np.count_nonzero(np.linalg.norm(velocity, axis=1) > MOVES_MPS)),
        )


def tcp_velocity_in_base_mps(trace: Trace) -> NDArray[np.float64]:
    """(n, 3) velocity of the TCP at each tick, from the true joints."""
    arm = load_arm(trace.scenario.robot.arm_name)
    found = np.empty((len(trace.ticks), 3))
    _velocities(
        arm.joint_origins,
        arm.joint_axes,
        arm.flange,
        true_motion(trace).joints_rad,
        true_motion(trace).rates_radps,
        found,
    )
    return found


@compiled
def _velocities(
    joint_origins: NDArray[np.float64],
    joint_axes: NDArray[np.float64],
    flange: NDArray[np.float64],
    joints_rad: NDArray[np.float64],  # (n, 6)
    velocities_radps: NDArray[np.float64],  # (n, 6)
    found: NDArray[np.float64],  # (n, 3), written
) -> None:
    links, jacobian = np.empty((8, 4, 4)), np.empty((6, 6))
    for k in range(joints_rad.shape[0]):
        forward_kinematics(joint_origins, joint_axes, flange, joints_rad[k], links)
        geometric_jacobian(joint_axes, links, jacobian)
        for i in range(3):
            found[k, i] = 0.0
            for j in range(6):
                found[k, i] += jacobian[i, j] * velocities_radps[k, j]


JOINT_ACCELERATIONS = Entry(
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

TCP_ACCELERATION = Entry(
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
