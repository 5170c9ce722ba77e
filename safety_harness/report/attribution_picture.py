"""Whose fault the violations are as a picture: a bar for each group, by its share."""

from __future__ import annotations

from collections.abc import Mapping
from xml.etree.ElementTree import Element, SubElement, tostring

from safety_harness.report.svg import Ink, describe, plain
from safety_harness.search.attribution.attribute import AttributionAnswer
from safety_harness.search.attribution.tally import group_words

WIDTH_PX, LEFT_PX, ROW_PX, HEAD_PX = 640, 230, 24, 26
LONGEST_PX = WIDTH_PX - LEFT_PX - 90  # room for the count
INKS = {
    AttributionAnswer.UNAVOIDABLE.value: Ink.MUTED,
    AttributionAnswer.NOTHING_HELPED.value: Ink.LIMIT,
    AttributionAnswer.NOT_ATTRIBUTED.value: Ink.MISSING,
}


def draw_attributions(groups: Mapping[str, int]) -> str:
    """An ``<svg>`` element for a page, or ``standalone``: how many violations each group has."""
    total = sum(groups.values())
    height = HEAD_PX + ROW_PX * max(len(groups), 1)
    size = {"width": str(WIDTH_PX), "height": str(height), "viewBox": f"0 0 {WIDTH_PX} {height}"}
    root = Element("svg", size)
    _text(root, 0, 14, f"{total:,} {'violation' if total == 1 else 'violations'}", Ink.TEXT, weight="600")
    for row, (group, count) in enumerate(groups.items()):
        top = HEAD_PX + ROW_PX * row
        _text(root, 0, top + 15, plain(group, longest=36), Ink.TEXT)
        length = max(LONGEST_PX * count / total, 1.0)
        ink = INKS.get(group, Ink.TCP)
        bar = {"x": str(LEFT_PX), "y": str(top + 3), "width": f"{length:.1f}", "height": str(ROW_PX - 8)}
        SubElement(root, "rect", {**bar, "fill": f"var({ink.variable})"})
        _text(root, LEFT_PX + length + 6, top + 15, f"{count:,} ({count / total:.0%})", Ink.MUTED)
    describe(
        root, prefix="attribution-", title="Whose fault the violations are", description=group_words(groups)
    )
    return tostring(root, encoding="unicode")


def _text(root: Element, x: float, y: float, words: str, ink: Ink, weight: str = "400") -> None:
    attributes = {"x": f"{x:.1f}", "y": str(y), "fill": f"var({ink.variable})", "font-size": "12"}
    SubElement(root, "text", {**attributes, "font-weight": weight}).text = words
