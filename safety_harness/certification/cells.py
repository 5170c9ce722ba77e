"""Cells and tables of the evidence report: one macro of the page draws them all."""

from __future__ import annotations

from dataclasses import dataclass

from safety_harness.certification.argument import STATE
from safety_harness.certification.evidence import ClaimStatus

DASH = "\u2013"


@dataclass(frozen=True, kw_only=True)
class TableCell:
    """One cell: ``sort`` is what a sorted column compares, ``state`` the class and icon of a verdict."""

    text: str
    sort: str = ""
    number: bool = False
    state: str = ""
    href: str = ""
    note: str = ""


@dataclass(frozen=True, kw_only=True)
class CellTable:
    """``head`` names the columns; the first cell of each row names the row."""

    caption: str
    head: tuple[str, ...]
    rows: tuple[tuple[TableCell, ...], ...]


def words(text: str, *, href: str = "", note: str = "") -> TableCell:
    """A cell of words."""
    return TableCell(text=text, href=href, note=note)


def number(text: str, sort: float | None = None) -> TableCell:
    """A cell of a number, sorted by ``sort``."""
    return TableCell(text=text, number=True, sort="" if sort is None else repr(float(sort)))


def count(value: int) -> TableCell:
    """A cell of a whole number."""
    return number(f"{value:,}".replace(",", "\u202f"), value)


def standing(value: ClaimStatus) -> TableCell:
    """A cell of a claim's standing."""
    return TableCell(text=value.value, state=STATE[value])
