"""What every figure is drawn with: colours, thinned curves, and from matplotlib to SVG inside a page.

matplotlib writes a document for itself: ids that repeat from figure to figure, a style rule for
every element of the page, metadata with addresses, fonts by name, fixed colours.  Here all of
that is taken out or made the page's own.  Text stays text, escaped by the XML writer.

matplotlib can only draw fixed colours, but a page that follows the reader's light or dark scheme
needs variables.  So every ink has a sentinel that nothing else uses, which is replaced here by
``var(--fig-...)``; the style sheet gives the variables their values (Okabe and Ito's colours,
safe for colour-blind readers, darkened or lightened for contrast with the page).
"""

from __future__ import annotations

import io
import re
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from enum import Enum
from typing import TYPE_CHECKING, Any
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray

from safety_harness.scenario.model import MAX_HANDS

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Floats = NDArray[np.float64]
_SVG = "{http://www.w3.org/2000/svg}"
_XLINK_HREF = "{http://www.w3.org/1999/xlink}href"
_COLOUR = re.compile(r"#a1b3[0-9a-f]{2}")
_REFERENCE = re.compile(r"url\(#([^)]+)\)")
_FONT_FAMILY = re.compile(r"\s*font-family:[^;]+;")
_NO_TURN = re.compile(r"rotate\(-?0[^)]*\)")
_LONG_NUMBER = re.compile(r"(-?\d+)\.(\d)\d+")
_COLOURS = re.compile(r"--fig-[\w-]+: #\w+;")
_PAPER = re.compile(r"--paper: (#\w+);")
_UNPRINTABLE = re.compile(r"[^\S ]|[\x00-\x1f\x7f-\x9f\ud800-\udfff\ufffe\uffff]")


class Ink(Enum):
    """One colour role each; the value is its number in the sentinel."""

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
    def sentinel(self) -> str:
        """The colour to hand to matplotlib."""
        return f"#a1b3{self.value:02x}"

    @property
    def variable(self) -> str:
        """The CSS variable's name."""
        return "--fig-" + self.name.lower().replace("_", "-")


BY_SENTINEL = {ink.sentinel: f"var({ink.variable})" for ink in Ink}
HANDS = tuple(Ink[f"HAND_{number}"] for number in range(1, MAX_HANDS + 1))
DASHES: tuple[Any, ...] = (
    "solid",
    (0, (6, 2)),
    (0, (2, 1.5)),
    (0, (7, 2, 1.5, 2)),
    (0, (1, 1)),
    (0, (9, 3, 2, 3, 2, 3)),
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


@contextmanager
def drawing() -> Iterator[None]:
    """The settings under which every figure is built and written, whatever the user's own are."""
    from matplotlib import style

    own = {
        "svg.fonttype": "none",
        "svg.hashsalt": "safety-harness",
        "font.size": 11.0,
        "axes.edgecolor": Ink.MUTED.sentinel,
        "axes.linewidth": 0.8,
        "axes.spines.top": False,
        "axes.spines.right": False,
        "axes.facecolor": "none",
        "axes.unicode_minus": True,
        "axes.formatter.useoffset": False,
        "text.color": Ink.TEXT.sentinel,
        "text.parse_math": False,
        "axes.labelcolor": Ink.MUTED.sentinel,
        "xtick.color": Ink.MUTED.sentinel,
        "ytick.color": Ink.MUTED.sentinel,
        "xtick.major.size": 3.0,
        "ytick.major.size": 3.0,
        "grid.color": Ink.GRID.sentinel,
        "grid.linewidth": 0.8,
        "axes.axisbelow": True,
        "axes.titley": 1.0,  # or every axis is measured to keep clear of titles
        "lines.solid_capstyle": "round",
    }
    with style.context(["default", own]), warnings.catch_warnings():
        # A letter that matplotlib's own font lacks: the browser's fonts may well have it.
        warnings.filterwarnings("ignore", message=r"Glyph .* missing from font", category=UserWarning)
        yield


def new_figure(width_px: float, height_px: float) -> Figure:
    """An empty figure, one unit of the SVG a pixel."""
    from matplotlib.backends.backend_svg import FigureCanvasSVG
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width_px / 72.0, height_px / 72.0), dpi=72, facecolor="none")
    FigureCanvasSVG(figure)
    return figure


def to_svg(figure: Figure, *, prefix: str, title: str, description: str) -> str:
    """The figure as an ``<svg>`` element; every id starts with ``prefix``.

    ``title`` and ``description`` are what a screen reader says.  Call inside ``drawing()``.
    """
    buffer = io.StringIO()
    figure.savefig(buffer, format="svg", metadata={"Date": None})
    root = ElementTree.fromstring(buffer.getvalue())
    referenced = _local_references(root)
    for parent in list(root.iter()):
        for child in list(parent):
            if child.tag in (f"{_SVG}metadata", f"{_SVG}style"):
                parent.remove(child)
    for element in root.iter():
        _tidy(element, prefix, referenced)
    _drop_empty(root)
    width, height = root.attrib.pop("width"), root.attrib.pop("height")
    root.attrib.pop("version", None)
    root.set("width", width.removesuffix("pt"))
    root.set("height", height.removesuffix("pt"))
    describe(root, prefix=prefix, title=title, description=description)
    return ElementTree.tostring(root, encoding="unicode")


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


def _local_references(root: ElementTree.Element) -> frozenset[str]:
    """The ids that something in the drawing points at."""
    found = set()
    for element in root.iter():
        if _XLINK_HREF in element.attrib:
            found.add(element.attrib[_XLINK_HREF].removeprefix("#"))
        for value in element.attrib.values():
            found.update(_REFERENCE.findall(value))
    return frozenset(found)


def _tidy(element: ElementTree.Element, prefix: str, referenced: frozenset[str]) -> None:
    """One element: no namespace, the page's colours and font, ids of its own, short numbers."""
    element.tag = element.tag.removeprefix(_SVG)
    if element.tag not in ("text", "tspan"):
        element.text = None
    element.tail = None
    old = dict(element.attrib)
    element.attrib.clear()
    for name, value in old.items():
        if name == "id":
            if value in referenced:
                element.set("id", prefix + value)
        elif name == _XLINK_HREF:
            element.set("href", "#" + prefix + value.removeprefix("#"))
        elif name == "d":
            element.set("d", " ".join(_LONG_NUMBER.sub(r"\1.\2", value).split()))
        elif name in ("x", "y", "transform"):
            if not _NO_TURN.fullmatch(value):
                element.set(name, _LONG_NUMBER.sub(r"\1.\2", value))
        else:
            value = _COLOUR.sub(lambda match: BY_SENTINEL[match.group()], value)
            value = _REFERENCE.sub(rf"url(#{prefix}\1)", value)
            element.set(name, _FONT_FAMILY.sub("", value))


def _drop_empty(element: ElementTree.Element) -> None:
    """Take out groups and definitions that hold nothing."""
    for child in list(element):
        _drop_empty(child)
        if child.tag in ("g", "defs") and len(child) == 0 and "id" not in child.attrib:
            element.remove(child)
