"""Draw one scenario, or many samples of a space, from above, from the side and in the camera's image."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from safety_harness.admission.preview import Preview
from safety_harness.base.whole_file import write_whole
from safety_harness.extensions.pages.axes import Axes, Picture, Share
from safety_harness.extensions.pages.page_parts import asset
from safety_harness.extensions.pages.path_views import (
    MM,
    capsule_outline,
    draw_cell,
    draw_obstacles,
    rectangle,
)
from safety_harness.extensions.pages.svg import HANDS, Floats, Ink, plain, standalone

Boxes = Sequence[tuple[str, Floats, Floats]]  # name, low (3,), high (3,) in the base frame [m]

WIDTH_PX, HEIGHT_PX = 1120.0, 860.0
LEFT_PX, SECOND_PX, TOP_PX, LOWER_PX = 72.0, 690.0, 62.0, 472.0
SIDE_PX, RIGHT_PX, PANEL_PX, KEY_PX = 540.0, 400.0, 330.0, 170.0


def draw_scene(path: Path, previews: Sequence[Preview], *, title: str, regions: Boxes = ()) -> None:
    """Write the picture as SVG.

    Args:
        path: The file to write.
        previews: The previews to draw, at least one.
        title: The title above the views.
        regions: Boxes to outline in the views.

    Raises:
        OSError: The file cannot be written.

    """
    picture = Picture(WIDTH_PX, HEIGHT_PX)
    for top, axis in ((TOP_PX, 1), (LOWER_PX, 2)):
        axes = picture.axes(LEFT_PX, top, SIDE_PX, PANEL_PX)
        _draw_side(axes, previews, axis, regions)
        if axis == 1:
            axes.title(plain(title, longest=100), lift=34.0)
    camera = previews[0].scenario.settings.camera
    height_px = min(PANEL_PX, RIGHT_PX * camera.height_px / camera.width_px)
    _draw_image(picture.axes(SECOND_PX, TOP_PX, RIGHT_PX, height_px), previews)
    _write_key(picture.axes(SECOND_PX, LOWER_PX, RIGHT_PX, KEY_PX), previews, regions)
    names = ", ".join(dict.fromkeys(preview.scenario.name for preview in previews[:3]))
    drawn = picture.svg(prefix="scene-", title=title, description=f"{len(previews)} drawn, such as {names}")
    write_whole(path, standalone(drawn, style=asset("report.css")))


def _draw_side(axes: Axes, previews: Sequence[Preview], axis: int, regions: Boxes) -> None:
    """Draw one view in millimetres.

    Base x points right, and base ``axis`` (1: y, 2: z) points up.
    """
    first = previews[0]
    faint = _opacity(previews)
    arm = first.links_in_base_m * MM
    axes.line(arm[:, 0], arm[:, axis], Ink.ARM, width=6)
    draw_cell(axes, first.scenario.settings, axis)
    draw_obstacles(axes, first.scenario.obstacles, axis)
    for name, low, high in regions:
        x, y = rectangle(low * MM, high * MM, axis)
        axes.line(x, y, Ink.PREDICTED, width=1.2, dashes=(4, 2))
        axes.text(plain(name), low[0] * MM, high[axis] * MM, shift=(0.0, -3.0), ink=Ink.PREDICTED, size=9)
    for preview in previews:
        for ink, path_m in zip(HANDS, preview.hand_paths_in_base_m, strict=False):
            x, y = path_m[:, 0] * MM, path_m[:, axis] * MM
            axes.line(x, y, ink, opacity=faint)
            axes.marks(x[:1], y[:1], "o", 4, fill=ink, opacity=faint)
        tcp = preview.tcp_in_base_m * MM
        axes.marks(tcp[[0]], tcp[[axis]], "o", 5, fill=Ink.TCP, opacity=max(faint, 0.3))
    if len(previews) == 1:
        _draw_last_hands(axes, first, axis)
    axes.x.grid = axes.y.grid = True
    axes.x.steps, axes.y.steps = 8, 6
    axes.fit(*np.transpose([axes.x.view(), axes.y.view()]))
    axes.x.label, axes.y.label = "x forward, mm", "y left, mm" if axis == 1 else "z up, mm"
    axes.title("From above" if axis == 1 else "From the side", bold=False)


def _opacity(previews: Sequence[Preview]) -> float:
    """Return the opacity with which each preview is drawn."""
    # Fainter with more draws, so that frequent paths stand out; the numbers are a choice.
    return 1.0 if len(previews) == 1 else max(0.06, min(0.5, 8.0 / len(previews)))


def _draw_last_hands(axes: Axes, preview: Preview, axis: int) -> None:
    """Draw each hand at its true size, at the point of its path that is nearest to the TCP."""
    radius = preview.scenario.settings.hand.radius_m * MM
    for ink, path in zip(HANDS, preview.hand_paths_in_base_m, strict=False):
        nearest = path[int(np.argmin(np.linalg.norm(path - preview.tcp_in_base_m, axis=1)))] * MM
        outline = capsule_outline(nearest[[0, axis]], nearest[[0, axis]], radius)
        axes.area(outline[:, 0], outline[:, 1], ink, opacity=0.25)


def _draw_image(axes: Axes, previews: Sequence[Preview]) -> None:
    """Draw the object in the camera's image at the start of each preview, and at the desired pose."""
    camera = previews[0].scenario.settings.camera
    for preview in previews:
        u, v = preview.start_image_px.T
        axes.area(u, v, None, edge=Ink.TCP, width=1.5, opacity=_opacity(previews))
    outline = previews[0].desired_image_px
    u, v = np.vstack([outline, outline[:1]]).T
    axes.line(u, v, Ink.TEXT, dashes=(4, 2))
    axes.fit((0.0, 0.0), (camera.width_px, camera.height_px))
    axes.y.show(*reversed(axes.y.view()))
    axes.x.label, axes.y.label = "u, px", "v, px"
    axes.title("In the servoing camera: object at the start, and desired (dashed)", bold=False)


def _write_key(axes: Axes, previews: Sequence[Preview], regions: Boxes) -> None:
    """Write the key, which explains the marks and states the names of the hands."""
    axes.x.line = axes.y.line = axes.x.labelled = axes.y.labelled = False
    many = len(previews) > 1
    axes.marks([], [], "o", 5, fill=Ink.TCP, name="TCP starts" if many else "TCP start")
    axes.marks([], [], "+", 12, edge=Ink.TEXT, width=1.6, name="desired TCP")
    axes.key("object", Ink.OBJECT)
    axes.line([], [], Ink.ARM, width=6, name="arm at the first start" if many else "arm at the start")
    for ink, hand in zip(HANDS, previews[0].scenario.hands, strict=False):
        axes.line([], [], ink, name=plain(hand.name))
    if regions:
        axes.line([], [], Ink.PREDICTED, width=1.2, dashes=(4, 2), name="region")
    axes.legend(anchor="start", inside=True)
    notes = ["Hands that reach for the TCP are drawn as if the TCP stayed at its start."]
    for line, note in enumerate([f"{len(previews)} draws."] * many + notes):
        axes.text(note, Share(0.0), Share(1.0), shift=(0.0, 17.0 * line))
