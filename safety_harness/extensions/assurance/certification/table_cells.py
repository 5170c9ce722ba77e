"""A table of the evidence report and its cells, which one macro of the page draws."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import TypeVar

from safety_harness.extensions.assurance.certification.argument import STATE
from safety_harness.extensions.assurance.certification.evidence import ClaimStatus
from safety_harness.report.words import with_minus

DASH = "\u2013"

T = TypeVar("T")


@dataclass(frozen=True, kw_only=True)
class TableCell:
    """One cell: ``sort`` is what a sorted column compares, ``state`` the class and icon of a verdict.

    ``href`` leads from it, ``row`` is the id of the row that it begins.
    """

    text: str
    sort: str = ""
    number: bool = False
    state: str = ""
    href: str = ""
    note: str = ""
    row: str = ""


@dataclass(frozen=True)
class CellTable:
    """``head`` names the columns; the first cell of each row names the row."""

    caption: str
    head: tuple[str, ...]
    rows: tuple[tuple[TableCell, ...], ...]


def table_of(caption: str, things: Iterable[T], columns: Mapping[str, Callable[[T], TableCell]]) -> CellTable:
    """A row for each thing, with a cell for each of the named columns."""
    rows = tuple(tuple(cell(one) for cell in columns.values()) for one in things)
    return CellTable(caption, tuple(columns), rows)


def words(text: str, *, href: str = "", note: str = "", row: str = "") -> TableCell:
    """A cell of words."""
    return TableCell(text=text, href=href, note=note, row=row)


def number(text: str, sort: float | None = None, href: str = "") -> TableCell:
    """A cell of a number, sorted by ``sort``, that leads to what it counts."""
    return TableCell(text=text, number=True, sort="" if sort is None else repr(float(sort)), href=href)


def count(value: int, href: str = "") -> TableCell:
    """A cell of a whole number; zero leads nowhere."""
    return number(f"{value:,}".replace(",", "\u202f"), value, href if value else "")


def standing(value: ClaimStatus) -> TableCell:
    """A cell of a claim's standing."""
    return TableCell(text=value.value, state=STATE[value])


def millimetres(length_m: float) -> TableCell:
    """A cell of a length."""
    return number(with_minus(f"{length_m * 1e3:.0f} mm"), length_m)
