"""Arms in 3-D on one self-contained page: the capsules that distances are measured to, about the meshes.

The viewer is that of the replays, and so is what it is told: each joint in turn goes from end to end.
"""

from __future__ import annotations

import base64
import json
from collections.abc import Sequence
from dataclasses import replace
from importlib.util import find_spec
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from markupsafe import Markup
from numpy.typing import NDArray

from safety_harness.extras import FITTING
from safety_harness.report.page_parts import render_page
from safety_harness.report.svg import plain
from safety_harness.robot.capsules import CapsuleSet
from safety_harness.robot.description import ArmModel
from safety_harness.robot.kinematics import links_in_base
from safety_harness.robot.robots import arm_capsules, arm_model
from safety_harness.scenario.robots import AnyRobot, Robot, robot_named
from safety_harness.shipped.contents import ShippedKind, shipped_files
from safety_harness.whole_file import write_whole

LITTLE_ENDIAN = "<f4"
TICK_S, LEG_S = 0.05, 2.0  # a joint's way has three legs: to its lower end, to the upper one, back
IN_TABLE = 120  # characters of a name
ENDLESS_RAD = np.pi  # where a joint without ends turns round


def write_arm_page(path: Path, robots: Sequence[AnyRobot], *, title: str) -> None:
    """Write the page whole or not at all; it asks nothing of the network.  OSError."""
    arms = [_section(robot, number) for number, robot in enumerate(robots, start=1)]
    scripts = ("three.js", "replay.js")
    write_whole(
        path, render_page("arms.html.j2", style="evidence.css", scripts=scripts, title=title, arms=arms)
    )


def shipped_robots() -> list[AnyRobot]:
    """The arms of the package, and the files of others that come with it."""
    files = [one.path for one in shipped_files() if one.kind is ShippedKind.ROBOTS]
    return [*Robot, *(robot_named(str(path)) for path in files)]


def arm_in_scene(arm: ArmModel, capsules: CapsuleSet) -> dict[str, Any]:
    """Frames and capsules as the viewer takes them."""
    return {
        "joint_origins": [rounded(origin, 9) for origin in arm.joint_origins],
        "joint_axes": arm.joint_axes.tolist(),
        "flange": rounded(arm.flange, 9),
        "capsules": [
            {"link": int(link), "start": rounded(start), "end": rounded(end), "radius_m": float(radius)}
            for link, start, end, radius in zip(
                capsules.link_index,
                capsules.start_in_link,
                capsules.end_in_link,
                capsules.radius_m,
                strict=True,
            )
        ],
    }


def in_script(found: dict[str, Any]) -> str:
    """JSON that is safe within a ``script`` element."""
    return json.dumps(found, separators=(",", ":"), allow_nan=False).replace("<", "\\u003c")


def column(values: NDArray[Any]) -> str:
    """32-bit floats in base64."""
    return base64.b64encode(np.ascontiguousarray(values, LITTLE_ENDIAN).tobytes()).decode()


def rounded(values: NDArray[np.float64], digits: int = 5) -> list[float]:
    """The numbers of an array of any shape, for people's eyes only.  ``values`` (...)."""
    return [round(float(value), digits) for value in values.ravel()]


def _section(robot: AnyRobot, number: int) -> dict[str, Any]:
    arm, capsules = arm_model(robot), arm_capsules(robot)
    lower, upper = np.rad2deg(arm.position_lower_rad), np.rad2deg(arm.position_upper_rad)
    speeds, efforts = np.rad2deg(arm.velocity_limit_radps), arm.effort_limit
    meshes = _meshes(arm)
    frames = (*arm.link_names, arm.tcp_link)
    return {
        "id": f"arm-{number}",
        "name": plain(robot.label if isinstance(robot, Robot) else arm.name, longest=60),
        "scene": Markup(in_script(_scene(arm, capsules, meshes))),
        "last_s": 3 * LEG_S * len(arm.joint_names),
        "meshes": bool(meshes),
        "joints": [
            (plain(name, longest=IN_TABLE), *(f"{x:.0f}" for x in row))
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


def _scene(arm: ArmModel, capsules: CapsuleSet, meshes: list[dict[str, Any]]) -> dict[str, Any]:
    """The arm alone, as a run without a hand in which the joints turn one after another."""
    joints, moving = _joint_ways(arm)
    tcps = np.array([links_in_base(arm, one)[-1, :3, 3] for one in joints])
    ends = [
        f"{plain(name)}, {np.rad2deg(low):.0f} to {np.rad2deg(high):.0f} deg"
        for name, low, high in zip(arm.joint_names, *_ends(arm), strict=True)
    ]
    foot = arm.transform_seat[:3, 3]
    found: dict[str, Any] = {
        **arm_in_scene(arm, capsules),
        "meshes": meshes,
        "hands": [],
        "hand_radius_m": 0.0,
        "critical_distance_m": 0.0,
        "table_height_m": float(foot[2]),
        "desired_tcp_in_base_m": rounded(tcps.min(axis=0) / 2 + tcps.max(axis=0) / 2),
        "size_m": 0.9 * float(np.abs(tcps - foot).max()),
        "object_in_base_m": [],
        "boxes_in_base_m": [],
        "tracks": 0,
        "modes": dict(enumerate(ends)),
        "decisions": [],
        "columns": {
            "time_s": column(TICK_S * np.arange(len(joints))),
            "joint_position_rad": column(joints),
            "tcp_in_base_m": column(tcps),
            "hand_in_base_m": "",
            "elbow_in_base_m": "",
            "hand_distance_m": "",
            "nearest_capsule": "",
            "predicted_in_base_m": "",
            "mode": column(moving),
        },
    }
    return found


def _ends(arm: ArmModel) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """(n,) each: between which angles each joint is shown."""
    low, high = arm.position_lower_rad, arm.position_upper_rad
    return np.where(np.isinf(low), -ENDLESS_RAD, low), np.where(np.isinf(high), ENDLESS_RAD, high)


def _joint_ways(arm: ArmModel) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """(ticks, n) joint positions, and (ticks,) which joint moves, from end to end, alone."""
    low, high = _ends(arm)
    rest = np.clip(0.0, low, high)
    way, moving = [rest[None]], [0]
    steps = round(LEG_S / TICK_S)
    for k in range(len(rest)):
        for start, end in pairwise((rest[k], low[k], high[k], rest[k])):
            leg = np.repeat(rest[None], steps, axis=0)
            leg[:, k] = np.linspace(start, end, steps + 1)[1:]
            way.append(leg)
            moving += [k] * steps
    return np.vstack(way), np.array(moving)


def _meshes(arm: ArmModel) -> list[dict[str, Any]]:
    """Triangles by link, of its collision shapes if it has any; none without the extra or the files."""
    if find_spec(FITTING.modules[0]) is None:
        return []
    from safety_harness.robot.fit_capsules import LONGEST_M, link_surface

    found = []
    for link in arm.links:
        shapes = link.collision or link.visual
        if not shapes or any(shape.kind == "mesh" and shape.file is None for shape in shapes):
            continue
        surface = link_surface(replace(link, collision=shapes, visual=()), LONGEST_M)
        corners = surface.vertices
        if link.index == 0:
            corners = corners @ arm.transform_seat[:3, :3].T + arm.transform_seat[:3, 3]
        found.append({"link": link.index, "corners": column(corners), "triangles": column(surface.faces)})
    return found
