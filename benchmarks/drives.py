"""How far are saturated drives from MuJoCo's?  Run: python benchmarks/drives.py (with mujoco installed).

Every joint of an arm is told a square wave of speed that the URDF's efforts cannot follow: as the drives'
model does it (kinematic world), and as MuJoCo's rigid bodies do it, by two rules:

- *one factor*: the model's rule on MuJoCo's own inverse dynamics, which MuJoCo then integrates.  What
  differs is the dynamics, and that the model's accelerations are even over a control period.
- *joint by joint*: the torques that would do it, each cut at its limit.  What differs is the rule.

Beside them PyBullet's velocity motors with the same limits, which is what an own arm without ``drives`` has.
Distances are the largest of the TCP over the run; times are to standstill after the demand became 0.
"""

from __future__ import annotations

import one_thread  # noqa: F401 (before every library that reads its variables)

# isort: split

import argparse
import sys
import tempfile
import xml.etree.ElementTree as ElementTree
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from itertools import product
from pathlib import Path

import numpy as np
import pybullet_data
from numpy.typing import NDArray

from safety_harness.base.settings import DEFAULTS
from safety_harness.cell.robot.description import ArmModel, read_arm, resolved_urdf
from safety_harness.cell.robot.drive import DriveModel, drive, drive_tick, limit_torques, tell_motors
from safety_harness.cell.robot.dynamics import GRAVITY_MPS2, link_masses, torque_share
from safety_harness.cell.robot.kinematics import links_in_base
from safety_harness.cell.simulation.engine import pybullet

try:
    import mujoco
except ImportError:
    sys.exit("this needs MuJoCo: pip install mujoco")

Floats = NDArray[np.float64]
DATA = Path(pybullet_data.getDataPath())
ARMS = {  # name: file, base, tcp, where it starts
    "iiwa": (DATA / "kuka_iiwa" / "model.urdf", None, None, [0.0, 0.8, 0.0, -1.2, 0.0, 0.9, 0.0]),
    "Panda": (
        DATA / "franka_panda" / "panda.urdf",
        "panda_link0",
        "panda_hand",
        [0.0, 0.2, 0.0, -1.8, 0.0, 2.0, 0.8],
    ),
}
PERIOD_S = DEFAULTS.clock.control_period_s
PAYLOADS_KG = 0.0, 3.0
SPEEDS_RADPS = 0.3, 1.0
PAYLOAD_AT_M = np.array([0.0, 0.02, 0.05])  # in the frame of the tcp
SUBSTEP_S = 0.0005  # of MuJoCo
HALF_WAVE_S, WAVES = 0.32, 3
PARTS = np.array([1.0, 1.0, -0.8, 1.0, 0.7, -1.0, 0.9])


@dataclass(frozen=True)
class Case:
    """An arm with a payload, and what its joints are told: (ticks, 7) ``told`` from ``start`` (7,) on."""

    arm: ArmModel
    start: Floats
    payload_kg: float
    speed_radps: float

    @property
    def told(self) -> Floats:
        """A square wave, then standstill."""
        signs = np.repeat([1.0, -1.0] * WAVES + [0.0, 0.0], round(HALF_WAVE_S / PERIOD_S))
        return self.speed_radps * signs[:, None] * PARTS

    @property
    def urdf(self) -> ElementTree.Element:
        """Without shapes and friction, with the payload as a link of its own."""
        root = ElementTree.fromstring(resolved_urdf(self.arm, visuals=False))
        for link in root.iter("link"):
            for shape in link.findall("collision"):
                link.remove(shape)
        for joint in root.iter("joint"):
            for damping in joint.findall("dynamics"):
                joint.remove(damping)
        if self.payload_kg > 0.0:
            tiny = 'ixx="1e-9" ixy="0" ixz="0" iyy="1e-9" iyz="0" izz="1e-9"'
            at = " ".join(map(str, PAYLOAD_AT_M))
            root.extend(
                ElementTree.fromstring(
                    f'<r><link name="payload"><inertial><mass value="{self.payload_kg}"/><inertia {tiny}/>'
                    '</inertial></link><joint name="payload" type="fixed"><child link="payload"/>'
                    f'<parent link="{self.arm.tcp_link}"/><origin xyz="{at}"/></joint></r>'
                )
            )
        return root


def modelled(case: Case) -> Floats:
    """(ticks + 1, n) joint positions of the drives' model, each set point integrated exactly."""
    arm, flange = case.arm, case.arm.flange
    masses = link_masses(arm, case.payload_kg, flange[:3, :3] @ PAYLOAD_AT_M + flange[:3, 3])
    model = DriveModel(torque_limit_nm=arm.effort_limit, masses=masses)
    drives, positions, told = drive(DEFAULTS, len(case.start), model), [case.start], np.empty_like(case.start)
    for k, demand in enumerate(case.told):
        drive_tick(drives, demand, False, 0.0, k * PERIOD_S)
        limit_torques(drives, arm.joint_axes, links_in_base(arm, positions[-1]))
        tell_motors(drives, told)
        positions.append(positions[-1] + told * PERIOD_S)
    return np.array(positions)


class InMuJoCo:
    """A case in MuJoCo, its joints in the arm's order."""

    def __init__(self, case: Case) -> None:
        root = case.urdf
        options = {"balanceinertia": "false", "fusestatic": "true"}
        ElementTree.SubElement(ElementTree.SubElement(root, "mujoco"), "compiler", options)
        for joint in root.iter("joint"):  # no stops, as in the kinematic world; limits of torque are ours
            joint.set("type", "fixed" if joint.get("type") == "fixed" else "continuous")
            for limit in joint.findall("limit"):
                joint.remove(limit)
        self.model = mujoco.MjModel.from_xml_string(ElementTree.tostring(root, encoding="unicode"))
        self.model.opt.timestep = SUBSTEP_S
        self.model.opt.gravity[:] = (0.0, 0.0, -GRAVITY_MPS2)
        self.data = mujoco.MjData(self.model)
        self.at = [self.model.joint(name).qposadr[0] for name in case.arm.joint_names]
        self.data.qpos[self.at] = case.start

    def torques(self, acceleration: Floats) -> Floats:
        """(n,) of MuJoCo's inverse dynamics where the arm is."""
        self.data.qacc[self.at] = acceleration
        mujoco.mj_inverse(self.model, self.data)
        return np.array(self.data.qfrc_inverse[self.at])

    def step(self, torques: Floats) -> None:
        """One sub-step with these torques (n,)."""
        self.data.qfrc_applied[self.at] = torques
        mujoco.mj_step(self.model, self.data)


def in_mujoco(case: Case, *, together: bool) -> Floats:
    """(ticks + 1, n): what cannot be had is taken back from all joints ``together``, or from each alone."""
    one, positions, limit = InMuJoCo(case), [case.start], case.arm.effort_limit
    still, substeps = np.zeros(len(case.start)), round(PERIOD_S / SUBSTEP_S)
    for demand in case.told:
        wanted = (demand - one.data.qvel[one.at]) / PERIOD_S
        if together:
            wanted = torque_share(one.torques(still), one.torques(wanted), limit) * wanted
        for left in range(substeps, 0, -1):
            if not together:
                wanted = (demand - one.data.qvel[one.at]) / (left * SUBSTEP_S)
            torques = one.torques(wanted)
            one.step(torques if together else np.clip(torques, -limit, limit))
        positions.append(np.array(one.data.qpos[one.at]))
    return np.array(positions)


def in_pybullet(case: Case) -> Floats:
    """(ticks + 1, n): velocity motors, as the reference world has them."""
    client, positions = pybullet.connect(pybullet.DIRECT), [case.start]
    try:
        with tempfile.TemporaryDirectory() as folder:
            file = Path(folder) / "arm.urdf"
            file.write_bytes(ElementTree.tostring(case.urdf))
            flags = pybullet.URDF_USE_INERTIA_FROM_FILE
            robot = pybullet.loadURDF(str(file), useFixedBase=True, flags=flags, physicsClientId=client)
        names = {
            pybullet.getJointInfo(robot, i, client)[1].decode(): i
            for i in range(pybullet.getNumJoints(robot, client))
        }
        joints = [names[name] for name in case.arm.joint_names]
        pybullet.setGravity(0.0, 0.0, -GRAVITY_MPS2, client)
        pybullet.setTimeStep(PERIOD_S / DEFAULTS.clock.physics_substeps, client)
        pybullet.setPhysicsEngineParameter(
            numSolverIterations=200, solverResidualThreshold=1e-18, physicsClientId=client
        )
        for i in range(-1, pybullet.getNumJoints(robot, client)):
            pybullet.changeDynamics(
                robot,
                i,
                linearDamping=0.0,
                angularDamping=0.0,
                jointDamping=0.0,
                jointLowerLimit=-1e9,
                jointUpperLimit=1e9,
                physicsClientId=client,
            )
        for i, angle in zip(joints, case.start, strict=True):
            pybullet.resetJointState(robot, i, angle, physicsClientId=client)
        for demand in case.told:
            pybullet.setJointMotorControlArray(
                robot,
                joints,
                pybullet.VELOCITY_CONTROL,
                targetVelocities=demand.tolist(),
                forces=case.arm.effort_limit.tolist(),
                physicsClientId=client,
            )
            for _ in range(DEFAULTS.clock.physics_substeps):
                pybullet.stepSimulation(client)
            states = pybullet.getJointStates(robot, joints, client)
            positions.append(np.array([state[0] for state in states]))
    finally:
        pybullet.disconnect(client)
    return np.array(positions)


RULES: dict[str, Callable[[Case], Floats]] = {
    "MuJoCo, one factor": partial(in_mujoco, together=True),
    "MuJoCo, joint by joint": partial(in_mujoco, together=False),
    "PyBullet's motors": in_pybullet,
}


def tcp_m(arm: ArmModel, positions: Floats) -> Floats:
    """(ticks + 1, 3) of the TCP."""
    return np.array([links_in_base(arm, one)[-1][:3, 3] for one in positions])


def standstill_s(case: Case, positions: Floats) -> float:
    """How long after the demand became 0 the arm still moves by more than 0.001 rad/s."""
    stop = 2 * WAVES * round(HALF_WAVE_S / PERIOD_S)
    moving = np.abs(np.diff(positions[stop:], axis=0)).max(axis=1) > 0.001 * PERIOD_S
    return float((np.flatnonzero(moving)[-1] + 1 if moving.any() else 0) * PERIOD_S)


def main() -> None:
    """Print the table of the page."""
    argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    ).parse_args()
    print(f"mujoco {mujoco.__version__}: TCP difference from the model; time to standstill\n")
    print(f"| arm | payload | wave | model | {' | '.join(RULES)} |")
    print(f"|---|---|---|---|{'---|' * len(RULES)}")
    for (name, (file, base, tcp, start)), kg, speed in product(ARMS.items(), PAYLOADS_KG, SPEEDS_RADPS):
        case = Case(read_arm(file, base=base, tcp=tcp), np.array(start), kg, speed)
        ours, cells = modelled(case), []
        for rule in RULES.values():
            theirs = rule(case)
            apart = np.linalg.norm(tcp_m(case.arm, ours) - tcp_m(case.arm, theirs), axis=1).max()
            cells.append(f"{1e3 * apart:.2f} mm; {standstill_s(case, theirs):.3f} s")
        row = f"| {name} | {kg:g} kg | {speed:g} rad/s"
        print(f"{row} | {standstill_s(case, ours):.3f} s | {' | '.join(cells)} |", flush=True)


if __name__ == "__main__":
    main()
