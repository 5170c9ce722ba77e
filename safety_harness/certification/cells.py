"""Cells and tables of the evidence report: one macro of the page draws them all."""

from __future__ import annotations

from dataclasses import dataclass

from safety_harness.certification.argument import STATE
from safety_harness.certification.evidence import Standing

DASH = "\u2013"


@dataclass(frozen=True, kw_only=True)
class Cell:
    """One cell: ``sort`` is what a sorted column compares, ``state`` the class and icon of a verdict."""

    text: str
    sort: str = ""
    number: bool = False
    state: str = ""
    href: str = ""
    note: str = ""


@dataclass(frozen=True, kw_only=True)
class Table:
    """``head`` names the columns; the first cell of each row names the row."""

    caption: str
    head: tuple[str, ...]
    rows: tuple[tuple[Cell, ...], ...]


def words(text: str, *, href: str = "", note: str = "") -> Cell:
    """A cell of words."""
    return Cell(text=text, href=href, note=note)


def number(text: str, sort: float | None = None) -> Cell:
    """A cell of a number, sorted by ``sort``."""
    return Cell(text=text, number=True, sort="" if sort is None else repr(float(sort)))


def count(value: int) -> Cell:
    """A cell of a whole number."""
    return number(f"{value:,}".replace(",", "\u202f"), value)


def standing(value: Standing) -> Cell:
    """A cell of a claim's standing."""
    return Cell(text=value.value, state=STATE[value])
