"""Draw maps of the positions with bad answers.

A map is a grid of squares, which shows the positions of hands or TCPs from above or from the side.

A cell with worse answers has a larger square, and squares of the worst class also have another colour.  A
reader can therefore tell the classes apart without colours.  All squares of a class form one path, which
keeps the size of a map to a few kilobytes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement

import numpy as np
from numpy.typing import NDArray

from safety_harness.base.geometry.arrays import ArrayNx3
from safety_harness.extensions.pages.svg import Ink, describe

# Cells per side; then the sizes in pixels; a choice.
CELLS, CELL_PX, LEFT_PX, TOP_PX, BELOW_PX, RIGHT_PX = 20, 14, 54, 10, 24, 8
LETTERS_PX = 14
AXES = "xyz"
VIEWS = ((0, 1, "from above"), (0, 2, "from the side"))  # across, up


@dataclass(frozen=True)
class Scale:
    """The classes of a quantity; ``edges`` contains n ascending limits between the classes.

    There are n + 1 classes, and ``words`` has a text for each of them.

    A value at or above the last edge is bad.  The class of a cell is the class of its largest value, or of
    its mean value if ``shares`` is True.
    """

    edges: tuple[float, ...]
    words: tuple[str, ...]
    shares: bool = False

    def classes(self, values: NDArray[np.float64]) -> NDArray[np.int64]:  # (n,)
        """Return the class of each value in ``values``, shape (n,); NaN belongs to the worst class."""
        numbers = np.searchsorted(np.array(self.edges), values, side="right")
        return np.where(np.isnan(values), len(self.edges), numbers)

    def size_px(self, level: int) -> int:
        """Return the side length of a square of class ``level`` [px]."""
        return 4 + round((CELL_PX - 5) * level / len(self.edges))


def question_map(
    positions: ArrayNx3,
    values: NDArray[np.float64],  # (n,)
    scale: Scale,
    view: tuple[int, int, str],
    *,
    prefix: str,
    title: str,
) -> str:
    """Return an ``<svg>`` of a grid whose cells show the class of the values in them.

    Args:
        positions: (n, 3) the positions in the base frame [m].
        values: (n,) the value at each position.
        scale: The classes.
        view: The index of the horizontal axis, the index of the vertical axis, and a text for the view.
        prefix: The prefix of identifiers.
        title: The title.

    """
    across, upwards, seen = view
    low, high = positions.min(axis=0), positions.max(axis=0)
    # All positions may share a coordinate.
    size = np.maximum(high - low, 1e-6)
    cell = np.minimum(((positions - low) / size * CELLS).astype(np.int64), CELLS - 1)
    place = cell[:, across], cell[:, upwards]
    count, sums = np.zeros((CELLS, CELLS)), np.full((CELLS, CELLS), 0.0 if scale.shares else -np.inf)
    np.add.at(count, place, 1.0)
    (np.add if scale.shares else np.maximum).at(sums, place, values)
    worst = np.where(count > 0, scale.classes(sums / np.maximum(count, 1.0) if scale.shares else sums), -1)
    ends = ((low[across], high[across]), (low[upwards], high[upwards]))
    return class_map(
        worst, scale, ends, AXES[across] + AXES[upwards], f"seen {seen}", prefix=prefix, title=title
    )


def class_map(
    worst: NDArray[np.int64],
    scale: Scale,
    ends_m: tuple[tuple[float, float], tuple[float, float]],
    axes: str,
    seen: str,
    *,
    prefix: str,
    title: str,
) -> str:
    """Return an ``<svg>`` of a grid whose cells show the given classes.

    Args:
        worst: (CELLS, CELLS) the classes, with a row for each horizontal position.  An empty cell has -1.
        scale: The classes.
        ends_m: The ends of the horizontal axis and of the vertical axis.
        axes: The letters of the two axes.
        seen: A text for the view, such as "seen from above".
        prefix: The prefix of identifiers.
        title: The title.

    """
    side = CELLS * CELL_PX
    width, height = LEFT_PX + side + RIGHT_PX, TOP_PX + side + BELOW_PX
    root = Element("svg", {"viewBox": f"0 0 {width} {height}", "width": str(width), "height": str(height)})
    counts = ", ".join(
        f"{np.count_nonzero(worst == level)} of {label}" for level, label in enumerate(scale.words)
    )
    cells = f"{np.count_nonzero(worst >= 0)} cells with questions, {seen}: {counts}."
    describe(root, prefix=prefix, title=title, description=cells)
    box = {"x": str(LEFT_PX), "y": str(TOP_PX), "width": str(side), "height": str(side), "fill": "none"}
    SubElement(root, "rect", {**box, "stroke": f"var({Ink.GRID.variable})"})
    for level in range(len(scale.words)):
        _draw_class(root, np.argwhere(worst == level), scale, level)
    _label_axes(root, side, *ends_m, axes)
    return ElementTree.tostring(root, encoding="unicode")


def _draw_class(root: Element, cells: NDArray[np.int64], scale: Scale, level: int) -> None:
    """Draw the squares of the cells of class ``level`` as one path.

    ``cells`` contains the indices of these cells, shape (n, 2).
    """
    size_px = scale.size_px(level)
    inset = (CELL_PX - size_px) / 2.0
    bad = level == len(scale.edges)
    squares = "".join(
        f"M{LEFT_PX + CELL_PX * i + inset:g} {TOP_PX + CELL_PX * (CELLS - 1 - j) + inset:g}"
        f"h{size_px}v{size_px}h-{size_px}z"
        for i, j in cells.tolist()
    )
    if squares:
        ink = Ink.LIMIT if bad else Ink.TCP
        SubElement(root, "path", {"d": squares, "fill": f"var({ink.variable})"})


def _label_axes(
    root: Element, side: int, across_m: tuple[float, float], up_m: tuple[float, float], names: str
) -> None:
    """Write the names of both axes, and the coordinates of their ends in millimetres."""
    bottom = TOP_PX + side
    marks: Sequence[tuple[float, float, str, str]] = (
        (LEFT_PX, bottom + 18, _mm(across_m[0]), "start"),
        (LEFT_PX + side, bottom + 18, _mm(across_m[1]), "end"),
        (LEFT_PX + side / 2, bottom + 18, f"{names[0]}, mm", "middle"),
        (LEFT_PX - 6, bottom, _mm(up_m[0]), "end"),
        (LEFT_PX - 6, TOP_PX + 10, _mm(up_m[1]), "end"),
        (LEFT_PX - 6, TOP_PX + side / 2, f"{names[1]}, mm", "end"),
    )
    for x, y, label, anchor in marks:
        place = {"x": f"{x:g}", "y": f"{y:g}", "text-anchor": anchor, "font-size": str(LETTERS_PX)}
        SubElement(root, "text", {**place, "fill": f"var({Ink.MUTED.variable})"}).text = label


def _mm(value_m: float) -> str:
    """Return the text of a length in millimetres, with a typographic minus sign."""
    return f"{1e3 * value_m:.0f}".replace("-", "\u2212")


def key_of(scale: Scale) -> str:
    """Return an ``<svg>`` with the legend of the classes."""
    width = sum(40 + 8 * len(label) for label in scale.words)
    root = Element("svg", {"viewBox": f"0 0 {width} 18", "width": str(width), "height": "18"})
    root.set("aria-hidden", "true")
    left = 0
    for level, label in enumerate(scale.words):
        size = scale.size_px(level)
        ink = Ink.LIMIT if level == len(scale.edges) else Ink.TCP
        place = {"x": f"{left + 9 - size / 2:g}", "y": f"{9 - size / 2:g}"}
        SubElement(
            root, "rect", {**place, "width": str(size), "height": str(size), "fill": f"var({ink.variable})"}
        )
        text = {"x": str(left + 22), "y": "13", "font-size": "13", "fill": f"var({Ink.TEXT.variable})"}
        SubElement(root, "text", text).text = label
        left += 40 + 8 * len(label)
    return ElementTree.tostring(root, encoding="unicode")
