"""Provide the parts that all drawings use: colours, thinned curves, plain text and standalone files.

A page follows the reader's light or dark scheme. Colours are therefore CSS variables, ``var(--fig-...)``. The
style sheet sets these variables to the colours of Okabe and Ito, which colour-blind readers can distinguish.
The style sheet darkens or lightens the colours for contrast with the page.
"""

from __future__ import annotations

import re
from enum import Enum
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray

from safety_harness.scenario.model import MAX_HANDS

Floats = NDArray[np.float64]
_COLOURS = re.compile(r"--fig-[\w-]+: #\w+;")
_PAPER = re.compile(r"--paper: (#\w+);")
_UNPRINTABLE = re.compile(r"[^\S ]|[\x00-\x1f\x7f-\x9f\ud800-\udfff\ufffe\uffff]")


class Ink(Enum):
    """The roles of the colours in a drawing."""

    PAPER = 1
    TEXT = 2
    MUTED = 3
    GRID = 4
    TCP = 5
    HAND_1 = 6
    HAND_2 = 7
    PREDICTED = 8
    GREEN = 9
    SKY = 10
    LIMIT = 11
    REPULSING = 12
    STOPPED = 13
    LOST = 14
    MISSING = 15
    ARM = 16
    OBJECT = 17
    CHOSEN = 18
    SERVOING = 19
    HAND_3 = 20
    HAND_4 = 21
    HAND_5 = 22
    HAND_6 = 23
    HAND_7 = 24
    HAND_8 = 25

    @property
    def variable(self) -> str:
        """Return the name of the colour's CSS variable."""
        return "--fig-" + self.name.lower().replace("_", "-")


HANDS = tuple(Ink[f"HAND_{number}"] for number in range(1, MAX_HANDS + 1))
DASHES: tuple[tuple[float, ...], ...] = (  # in widths of the line
    (),
    (6, 2),
    (2, 1.5),
    (7, 2, 1.5, 2),
    (1, 1),
    (9, 3, 2, 3, 2, 3),
)


def plain(text: str, *, longest: int = 28) -> str:
    """Return ``text`` for a figure: printable, on one line, with at most ``longest`` characters."""
    text = _UNPRINTABLE.sub("\ufffd", text)
    return text if len(text) <= longest else text[: longest - 1] + "\u2026"


def ticks_per_column(count: int, columns: int) -> int:
    """Return how many consecutive ticks are drawn in one column if there are ``columns`` columns.

    The result is 1 if there are at most two ticks per column.
    """
    return 1 if count <= 2 * columns else -(-count // columns)


def keep_extremes(time_s: Floats, values: Floats, columns: int) -> tuple[Floats, Floats]:
    """Return the smallest and the largest value of every column, with their times, in order of time.

    The result has at most 2 ``columns`` points, and includes the first and last finite samples. If there are
    at most 2 ``columns`` ticks, the result contains all ticks. A column without a finite value becomes one
    NaN, so that the line breaks there.

    Args:
        time_s: The times (n,) [s].
        values: The values (n,).
        columns: The number of columns of the drawing.

    """
    values = np.where(np.isfinite(values), values, np.nan)
    count = len(values)
    width = ticks_per_column(count, columns)
    if width == 1:
        return time_s, values
    # A table with a row for each column of the drawing; the last row is filled with NaN.
    rows = -(-count // width)
    padded = np.full(rows * width, np.nan)
    padded[:count] = values
    table = padded.reshape(rows, width)
    empty = np.isnan(table).all(axis=1)
    starts = np.arange(rows) * width
    least = starts + np.argmin(np.where(np.isnan(table), np.inf, table), axis=1)
    most = starts + np.argmax(np.where(np.isnan(table), -np.inf, table), axis=1)
    least[empty] = most[empty] = starts[empty]
    ends = np.flatnonzero(np.isfinite(values))[[0, -1]] if not empty.all() else np.empty(0, dtype=np.int64)
    keep = np.unique(np.concatenate([least, most, ends]))
    return time_s[keep], values[keep]


def spans(time_s: Floats, mask: NDArray[np.bool_], end_s: float, columns: int) -> list[tuple[float, float]]:
    """Return the intervals (start, length) [s] in which ``mask`` is true.

    Each tick lasts until the next tick. The function closes gaps that are narrower than a column, because
    they would not be visible in the drawing. The function never omits a tick at which ``mask`` is true.

    Args:
        time_s: The times (n,) [s] of the ticks.
        mask: True at the ticks (n,) to show.
        end_s: The end of the last tick [s].
        columns: The number of columns of the drawing.

    """
    if not mask.any():
        return []
    ends = np.append(time_s[1:], max(end_s, time_s[-1]))
    shortest_s = (ends[-1] - time_s[0]) / columns
    stretches: list[tuple[float, float]] = []
    for index in np.flatnonzero(mask):
        start, end = float(time_s[index]), float(ends[index])
        # The gap is narrower than a column, so extend the previous interval.
        if stretches and start - (stretches[-1][0] + stretches[-1][1]) < shortest_s:
            stretches[-1] = (stretches[-1][0], end - stretches[-1][0])
        else:
            stretches.append((start, end - start))
    return stretches


def describe(root: ElementTree.Element, *, prefix: str, title: str, description: str) -> None:
    """Add a title and a description for screen readers to an ``<svg>``.

    The ids of both start with ``prefix``.
    """
    root.set("role", "img")
    root.set("aria-labelledby", f"{prefix}title {prefix}desc")
    for name, text, place in (("title", title, 0), ("desc", description, 1)):
        child = ElementTree.Element(name, {"id": f"{prefix}{name}"})
        child.text = _UNPRINTABLE.sub(" ", text)
        root.insert(place, child)


def standalone(svg: str, *, style: str) -> str:
    """Convert an ``<svg>`` element of a page to the text of a standalone file.

    Like the page, the file follows the reader's light or dark scheme. ``style`` is the page's style sheet,
    which defines the colours of the figures.
    """
    root = ElementTree.fromstring(svg)
    root.set("xmlns", "http://www.w3.org/2000/svg")
    light, dark = (_COLOURS.findall(part) for part in _schemes(style))
    paper_light, paper_dark = (_PAPER.findall(part)[0] for part in _schemes(style))
    child = ElementTree.Element("style")
    child.text = (
        f":root{{color-scheme:light dark;background:{paper_light};font-family:sans-serif;{''.join(light)}}}"
        f"@media (prefers-color-scheme:dark){{:root{{background:{paper_dark};{''.join(dark)}}}}}"
    )
    root.insert(2, child)
    return ElementTree.tostring(root, encoding="unicode") + "\n"


def _schemes(style: str) -> tuple[str, str]:
    """Return two parts of a style sheet: the rules for light paper and the rules for dark paper."""
    light, _, rest = style.partition("@media screen and (prefers-color-scheme: dark)")
    return light, rest.partition("body {")[0]
