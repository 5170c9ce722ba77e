"""The tables of the evidence report and their cells, which a single macro of the page draws."""

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
    """A cell of a table.

    A sorted column compares ``sort``. ``state`` is the class and the icon of a verdict. ``href`` is the id to
    which the cell links. ``row`` is the id of the row that begins with this cell.
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
    """A table.

    ``head`` has the names of the columns, and the first cell of each row identifies the row.
    """

    caption: str
    head: tuple[str, ...]
    rows: tuple[tuple[TableCell, ...], ...]


def table_of(caption: str, things: Iterable[T], columns: Mapping[str, Callable[[T], TableCell]]) -> CellTable:
    """Return a table with a row for each of ``things``.

    Args:
        caption: The text above the table.
        things: The objects, one for each row.
        columns: A mapping from the name of each column to a function, which returns the column's cell for an
            object.

    """
    rows = tuple(tuple(cell(thing) for cell in columns.values()) for thing in things)
    return CellTable(caption, tuple(columns), rows)


def text_cell(text: str, *, href: str = "", note: str = "", row: str = "") -> TableCell:
    """Return a cell that contains ``text`` and the remark ``note``.

    The cell links to ``href``, and ``row`` is the id of its row.
    """
    return TableCell(text=text, href=href, note=note, row=row)


def number(text: str, sort: float | None = None, href: str = "") -> TableCell:
    """Return a cell with the number ``text``.

    The column of the cell is sorted by ``sort``. The cell links to the counted items at ``href``.
    """
    return TableCell(text=text, number=True, sort="" if sort is None else repr(float(sort)), href=href)


def count(value: int, href: str = "") -> TableCell:
    """Return a cell with the whole number ``value``.

    The cell links to ``href`` unless the number is zero.
    """
    return number(f"{value:,}".replace(",", "\u202f"), value, href if value else "")


def standing(value: ClaimStatus) -> TableCell:
    """Return a cell with the claim status ``value``."""
    return TableCell(text=value.value, state=STATE[value])


def millimetres(length_m: float) -> TableCell:
    """Return a cell with ``length_m`` in mm."""
    return number(with_minus(f"{length_m * 1e3:.0f} mm"), length_m)
