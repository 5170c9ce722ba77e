"""Read streams in tables (CSV, Parquet); a column's name consists of track, axis and unit.

For example, the column ``right_hand_x_mm`` has the x coordinate of the track ``right_hand`` in millimetres.
If a column's name has no unit, LOG.yaml must state the unit of the whole stream. An empty cell or NaN is an
unmeasured sample.
"""

from __future__ import annotations

import csv
import math
import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from decimal import Decimal, InvalidOperation
from os import SEEK_END
from pathlib import Path
from typing import Any

import numpy as np

from safety_harness.base.exceptions import LogError, Place, near_miss
from safety_harness.base.extras import LOGS
from safety_harness.extensions.field.logs.streams import LATEST_S, NS, Collector, LogSource
from safety_harness.scenario.units import shown

MOST_COLUMNS, MOST_NAMES_BYTES = 10_000, 1_000_000  # a choice: more columns come from a file that is no table
ROWS_AT_ONCE = 8_192  # of a Parquet file, to limit the memory; a choice
TIME_UNITS = {"s": 10**9, "ms": 10**6, "us": 10**3, "ns": 1}  # in nanoseconds
LENGTH_UNITS = {"m": 1.0, "cm": 1e-2, "mm": 1e-3}
ANGLE_UNITS = {"rad": 1.0, "deg": math.pi / 180.0}
SEPARATORS = ("\t", ";", ",")  # or spaces, where the line of names has none of these
RTDE_JOINTS, RTDE_TIME = ("actual_q_", "actual_qd_"), "timestamp in s"
RTDE_TCP, RTDE_BASE = "actual_TCP_pose", np.diag([-1.0, -1.0, 1.0, 1.0])  # UR's base frame, in base_link's
SPEED_UNITS = {f"{unit}ps": si for unit, si in LENGTH_UNITS.items()}
RATE_UNITS = {"radps": 1.0, "degps": math.pi / 180.0}
_TIME_HINT = (
    'the key "time" states another column, such as: stamp in ns; without times, hands: {rate: 120 Hz}'
)
_EXACT_BELOW = 1e6  # as a float, a smaller number of any unit of time has enough digits for nanoseconds


@dataclass(frozen=True)
class TableColumn:
    """A column of a table.

    If the column contains numbers, ``si`` is the factor that converts them to SI units. If it contains texts,
    ``words`` maps them to numbers.
    """

    name: str
    si: float
    words: Mapping[str, float] | None = None


@dataclass(frozen=True)
class Table:
    """The columns of a stream, the name of its time column, and the unit of its times [ns].

    If there is no time column, ``time`` is empty, and the time increases by ``time_ns`` from row to row.
    """

    time: str
    time_ns: float
    columns: tuple[TableColumn | None, ...]


def header_of(source: LogSource) -> tuple[str, ...]:
    """Return the names of a table's columns; raise LogError if the file has none."""
    if source.ending == ".parquet":
        with _parquet(source) as file:
            names = tuple(file.schema_arrow.names)
    else:
        with _rows(source.file) as rows:
            _, first = next(rows, (1, []))
            names = tuple(cell.strip() for cell in first)
    for at, name in enumerate(names):
        if name in names[:at]:
            raise _error(source, "each column once", f'"{shown(name)}" twice', line=1)
    if not names or len(names) > MOST_COLUMNS:
        raise _error(source, f"1 to {MOST_COLUMNS:,} named columns", str(len(names)), line=1)
    return names


def time_column(
    source: LogSource, names: Sequence[str], stated: str | None, rate_hz: float | None = None
) -> tuple[str, float]:
    """Return the name of the time column, and its unit [ns].

    Args:
        source: The table.
        names: The names of its columns.
        stated: The time column that LOG.yaml states, or None to find a column such as ``time_s``.
        rate_hz: The rate of a table without times, or None if the table has times. With a rate, the returned
            name is empty, and the unit is the time per row.

    Raises:
        LogError: No column fits, several columns fit, or a table for which a rate is stated also has times.

    """
    if rate_hz is not None:
        got = stated or next((name for unit in TIME_UNITS if (name := f"time_{unit}") in names), None)
        if got is not None:
            raise _error(source, 'no column of times, where the file says a "rate"', got, line=1)
        return "", NS / rate_hz
    if stated is not None:
        name, _, unit = stated.partition(" in ")
        unit = unit or name.rpartition("_")[2]
        if name not in names:
            raise _error(
                source,
                f'the column "{name}", which the file states as the time',
                "no such column",
                near_miss(name, names),
                line=1,
            )
        if unit not in TIME_UNITS:
            expected = f"a unit of the time, as in {name}_ms or in the words {name} in ms"
            raise LogError(place=source.place, expected=expected, got=stated, hint=", ".join(TIME_UNITS))
        return name, TIME_UNITS[unit]
    matches = [(name, unit) for unit in TIME_UNITS if (name := f"time_{unit}") in names]
    if len(matches) != 1:
        expected = "one column time_s, time_ms, time_us or time_ns"
        got = " and ".join(name for name, _ in matches) or f"the columns {shown(', '.join(names))}"
        raise _error(source, expected, got, _TIME_HINT, line=1)
    return matches[0][0], TIME_UNITS[matches[0][1]]


def optional_column(
    source: LogSource,
    names: Sequence[str],
    stem: str,
    units: dict[str, float],
    unit: str | None,
    *,
    bare: bool = True,
) -> TableColumn | None:
    """Return the column for the quantity ``stem``, or None if there is no such column.

    The unit of the column must be stated, either at the end of its name or in LOG.yaml.

    Args:
        source: The table.
        names: The names of its columns.
        stem: The beginning of the name.
        units: The possible units in SI.
        unit: The unit that LOG.yaml states, or None.
        bare: True to reject a column ``stem`` whose unit is not stated. If False, such a column is ignored as
            another quantity.

    """
    matches = [TableColumn(name, si) for item, si in units.items() if (name := f"{stem}_{item}") in names]
    if stem in names and unit is not None:
        matches.append(TableColumn(stem, units[unit]))
    if len(matches) > 1:
        raise _error(source, f"one column of {stem}", " and ".join(item.name for item in matches), line=1)
    if not matches and bare and stem in names:
        ends = " or ".join(f"{stem}_{item}" for item in units)
        raise _error(source, f'a unit: {ends} as the name of the column, or the key "unit"', stem, line=1)
    return matches[0] if matches else None


def required_column(
    source: LogSource, names: Sequence[str], stem: str, units: dict[str, float], unit: str | None
) -> TableColumn:
    """Return the column as ``optional_column`` does; raise LogError if it is missing."""
    column = optional_column(source, names, stem, units, unit)
    if column is None:
        wanted = [f"{stem}_{ending}" for ending in units]
        hint = near_miss(wanted[0], names) or f"the columns: {shown(', '.join(names))}"
        raise _error(source, f"a column {' or '.join(wanted)}", "no such column", hint, line=1)
    return column


def along(track: str, axis: str) -> str:
    """Return the name of a track's column for ``axis``, without the unit.

    The name of the track may be empty.
    """
    return f"{track}_{axis}" if track else axis


def tracks_of(header: tuple[str, ...], *, bare: bool) -> set[str]:
    """Return the names of all tracks in a table.

    A track consists of columns for x, y and z that have the same unit of length. If ``bare`` is True, columns
    without a unit can also be a track. If the columns' names are only x, y and z, the track's name is empty.
    """
    ends = (*(f"_{unit}" for unit in LENGTH_UNITS), *[""] * bare)
    stems = {(name[: -len(f"_x{end}")], end) for name in header for end in ends if name.endswith(f"_x{end}")}
    stems |= {("", end) for end in ends if f"x{end}" in header}
    return {stem for stem, end in stems if {along(stem, f"{axis}{end}") for axis in "yz"} <= set(header)}


def only_track(source: LogSource, header: tuple[str, ...]) -> str:
    """Return the only track of a table; raise LogError if there is no track or if there are several."""
    tracks = sorted(tracks_of(header, bare=True))
    if len(tracks) != 1:
        got = ", ".join(tracks) or f"the columns {', '.join(header)}"
        expected = f"which track, such as {source.file.name}#right_hand"
        raise LogError(place=source.place, expected=expected, got=got)
    return tracks[0]


def read_table(table: Table, collector: Collector) -> None:
    """Add every row to ``collector``; raise LogError with the line or row of a cell that is not a number."""
    source = collector.source
    wanted = tuple(col.name for col in table.columns if col is not None)
    wanted = (table.time, *wanted) if table.time else wanted
    source.seen.update(header_of(source))
    source.used.update(wanted)
    parquet, first = source.ending == ".parquet", None
    for at, cells in _parquet_cells(source, table, wanted) if parquet else _csv_cells(source, wanted):
        rest, first = iter(cells), at if first is None else first
        try:
            since = round((at - first) * table.time_ns)  # an empty line is a sample that was lost
            time_ns = _time(next(rest), table, source, at) if table.time else since
        except LogError as refused:
            collector.unstamped(refused)
            continue
        values = [math.nan if col is None else _cell(next(rest), col, source, at) for col in table.columns]
        collector.add(time_ns, values, at)


def _csv_cells(source: LogSource, wanted: Sequence[str]) -> Iterator[tuple[int, Sequence[Any]]]:
    """Yield each line's number, and its cells in the ``wanted`` columns."""
    with source.file.open("rb") as data:
        data.seek(-1, SEEK_END)
        cut_off = data.read() not in (b"\n", b"\r")
    with _rows(source.file) as rows:
        line, row = next(rows)
        names = [cell.strip() for cell in row]
        cells_at = [names.index(name) for name in wanted]
        for line, row in rows:
            if not row:
                continue
            if len(row) != len(names):
                expected = f"{len(names)} cells, as in the first line"
                raise _error(source, expected, str(len(row)), line=line)
            yield line, [row[at] for at in cells_at]
    if cut_off:
        expected, got = "a line end after the last line", f"the end of the file after {row[-1]!r}"
        hint = "it may be cut off within a number; if it is whole, end it with a line end, in a copy"
        raise _error(source, expected, got, hint, line=line)


def _parquet_cells(
    source: LogSource, table: Table, wanted: Sequence[str]
) -> Iterator[tuple[int, Sequence[Any]]]:
    """Yield each row's number, and its cells in the ``wanted`` columns."""
    with _parquet(source) as file:
        _refuse_types(source, file.schema_arrow, table)
        row = 0
        for batch in file.iter_batches(batch_size=ROWS_AT_ONCE, columns=list(dict.fromkeys(wanted))):
            columns = {name: batch.column(name).to_pylist() for name in batch.schema.names}
            for cells in zip(*(columns[name] for name in wanted), strict=True):
                row += 1
                yield row, cells


def _refuse_types(source: LogSource, schema: Any, table: Table) -> None:
    """Raise LogError if a Parquet column has booleans or times, because they would be misread as numbers."""
    columns = [column.name for column in table.columns if column is not None and column.words is None]
    for name in [*[table.time] * bool(table.time), *columns]:
        kind = str(schema.field(name).type)
        if kind == "bool" or kind.startswith(("timestamp", "duration", "date", "time")):
            hint = 'whole nanoseconds, in a copy: column.cast("timestamp[ns]").cast("int64") of pyarrow'
            raise _error(source, "a column of numbers", kind, hint * (kind != "bool"), field=name)


def as_word(cell: object) -> str:
    """Return the content of a cell as a text that can be looked up in the table of words.

    Some programs log a number instead of a word.
    """
    if isinstance(cell, float) and cell.is_integer():
        return str(int(cell))
    return "" if cell is None else str(cell).strip()


def _time(cell: Any, table: Table, source: LogSource, at: int) -> int:
    """Return the time in a cell [ns].

    If a float has too few digits for the time, the function uses the decimal text of the cell.
    """
    try:
        value = float(cell)
        # Python's ``float`` accepts 1_000, but a cell with an underscore is a mistake.
        if isinstance(cell, str) and "_" in cell:
            raise ValueError
        if abs(value) * table.time_ns > LATEST_S * NS:
            expected = f"a time within {LATEST_S:g} s of 0"
            got, hint = f"{value * table.time_ns / NS:.6g} s", 'its unit? the key "time" says it: stamp in ns'
            raise _error(source, expected, got, hint, field=table.time, line=at)
        if isinstance(cell, int):
            return cell * int(table.time_ns)
        if abs(value) < _EXACT_BELOW or not isinstance(cell, str):
            return round(value * table.time_ns)
        return int((Decimal(cell.strip()) * int(table.time_ns)).to_integral_value())
    except (TypeError, ValueError, OverflowError, InvalidOperation):
        raise _error(
            source, "a time", shown(str(cell)) or "an empty cell", field=table.time, line=at
        ) from None


def _cell(cell: Any, col: TableColumn, source: LogSource, at: int) -> float:
    """Return the number in a cell, or NaN if the cell is empty.

    The number is in SI units. If the cell contains a word, the column maps the word to a number.
    """
    if col.words is not None:
        term = as_word(cell)
        if term not in col.words:
            hint = near_miss(term, col.words)
            raise _error(
                source, f"one of {', '.join(col.words)}", shown(term) or "none", hint, field=col.name, line=at
            )
        return col.words[term]
    text = cell.strip() if isinstance(cell, str) else cell
    if text is None or text == "":
        return math.nan
    try:
        value = float(text)
    except (TypeError, ValueError):
        value = math.inf
    if math.isinf(value) or (isinstance(text, str) and "_" in text):
        expected = "a number, or an empty cell for a missing measurement"
        raise _error(source, expected, shown(str(cell)), field=col.name, line=at)
    return value * col.si


def _separator(path: Path) -> str:
    """Return the separator of the cells in a CSV file.

    It is derived from the line with the names of the columns. If it is a space, several successive spaces are
    one separator.
    """
    with path.open("rb") as data:
        names = data.readline(MOST_NAMES_BYTES).decode("utf-8-sig", "replace").strip()
    unquoted = re.sub(r'"[^"]*"', "", names)
    sep = max(SEPARATORS, key=unquoted.count)
    return sep if sep in unquoted else " " if " " in unquoted else ","


@contextmanager
def _rows(path: Path) -> Iterator[Iterator[tuple[int, list[str]]]]:
    """Yield an iterator of (line number, cells) that reads the rows of a CSV file one by one."""
    try:
        with path.open(encoding="utf-8-sig", newline="") as text:
            sep = _separator(path)
            lines = (f"{line.strip()}\n" for line in text) if sep == " " else text
            reader = csv.reader(lines, strict=True, delimiter=sep, skipinitialspace=sep == " ")

            def rows() -> Iterator[tuple[int, list[str]]]:
                while True:
                    try:
                        row = next(reader)
                    except StopIteration:
                        return
                    except csv.Error as error:
                        place = Place(file=path, line=reader.line_num)
                        raise LogError(
                            place=place,
                            expected=f"a table of cells with {sep!r} between them",
                            got=str(error),
                        ) from error
                    except UnicodeDecodeError as error:
                        place = Place(file=path, line=reader.line_num + 1)
                        raise LogError(place=place, expected="text in UTF-8", got=str(error)) from error
                    yield reader.line_num, row

            yield rows()
    except OSError as error:
        raise LogError(place=Place(file=path), expected="a file that can be read", got=str(error)) from error


@contextmanager
def _parquet(source: LogSource) -> Iterator[Any]:
    with LOGS.needed("logs in Parquet files", source.file):
        from pyarrow.parquet import ParquetFile
    try:
        with ParquetFile(source.file) as file:
            yield file
    except LogError:
        raise
    except Exception as error:  # a damaged file may raise anything
        place = Place(file=source.file)
        raise LogError(
            place=place, expected="a Parquet file, whole", got=f"{type(error).__name__}: {error}"
        ) from error


def _error(
    source: LogSource,
    expected: str,
    got: str,
    hint: str = "",
    *,
    field: str | None = None,
    line: int | None = None,
) -> LogError:
    """Return a LogError that refers to a line of a CSV file or to a row of a Parquet file."""
    if source.ending == ".parquet":
        field = f"row {line}" + (f": {field}" if field else "") if line else field
        line = None
    place = Place(file=source.file, line=line, field=field)
    return LogError(place=place, expected=expected, got=got, hint=hint)
