"""Draw the coverage of a set of runs as a map.

A cell with more runs has a larger square. The map has 1,536 cells. A row combines a direction and a speed. A
column combines a distance, an outcome, and a class of coverage. The class states whether the avoider's
training data cover the positions of the hand and the TCP. A cell with violations differs by its colour and
also by a frame, so that colour is never the only sign. The picture depends only on the counts.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from itertools import product
from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement

from safety_harness.extensions.pages.svg import Ink, describe
from safety_harness.search.coverage import (
    AXES,
    DIRECTIONS,
    DISTANCES,
    OUTCOMES,
    SEEN,
    SPEEDS,
    Coverage,
    CoverageCell,
)

CELL_PX, LEFT_PX, TOP_PX, RIGHT_PX, BELOW_PX = 12, 152, 158, 54, 94  # the margins hold the labels and the key
GAPS_PX = {"direction": 7, "distance": 10, "seen": 3}  # before each group but the first
SIZES_PX = (3, 5, 7, 9, 11)  # of squares, by decades
CLASSES = ("1", "2 to 9", "10 to 99", "100 to 999", "1,000 and more")
NOTHING: Mapping[CoverageCell, int] = {}


def _columns() -> dict[tuple[str, str, str], int]:
    """Return the left edge of each column [px]."""
    edges, left = {}, LEFT_PX
    for distance, seen in product(DISTANCES, SEEN):
        if seen != SEEN[0]:
            left += GAPS_PX["seen"]
        elif distance != DISTANCES[0]:
            left += GAPS_PX["distance"]
        for outcome in OUTCOMES:
            edges[distance, seen, outcome] = left
            left += CELL_PX
    return edges


def _rows() -> dict[tuple[str, str], int]:
    """Return the upper edge of each row [px]."""
    edges, top = {}, TOP_PX
    for direction in DIRECTIONS:
        top += GAPS_PX["direction"] if direction != DIRECTIONS[0] else 0
        for speed in SPEEDS:
            edges[direction, speed] = top
            top += CELL_PX
    return edges


X_PX, Y_PX = _columns(), _rows()
WIDTH_PX, BOTTOM_PX = max(X_PX.values()) + CELL_PX + RIGHT_PX, max(Y_PX.values()) + CELL_PX


def size_class(count: int) -> int:
    """Return the index into CLASSES for ``count`` runs, where ``count`` is at least 1."""
    return 0 if count == 1 else min(len(str(count)), len(CLASSES) - 1)


def coverage_map(
    coverage: Coverage, violations: Mapping[CoverageCell, int] = NOTHING, *, prefix: str, title: str
) -> str:
    """Return the coverage map as an ``<svg>`` element.

    Args:
        coverage: The number of runs in each cell.
        violations: The number of runs with a violation in each cell. ``coverage`` must include these runs.
        prefix: The text with which every id starts.
        title: The title for a screen reader.

    """
    height = BOTTOM_PX + BELOW_PX
    size = {"viewBox": f"0 0 {WIDTH_PX} {height}", "width": str(WIDTH_PX), "height": str(height)}
    root = Element("svg", size)
    describe(root, prefix=prefix, title=title, description=_description(coverage, violations))
    root.set("font-size", "11")
    _draw_empty(root, coverage)
    for cell, count in sorted(coverage.counts.items()):
        if count > 0:
            _draw_cell(root, cell, count, violations.get(cell, 0))
    _name_axes(root)
    _name_rows(root, coverage)
    _name_columns(root, coverage)
    _draw_key(root, BOTTOM_PX + 66)
    return ElementTree.tostring(root, encoding="unicode")


def _place(cell: CoverageCell) -> tuple[int, int]:
    """Return the position [px] of the upper left corner of a cell."""
    return X_PX[cell.distance, cell.seen, cell.outcome], Y_PX[cell.direction, cell.speed]


def _draw_empty(root: Element, coverage: Coverage) -> None:
    """Draw a dot in every cell without a run.

    A single path contains all dots.
    """
    middle = CELL_PX // 2
    dots = [f"M{x + middle} {y + middle}h0" for x, y in map(_place, coverage.holes)]
    attributes = {"stroke": _colour(Ink.MISSING), "stroke-width": "2", "stroke-linecap": "round"}
    SubElement(root, "path", {"d": "".join(dots), "fill": "none", **attributes})


def _draw_cell(parent: Element, cell: CoverageCell, count: int, violated: int) -> None:
    group = SubElement(parent, "g")
    label = f"{cell}: {_runs(count)}" + (f", {violated:,} with a violation" if violated else "")
    SubElement(group, "title").text = label
    _draw_square(group, SIZES_PX[size_class(count)], _place(cell), violated=bool(violated))


def _draw_square(parent: Element, size_px: int, where: tuple[int, int], *, violated: bool) -> None:
    """Draw a square in the middle of a cell.

    If a run violated a claim in this cell, add a frame to the cell.
    """
    ink = _colour(Ink.LIMIT if violated else Ink.TCP)
    # Leave a gap between the square and its frame.
    size_px = min(size_px, CELL_PX - 5) if violated else size_px
    inset = (CELL_PX - size_px) / 2
    attributes = {"x": f"{where[0] + inset:g}", "y": f"{where[1] + inset:g}", "fill": ink}
    SubElement(parent, "rect", {**attributes, "width": str(size_px), "height": str(size_px)})
    if violated:
        side = str(CELL_PX - 2)
        frame = {"x": str(where[0] + 1), "y": str(where[1] + 1), "width": side, "height": side}
        SubElement(parent, "rect", {**frame, "fill": "none", "stroke": ink, "stroke-width": "1.2"})


def _name_axes(root: Element) -> None:
    """Write the names of the axes to the left of the first column and above the first row."""
    for y, label in ((14, "Least distance"), (34, "In the training data"), (TOP_PX - 60, "Worst decision")):
        _label(root, LEFT_PX - 8, y, label, text_anchor="end")
    _label(root, 0, TOP_PX - 8, "Hand comes from")
    _label(root, LEFT_PX - 8, TOP_PX - 8, "Its speed", text_anchor="end")


def _name_rows(root: Element, coverage: Coverage) -> None:
    speeds = coverage.table("direction", "speed")
    for direction, runs in coverage.along("direction").items():
        top = Y_PX[direction, SPEEDS[0]]
        _text(root, 0, top + 20, direction, font_weight="600", size=12.5)
        _text(root, 0, top + 34, _runs(runs), ink=Ink.MUTED)
        for speed in SPEEDS:
            _label(root, LEFT_PX - 8, Y_PX[direction, speed] + 10, speed, text_anchor="end")
            if speeds[direction][speed]:
                total = f"{speeds[direction][speed]:,}"
                _label(root, WIDTH_PX, Y_PX[direction, speed] + 10, total, text_anchor="end")


def _name_columns(root: Element, coverage: Coverage) -> None:
    for distance, runs in coverage.along("distance").items():
        left = X_PX[distance, SEEN[0], OUTCOMES[0]]
        _text(root, left, 14, distance, font_weight="600", size=12.5)
        right = X_PX[distance, SEEN[-1], OUTCOMES[-1]] + CELL_PX
        _text(root, right, 14, _runs(runs), text_anchor="end", ink=Ink.MUTED)
        for seen in SEEN:
            for line, part in enumerate(seen.split()):
                _label(root, X_PX[distance, seen, OUTCOMES[0]], 34 + 12 * line, part)
            for outcome in OUTCOMES:
                _upright(root, X_PX[distance, seen, outcome], TOP_PX - 8, outcome)
    totals: Counter[tuple[str, str, str]] = Counter()
    for cell, count in coverage.counts.items():
        totals[cell.distance, cell.seen, cell.outcome] += count
    for column, left in X_PX.items():
        if totals[column]:
            _upright(root, left, BOTTOM_PX + 8, f"{totals[column]:,}", text_anchor="end")


def _draw_key(root: Element, top: int) -> None:
    _text(root, 0, top + 10, "Runs in a cell:", ink=Ink.MUTED)
    left = LEFT_PX
    for size_px, label in zip(SIZES_PX, CLASSES, strict=True):
        _draw_square(root, size_px, (left, top), violated=False)
        _text(root, left + 17, top + 10, label)
        left += 36 + 7 * len(label)
    _draw_square(root, 7, (left + 10, top), violated=True)
    _text(root, left + 27, top + 10, "violations among them")


def _text(
    parent: Element, x: float, y: float, label: str, ink: Ink = Ink.TEXT, size: float = 11, **named: str
) -> None:
    """Write ``label`` at (x, y) [px].

    ``named`` has further SVG attributes. In their names, ``_`` replaces the hyphen.
    """
    attributes = {"x": f"{x:g}", "y": f"{y:g}", "fill": _colour(ink), "font-size": f"{size:g}"}
    attributes |= {name.replace("_", "-"): value for name, value in named.items()}
    SubElement(parent, "text", attributes).text = label


def _label(parent: Element, x: float, y: float, label: str, **attributes: str) -> None:
    _text(parent, x, y, label, Ink.MUTED, 10, **attributes)


def _upright(parent: Element, left: float, y: float, label: str, **attributes: str) -> None:
    """Write ``label`` vertically in a column, so that it reads from bottom to top."""
    _label(parent, left + 10, y, label, transform=f"rotate(-90 {left + 10:g} {y:g})", **attributes)


def _runs(count: int) -> str:
    return f"{count:,} {'run' if count == 1 else 'runs'}"


def _colour(ink: Ink) -> str:
    return f"var({ink.variable})"


def _description(coverage: Coverage, violations: Mapping[CoverageCell, int]) -> str:
    """Return the totals along each axis, for readers who cannot see the picture."""
    parts = [str(coverage).split("\n")[0]]
    for axis in AXES:
        parts.append(f"{axis}: " + ", ".join(f"{name} {runs}" for name, runs in coverage.along(axis).items()))
    if violations:
        parts.append(f"{len(violations)} cells have violations")
    return ". ".join(parts) + "."
