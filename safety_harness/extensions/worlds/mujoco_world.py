"""Simulate the second reference world: the arm in MuJoCo, with its meshes, motors and physics."""

from __future__ import annotations

import mujoco
import numpy as np
from numpy.typing import NDArray

from safety_harness.base.exceptions import SimulationError
from safety_harness.base.geometry.arrays import ArrayN
from safety_harness.cell.controller.records import CommandRecords
from safety_harness.cell.perception.detector import BoundingBoxDetector
from safety_harness.cell.robot.description import ArmModel
from safety_harness.cell.simulation.steps import drive_on, move_on
from safety_harness.cell.simulation.world import AMPLE, RecordedWorld, overshoot_radps
from safety_harness.extensions.worlds.mujoco_model import PREFIX, cell_model
from safety_harness.scenario.model import Scenario

MOST_EXCHANGES = 1000  # an arm of six weak joints needs some tens at most
ROUNDING_RADPS2 = 1e-6  # of accelerations; a sub-step makes less than 1e-8 rad/s of it


class MujocoWorld(RecordedWorld):
    """A run of a scenario in MuJoCo; use the object once, as a context manager.

    The set points of the drives are inputs of motors, whose torque limits come from the URDF. Each control
    period consists of ``physics_substeps`` steps of the engine. Hands exert no forces; a contact is only a
    distance below zero.
    """

    name = "mujoco"

    def __init__(
        self,
        scenario: Scenario,
        arm: ArmModel,
        joint_position_rad: ArrayN,
        *,
        detector: BoundingBoxDetector | None = None,
    ) -> None:
        super().__init__(scenario, arm, joint_position_rad)
        clock = scenario.settings.clock
        self._substeps = clock.physics_substeps
        self._step_s = clock.control_period_s / clock.physics_substeps
        self._model = cell_model(arm, scenario.settings.cell.table_height_m, self._step_s)
        self._data = mujoco.MjData(self._model)
        joints = [self._model.joint(PREFIX + name) for name in arm.joint_names]
        self._positions = np.array([joint.qposadr[0] for joint in joints])
        self._speeds = np.array([joint.dofadr[0] for joint in joints])
        # The model of the drives limits their torque, so the engine must not limit it a second time.
        more = AMPLE if self.records.drives[0]["limited"] else 1.0
        self._limit_nm = np.full(self._model.nv, np.inf)  # a joint that is not the arm's is held
        self._limit_nm[self._speeds] = more * arm.effort_limit
        self._wanted_radps = np.zeros(self._model.nv)
        self._commanded_radps = np.empty(len(joints))
        self._data.qpos[self._positions] = joint_position_rad
        self.overshoot_radps = np.zeros((scenario.ticks + 1, len(joints)))  # for the trace
        self.saturated = self.contacts = 0  # sub-steps

    def step(self, command: NDArray[np.void]) -> bool:
        """Run drives, motors and physics for one control period, during which the hands also move.

        ``command`` (1,) COMMAND. Return True if the brakes are active.
        """
        r, data = self.records, self._data
        braking = drive_on(
            r.drives, r.arm, r.truth, r.clock, r.faults, CommandRecords(command), self._commanded_radps
        )
        self._wanted_radps[self._speeds] = self._commanded_radps
        before_radps, tick = r.truth[0]["joint_velocity_radps"].copy(), int(r.clock[0]["tick"])
        own_radps = np.empty((self._substeps, len(self._speeds)))
        for k in range(self._substeps):
            # The torques depend on the state after ``mj_step1``, so the step is done in two halves.
            mujoco.mj_step1(self._model, data)
            data.qfrc_applied[:] = self._torques_nm()
            mujoco.mj_step2(self._model, data)
            own_radps[k] = data.qvel[self._speeds]
            self.contacts += bool(data.ncon)
        move_on(*r[1:9], data.qpos[self._positions], own_radps[-1])
        self.overshoot_radps[tick] = overshoot_radps(before_radps, own_radps)
        return braking

    def _torques_nm(self) -> NDArray[np.float64]:
        """Return the motors' torques (nv,) that give the joints the wanted speeds after this sub-step.

        If a motor would need more than its limit, it gives its limit. The torques of the other motors are
        then adjusted, so that their joints still reach the wanted speeds (see ``saturated_torques``). The
        torques also balance the forces of contacts and joint stops in the previous sub-step. Without this
        balance, an arm that presses on the table would move its other joints.
        """
        data = self._data
        # Inverse dynamics: M times the acceleration that leads to the wanted speed, plus all other forces.
        need_radps2 = (self._wanted_radps - data.qvel) / self._step_s
        other_nm = data.qfrc_bias - data.qfrc_passive - data.qfrc_constraint
        torques_nm = np.empty(self._model.nv)
        mujoco.mj_mulM(self._model, data, torques_nm, need_radps2)
        torques_nm += other_nm
        if not (np.abs(torques_nm) > self._limit_nm).any():
            return torques_nm
        self.saturated += 1
        mass = np.empty((self._model.nv, self._model.nv))
        mujoco.mj_fullM(self._model, data, mass)
        return saturated_torques(mass, other_nm, need_radps2, self._limit_nm)


def saturated_torques(
    mass: NDArray[np.float64],
    other_nm: NDArray[np.float64],
    need_radps2: NDArray[np.float64],
    limit_nm: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Return the torques of the motors if some of them are too weak for the needed accelerations, shape (n,).

    A motor at its limit never accelerates its joint beyond the need, because it would otherwise push the
    joint back and forth. If the motor of a joint is not at a limit, the joint has exactly the acceleration
    that it needs. At the upper limit the acceleration is at most the need, and at the lower limit it is at
    least the need. For a mass matrix, exactly one solution exists. To find it, each step exchanges only the
    first joint that contradicts these conditions (Murty's least-index rule).

    Args:
        mass: The mass matrix (n, n).
        other_nm: The torques (n,) that the motors need for zero acceleration.
        need_radps2: The accelerations (n,) that all joints need.
        limit_nm: The limits (n,) of the torques.

    Raises:
        SimulationError: Rounding or NaN prevents a solution.

    """
    at_end = np.zeros(len(need_radps2))  # 1 for a motor at its upper limit, -1 at its lower one, otherwise 0
    for _ in range(MOST_EXCHANGES):
        weak, free = at_end != 0.0, at_end == 0.0
        torques_nm, radps2 = np.empty_like(need_radps2), need_radps2.copy()
        torques_nm[weak] = at_end[weak] * limit_nm[weak]
        # The joints at a limit follow from the dynamics; the free joints have the accelerations that they
        # need.
        moved_nm = torques_nm[weak] - other_nm[weak] - mass[np.ix_(weak, free)] @ need_radps2[free]
        radps2[weak] = np.linalg.solve(mass[np.ix_(weak, weak)], moved_nm)
        torques_nm[free] = mass[free] @ radps2 + other_nm[free]
        beyond_limit = free & (np.abs(torques_nm) > limit_nm)
        beyond_need = weak & (at_end * (radps2 - need_radps2) > ROUNDING_RADPS2)
        contradicting = np.flatnonzero(beyond_limit | beyond_need)
        if not len(contradicting):
            return torques_nm
        first = contradicting[0]
        at_end[first] = np.sign(torques_nm[first]) if free[first] else 0.0
    raise SimulationError("MuJoCo: no torques of the saturated motors agree with the motion")
