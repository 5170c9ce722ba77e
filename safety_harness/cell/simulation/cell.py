"""Build the cell in PyBullet, with robot, table, object and hands as bodies, and render its images."""

from __future__ import annotations

import atexit
import os
import tempfile
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from safety_harness.base.elementary import cos, length, sin
from safety_harness.base.geometry.arrays import Array4x4, ArrayN
from safety_harness.base.geometry.rotations import vector_from_rotation
from safety_harness.base.settings import Settings, Vector3
from safety_harness.cell.perception.detector import (
    HAND_COLOUR_RGBA,
    OBJECT_RGB,
    SLEEVE_COLOUR_RGBA,
    TABLE_RGB,
    object_mask,
)
from safety_harness.cell.perception.hand_boxes import rendered_principal_point_px
from safety_harness.cell.perception.moments import MOMENT_COUNT
from safety_harness.cell.perception.raster import mask_moments
from safety_harness.cell.robot.description import ArmModel, resolved_urdf
from safety_harness.cell.robot.dynamics import GRAVITY_MPS2
from safety_harness.cell.robot.joint_data import Use
from safety_harness.cell.simulation.cameras import object_polygon_in_base
from safety_harness.cell.simulation.engine import pybullet, quiet
from safety_harness.cell.simulation.world import TABLE_CENTRE_M, TABLE_HALF_M

# A choice: the visible table lies lower by this, so that the object covers it.
OBJECT_THICKNESS_M = 0.0005
OUT_OF_VIEW_M = (0.0, 0.0, -9.0)  # the position of hands until ``place_hands``
OBJECT_COLOUR_RGBA = (*(value / 255.0 for value in OBJECT_RGB), 1.0)
TABLE_COLOUR_RGBA = (*(value / 255.0 for value in TABLE_RGB), 1.0)


@dataclass(frozen=True)
class Bodies:
    """PyBullet's numbers of the bodies in the cell.

    Hands are bodies only if the world renders images.
    """

    robot: int
    joints: tuple[int, ...]
    hands: tuple[int, ...]
    forearms: tuple[int, ...]


@lru_cache(maxsize=16)
def urdf_file(arm: ArmModel, visuals: bool) -> Path:
    """Return a file with the resolved URDF for PyBullet.

    The function writes the file once, and the file disappears when the process ends.
    """
    handle, path = tempfile.mkstemp(prefix="safety_harness_", suffix=".urdf")
    atexit.register(Path(path).unlink, missing_ok=True)
    with os.fdopen(handle, "w") as file:
        file.write(resolved_urdf(arm, visuals=visuals))
    return Path(path)


def load_robot(client: int, arm: ArmModel, *, visuals: bool) -> tuple[int, tuple[int, ...]]:
    """Load an arm at its seat, and return PyBullet's numbers of the arm and of its joints.

    Args:
        client: PyBullet's client.
        arm: The arm.
        visuals: Whether to load the arm's visual meshes.

    Raises:
        ArmFileError: The arm lacks an effort or an inertia.

    """
    arm.require(Use.PHYSICS)
    tilt = vector_from_rotation(arm.transform_seat[:3, :3])
    with quiet(1):  # a line for each frame without inertia, such as tool0
        robot = pybullet.loadURDF(
            str(urdf_file(arm, visuals)),
            arm.transform_seat[:3, 3],
            _turn_by(tilt),
            useFixedBase=True,
            physicsClientId=client,
        )
    by_name = {
        pybullet.getJointInfo(robot, i, physicsClientId=client)[1].decode(): i
        for i in range(pybullet.getNumJoints(robot, physicsClientId=client))
    }
    return robot, tuple(by_name[name] for name in arm.joint_names)


def build_cell(
    client: int,
    settings: Settings,
    arm: ArmModel,
    joint_position_rad: ArrayN,
    *,
    rendered: bool,
    hands: int = 2,
) -> Bodies:
    """Load the cell into a client of PyBullet, and return the numbers of its bodies.

    Args:
        client: The client.
        settings: The settings.
        arm: The arm.
        joint_position_rad: The arm's joint position (n,).
        rendered: Whether the world renders images. If it does, the cell also has visual meshes, the object
            and the hands.
        hands: The number of hands.

    """
    pybullet.setGravity(0.0, 0.0, -GRAVITY_MPS2, physicsClientId=client)
    pybullet.setTimeStep(
        settings.clock.control_period_s / settings.clock.physics_substeps, physicsClientId=client
    )
    # By default the solver stops early and gravity pulls the joints along at 1e-5 to 1e-4 rad/s,
    # 1 mm and 0.1 degree in a minute: real drives hold.
    pybullet.setPhysicsEngineParameter(
        numSolverIterations=200, solverResidualThreshold=1e-18, physicsClientId=client
    )
    robot, joints = load_robot(client, arm, visuals=rendered)
    pybullet.resetJointStatesMultiDof(
        robot, joints, [[q] for q in joint_position_rad], [[0.0]] * len(joints), physicsClientId=client
    )
    for joint in range(-1, pybullet.getNumJoints(robot, physicsClientId=client)):
        # the model includes the drives, but no friction and no air drag
        pybullet.changeDynamics(
            robot, joint, linearDamping=0.0, angularDamping=0.0, jointDamping=0.0, physicsClientId=client
        )
    _table(client, settings, rendered=rendered)
    spheres: tuple[int, ...] = ()
    forearms: tuple[int, ...] = ()
    if rendered:
        _paint_object(client, settings)
        spheres = tuple(_hand(client, settings) for _ in range(hands))
        forearms = tuple(_forearm(client, settings) for _ in range(hands))
    return Bodies(robot, joints, spheres, forearms)


def _table(client: int, settings: Settings, *, rendered: bool) -> None:
    """Load the table into the client.

    The table is visible if ``rendered`` is True.
    """
    height_m = settings.cell.table_height_m
    collision = pybullet.createCollisionShape(
        pybullet.GEOM_BOX, halfExtents=TABLE_HALF_M, physicsClientId=client
    )
    visual = -1
    if rendered:
        # the visible table lies lower, so that the thin object is above it
        visual = pybullet.createVisualShape(
            pybullet.GEOM_BOX,
            halfExtents=TABLE_HALF_M,
            rgbaColor=TABLE_COLOUR_RGBA,
            visualFramePosition=(0.0, 0.0, -OBJECT_THICKNESS_M),
            physicsClientId=client,
        )
    pybullet.createMultiBody(
        0.0,
        collision,
        visual,
        basePosition=np.add(TABLE_CENTRE_M, (0.0, 0.0, height_m)),
        physicsClientId=client,
    )


def _paint_object(client: int, settings: Settings) -> None:
    """Load the object as a thin painted prism.

    The upper face is in the plane of the object that servoing assumes.
    """
    top = object_polygon_in_base(settings)
    n = len(top)
    if np.cross(top[1] - top[0], top[2] - top[0])[2] < 0.0:
        top = top[::-1]
    vertices = np.concatenate([top, top])
    vertices[n:, 2] -= OBJECT_THICKNESS_M
    faces = [i for k in range(1, n - 1) for i in (0, k, k + 1)]
    normals = [(0.0, 0.0, 1.0)] * len(vertices)
    _painted(
        client,
        OBJECT_COLOUR_RGBA,
        (0.0, 0.0, 0.0),
        vertices=vertices.tolist(),
        indices=faces,
        normals=normals,
    )


def _painted(
    client: int,
    colour: tuple[float, ...],
    at: Vector3 = OUT_OF_VIEW_M,
    kind: int = pybullet.GEOM_MESH,
    **shape: Any,
) -> int:
    """Load a visible body without collisions, and return its number."""
    visual = pybullet.createVisualShape(kind, rgbaColor=colour, physicsClientId=client, **shape)
    return int(pybullet.createMultiBody(0.0, -1, visual, basePosition=at, physicsClientId=client))


def _hand(client: int, settings: Settings) -> int:
    """Load the sphere of a hand, and return its number."""
    vertices, faces = _round_mesh(settings.hand.radius_m)  # PyBullet's own sphere errs by up to 9 px
    return _painted(client, HAND_COLOUR_RGBA, vertices=vertices, indices=faces, normals=vertices)


def _round_mesh(radius_m: float, rings: int = 24) -> tuple[list[list[float]], list[int]]:
    """Return the vertices of a sphere's mesh and the vertex indices of its triangles.

    The mesh has ``rings`` parallels and twice as many meridians.
    """
    around = 2 * rings
    polar = np.pi * np.arange(rings + 1) / rings
    azimuth = 2.0 * np.pi * np.arange(around) / around
    height = np.repeat(cos(polar), around)
    width = np.repeat(sin(polar), around)
    turn = np.tile(azimuth, rings + 1)
    vertices = radius_m * np.stack([width * cos(turn), width * sin(turn), height], axis=1)
    faces: list[int] = []
    for ring in range(rings):
        for k in range(around):
            a, b = ring * around + k, ring * around + (k + 1) % around
            faces += [a, a + around, b, b, a + around, b + around]
    return vertices.tolist(), faces


def _forearm(client: int, settings: Settings) -> int:
    """Load the capsule of a forearm, and return its number."""
    hand, kind = settings.hand, pybullet.GEOM_CAPSULE
    return _painted(
        client, SLEEVE_COLOUR_RGBA, kind=kind, radius=hand.forearm_radius_m, length=hand.forearm_length_m
    )


def place_hands(client: int, bodies: Bodies, hands: NDArray[np.void]) -> None:
    """Move each painted hand to its position, and each forearm between its hand and its elbow.

    ``hands`` (hands,) contains records HAND.
    """
    for hand, sphere, forearm in zip(hands, bodies.hands, bodies.forearms, strict=True):
        if not hand["present"]:
            continue
        position, elbow = hand["position_in_base_m"], hand["elbow_in_base_m"]
        pybullet.resetBasePositionAndOrientation(
            sphere, position, (0.0, 0.0, 0.0, 1.0), physicsClientId=client
        )
        pybullet.resetBasePositionAndOrientation(
            forearm, 0.5 * (position + elbow), _turn_z_to(elbow - position), physicsClientId=client
        )


def _turn_by(vector: NDArray[np.float64]) -> tuple[float, float, float, float]:
    """Return the quaternion (x, y, z, w) of a rotation vector (3,)."""
    half = 0.5 * length(vector)
    x, y, z = 0.5 * np.sinc(half / np.pi) * vector
    return (x, y, z, float(cos(half)))


def _turn_z_to(direction: NDArray[np.float64]) -> tuple[float, float, float, float]:
    """Return the quaternion (x, y, z, w) that turns z into ``direction``."""
    unit = direction / length(direction)
    if unit[2] < -1.0 + 1e-12:
        return (1.0, 0.0, 0.0, 0.0)
    quaternion = np.array([-unit[1], unit[0], 0.0, 1.0 + unit[2]])
    quaternion /= length(quaternion)
    return (quaternion[0], quaternion[1], quaternion[2], quaternion[3])


# A choice: the renderer draws nothing nearer or farther than this.
NEAR_M, FAR_M = 0.02, 5.0


def render(
    client: int, transform_camera_to_base: Array4x4, focal_px: float, width_px: int, height_px: int
) -> tuple[NDArray[np.uint8], NDArray[np.float64]]:
    """Return the colours (h, w, 3) and the depths (h, w) [m] of an image.

    A depth is along the optical axis, and is +inf if the pixel shows no body. OpenGL's camera looks along its
    -z axis with y up. The camera here looks along z with y down.

    Args:
        client: PyBullet's client.
        transform_camera_to_base: The camera's pose (4, 4).
        focal_px: The camera's focal length.
        width_px: The image's width w.
        height_px: The image's height h.

    """
    eye = transform_camera_to_base[:3, 3]
    view = pybullet.computeViewMatrix(
        eye, eye + transform_camera_to_base[:3, 2], -transform_camera_to_base[:3, 1]
    )
    projection = (
        (2.0 * focal_px / width_px, 0.0, 0.0, 0.0)
        + (0.0, 2.0 * focal_px / height_px, 0.0, 0.0)
        + (0.0, 0.0, -(FAR_M + NEAR_M) / (FAR_M - NEAR_M), -1.0)
        + (0.0, 0.0, -2.0 * FAR_M * NEAR_M / (FAR_M - NEAR_M), 0.0)
    )
    _, _, colour, buffer, _ = pybullet.getCameraImage(
        width_px,
        height_px,
        view,
        projection,
        # Shadows double the time of an image.
        shadow=0,
        lightDirection=(0.0, 0.0, 1.0),
        renderer=pybullet.ER_TINY_RENDERER,
        physicsClientId=client,
    )
    buffer = np.asarray(buffer, dtype=np.float64).reshape(height_px, width_px)
    depth_m = FAR_M * NEAR_M / (FAR_M - (FAR_M - NEAR_M) * buffer)
    depth_m[buffer >= 1.0] = np.inf
    pixels = np.asarray(colour, dtype=np.uint8).reshape(height_px, width_px, 4)
    return np.ascontiguousarray(pixels[:, :, :3]), depth_m


def rendered_object(colour: NDArray[np.uint8], focal_px: float) -> tuple[bool, NDArray[np.float64]]:
    """Return whether the object is in view in a rendered image, and the object's moments (31,).

    A threshold selects the pixels of the object. ``colour`` has the shape (height, width, 3).
    """
    moments = np.full(MOMENT_COUNT, np.nan)
    mask = object_mask(colour)
    c_u, c_v = rendered_principal_point_px(colour.shape[1], colour.shape[0])
    pixels = mask_moments(mask, focal_px, c_u, c_v, moments)
    return pixels > 0, moments
