"""The picture of the assurance argument: a tree from left to right, as SVG."""

from __future__ import annotations

import re
import textwrap
from html import escape

from markupsafe import Markup

from safety_harness.extensions.assurance.certification.argument import UNDEVELOPED, Element, ElementKind
from safety_harness.extensions.pages.page_parts import templates
from safety_harness.extensions.pages.svg import plain

WIDTH, PAD, LINE, GAP_X, GAP_Y = 176.0, 10.0, 15.0, 22.0, 12.0
LETTERS = 25  # in a line of a box
_HASH = re.compile(r"\b([0-9a-f]{16})[0-9a-f]{48}\b")
INDENT = 12.0  # of elements beside an element, which the picture draws below it


class _Box:
    """An element of the picture.

    The element has an upper left corner and a size in px. ``lines`` has the text of the element as escaped
    markup.
    """

    def __init__(self, element: Element, x: float, y: float) -> None:
        kind = element.kind.name.lower()
        self.element, self.x, self.y, self.width = element, x, y, WIDTH
        text = _HASH.sub(r"\1...", element.text)  # its digits are wider than letters
        lines = textwrap.wrap(plain(text, longest=140), LETTERS) or [""]
        self.lines = [Markup(escape(line)) for line in (f"{element.key} \u00b7 {kind}", *lines)]
        self.height = 2 * PAD + LINE * len(self.lines)
        self.middle, self.bottom = y + self.height / 2.0, y + self.height


class _Layout:
    """A layout that places every element from left to right, and records the connecting lines."""

    def __init__(self, top: Element) -> None:
        self.boxes: list[_Box] = []
        self.arrows: list[tuple[list[tuple[float, float]], str]] = []  # a line's points, its end's marker
        self.height = self._place(top, GAP_X, GAP_X)[1] + GAP_X
        self.width = max(box.x for box in self.boxes) + WIDTH + GAP_X

    def _place(self, element: Element, x: float, y: float) -> tuple[_Box, float]:
        """Place ``element`` and its whole subtree.

        The upper left corner of ``element`` is at the point (``x``, ``y``) in px. If other elements stand
        beside ``element`` in the argument, they are drawn below its box. If other elements support
        ``element``, they are drawn to the right of its box.

        Returns:
            The box of the element, and the lowest coordinate (px) of the element and its subtree.

        """
        box = self._box(element, x, y)
        bottom = box.bottom + (10.0 if element.undeveloped else 0.0)
        for child in element.beside:
            beside = self._box(child, x + INDENT, bottom + 8.0)
            self.arrows.append(
                ([(x + 4.0, box.bottom), (x + 4.0, beside.middle), (beside.x, beside.middle)], "ring")
            )
            bottom = beside.bottom
        end, rail = y, x + WIDTH + INDENT + GAP_X / 2.0
        for child in element.below:
            below, end = self._place(child, x + WIDTH + GAP_X + INDENT, end)
            line = [(x + WIDTH, box.y + PAD + 8.0), (rail, box.y + PAD + 8.0), (rail, below.y + PAD + 8.0)]
            line.append((below.x, below.y + PAD + 8.0))
            against = child.kind in (ElementKind.DEFEATER, ElementKind.ANSWER)
            self.arrows.append((line[::-1], "against") if against else (line, "tip"))
            end += GAP_Y
        return box, max(bottom, end - GAP_Y)

    def _box(self, element: Element, x: float, y: float) -> _Box:
        self.boxes.append(_Box(element, x, y))
        return self.boxes[-1]


def argument_svg(top: Element, *, prefix: str) -> str:
    """Return the picture of the argument below ``top`` as an ``<svg>`` element.

    Every element links to its place on the page. All ids in the picture begin with ``prefix``.
    """
    drawn = templates("safety_harness.extensions.assurance").get_template("argument.svg.j2")
    return drawn.render(
        layout=_Layout(top), prefix=prefix, pad=PAD, line_height=LINE, undeveloped=UNDEVELOPED
    )
