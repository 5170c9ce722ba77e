"""Draw the paths of one run from above (x-y) and from the side (x-z), in full and as a close-up at the TCP.

All drawings are in millimetres. In every drawing, the x axis of the base frame points right. Either the y
axis (``axis`` 1) or the z axis (``axis`` 2) points up.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from markupsafe import Markup

from safety_harness.base.geometry.arrays import Array3
from safety_harness.base.settings import Cell, Settings
from safety_harness.cell.robot.kinematics import links_in_base
from safety_harness.cell.robot.robots import arm_model
from safety_harness.cell.simulation.cameras import object_polygon_in_base
from safety_harness.extensions.pages.axes import Axes, Picture, Share
from safety_harness.extensions.pages.svg import HANDS, Floats, Ink, keep_extremes
from safety_harness.report.evidence import JudgedRun
from safety_harness.report.words import with_minus
from safety_harness.scenario.obstacles import Obstacle
from safety_harness.trace.trace import Trace
from safety_harness.trace.unmeasured import decided

WIDTH_PX, HEIGHT_PX = 430.0, 390.0
MARGINS_PX = (46.0, 12.0, 40.0, 26.0)  # left, right, below, above
COLUMNS = 400
SMALLEST_CLOSE_UP_MM = 60.0  # half a side; an arm that hardly moves is not enlarged further
MOST_NUMBERS = 12  # numbered decisions in a view; more numbers would hide the paths
MM = 1e3


@dataclass(frozen=True)
class Moment:
    """The time at which the views show the hands, the forearms and the arm."""

    tick: int
    time_s: float
    claim: int | None  # index of the claim that has its worst moment now; None for the nearest hand


def shown_moment(run: JudgedRun) -> Moment | None:
    """Return the moment that all pictures and replays of a run show.

    This moment is the worst moment of the claim ``run.shown_claim()``. If there is no such claim, the moment
    is the time when a hand was nearest. The result is None if, in addition, no hand was present.
    """
    ticks = run.trace.ticks
    if len(ticks) == 0:
        return None
    claim = run.shown_claim()
    if claim is not None:
        worst_s = run.evaluations[claim].worst_time_s
        assert worst_s is not None  # shown_claim() only names claims with a moment
        return Moment(int(np.argmin(np.abs(run.trace.time_s - worst_s))), worst_s, claim)
    distance = np.where(ticks["hand_present"], ticks["hand_distance_m"], np.inf)
    distance = np.where(np.isnan(distance), np.inf, distance)
    if not np.isfinite(distance).any():
        return None
    tick = int(np.argmin(distance.min(axis=1)))
    return Moment(tick, float(run.trace.time_s[tick]), None)


def path_views(run: JudgedRun, *, prefix: str) -> tuple[Markup, ...]:
    """Return four SVG drawings of the paths: from above and from the side, each in full and as a close-up.

    Args:
        run: A run with at least one tick.
        prefix: The text with which every id starts.

    """
    moment = shown_moment(run)
    return tuple(
        Markup(_view(run, moment, axis, close_up=close_up, prefix=prefix))
        for close_up in (False, True)
        for axis in (1, 2)
    )


def widest_view(trace: Trace) -> int:
    """Return the index of the view that shows the hands' motion best: 0 from above, 1 from the side."""
    there = trace.ticks["hand_present"]
    hands_m = trace.ticks["hand_position_in_base_m"][there]
    y_m, z_m = np.ptp(hands_m, axis=0)[1:] if len(hands_m) else (0.0, 0.0)
    return 0 if y_m > z_m else 1


def _view(run: JudgedRun, moment: Moment | None, axis: int, *, close_up: bool, prefix: str) -> str:
    """Return one view in millimetres.

    The x axis of the base frame points right. Either the y axis (``axis`` 1) or the z axis (``axis`` 2)
    points up.
    """
    trace = run.trace
    picture = Picture(WIDTH_PX, HEIGHT_PX)
    left, right, below, above = MARGINS_PX
    axes = picture.axes(left, above, WIDTH_PX - left - right, HEIGHT_PX - below - above)
    axes.x.grid = axes.y.grid = True
    axes.x.steps = axes.y.steps = 6
    axes.x.margin = axes.y.margin = 0.06
    if moment is not None and not close_up:
        draw_arm(axes, trace, moment, axis)
    if moment is not None:
        draw_forearms(axes, trace, moment, axis)
    draw_cell(axes, trace.scenario.settings, axis)
    draw_obstacles(axes, trace.scenario.obstacles, axis)
    if not close_up:
        draw_close_up_frame(axes, trace, axis)
    draw_hands(axes, trace, moment, axis)
    draw_tcp(axes, trace, moment, axis)
    if close_up:
        draw_decisions(axes, trace, axis)
        low, high = close_up_mm(trace)
        axes.fit(low[[0, axis]], high[[0, axis]])
    else:
        if axis == 2:
            name_table(axes, trace.scenario.settings.cell)
        low, high = np.transpose([axes.x.view(), axes.y.view()])
        axes.fit(low, high)
    seen = ("from above" if axis == 1 else "from the side") + (", close to the TCP" if close_up else "")
    axes.title(("y left" if axis == 1 else "z up") + ", mm", bold=False, ink=Ink.MUTED)
    axes.title(seen.capitalize().replace("tcp", "TCP"), anchor="end")
    axes.x.label = "x forward, mm"
    name = f"{'top' if axis == 1 else 'side'}-{'close-' if close_up else ''}"
    return picture.svg(
        prefix=prefix + name,
        title=f"{trace.scenario.name}: paths seen {seen}",
        description=_description(run, moment, axis),
    )


def _description(run: JudgedRun, moment: Moment | None, axis: int) -> str:
    start = run.trace.ticks["transform_tcp_to_base"][0, :3, 3] * MM
    end = run.trace.ticks["transform_tcp_to_base"][-1, :3, 3] * MM
    text = (
        f"Base frame, millimetres. The TCP goes from x {start[0]:.0f}, {'xyz'[axis]} {start[axis]:.0f} "
        f"to x {end[0]:.0f}, {'xyz'[axis]} {end[axis]:.0f} with {len(run.trace.decisions)} decisions."
    )
    if not (np.isfinite([start, end]).all() and decided(run.trace)):
        text = "Base frame, millimetres. Some values were not measured."
    return text + (f" Hands are drawn in full at {moment.time_s:.2f} s." if moment else "")


def close_up_mm(trace: Trace) -> tuple[Floats, Floats]:
    """Return two corners (3,) [mm] of a box that contains the TCP's path and all decisions."""
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
    """Write the height of the table's surface below its line."""
    height_mm = cell.table_height_m * MM
    label = with_minus(f"table, z = {height_mm:.0f}")
    axes.text(label, Share(1.0), height_mm, shift=(0.0, 14.0), anchor="end", ink=Ink.MUTED)


def draw_close_up_frame(axes: Axes, trace: Trace, axis: int) -> None:
    """Draw a frame in the full view, which shows the area of the close-up."""
    x, y = rectangle(*close_up_mm(trace), axis)
    axes.line(x, y, Ink.MUTED, width=0.8)


def rectangle(low: Array3, high: Array3, axis: int) -> Floats:
    """Return the closed outline (2, 5) of the box between two corners (3,).

    The coordinates of the outline are x and, according to ``axis``, y (1) or z (2) in the base frame.
    """
    across = np.array([low[0], high[0], high[0], low[0], low[0]])
    return np.stack([across, np.array([low[axis], low[axis], high[axis], high[axis], low[axis]])])


def draw_cell(axes: Axes, settings: Settings, axis: int) -> None:
    """Draw the object, the desired TCP position and, from the side, the table's edge."""
    cell, corners = settings.cell, object_polygon_in_base(settings) * MM
    if axis == 2:
        axes.hline(cell.table_height_m * MM, Ink.TEXT, width=1.6)
    axes.area(corners[:, 0], corners[:, axis], Ink.OBJECT, opacity=0.18)
    axes.area(corners[:, 0], corners[:, axis], None, edge=Ink.OBJECT, width=2.0)
    desired = np.array(cell.desired_tcp_position_in_base_m) * MM
    axes.marks(desired[[0]], desired[[axis]], "+", 15, edge=Ink.TEXT, width=1.6)


def draw_obstacles(axes: Axes, obstacles: Sequence[Obstacle], axis: int) -> None:
    """Draw the boxes that stand in the cell."""
    for box in obstacles:
        corners = box.corners_in_base_m * MM
        outline = (
            corners[:4, :2].T if axis == 1 else rectangle(corners.min(axis=0), corners.max(axis=0), axis)
        )
        axes.area(outline[0], outline[1], Ink.MUTED, opacity=0.18)
        axes.area(outline[0], outline[1], None, edge=Ink.MUTED, width=1.6)


def draw_arm(axes: Axes, trace: Trace, moment: Moment, axis: int) -> None:
    """Draw the arm as straight lines between its link frames."""
    arm = arm_model(trace.scenario.robot)
    joints = np.ascontiguousarray(trace.ticks["joint_position_rad"][moment.tick])
    if not np.all(np.isfinite(joints)):
        return
    points = links_in_base(arm, joints)[:, :3, 3] * MM  # (n + 2, 3)
    axes.line(points[:, 0], points[:, axis], Ink.ARM, width=7)
    axes.marks(points[:, 0], points[:, axis], "o", 4, fill=Ink.PAPER, edge=Ink.MUTED)


def draw_forearms(axes: Axes, trace: Trace, moment: Moment, axis: int) -> None:
    """Draw the outline of each forearm's capsule at the drawn moment."""
    size = trace.scenario.settings.hand
    tick = trace.ticks[moment.tick]
    for hand in np.flatnonzero(tick["hand_present"]):
        start, elbow = tick["hand_position_in_base_m"][hand], tick["elbow_position_in_base_m"][hand]
        if not (np.isfinite(start).all() and np.isfinite(elbow).all()) or np.array_equal(start, elbow):
            continue
        length = float(np.linalg.norm(elbow - start))
        end = start + (elbow - start) * min(1.0, size.forearm_length_m / length)
        outline = capsule_outline(start[[0, axis]], end[[0, axis]], size.forearm_radius_m) * MM
        axes.area(outline[:, 0], outline[:, 1], HANDS[hand], opacity=0.16)


def capsule_outline(start: Array3, end: Array3, radius: float) -> Floats:
    """Return the outline (k, 2) of the area within ``radius`` of a segment.

    For a segment of zero length, the outline is a circle.
    """
    along = end - start
    heading = float(np.arctan2(along[1], along[0]))
    turn = np.linspace(0.5 * np.pi, 1.5 * np.pi, 33) + heading
    back = start + radius * np.column_stack([np.cos(turn), np.sin(turn)])
    front = end + radius * np.column_stack([np.cos(turn + np.pi), np.sin(turn + np.pi)])
    return np.vstack([back, front])


def draw_hands(axes: Axes, trace: Trace, moment: Moment | None, axis: int) -> None:
    """Draw the path of each hand's centre, and the hand's sphere at ``moment``."""
    radius_mm = trace.scenario.settings.hand.radius_m * MM
    for hand, ink in enumerate(HANDS[: trace.scenario.hand_slots]):
        present = trace.ticks["hand_present"][:, hand]
        if not present.any():
            continue
        path = np.where(present[:, None], trace.ticks["hand_position_in_base_m"][:, hand], np.nan) * MM
        _draw_path(axes, path, axis, ink, dashed=hand % 2 == 1)
        _draw_ends(axes, path[np.flatnonzero(present)], axis, ink)
        if moment is not None and present[moment.tick]:
            centre = path[moment.tick]
            if np.all(np.isfinite(centre)):
                outline = capsule_outline(centre[[0, axis]], centre[[0, axis]], radius_mm)
                axes.area(outline[:, 0], outline[:, 1], None, edge=ink)


def draw_tcp(axes: Axes, trace: Trace, moment: Moment | None, axis: int) -> None:
    """Draw the path of the TCP, and its position at ``moment``."""
    path = trace.ticks["transform_tcp_to_base"][:, :3, 3] * MM
    _draw_path(axes, path, axis, Ink.TCP, dashed=False)
    _draw_ends(axes, path, axis, Ink.TCP)
    if moment is not None:
        now = path[moment.tick]
        axes.marks(now[[0]], now[[axis]], "x", 9, edge=Ink.TCP, width=2)


def _draw_path(axes: Axes, path_mm: Floats, axis: int, ink: Ink, *, dashed: bool) -> None:
    """Draw a path (n, 3) with fewer points, but keep the extreme points of both coordinates."""
    order = np.arange(len(path_mm), dtype=np.float64)
    kept = np.union1d(*(keep_extremes(order, path_mm[:, k], COLUMNS)[0] for k in (0, axis)))
    points = path_mm[kept.astype(np.int64)]
    axes.line(points[:, 0], points[:, axis], ink, width=1.6, dashes=(5, 2) if dashed else ())


def _draw_ends(axes: Axes, path_mm: Floats, axis: int, ink: Ink) -> None:
    """Draw a ring at the start of a path (n, 3) and a square at its end."""
    for point, shape, fill in ((path_mm[0], "o", Ink.PAPER), (path_mm[-1], "s", ink)):
        axes.marks(point[[0]], point[[axis]], shape, 6.5, fill=fill, edge=ink, width=1.6)


def draw_decisions(axes: Axes, trace: Trace, axis: int) -> None:
    """For each decision, draw a line from the TCP to the repulsive position that the decision chose."""
    decisions = trace.decisions
    starts = decisions["tcp_position_in_base_m"] * MM
    chosen = decisions["chosen_position_in_base_m"] * MM
    lines = np.stack([starts, chosen, np.full_like(starts, np.nan)], axis=1).reshape(-1, 3)
    axes.line(lines[:, 0], lines[:, axis], Ink.CHOSEN, width=1.0, dashes=(1, 2))
    for points, shape, ink in ((chosen, "D", Ink.CHOSEN), (starts, "v", Ink.TEXT)):
        axes.marks(points[:, 0], points[:, axis], shape, 7, fill=ink, edge=Ink.PAPER)
    if len(decisions) > MOST_NUMBERS:
        return
    for number, point in enumerate(starts, start=1):
        if np.all(np.isfinite(point)):
            axes.text(str(number), point[0], point[axis], shift=(5.0, -4.0))
