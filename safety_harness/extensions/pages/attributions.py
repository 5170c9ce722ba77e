"""Draw how often each cause of violations occurs."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from xml.etree.ElementTree import Element, SubElement, tostring

from safety_harness.base.whole_file import write_text
from safety_harness.extensions.attribution.attribute import AttributionAnswer
from safety_harness.extensions.attribution.tally import group_words
from safety_harness.extensions.pages.page_parts import asset
from safety_harness.extensions.pages.svg import Ink, describe, plain, standalone

WIDTH_PX, LEFT_PX, ROW_PX, HEAD_PX = 640, 230, 24, 26
LONGEST_PX = WIDTH_PX - LEFT_PX - 90  # leaves room for the count
INKS = {
    AttributionAnswer.UNAVOIDABLE.value: Ink.MUTED,
    AttributionAnswer.NOTHING_HELPED.value: Ink.LIMIT,
    AttributionAnswer.NOT_ATTRIBUTED.value: Ink.MISSING,
}


def draw_attributions(groups: Mapping[str, int]) -> str:
    """Draw how many violations each cause has, as an ``<svg>`` element for a page or for ``standalone``."""
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


def write_attributions(path: Path, groups: Mapping[str, int]) -> None:
    """Draw the number of violations in each of ``groups`` as an SVG file."""
    write_text(path, standalone(draw_attributions(groups), style=asset("report.css")))


def _text(root: Element, x: float, y: float, text: str, ink: Ink, weight: str = "400") -> None:
    attributes = {"x": f"{x:.1f}", "y": str(y), "fill": f"var({ink.variable})", "font-size": "12"}
    SubElement(root, "text", {**attributes, "font-weight": weight}).text = text
