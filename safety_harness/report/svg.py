"""What every drawing on a page shares: colours, thinned curves, plain text, and how it becomes a file.

A page follows the reader's light or dark scheme, so colours are variables, ``var(--fig-...)``: the style
sheet gives them their values (Okabe and Ito's colours, safe for colour-blind readers, darkened or
lightened for contrast with the page).
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
    """One colour role each."""

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
        """The CSS variable's name."""
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
    """``text`` as it may stand in a figure: printable, on one line, not too long."""
    text = _UNPRINTABLE.sub("\ufffd", text)
    return text if len(text) <= longest else text[: longest - 1] + "\u2026"


def ticks_per_column(count: int, columns: int) -> int:
    """How many consecutive ticks share one of ``columns`` columns (1: every tick is drawn)."""
    return 1 if count <= 2 * columns else -(-count // columns)


def keep_extremes(time_s: Floats, values: Floats, columns: int) -> tuple[Floats, Floats]:
    """The smallest and the largest value of every column, at their own times and in order.

    ``time_s`` and ``values`` are (n,); at most 2 ``columns`` points come back, and every tick when
    there are no more than that.  What is not finite is a gap: a column without any finite value
    becomes one NaN, so that the line breaks there.  The first and last finite samples are kept.
    """
    values = np.where(np.isfinite(values), values, np.nan)
    count = len(values)
    width = ticks_per_column(count, columns)
    if width == 1:
        return time_s, values
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
    """Stretches (start, length) [s] in which ``mask`` is true, each tick lasting to the next.

    ``mask`` (n,) and ``time_s`` (n,) are of the ticks.

    Gaps shorter than one of ``columns`` columns are closed, so that a mode which flickers costs no
    more ink than one can see; nothing that is true is ever left out.
    """
    if not mask.any():
        return []
    ends = np.append(time_s[1:], max(end_s, time_s[-1]))
    shortest_s = (ends[-1] - time_s[0]) / columns
    found: list[tuple[float, float]] = []
    for index in np.flatnonzero(mask):
        start, end = float(time_s[index]), float(ends[index])
        if found and start - (found[-1][0] + found[-1][1]) < shortest_s:
            found[-1] = (found[-1][0], end - found[-1][0])
        else:
            found.append((start, end - start))
    return found


def describe(root: ElementTree.Element, *, prefix: str, title: str, description: str) -> None:
    """What a screen reader says of an ``<svg>`` element; the ids start with ``prefix``."""
    root.set("role", "img")
    root.set("aria-labelledby", f"{prefix}title {prefix}desc")
    for name, text, place in (("title", title, 0), ("desc", description, 1)):
        child = ElementTree.Element(name, {"id": f"{prefix}{name}"})
        child.text = _UNPRINTABLE.sub(" ", text)
        root.insert(place, child)


def standalone(svg: str, *, style: str) -> str:
    """An ``<svg>`` element of a page as a file of its own, light or dark like the page.

    ``style`` is the page's style sheet, of which the figures' colours are taken.
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
    """What a style sheet says for light paper, and for dark."""
    light, _, rest = style.partition("@media screen and (prefers-color-scheme: dark)")
    return light, rest.partition("body {")[0]
