"""The table of a recording's CSV file, bounded in size, as text until a track of it is used."""

from __future__ import annotations

import csv
import hashlib
import io
import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from safety_harness.exceptions import Place, RecordingError
from safety_harness.scenario.files import decode
from safety_harness.scenario.units import near_miss, shown

MAX_BYTES = 20_000_000
MAX_ROWS = 200_000  # half an hour at 100 Hz
MAX_COLUMNS = 1_000
TIME_COLUMN = "time_s"
_LARGEST_TIME_S = 1e10  # a clock that counts from 1970 still fits
LARGEST_COORDINATE_M = 100.0
_SHORTEST_STEP_S = 1e-6


@dataclass(frozen=True, eq=False)
class Recording:
    """A recording as it stands in its file: cells are read as numbers only when a track is used."""

    file: Path
    sha256: str
    header: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    line: NDArray[np.int64]  # (n,) of each row in the file
    time_s: NDArray[np.float64]  # (n,) rising strictly

    @property
    def tracks(self) -> tuple[str, ...]:
        """The names of the points that have all three columns."""
        stems = (name.removesuffix("_x_m") for name in self.header if name.endswith("_x_m"))
        return tuple(stem for stem in stems if {f"{stem}_y_m", f"{stem}_z_m"} <= set(self.header))

    def elbow_of(self, track: str) -> str | None:
        """The same side's elbow, ``right_elbow`` for ``right_hand``, if it was recorded."""
        elbow = track.replace("hand", "elbow")
        return elbow if elbow != track and elbow in self.tracks else None


def parse_recording(data: bytes, file: Path) -> Recording:
    """The table in the bytes of a CSV file; RecordingError when there is none with a time column."""
    text = decode(data, most=MAX_BYTES, file=file, error=RecordingError)
    header, rows, lines = _read_table(text, file)
    column = header.index(TIME_COLUMN)
    time_s = np.array(
        [
            number_in(row[column], file, line, TIME_COLUMN, largest=_LARGEST_TIME_S)
            for row, line in zip(rows, lines, strict=True)
        ]
    )
    _check_time(time_s, lines, file)
    return Recording(
        file=file,
        sha256=hashlib.sha256(data).hexdigest(),
        header=header,
        rows=tuple(rows),
        line=np.array(lines, dtype=np.int64),
        time_s=time_s,
    )


def _read_table(text: str, file: Path) -> tuple[tuple[str, ...], list[tuple[str, ...]], list[int]]:
    """Header, rows and the rows' line numbers; empty lines are skipped."""
    reader = csv.reader(io.StringIO(text, newline=""), strict=True)
    rows: list[tuple[str, ...]] = []
    lines: list[int] = []
    try:
        for row in reader:
            if not row:
                continue
            if len(row) > MAX_COLUMNS:
                expected, got = f"at most {MAX_COLUMNS:,} columns", f"{len(row):,}"
                raise recording_error(file, reader.line_num, expected=expected, got=got)
            if len(rows) > MAX_ROWS:  # the first is the header
                raise recording_error(
                    file, reader.line_num, expected=f"at most {MAX_ROWS:,} samples", got="more"
                )
            rows.append(tuple(cell.strip() for cell in row))
            lines.append(reader.line_num)
    except csv.Error as error:
        raise recording_error(
            file, reader.line_num, expected="a table of cells with commas", got=str(error)
        ) from error
    if not rows:
        raise recording_error(file, 1, expected="a line with the names of the columns", got="an empty file")
    header = rows[0]
    if TIME_COLUMN not in header:
        ours = any(name.endswith("_x_m") for name in header)  # nothing is quoted of what may be anybody's
        got = f"the columns {shown(', '.join(header))}" if ours else "none of that name"
        hint = near_miss(TIME_COLUMN, header)
        raise recording_error(file, lines[0], expected=f'a column "{TIME_COLUMN}"', got=got, hint=hint)
    if len(set(header)) < len(header):
        name = next(name for at, name in enumerate(header) if name in header[:at])
        raise recording_error(file, lines[0], name, expected="each column once", got=f'"{shown(name)}" twice')
    for cells, line in zip(rows, lines, strict=True):
        if len(cells) != len(header):
            raise recording_error(
                file, line, expected=f"{len(header)} cells, as in the first line", got=str(len(cells))
            )
    return header, rows[1:], lines[1:]


def _check_time(time_s: NDArray[np.float64], lines: list[int], file: Path) -> None:
    if len(time_s) < 2:
        raise recording_error(file, expected="at least two samples", got=str(len(time_s)))
    for index in np.flatnonzero(~np.isfinite(time_s)):
        raise recording_error(file, lines[index], TIME_COLUMN, expected="a time", got="an empty cell")
    for index in np.flatnonzero(np.diff(time_s) < _SHORTEST_STEP_S):
        got = f"{time_s[index + 1]:.12g} s after {time_s[index]:.12g} s"
        raise recording_error(
            file, lines[index + 1], TIME_COLUMN, expected="a time later than the one before", got=got
        )


def number_in(cell: str, file: Path, line: int, column: str, *, largest: float) -> float:
    """The number in a cell; NaN for an empty one (a gap), for which some programs write nan."""
    if cell.lower() in ("", "nan"):
        return math.nan
    expected = f"a number of at most {largest:g}, or an empty cell for a gap"
    try:
        value = float(cell)
    except ValueError:
        value = math.inf
    if not abs(value) <= largest or "_" in cell:
        raise recording_error(file, line, column, expected=expected, got=shown(cell))
    return value


def recording_error(
    file: Path, line: int | None = None, column: str | None = None, *, expected: str, got: str, hint: str = ""
) -> RecordingError:
    """The error for a place in a recording."""
    place = Place(file=file, line=line, field=column)
    return RecordingError(place=place, expected=expected, got=got, hint=hint)
