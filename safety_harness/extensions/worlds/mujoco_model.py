"""Make MuJoCo's model of the cell: the table, and the arm of a URDF on its seat."""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from functools import lru_cache
from typing import Any

import mujoco
import numpy as np

from safety_harness.base.exceptions import SimulationError
from safety_harness.cell.robot.description import ArmModel, resolved_urdf
from safety_harness.cell.robot.dynamics import GRAVITY_MPS2
from safety_harness.cell.robot.joint_data import Use
from safety_harness.cell.simulation.world import TABLE_CENTRE_M, TABLE_HALF_M

UNUSED = ("gazebo", "transmission")  # elements of a URDF for other programs
# MuJoCo's own element in a URDF; ``balanceinertia`` takes inertias that no body can have, as PyBullet does.
COMPILER = {"fusestatic": "false", "discardvisual": "true", "balanceinertia": "true", "strippath": "false"}
PREFIX = "arm/"  # of names in the URDF
ARM, TABLE = (1, 2), (2, 1)  # contype and conaffinity: the arm touches the table, but not itself
STIFF = (0.99, 0.999, 0.001, 0.5, 2.0)  # MuJoCo's solimp; the first two make contacts stiff
LEAST_STEPS = 2.0  # a contact's time constant in sub-steps, the least that MuJoCo takes


@lru_cache(maxsize=16)
def cell_model(arm: ArmModel, table_height_m: float, step_s: float) -> Any:
    """Return the compiled ``mujoco.MjModel``. Runs share the model, because they do not change it.

    Args:
        arm: The arm on its seat.
        table_height_m: The height of the table's upper face in the base frame.
        step_s: The duration of a sub-step.

    Raises:
        ArmFileError: The arm lacks an effort or an inertia.
        SimulationError: MuJoCo cannot use the arm's URDF.

    """
    arm.require(Use.PHYSICS)
    cell, quaternion = mujoco.MjSpec(), np.empty(4)
    cell.option.timestep, cell.option.gravity = step_s, (0.0, 0.0, -GRAVITY_MPS2)
    table_m = np.add(TABLE_CENTRE_M, (0.0, 0.0, table_height_m))
    cell.worldbody.add_geom(
        name="table", type=mujoco.mjtGeom.mjGEOM_BOX, size=TABLE_HALF_M, pos=table_m.tolist()
    )
    mujoco.mju_mat2Quat(quaternion, arm.transform_seat[:3, :3].flatten())
    try:
        robot = mujoco.MjSpec.from_string(_urdf(arm))
        seat = cell.worldbody.add_frame(pos=arm.transform_seat[:3, 3].tolist(), quat=quaternion.tolist())
        cell.attach(robot, frame=seat, prefix=PREFIX)
        model = cell.compile()
    except ValueError as error:
        raise SimulationError(f"MuJoCo cannot use {arm.file}: {error}") from error
    model.dof_frictionloss[:] = model.dof_damping[:] = 0.0  # the drives' model includes both
    model.geom_contype[:], model.geom_conaffinity[:] = ARM
    table = model.geom("table").id
    model.geom_contype[table], model.geom_conaffinity[table] = TABLE
    model.geom_solref[:], model.geom_solimp[:] = (LEAST_STEPS * step_s, 1.0), STIFF
    return model


def _urdf(arm: ArmModel) -> str:
    """Return the arm's URDF in the form that MuJoCo reads."""
    root = ElementTree.fromstring(resolved_urdf(arm, visuals=False))
    for element in [child for child in root if child.tag in UNUSED]:
        root.remove(element)
    ElementTree.SubElement(ElementTree.SubElement(root, "mujoco"), "compiler", COMPILER)
    return ElementTree.tostring(root, encoding="unicode")
