"""Draw plots as SVG in the page's colours.

A plot has axes with ticks at round values, curves, bars, marks, texts and a key. The module computes all
positions when the picture is written, so that axes can be extended until then. Positions are pixels of the
picture with one decimal, and y points downwards. A value that is not finite leaves a gap. Curves end at the
edges of their axes. Marks and texts outside the axes are omitted.
"""

from __future__ import annotations

import math
import re
import unicodedata
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from xml.etree.ElementTree import Element, SubElement, tostring

import numpy as np
from numpy.typing import ArrayLike

from safety_harness.extensions.pages.svg import Floats, Ink, describe
from safety_harness.report.words import with_minus

FONT_PX = 11.0
_FAR_PX, _LARGEST = 9e4, 1e300  # values beyond these limits are drawn at the limits
_ROUNDED_PX = 0.1
_MOST_PLACES = 20  # a path with more places is written as relative steps
_LEADING_ZERO = re.compile(r"(^|[ -])0(?=\.)")
_ROUND = (1.0, 2.0, 2.5, 5.0, 10.0)  # round steps, times a power of ten
_HALF_DIAGONAL = 0.5 * 2.0**0.5  # of a square whose side is the size of the mark
_SHAPES = {  # strokes from point to point, in sizes of the mark
    "x": (((-0.5, -0.5), (0.5, 0.5)), ((-0.5, 0.5), (0.5, -0.5))),
    "+": (((-0.5, 0.0), (0.5, 0.0)), ((0.0, -0.5), (0.0, 0.5))),
    "|": (((0.0, -0.5), (0.0, 0.5)),),
    "s": (((-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5)),),
    "D": (((-_HALF_DIAGONAL, 0.0), (0.0, -_HALF_DIAGONAL), (_HALF_DIAGONAL, 0.0), (0.0, _HALF_DIAGONAL)),),
    "v": (((-0.5, -0.5), (0.5, -0.5), (0.0, 0.5)),),
    "<": (((0.5, -0.5), (0.5, 0.5), (-0.5, 0.0)),),
    "X": (
        tuple(
            (sign * x, sign * y)
            for sign in (1.0, -1.0)
            for x, y in ((-0.25, -0.5), (0.0, -0.25), (0.25, -0.5), (0.5, -0.25), (0.25, 0.0), (0.5, 0.25))
        ),
    ),
}
Key = Callable[[Element, float, float], None]  # draws a sample about a place (x, y) [px]


class Share(float):
    """A position along an axis, given as a fraction of the axis's length instead of a value."""


@dataclass
class Axis:
    """One axis of a plot.

    An axis has the given ``ticks`` (value, label) or, by default, at most ``steps`` + 1 ticks at round
    values.
    """

    start_px: float
    length_px: float  # negative if the axis points upwards
    label: str = ""
    grid: bool = False
    line: bool = True  # whether to draw the axis line with ticks
    labelled: bool = True
    log: bool = False
    steps: int = 5
    margin: float = 0.05  # beyond the drawn values, as a share of their range
    ticks: Sequence[tuple[float, str]] | None = None
    minor: Sequence[float] = ()
    _seen: tuple[float, float] = (np.inf, -np.inf)
    _shown: tuple[float, float] | None = None

    def see(self, values: ArrayLike) -> Floats:
        """Extend the view to include ``values`` (n,), and return them as an array.

        If ``show`` has fixed the view, the view stays the same.
        """
        array = np.asarray(values, dtype=np.float64)
        finite = np.clip(array[np.isfinite(array)], -_LARGEST, _LARGEST)
        low, high = self._seen
        self._seen = float(finite.min(initial=low)), float(finite.max(initial=high))
        return array

    def show(self, low: float, high: float) -> None:
        """Fix the view to the values from ``low`` to ``high``."""
        self._shown = low, high

    def hold(self, value: float) -> None:
        """Extend the view to include ``value``, without a margin."""
        low, high = self.view()
        self.show(min(low, value), max(high, value))

    def view(self) -> tuple[float, float]:
        """Return the lowest and the highest value of the current view."""
        if self._shown is not None:
            return self._shown
        low, high = self._seen
        if low > high:
            return 0.0, 1.0
        size = max(abs(low), abs(high))
        pad = self.margin * (high - low) if high - low > 1e-12 * size else 0.05 * size or 0.05
        return low - pad, high + pad

    def place(self, values: ArrayLike) -> Floats:
        """Return the positions [px] of ``values`` (n,)."""
        array, ends = np.asarray(values, dtype=np.float64), np.array(self.view())
        if self.log:
            array, ends = np.log10(np.where(array > 0.0, array, np.nan)), np.log10(ends)
        places: Floats = self.start_px + self.length_px * (array - ends[0]) / (ends[1] - ends[0])
        return places

    def at(self, value: float) -> float:
        """Return the position [px] of a value on the axis, or of a ``Share`` of the axis's length."""
        if isinstance(value, Share):
            return self.start_px + self.length_px * value
        return float(self.place([value])[0])

    def ends_px(self) -> Floats:
        """Return the positions [px] of the axis's start and end, shape (2,)."""
        return np.array([self.start_px, self.start_px + self.length_px])

    def has(self, place_px: float) -> bool:
        """Return whether the position ``place_px`` lies on the axis, with a tolerance of one pixel."""
        low, high = sorted(self.ends_px())
        return bool(low - 1.0 <= place_px <= high + 1.0)

    def labels(self) -> list[tuple[float, str]]:
        """Return (position [px], text) of each tick in view."""
        ticks = self.ticks
        if ticks is None:
            rounded = round_values(min(self.view()), max(self.view()), self.steps)
            ticks = [(value, with_minus(f"{value:g}")) for value in rounded]
        return [(self.at(value), label) for value, label in ticks if self.has(self.at(value))]


def round_values(low: float, high: float, steps: int) -> list[float]:
    """Return all multiples of a round step between ``low`` and ``high``.

    The step is so large that there are at most ``steps`` + 1 multiples.
    """
    least = max((high - low) / steps, 1e-300)
    power = 10.0 ** np.floor(np.log10(least))
    # The tolerances keep a multiple that rounding has moved slightly beyond an end.
    step = next(power * factor for factor in _ROUND if power * factor >= least * (1.0 - 1e-9))
    first, last = np.ceil(low / step - 1e-9), np.floor(high / step + 1e-9)
    return [float(f"{k * step:.12g}") + 0.0 for k in np.arange(first, last + 1.0)]


def stairs(x: ArrayLike, y: ArrayLike) -> tuple[Floats, Floats]:
    """Return the corners of a step curve.

    Each value of ``y`` (n,) applies from its ``x`` (n,) until the next ``x``.
    """
    return np.repeat(np.asarray(x, np.float64), 2)[1:], np.repeat(np.asarray(y, np.float64), 2)[:-1]


@dataclass
class Axes:
    """A rectangular plot.

    The values of ``x`` increase to the right, and the values of ``y`` increase upwards.
    """

    x: Axis
    y: Axis
    _items: list[Callable[[Element, str], None]] = field(default_factory=list)
    _above: list[Callable[[Element, str], None]] = field(default_factory=list)  # drawn last
    _keys: list[tuple[str, Key]] = field(default_factory=list)

    def line(
        self,
        x: ArrayLike,  # (n,)
        y: ArrayLike,  # (n,)
        ink: Ink,
        *,
        width: float = 1.5,
        dashes: Sequence[float] = (),  # in widths
        opacity: float = 1.0,
        name: str | None = None,  # in the key
    ) -> None:
        """Draw a curve."""
        across, heights = self.x.see(x), self.y.see(y)
        self._stroke(lambda: (self.x.place(across), self.y.place(heights)), ink, width, dashes, opacity, name)

    def hline(self, y: float, ink: Ink, *, width: float = 0.8, dashes: Sequence[float] = ()) -> None:
        """Draw a horizontal line across the whole width."""
        self.y.see([y])
        self._stroke(lambda: (self.x.ends_px(), self.y.place([y, y])), ink, width, dashes)

    def vline(self, x: float, ink: Ink, *, width: float = 0.8, dashes: Sequence[float] = ()) -> None:
        """Draw a vertical line over the whole height."""
        self.x.see([x])
        self._stroke(lambda: (self.x.place([x, x]), self.y.ends_px()), ink, width, dashes)

    def _stroke(
        self,
        places: Callable[[], tuple[Floats, Floats]],
        ink: Ink,
        width: float,
        dashes: Sequence[float],
        opacity: float = 1.0,
        name: str | None = None,
    ) -> None:
        style = _style(None, ink, width, opacity)
        style |= (
            {"stroke-dasharray": " ".join(f"{width * dash:g}" for dash in dashes)}
            if dashes
            else {"stroke-linecap": "round"}
        )
        self._items.append(lambda root, clip: _path(root, _strokes(*places()), style | {"clip-path": clip}))
        if name is not None:
            self._keys.append((name, lambda root, x, y: _path(root, f"M{x - 13:g} {y:g}h26", style)))

    def area(
        self,
        x: ArrayLike,  # (n,)
        y: ArrayLike,  # (n,)
        fill: Ink | None,
        *,
        opacity: float = 1.0,
        edge: Ink | None = None,
        width: float = 1.8,
    ) -> None:
        """Fill the area within an outline."""
        across, heights = self.x.see(x), self.y.see(y)
        style = _style(fill, edge, width, opacity)

        def draw(root: Element, clip: str) -> None:
            drawn = _strokes(self.x.place(across), self.y.place(heights), closed=True)
            _path(root, drawn, style | {"clip-path": clip})

        self._items.append(draw)

    def bars(
        self,
        spans: Iterable[tuple[float, float]],
        y: tuple[float, float],
        ink: Ink,
        *,
        opacity: float = 1.0,
        hatched: bool = False,
    ) -> None:
        """Draw a rectangle for each span (x, length).

        A rectangle extends from x to x + length, and between the two heights in ``y``.
        """
        corners = [([x, x + length, x + length, x], [y[0], y[0], y[1], y[1]]) for x, length in spans]
        self.y.see(y)
        style = _style(ink, None, 0.0, opacity)

        def draw(root: Element, clip: str) -> None:
            if hatched:
                name = clip[5:-1] + "hatch"
                size = {"width": "7", "height": "7", "patternUnits": "userSpaceOnUse"}
                turn = {"id": name, "patternTransform": "rotate(45)"}
                _path(SubElement(root, "pattern", size | turn), "M0 0v7", _style(None, ink, 1.0, 1.0))
                style["fill"] = f"url(#{name})"
            drawn = "".join(_strokes(self.x.place(a), self.y.place(b), closed=True) for a, b in corners)
            _path(root, drawn, style | {"clip-path": clip})

        self._items.append(draw)

    def marks(
        self,
        x: ArrayLike,  # (n,)
        y: ArrayLike,  # (n,)
        shape: str,  # o, or one of _SHAPES
        size: float,  # px
        *,
        fill: Ink | None = None,
        edge: Ink | None = None,
        width: float = 0.8,
        opacity: float = 1.0,
        name: str | None = None,  # in the key
    ) -> None:
        """Draw a mark at each point (x, y)."""
        across, heights = self.x.see(x), self.y.see(y)
        style = _style(fill, edge, width, opacity)

        def draw(root: Element, _: str) -> None:
            places = zip(self.x.place(across).tolist(), self.y.place(heights).tolist(), strict=True)
            shown = [place for place in places if self.x.has(place[0]) and self.y.has(place[1])]
            _path(root, "".join(_mark(shape, size, *place) for place in shown), style)

        self._items.append(draw)
        if name is not None:
            self._keys.append((name, lambda root, x, y: _path(root, _mark(shape, size, x, y), style)))

    def key(self, name: str, ink: Ink) -> None:
        """Add an item with a coloured box to the plot's key, for items that were drawn without a name."""
        self._keys.append(
            (name, lambda root, x, y: _path(root, f"M{x - 9:g} {y - 4:g}h18v8h-18z", _style(ink)))
        )

    def text(
        self,
        label: str,
        x: float,
        y: float,
        *,
        shift: tuple[float, float] = (0.0, 0.0),  # px to the right, and down to the base line
        anchor: str = "start",
        ink: Ink = Ink.TEXT,
        size: float = FONT_PX,
    ) -> None:
        """Write ``label`` at (x, y).

        Each coordinate is a value on its axis, or a ``Share`` of the axis's length.
        """

        def draw(root: Element, _: str) -> None:
            place = self.x.at(x), self.y.at(y)
            if self.x.has(place[0]) and self.y.has(place[1]):
                at = place[0] + shift[0], place[1] + shift[1]
                _text(root, label, *at, anchor=anchor, ink=ink, size=size)

        self._items.append(draw)

    def title(
        self, label: str, *, anchor: str = "start", lift: float = 8.0, bold: bool = True, ink: Ink = Ink.TEXT
    ) -> None:
        """Write ``label`` on a line above the axes, aligned with the start or end of the axes.

        The line is ``lift`` pixels above the axes.
        """

        def draw(root: Element, _: str) -> None:
            x, y = self.x.ends_px()[int(anchor == "end")], self.y.ends_px()[1] - lift
            _text(root, label, x, y, anchor=anchor, ink=ink, bold=bold)

        self._above.append(draw)

    def legend(self, *, anchor: str = "end", inside: bool = False) -> None:
        """Draw the key as a row above the axes, at their start or end, or as a list in a corner."""

        def draw(root: Element, _: str) -> None:
            widths = [44.0 + text_px(name) for name, _ in self._keys]
            left, right = self.x.ends_px()
            bottom, top = self.y.ends_px()
            x = left if anchor == "start" else right - (max(widths) if inside else sum(widths)) + 12.0
            y = bottom + 4.0 - 17.0 * len(widths) if inside else top - 8.0
            for (name, key), width in zip(self._keys, widths, strict=True):
                key(root, x + 13.0, y - 4.0)
                _text(root, name, x + 31.0, y, anchor="start")
                x, y = (x, y + 17.0) if inside else (x + width, y)

        if self._keys:
            self._above.append(draw)

    def fit(self, low: ArrayLike, high: ArrayLike) -> None:
        """Choose a view that shows the rectangle from corner ``low`` to corner ``high`` (2,).

        Both directions have the same scale.
        """
        room_px = np.abs([self.x.length_px, self.y.length_px])
        low, high = np.asarray(low), np.asarray(high)
        half = 0.5 * room_px * float(np.max((high - low) / room_px))
        for axis, centre, size in zip((self.x, self.y), 0.5 * (low + high), half, strict=True):
            axis.show(centre - size, centre + size)

    def draw(self, root: Element, clip: str) -> None:
        """Draw the axes and their content.

        ``clip`` is the id of the area within the edges.
        """
        (left, right), (bottom, top) = self.x.ends_px(), self.y.ends_px()
        edges = np.array([left - 1.0, right + 1.0, right + 1.0, left - 1.0])
        heights = np.array([bottom + 1.0, bottom + 1.0, top - 1.0, top - 1.0])
        _path(SubElement(root, "clipPath", {"id": clip}), _strokes(edges, heights, closed=True), {})
        for axis in (self.x, self.y):
            if axis.grid:
                lines = [self._along(axis, at, top - bottom, right - left) for at, _ in axis.labels()]
                _path(root, "".join(lines), _style(None, Ink.GRID))
        for axis in (self.x, self.y):
            if axis.line:
                line = f"M{left:g} {bottom:g}" + (f"H{right:g}" if axis is self.x else f"V{top:g}")
                line += "".join(self._along(axis, at, 3.0, -3.0) for at, _ in axis.labels())
                line += "".join(self._along(axis, axis.at(value), 2.0, -2.0) for value in axis.minor)
                _path(root, line, _style(None, Ink.MUTED))
        for at, label in self.x.labels() if self.x.labelled else ():
            _text(root, label, at, bottom + 15.0, anchor="middle", ink=Ink.MUTED)
        for at, label in self.y.labels() if self.y.labelled else ():
            _text(root, label, left - 7.0, at + 4.0, anchor="end", ink=Ink.MUTED)
        _text(root, self.x.label, right, bottom + 32.0, anchor="end", ink=Ink.MUTED)
        middle = 0.5 * (bottom + top)
        _text(root, self.y.label, left - 58.0, middle, anchor="middle", ink=Ink.MUTED, turned=True)
        for item in (*self._items, *self._above):
            item(root, f"url(#{clip})")

    def _along(self, axis: Axis, at_px: float, down_px: float, right_px: float) -> str:
        """Return the SVG path of a tick mark of ``axis``.

        A tick mark is a short line that begins at the edge of the axes.
        """
        if axis is self.x:
            return f"M{_short(at_px)} {_short(self.y.start_px)}v{_short(down_px)}"
        return f"M{_short(self.x.start_px)} {_short(at_px)}h{_short(right_px)}"


class Picture:
    """A drawing of a given size [px] that contains axes."""

    def __init__(self, width: float, height: float) -> None:
        self.size = width, height
        self._axes: list[Axes] = []

    def axes(self, left: float, top: float, width: float, height: float) -> Axes:
        """Add axes, which are drawn on top of all earlier axes."""
        self._axes.append(Axes(Axis(left, width), Axis(top + height, -height)))
        return self._axes[-1]

    def svg(self, *, prefix: str, title: str, description: str) -> str:
        """Return the drawing as an ``<svg>`` element, for a page or for the function ``standalone``.

        Args:
            prefix: The text with which every id starts.
            title: The title for a screen reader.
            description: The description for a screen reader.

        """
        width, height = (f"{length:g}" for length in self.size)
        size = {"width": width, "height": height, "viewBox": f"0 0 {width} {height}"}
        root = Element("svg", size | {"font-size": f"{FONT_PX:g}"})
        describe(root, prefix=prefix, title=title, description=description)
        for number, axes in enumerate(self._axes):
            axes.draw(root, f"{prefix}axes-{number}")
        return tostring(root, encoding="unicode")


def text_px(text: str) -> float:
    """Return an estimate of the width [px] of a text in the font size ``FONT_PX``.

    The estimate tends to be too large.
    """
    return FONT_PX * sum(
        1.0
        if unicodedata.east_asian_width(letter) in "WF"
        else 0.9
        if letter in "mwMW"
        else 0.35
        if letter in "ijlt.,:;'|! "
        else 0.62
        for letter in text
    )


def _short(number: float) -> str:
    """Return a position [px] as text with at most one decimal."""
    return f"{round(min(max(number, -_FAR_PX), _FAR_PX), 1) + 0.0:g}"


def _strokes(x: Floats, y: Floats, *, closed: bool = False) -> str:
    """Return the SVG path through positions (n,) [px], without the inner points of a horizontal line.

    The path is interrupted where a position is not finite.
    """
    places = np.round(np.column_stack([x, y]), 1)
    places = np.where(np.isfinite(places), np.clip(places, -_FAR_PX, _FAR_PX) + 0.0, np.nan)
    # First drop repeated positions, which would hide that a point lies between its neighbours.
    places = np.delete(places, 1 + np.flatnonzero((np.diff(places, axis=0) == 0.0).all(axis=1)), axis=0)
    across, rise = np.diff(places, axis=0).T
    along = (rise[1:] == 0.0) & (rise[:-1] == 0.0) & (across[1:] * across[:-1] > 0.0)
    places = np.delete(places, 1 + np.flatnonzero(along), axis=0)
    good = np.isfinite(places.sum(axis=1))
    drawn = []
    for run in np.split(np.arange(len(good)), np.flatnonzero(np.diff(good)) + 1):
        if len(run) and good[run[0]]:
            drawn.append(
                _path_words(_straightened(np.asarray(places[run], np.float64)))
                + ("z" if closed else "h0" if len(run) == 1 else "")
            )
    return "".join(drawn)


def _straightened(places: Floats) -> Floats:
    """Return ``places`` (n, 2) [px] without the points on a straight line between two retained points.

    The tolerance is the rounding of positions. A point where the path turns back is retained. After each
    retained point, the function drops the following points while they lie within a cone (Reumann and Witkam,
    1974).
    """
    if len(places) <= _MOST_PLACES:
        return places
    kept, (x, y) = [0], places[0]
    least, most, reached, ahead = -math.pi, math.pi, 0.0, math.nan
    for k, (a, b) in enumerate(places.tolist()):
        away = math.hypot(a - x, b - y)
        bearing = math.atan2(b - y, a - x)
        turned = math.remainder(bearing - ahead, math.tau) if ahead == ahead else 0.0
        # The path turns back or leaves the cone: keep the previous point, and begin a new cone there.
        if away < reached or not least <= turned <= most:
            kept.append(k - 1)
            x, y = places[k - 1].tolist()
            away, bearing = math.hypot(a - x, b - y), math.atan2(b - y, a - x)
            least, most, ahead, turned = -math.pi, math.pi, math.nan, 0.0
        reached = away
        if away > _ROUNDED_PX:
            ahead = bearing if ahead != ahead else ahead
            # The bearings of lines that pass this point within the tolerance narrow the cone.
            spread = math.asin(_ROUNDED_PX / away)
            least, most = max(least, turned - spread), min(most, turned + spread)
    corners: Floats = places[[*kept, len(places) - 1]]
    return corners


def _path_words(places: Floats) -> str:
    """Return the SVG path through ``places`` (n, 2) [px].

    A long path uses relative steps, which need fewer digits.
    """
    if len(places) <= _MOST_PLACES:
        return "M" + " ".join([f"{a:g} {b:g}" for a, b in places.tolist()])
    steps = " ".join([f"{step:g}" for step in np.round(np.diff(places, axis=0), 1).ravel() + 0.0])
    return f"M{places[0, 0]:g} {places[0, 1]:g}l" + _LEADING_ZERO.sub(r"\1", steps).replace(" -", "-")


def _mark(shape: str, size: float, x: float, y: float) -> str:
    if shape == "o":
        r = f"{0.5 * size:g}"
        return f"M{_short(x - 0.5 * size)} {_short(y)}a{r} {r} 0 1 0 {size:g} 0a{r} {r} 0 1 0 {-size:g} 0z"
    strokes = (np.array(stroke) * size + [x, y] for stroke in _SHAPES[shape])
    return "".join(_strokes(stroke[:, 0], stroke[:, 1], closed=True) for stroke in strokes)


def _style(
    fill: Ink | None = None, edge: Ink | None = None, width: float = 0.8, opacity: float = 1.0
) -> dict[str, str]:
    style = {"fill": "none" if fill is None else f"var({fill.variable})"}
    if edge is not None:
        style |= {"stroke": f"var({edge.variable})", "stroke-width": f"{width:g}"}
    return style | ({"opacity": f"{opacity:g}"} if opacity < 1.0 else {})


def _path(root: Element, drawn: str, style: dict[str, str]) -> None:
    if drawn:
        SubElement(root, "path", {"d": drawn} | style)


def _text(
    root: Element,
    label: str,
    x: float,
    y: float,
    *,
    anchor: str,
    ink: Ink = Ink.TEXT,
    size: float = FONT_PX,
    bold: bool = False,
    turned: bool = False,
) -> None:
    if not label:
        return
    attributes = {"x": _short(x), "y": _short(y), "fill": f"var({ink.variable})", "text-anchor": anchor}
    attributes |= {"font-size": f"{size:g}"} if size != FONT_PX else {}
    attributes |= {"font-weight": "bold"} if bold else {}
    attributes |= {"transform": f"rotate(-90 {_short(x)} {_short(y)})"} if turned else {}
    SubElement(root, "text", attributes).text = label
