"""Show arms in 3-D on one self-contained page.

Around the meshes, the page draws the capsules with which the package computes distances. The page uses the
viewer and the data format of replays. It moves each joint in turn from one end of its range to the other.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from importlib.util import find_spec
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from safety_harness.base.extras import FITTING
from safety_harness.base.shipped.contents import ShippedKind, shipped_files
from safety_harness.base.whole_file import write_whole
from safety_harness.cell.robot.capsules import CapsuleSet
from safety_harness.cell.robot.description import ArmModel
from safety_harness.cell.robot.robots import arm_capsules, arm_model
from safety_harness.extensions.pages.arm_meshes import packed_meshes
from safety_harness.extensions.pages.packing import as_attribute, packed
from safety_harness.extensions.pages.page_parts import render_page
from safety_harness.extensions.pages.replay import arm_in_scene
from safety_harness.extensions.pages.svg import plain
from safety_harness.scenario.robots import AnyRobot, OwnRobot, Robot, robot_named

TICK_S, LEG_S = 0.05, 2.0  # each joint moves in three legs: to its lower end, to its upper end, and back
IN_TABLE = 120  # characters of a name
ENDLESS_RAD = np.pi  # where a joint without limits turns back


def write_arm_page(path: Path, robots: Sequence[AnyRobot], *, title: str) -> None:
    """Write the page completely or not at all; raise OSError if that fails. The page needs no network."""
    arms = [_section(robot, number) for number, robot in enumerate(robots, start=1)]
    page = render_page(
        "arms.html.j2",
        package="safety_harness.extensions.arms",
        basis="",
        style="evidence.css",
        replays=True,
        title=title,
        arms=arms,
    )
    write_whole(path, page)


def shipped_robots() -> list[AnyRobot]:
    """Return the arms that are built into the package, then the arms whose files are part of the package."""
    files = [file.path for file in shipped_files() if file.kind is ShippedKind.ROBOTS]
    return [*Robot, *(robot_named(str(path)) for path in files)]


def _section(robot: AnyRobot, number: int) -> dict[str, Any]:
    arm, capsules = arm_model(robot), arm_capsules(robot)
    lower, upper = np.rad2deg(arm.position_lower_rad), np.rad2deg(arm.position_upper_rad)
    speeds, efforts = np.rad2deg(arm.velocity_limit_radps), arm.effort_limit
    meshes = _meshes(arm)
    frames = (*arm.link_names, arm.tcp_link)
    return {
        "id": f"arm-{number}",
        "name": plain(arm.name if isinstance(robot, OwnRobot) else robot.label, longest=60),
        "replay": {
            "id": f"arm-{number}-scene",
            "data": as_attribute(_scene(arm, capsules, meshes)),
            "first_s": 0.0,
            "last_s": 3 * LEG_S * len(arm.joint_names),
            "from_s": 0.0,
            "step_s": 0.1,
            "moment_s": "",
            "moment_name": "",
        },
        "meshes": bool(meshes),
        "joints": [
            (plain(name, longest=IN_TABLE), *("unknown" if np.isnan(x) else f"{x:.0f}" for x in row))
            for name, *row in zip(arm.joint_names, lower, upper, speeds, efforts, strict=True)
        ],
        "capsules": [
            (
                plain(name, longest=IN_TABLE),
                plain(frames[link], longest=IN_TABLE),
                f"{1e3 * np.linalg.norm(end - start):.0f}",
                f"{1e3 * radius:.1f}",
            )
            for name, link, start, end, radius in zip(
                capsules.names,
                capsules.link_index,
                capsules.start_in_link,
                capsules.end_in_link,
                capsules.radius_m,
                strict=True,
            )
        ],
    }


def _scene(arm: ArmModel, capsules: CapsuleSet, meshes: dict[str, Any] | None) -> dict[str, Any]:
    """Return the data of a replay without hands, in which one joint of the arm moves at a time."""
    joints, moving = _joint_ways(arm)
    ends = [
        f"{plain(name)}, {np.rad2deg(low):.0f} to {np.rad2deg(high):.0f} deg"
        for name, low, high in zip(arm.joint_names, *_ends(arm), strict=True)
    ]
    return {
        **arm_in_scene(arm, capsules),
        "name": plain(arm.name, longest=60),
        "meshes": meshes,
        "hands": [],
        "table_height_m": float(arm.transform_seat[2, 3]),
        "modes": dict(enumerate(ends)),
        "shows": ["capsules"],
        **packed({"time_s": TICK_S * np.arange(len(joints)), "joint_position_rad": joints, "mode": moving}),
    }


def _ends(arm: ArmModel) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the lower and the upper joint angles (n,) [rad] between which the page moves the arm."""
    low, high = arm.position_lower_rad, arm.position_upper_rad
    return np.where(np.isinf(low), -ENDLESS_RAD, low), np.where(np.isinf(high), ENDLESS_RAD, high)


def _joint_ways(arm: ArmModel) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Return the joint positions and the index of the moving joint, shapes (ticks, n) and (ticks,)."""
    low, high = _ends(arm)
    rest = np.clip(0.0, low, high)
    path, moving = [rest[None]], [0]
    steps = round(LEG_S / TICK_S)
    for k in range(len(rest)):
        for start, end in pairwise((rest[k], low[k], high[k], rest[k])):
            leg = np.repeat(rest[None], steps, axis=0)
            leg[:, k] = np.linspace(start, end, steps + 1)[1:]
            path.append(leg)
            moving += [k] * steps
    return np.vstack(path), np.array(moving)


def _meshes(arm: ArmModel) -> dict[str, Any] | None:
    """Return each link's mesh.

    The collision shapes form the mesh, or the visual shapes if the link has no collision shapes. A link whose
    files are missing is omitted. The result is None if no link has a mesh, or if the extra "fitting" is not
    installed.
    """
    if find_spec(FITTING.modules[0]) is None:
        return None
    from safety_harness.extensions.arms.fit_capsules import LONGEST_M, link_surface

    meshes = {}
    for link in arm.links:
        shapes = link.collision or link.visual
        if not shapes or any(shape.kind == "mesh" and shape.file is None for shape in shapes):
            continue
        surface = link_surface(replace(link, collision=shapes, visual=()), LONGEST_M)
        corners = surface.vertices
        if link.index == 0:
            corners = corners @ arm.transform_seat[:3, :3].T + arm.transform_seat[:3, 3]
        meshes[link.index] = corners, surface.faces
    return packed_meshes(meshes)
