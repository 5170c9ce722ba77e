"""A picture of what a scenario, or many draws of a space, would try: above, side and camera views."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from safety_harness.admission.preview import Preview
from safety_harness.report.path_views import MM, rectangle
from safety_harness.report.svg import Floats, plain
from safety_harness.whole_file import replacing

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Boxes = Sequence[tuple[str, Floats, Floats]]  # name, low (3,), high (3,) in the base frame [m]

# Okabe and Ito's colours, safe for colour-blind readers.
TCP, OBJECT, REGION = "#0072b2", "#009e73", "#cc79a7"
HANDS = ("#d55e00", "#e69f00", "#5b7f00", "#3f51b5", "#8a4b2a", "#c2185b", "#00838f", "#455a64")
ARM, TEXT = "#bbbbbb", "#333333"


def draw_scene(path: Path, previews: Sequence[Preview], *, title: str, regions: Boxes = ()) -> None:
    """Write the picture to ``path`` (.png, .svg or .pdf); needs at least one preview.  Raises OSError."""
    from matplotlib.figure import Figure  # slow to import

    figure = Figure(figsize=(13.0, 9.0), dpi=110, layout="constrained")
    above, camera, side, words = figure.subplots(2, 2, width_ratios=(3, 2)).ravel()
    for axes, axis in ((above, 1), (side, 2)):
        _draw_side(axes, previews, axis, regions)
    _draw_image(camera, previews)
    _write_legend(words, previews, regions)
    figure.suptitle(plain(title, longest=100), x=0.01, ha="left", fontsize=15, fontweight="bold")
    with replacing(path) as unfinished:
        figure.savefig(unfinished, format=path.suffix.removeprefix(".") or None)


def _draw_side(axes: Axes, previews: Sequence[Preview], axis: int, regions: Boxes) -> None:
    """Base x to the right, base ``axis`` (1: y, 2: z) upwards, in millimetres."""
    first = previews[0]
    faint = 1.0 if len(previews) == 1 else max(0.06, min(0.5, 8.0 / len(previews)))
    cell = first.scenario.settings.cell
    arm = first.links_in_base_m * MM
    axes.plot(arm[:, 0], arm[:, axis], color=ARM, linewidth=6, solid_joinstyle="round", zorder=1)
    shape = first.object_in_base_m * MM
    axes.fill(shape[:, 0], shape[:, axis], facecolor=OBJECT, edgecolor=OBJECT, alpha=0.4, linewidth=2.0)
    for name, low, high in regions:
        _draw_box(axes, name, low * MM, high * MM, axis)
    for preview in previews:
        for colour, path_m in zip(HANDS, preview.hand_paths_in_base_m, strict=False):
            path = path_m * MM
            axes.plot(path[:, 0], path[:, axis], color=colour, linewidth=1.5, alpha=faint, zorder=3)
            axes.plot(path[0, 0], path[0, axis], "o", color=colour, markersize=4, alpha=faint, zorder=4)
        tcp = preview.tcp_in_base_m * MM
        axes.plot(tcp[0], tcp[axis], "o", color=TCP, markersize=5, alpha=max(faint, 0.3), zorder=5)
    if len(previews) == 1:
        _draw_last_hands(axes, first, axis)
    desired = np.array(cell.desired_tcp_position_in_base_m) * MM
    axes.plot(desired[0], desired[axis], "+", color=TEXT, markersize=14, markeredgewidth=1.6, zorder=6)
    if axis == 2:
        axes.axhline(cell.table_height_m * MM, color=TEXT, linewidth=1.5)
    axes.set_aspect("equal", adjustable="datalim")
    axes.grid(color="#e5e5e5", linewidth=0.8)
    axes.set_axisbelow(True)
    axes.set_xlabel("x forward, mm")
    axes.set_ylabel("y left, mm" if axis == 1 else "z up, mm")
    axes.set_title("From above" if axis == 1 else "From the side", loc="left", fontsize=11)


def _draw_box(axes: Axes, name: str, low: Floats, high: Floats, axis: int) -> None:
    axes.plot(*rectangle(low, high, axis), color=REGION, linewidth=1.2, linestyle="--", zorder=2)
    axes.annotate(plain(name), (low[0], high[axis]), color=REGION, fontsize=8, va="bottom")


def _draw_last_hands(axes: Axes, preview: Preview, axis: int) -> None:
    """The hands at their true size where they come nearest to the TCP."""
    from matplotlib.patches import Circle

    radius = preview.scenario.settings.hand.radius_m * MM
    for colour, path in zip(HANDS, preview.hand_paths_in_base_m, strict=False):
        nearest = path[int(np.argmin(np.linalg.norm(path - preview.tcp_in_base_m, axis=1)))] * MM
        axes.add_patch(Circle((nearest[0], nearest[axis]), radius, facecolor=colour, alpha=0.25, zorder=3))


def _draw_image(axes: Axes, previews: Sequence[Preview]) -> None:
    """What the camera sees of the object at each start, and should see at the desired pose."""
    camera = previews[0].scenario.settings.camera
    faint = 1.0 if len(previews) == 1 else max(0.06, min(0.5, 8.0 / len(previews)))
    for preview in previews:
        axes.fill(*preview.start_image_px.T, facecolor="none", edgecolor=TCP, linewidth=1.5, alpha=faint)
    axes.fill(
        *previews[0].desired_image_px.T, facecolor="none", edgecolor=TEXT, linestyle="--", linewidth=1.5
    )
    axes.set_xlim(0, camera.width_px)
    axes.set_ylim(camera.height_px, 0)
    axes.set_aspect("equal")
    axes.set_xlabel("u, px")
    axes.set_ylabel("v, px")
    axes.set_title(
        "In the servoing camera: object at the start, and desired (dashed)", loc="left", fontsize=11
    )


def _write_legend(axes: Axes, previews: Sequence[Preview], regions: Boxes) -> None:
    """What the marks mean, and the hands by name."""
    from matplotlib.lines import Line2D

    axes.axis("off")
    many = len(previews) > 1
    handles = [
        Line2D([], [], marker="o", linestyle="", color=TCP, label="TCP start" + ("s" if many else "")),
        Line2D([], [], marker="+", linestyle="", color=TEXT, markersize=12, label="desired TCP"),
        Line2D([], [], color=OBJECT, linewidth=4, alpha=0.5, label="object"),
        Line2D([], [], color=ARM, linewidth=6, label="arm at the " + ("first start" if many else "start")),
    ]
    for colour, hand in zip(HANDS, previews[0].scenario.hands, strict=False):
        handles.append(Line2D([], [], color=colour, marker="o", label=plain(hand.name)))
    if regions:
        handles.append(Line2D([], [], color=REGION, linestyle="--", label="region"))
    axes.legend(handles=handles, loc="upper left", frameon=False, fontsize=11)
    note = "Hands that head for the TCP are drawn as if it stayed where it starts."
    count = f"{len(previews)} draws.\n" if many else ""
    axes.text(0.02, 0.08, count + note, transform=axes.transAxes, fontsize=10, color=TEXT, wrap=True)
