"""What can be drawn into a view of the paths: the cell, the arm, hands, the TCP, decisions.

Every function draws base x to the right and base ``axis`` (1: y, 2: z) upwards, in millimetres.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from safety_harness.report.svg import HANDS, Floats, Ink, keep_extremes
from safety_harness.report.words import with_minus
from safety_harness.robot.description import load_arm
from safety_harness.robot.kinematics import FRAMES, forward_kinematics
from safety_harness.settings import Cell, Settings
from safety_harness.trace.trace import Trace

if TYPE_CHECKING:
    from matplotlib.axes import Axes

COLUMNS = 400
SMALLEST_CLOSE_UP_MM = 60.0  # half its side; an arm that hardly moves is not blown up further
MOST_NUMBERS = 12  # decisions that are numbered in a view; more would hide the paths
MM = 1e3


@dataclass(frozen=True)
class Moment:
    """The instant at which hands, forearms and the arm are drawn in full."""

    tick: int
    time_s: float
    claim: int | None  # index of the claim whose worst moment it is


def close_up_mm(trace: Trace) -> tuple[Floats, Floats]:
    """The two corners (3,) [mm] of the box that holds all of the TCP's path and every decision."""
    points = np.vstack(
        [
            trace.ticks["transform_tcp_to_base"][:, :3, 3],
            trace.decisions["chosen_position_in_base_m"],
            np.array([trace.scenario.settings.cell.desired_tcp_position_in_base_m]),
        ]
    )
    points = points[np.isfinite(points).all(axis=1)] * MM
    low, high = points.min(axis=0), points.max(axis=0)
    half = np.maximum(0.58 * (high - low), SMALLEST_CLOSE_UP_MM)
    return 0.5 * (low + high) - half, 0.5 * (low + high) + half


def name_table(axes: Axes, cell: Cell) -> None:
    """The height of the table's surface, written below it."""
    axes.annotate(
        with_minus(f"table, z = {cell.table_height_m * MM:.0f}"),
        (1.0, cell.table_height_m * MM),
        xycoords=("axes fraction", "data"),
        xytext=(0, -4),
        textcoords="offset points",
        ha="right",
        va="top",
        color=Ink.MUTED.sentinel,
    )


def draw_close_up_frame(axes: Axes, trace: Trace, axis: int) -> None:
    """What part of the whole view the close-up shows."""
    low, high = close_up_mm(trace)
    axes.plot(*rectangle(low, high, axis), color=Ink.MUTED.sentinel, linewidth=0.8, zorder=3)


def rectangle(low: Floats, high: Floats, axis: int) -> Floats:
    """The closed outline (2, 5) of the box between two corners (3,): base x, and base ``axis``."""
    across = np.array([low[0], high[0], high[0], low[0], low[0]])
    return np.stack([across, np.array([low[axis], low[axis], high[axis], high[axis], low[axis]])])


def _plot(axes: Axes, points_mm: Floats, axis: int, ink: Ink, **style: Any) -> None:
    """Points (..., 3) [mm] as this view shows them."""
    axes.plot(points_mm[..., 0], points_mm[..., axis], color=ink.sentinel, **style)


def draw_cell(axes: Axes, settings: Settings, axis: int) -> None:
    """Object, desired TCP and, from the side, the table's edge."""
    cell, shape = settings.cell, settings.object
    c, s = np.cos(shape.yaw_rad), np.sin(shape.yaw_rad)
    corners = np.zeros((len(shape.polygon_m), 3))
    corners[:, :2] = np.array(shape.polygon_m) @ np.array([[c, s], [-s, c]])
    corners = (corners + shape.position_in_base_m) * MM
    axes.fill(corners[:, 0], corners[:, axis], facecolor=Ink.OBJECT.sentinel, alpha=0.18, zorder=2)
    _plot(axes, np.vstack([corners, corners[:1]]), axis, Ink.OBJECT, linewidth=2.0, zorder=2)
    desired = np.array(cell.desired_tcp_position_in_base_m) * MM
    _plot(axes, desired, axis, Ink.TEXT, marker="+", markersize=15, markeredgewidth=1.6, zorder=6)
    if axis == 2:
        axes.axhline(cell.table_height_m * MM, color=Ink.TEXT.sentinel, linewidth=1.6, zorder=1.5)


def draw_arm(axes: Axes, trace: Trace, moment: Moment, axis: int) -> None:
    """The arm as straight lines between its link frames."""
    arm = load_arm(trace.scenario.robot.arm_name)
    joints = np.ascontiguousarray(trace.ticks["joint_position_rad"][moment.tick])
    if not np.all(np.isfinite(joints)):
        return
    transforms = np.empty((FRAMES, 4, 4))
    forward_kinematics(arm.chain[0], joints, transforms)
    points = transforms[:, :3, 3] * MM  # (8, 3)
    _plot(axes, points, axis, Ink.ARM, linewidth=7, solid_joinstyle="round", zorder=1.2)
    joint = {"markersize": 4, "markerfacecolor": Ink.PAPER.sentinel, "markeredgewidth": 0.8}
    _plot(axes, points, axis, Ink.MUTED, linestyle="none", marker="o", zorder=1.3, **joint)


def draw_forearms(axes: Axes, trace: Trace, moment: Moment, axis: int) -> None:
    """The outline of each forearm's capsule at the moment."""
    size = trace.scenario.settings.hand
    tick = trace.ticks[moment.tick]
    for hand in np.flatnonzero(tick["hand_present"]):
        start, elbow = tick["hand_position_in_base_m"][hand], tick["elbow_position_in_base_m"][hand]
        if not (np.isfinite(start).all() and np.isfinite(elbow).all()) or np.array_equal(start, elbow):
            continue
        length = float(np.linalg.norm(elbow - start))
        end = start + (elbow - start) * min(1.0, size.forearm_length_m / length)
        outline = capsule_outline(start[[0, axis]], end[[0, axis]], size.forearm_radius_m) * MM
        axes.fill(
            outline[:, 0],
            outline[:, 1],
            facecolor=HANDS[hand].sentinel,
            edgecolor="none",
            alpha=0.16,
            zorder=1.6,
        )


def capsule_outline(start: Floats, end: Floats, radius: float) -> Floats:
    """The outline (k, 2) of all points within ``radius`` of the segment; a disc when it has no length."""
    along = end - start
    heading = float(np.arctan2(along[1], along[0]))
    turn = np.linspace(0.5 * np.pi, 1.5 * np.pi, 17) + heading
    back = start + radius * np.column_stack([np.cos(turn), np.sin(turn)])
    front = end + radius * np.column_stack([np.cos(turn + np.pi), np.sin(turn + np.pi)])
    return np.vstack([back, front])


def draw_hands(axes: Axes, trace: Trace, moment: Moment | None, axis: int) -> None:
    """The way of each hand's centre, and its sphere at the moment."""
    from matplotlib.patches import Circle

    radius_mm = trace.scenario.settings.hand.radius_m * MM
    for hand, ink in enumerate(HANDS):
        present = trace.ticks["hand_present"][:, hand]
        if not present.any():
            continue
        path = np.where(present[:, None], trace.ticks["hand_position_in_base_m"][:, hand], np.nan) * MM
        _draw_path(axes, path, axis, ink, dashed=hand == 1)
        _draw_ends(axes, path[np.flatnonzero(present)], axis, ink)
        if moment is not None and present[moment.tick]:
            centre = path[moment.tick]
            if np.all(np.isfinite(centre)):
                edge = {"edgecolor": ink.sentinel, "linewidth": 1.8}
                axes.add_patch(Circle(centre[[0, axis]], radius_mm, facecolor="none", zorder=5, **edge))


def draw_tcp(axes: Axes, trace: Trace, moment: Moment | None, axis: int) -> None:
    """The way of the TCP, and where it is at the moment."""
    path = trace.ticks["transform_tcp_to_base"][:, :3, 3] * MM
    _draw_path(axes, path, axis, Ink.TCP, dashed=False)
    _draw_ends(axes, path, axis, Ink.TCP)
    if moment is not None:
        now = path[moment.tick]
        _plot(axes, now, axis, Ink.TCP, marker="x", markersize=9, markeredgewidth=2, zorder=7)


def _draw_path(axes: Axes, path_mm: Floats, axis: int, ink: Ink, *, dashed: bool) -> None:
    """A path (n, 3), thinned so that the extremes of both coordinates survive."""
    order = np.arange(len(path_mm), dtype=np.float64)
    kept = np.union1d(*(keep_extremes(order, path_mm[:, k], COLUMNS)[0] for k in (0, axis)))
    style = (0, (5, 2)) if dashed else "solid"
    _plot(axes, path_mm[kept.astype(np.int64)], axis, ink, linewidth=1.6, linestyle=style, zorder=4)


def _draw_ends(axes: Axes, path_mm: Floats, axis: int, ink: Ink) -> None:
    """A ring where a path (n, 3) starts, a square where it ends."""
    for point, marker, fill in ((path_mm[0], "o", Ink.PAPER), (path_mm[-1], "s", ink)):
        style = {"markersize": 6.5, "markerfacecolor": fill.sentinel, "markeredgewidth": 1.6}
        _plot(axes, point, axis, ink, marker=marker, zorder=5.5, **style)


def draw_decisions(axes: Axes, trace: Trace, axis: int) -> None:
    """From where the TCP stood at each decision to the repulsive position that was chosen."""
    decisions = trace.decisions
    asked = decisions["tcp_position_in_base_m"] * MM
    chosen = decisions["chosen_position_in_base_m"] * MM
    ways = np.stack([asked, chosen, np.full_like(asked, np.nan)], axis=1).reshape(-1, 3)
    _plot(axes, ways, axis, Ink.CHOSEN, linewidth=1.0, linestyle=(0, (1, 2)), zorder=3)
    for points, marker, ink in ((chosen, "D", Ink.CHOSEN), (asked, "v", Ink.TEXT)):
        style = {"markersize": 7, "markeredgecolor": Ink.PAPER.sentinel, "markeredgewidth": 0.8}
        _plot(axes, points, axis, ink, linestyle="none", marker=marker, zorder=6, **style)
    if len(decisions) > MOST_NUMBERS:
        return
    for number, point in enumerate(asked, start=1):
        if np.all(np.isfinite(point)):
            axes.annotate(
                str(number),
                (float(point[0]), float(point[axis])),
                xytext=(5, 4),
                textcoords="offset points",
                zorder=8,
            )
