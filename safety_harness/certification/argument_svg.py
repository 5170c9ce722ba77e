"""The argument as a picture: goals as boxes, strategies slanted, solutions as circles, contexts rounded.

A goal stands above the strategies that support it; what supports a strategy stands below it in rows, each
with its solutions to the right, so that the picture is as wide as a page.  Contexts and assumptions stand
beside.
"""

from __future__ import annotations

import textwrap
from dataclasses import dataclass
from html import escape

from safety_harness.certification.argument import KIND_WORDS, Element, ElementKind
from safety_harness.report.svg import plain

WIDTH, PAD, LINE, GAP_X, GAP_Y = 176.0, 10.0, 15.0, 22.0, 46.0
LETTERS = 25  # in a line of a box
GSN_KEY = ' class="gsn-key"'
HALO = {"holds": "--holds", "inconclusive": "--inconclusive", "violated": "--violated", "none": "--muted"}


@dataclass(frozen=True)
class _Box:
    """An element with its place: the left upper corner and the size."""

    element: Element
    x: float
    y: float
    width: float
    height: float
    lines: tuple[str, ...]

    @property
    def middle(self) -> float:
        return self.x + self.width / 2.0


def _lines(element: Element) -> tuple[str, ...]:
    return tuple(textwrap.wrap(plain(element.text, longest=140), LETTERS)) or ("",)


def _height(element: Element) -> float:
    return 2 * PAD + LINE * (len(_lines(element)) + 1)


def _own_width(element: Element) -> float:
    return WIDTH + (WIDTH + GAP_X if element.beside else 0.0)


def _width(element: Element) -> float:
    """With all that supports it."""
    if element.kind is ElementKind.STRATEGY:
        return max(_own_width(element), 2 * (GAP_X + WIDTH))
    below = sum(map(_width, element.below)) + GAP_X * max(len(element.below) - 1, 0)
    return max(_own_width(element), below)


class _Layout:
    """Places every element, and remembers what is joined to what."""

    def __init__(self, top: Element) -> None:
        self.boxes: list[_Box] = []
        self.arrows: list[tuple[list[tuple[float, float]], str]] = []  # a line, the marker at its end
        self.width = _width(top) + 2 * GAP_X
        self.height = self._place(top, GAP_X, GAP_X)[1] + GAP_X

    def _place(self, element: Element, left: float, top: float) -> tuple[_Box, float]:
        """Put ``element`` and all below it; returns its box and how far down all of it goes."""
        span = _width(element)
        box = self._box(element, left + (span - _own_width(element)) / 2.0, top)
        bottom = self._beside(box)
        if element.kind is ElementKind.STRATEGY:
            return box, self._rows(box, left, bottom + GAP_Y * 0.6)
        lowest, start = bottom, left
        for one in element.below:
            placed, end = self._place(one, start, bottom + GAP_Y)
            level = placed.y - GAP_Y / 2.0
            below = (box.middle, box.y + box.height), (box.middle, level)
            self.arrows.append(([*below, (placed.middle, level), (placed.middle, placed.y)], "tip"))
            lowest, start = max(lowest, end), start + _width(one) + GAP_X
        return box, lowest

    def _beside(self, box: _Box) -> float:
        """What the element is to be read in, to its right; returns how far down it goes."""
        y = box.y
        for one in box.element.beside:
            beside = self._box(one, box.x + WIDTH + GAP_X, y)
            at = min(beside.y + beside.height / 2.0, box.y + box.height - 4.0)
            self._arrow(box.x + WIDTH, at, beside.x, beside.y + beside.height / 2.0, "ring")
            y += beside.height + 8.0
        return max(y - 8.0, box.y + box.height)

    def _rows(self, box: _Box, left: float, y: float) -> float:
        """What supports a strategy, one below the other, each with its own support to the right."""
        rail = min(left, box.x) + 6.0
        centre = box.y + box.height
        for one in box.element.below:
            placed = self._box(one, left + GAP_X, y)
            end = placed.y + placed.height + (8.0 if one.undeveloped else 0.0)
            centre = placed.y + placed.height / 2.0
            self._arrow(rail, centre, placed.x, centre, "tip")
            for solution in one.below:
                leaf = self._box(solution, placed.x + WIDTH + GAP_X, y)
                at = min(leaf.y + leaf.height / 2.0, placed.y + placed.height - 4.0)
                self._arrow(placed.x + WIDTH, at, leaf.x, leaf.y + leaf.height / 2.0, "tip")
                y += leaf.height + 8.0
            y = max(y, end + 12.0)
        joint = box.y + box.height
        self.arrows.append(
            ([(box.middle, joint), (box.middle, joint + 10.0), (rail, joint + 10.0), (rail, centre)], "")
        )
        return y

    def _arrow(self, x1: float, y1: float, x2: float, y2: float, tip: str) -> None:
        self.arrows.append(([(x1, y1), (x2, y2)], tip))

    def _box(self, element: Element, x: float, y: float) -> _Box:
        box = _Box(element, x, y, WIDTH, _height(element), _lines(element))
        self.boxes.append(box)
        return box


def argument_svg(top: Element, *, prefix: str) -> str:
    """The picture as an ``<svg>`` element; every element is a link to its place on the page."""
    layout = _Layout(top)
    parts = [
        f'<svg width="{layout.width:.0f}" height="{layout.height:.0f}" viewBox="0 0 {layout.width:.0f} '
        f'{layout.height:.0f}" role="group" aria-labelledby="{prefix}title {prefix}desc">',
        f'<title id="{prefix}title">The assurance argument in goal structuring notation</title>',
        f'<desc id="{prefix}desc">The same as the list below the picture.</desc>',
        "<defs>",
        _marker(f"{prefix}tip", 'fill="var(--muted)"'),
        _marker(f"{prefix}ring", 'fill="var(--paper)" stroke="var(--muted)"'),
        "</defs>",
    ]
    for points, tip in layout.arrows:
        end = f' marker-end="url(#{prefix}{tip})"' if tip else ""
        way = " L".join(f"{x:.1f} {y:.1f}" for x, y in points)
        parts.append(f'<path d="M{way}" fill="none" stroke="var(--muted)"{end}/>')
    parts += [_drawn(box) for box in layout.boxes]
    parts.append("</svg>")
    return "".join(parts)


def _marker(name: str, style: str) -> str:
    return (
        f'<marker id="{name}" viewBox="0 0 10 10" refX="9" refY="5" markerWidth="8" markerHeight="8" '
        f'orient="auto"><path d="M1 1.5 9 5 1 8.5z" {style}/></marker>'
    )


def _drawn(box: _Box) -> str:
    element = box.element
    style = f'fill="var(--raised)" stroke="var({HALO[element.state]})" stroke-width="1.6"'
    if element.state == "inconclusive":
        style += ' stroke-dasharray="5 2.5"'
    if element.state == "violated":
        style = style.replace('stroke-width="1.6"', 'stroke-width="3"')
    lines = [f"{element.key} \u00b7 {KIND_WORDS[element.kind]}", *box.lines]
    x, y = box.x + PAD + (8.0 if element.kind is ElementKind.STRATEGY else 0.0), box.y + PAD + 11.0
    spans = [
        f'<tspan x="{x:.1f}" y="{y + LINE * k:.1f}"{GSN_KEY if k == 0 else ""}>{escape(line)}</tspan>'
        for k, line in enumerate(lines)
    ]
    drawn = f'{_shape(box, style)}<text class="gsn-text">{"".join(spans)}</text>'
    if element.undeveloped:
        drawn += (
            f'<path d="M{box.middle:.1f} {box.y + box.height:.1f}l8 8-8 8-8-8z" fill="var(--paper)" '
            'stroke="var(--inconclusive)" stroke-width="1.6"><title>undeveloped: nothing supports it</title>'
            "</path>"
        )
    label = escape(f"{element.key}, {KIND_WORDS[element.kind]}: {element.text}", quote=True)
    return f'<a href="#{escape(element.place, quote=True)}" aria-label="{label}">{drawn}</a>'


def _shape(box: _Box, style: str) -> str:
    x, y, width, height = box.x, box.y, box.width, box.height
    if box.element.kind is ElementKind.STRATEGY:
        slant = 9.0
        return (
            f'<path d="M{x + slant:.1f} {y:.1f}h{width - slant:.1f}l{-slant:.1f} {height:.1f}'
            f'h{slant - width:.1f}z" {style}/>'
        )
    radius = {ElementKind.GOAL: 0.0, ElementKind.SOLUTION: min(height / 2.0, 26.0), ElementKind.CONTEXT: 12.0}
    return (
        f'<rect x="{x:.1f}" y="{y:.1f}" width="{width:.1f}" height="{height:.1f}" '
        f'rx="{radius.get(box.element.kind, 18.0):.1f}" {style}/>'
    )
