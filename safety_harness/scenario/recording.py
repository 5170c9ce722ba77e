"""Recorded hands: a CSV file of marker positions becomes a motion in the robot's base frame.

The file has a column ``time_s`` and, for each tracked point, ``<track>_x_m``, ``<track>_y_m`` and
``<track>_z_m``.  Real recordings have gaps (empty cells) and swapped markers (jumps of several
metres a second); both are mended by straight motion as far as the user's bounds allow, reported
in words, and refused beyond.  Nothing is smoothed.
"""

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
from safety_harness.scenario.model import RecordedMotion
from safety_harness.scenario.tracks import MendedTrack, Track, mend
from safety_harness.scenario.units import near_miss, shown
from safety_harness.settings import Vector3

MAX_BYTES = 64_000_000
_TIME = "time_s"
_LARGEST_TIME_S = 1e10  # a clock that counts from 1970 still fits
_LARGEST_COORDINATE_M = 100.0
_SHORTEST_STEP_S = 1e-6
_NEAREST_ELBOW_M = 1e-3


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
    if _TIME not in header:
        got = f"the columns {shown(', '.join(header))}"
        raise _error(file, 1, expected=f'a column "{_TIME}"', got=got, hint=near_miss(_TIME, header))
    column = header.index(_TIME)
    time_s = np.array(
        [
            _number(row[column], file, line, _TIME, largest=_LARGEST_TIME_S)
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


def load_recording(
    recording: Recording,
    *,
    track: str,
    elbow_track: str | None,
    elbow_towards_in_base_m: Vector3 | None,
    forearm_length_m: float,
    starts_at_in_base_m: Vector3,
    turn_rad: float,
    speed_factor: float,
    from_s: float | None,
    to_s: float | None,
    longest_gap_s: float,
    fastest_jump_mps: float,
) -> RecordedMotion:
    """The recording's window, mended, turned about the vertical and put where the user wants it.

    The first used sample of ``track`` comes to ``starts_at_in_base_m`` at time 0.  Gaps and jumps
    are measured in the recording's own time, before ``speed_factor``.  The elbow is that of
    ``elbow_track``; without one it lies ``forearm_length_m`` from the hand towards
    ``elbow_towards_in_base_m``.  RecordingError says what cannot be used, and where.
    """
    window_s = _window(recording, from_s, to_s)
    names = (track,) if elbow_track is None else (track, elbow_track)
    mended = [
        mend(
            _track(recording, name, window_s),
            longest_gap_s=longest_gap_s,
            fastest_jump_mps=fastest_jump_mps,
        )
        for name in names
    ]
    time_s = _common_times(mended, recording.file)
    hand_m = mended[0].at(time_s)
    turned = _turned(hand_m - hand_m[0], turn_rad)
    hand_in_base_m = turned + np.array(starts_at_in_base_m)
    if elbow_track is not None:
        turned = _turned(mended[1].at(time_s) - hand_m[0], turn_rad)
        elbow_in_base_m = turned + np.array(starts_at_in_base_m)
    else:
        assert elbow_towards_in_base_m is not None
        elbow_in_base_m = _elbows_towards(
            elbow_towards_in_base_m, hand_in_base_m, forearm_length_m, recording.file
        )
    return RecordedMotion(
        time_s=(time_s - time_s[0]) / speed_factor,
        hand_position_in_base_m=hand_in_base_m,
        elbow_position_in_base_m=elbow_in_base_m,
        notes=tuple(one.note for one in mended if one.note),
        sha256=recording.sha256,
    )


def _read_table(text: str, file: Path) -> tuple[tuple[str, ...], list[tuple[str, ...]], list[int]]:
    """Header, rows and the rows' line numbers; empty lines are skipped."""
    reader = csv.reader(io.StringIO(text, newline=""), strict=True)
    rows: list[tuple[str, ...]] = []
    lines: list[int] = []
    try:
        for row in reader:
            if row:
                rows.append(tuple(cell.strip() for cell in row))
                lines.append(reader.line_num)
    except csv.Error as error:
        raise _error(
            file, reader.line_num, expected="a table of cells with commas", got=str(error)
        ) from error
    if not rows:
        raise _error(file, 1, expected="a line with the names of the columns", got="an empty file")
    header = rows[0]
    if len(set(header)) < len(header):
        name = next(name for at, name in enumerate(header) if name in header[:at])
        raise _error(file, lines[0], name, expected="each column once", got=f'"{shown(name)}" twice')
    for cells, line in zip(rows, lines, strict=True):
        if len(cells) != len(header):
            raise _error(
                file, line, expected=f"{len(header)} cells, as in the first line", got=str(len(cells))
            )
    return header, rows[1:], lines[1:]


def _check_time(time_s: NDArray[np.float64], lines: list[int], file: Path) -> None:
    if len(time_s) < 2:
        raise _error(file, expected="at least two samples", got=str(len(time_s)))
    for index in np.flatnonzero(~np.isfinite(time_s)):
        raise _error(file, lines[index], _TIME, expected="a time", got="an empty cell")
    for index in np.flatnonzero(np.diff(time_s) < _SHORTEST_STEP_S):
        got = f"{time_s[index + 1]:.12g} s after {time_s[index]:.12g} s"
        raise _error(file, lines[index + 1], _TIME, expected="a time later than the one before", got=got)


def _number(cell: str, file: Path, line: int, column: str, *, largest: float) -> float:
    """The number in a cell; NaN for an empty one (a gap), for which some programs write nan."""
    if cell.lower() in ("", "nan"):
        return math.nan
    expected = f"a number of at most {largest:g}, or an empty cell for a gap"
    try:
        value = float(cell)
    except ValueError:
        value = math.inf
    if not abs(value) <= largest or "_" in cell:
        raise _error(file, line, column, expected=expected, got=shown(cell))
    return value


def _window(recording: Recording, from_s: float | None, to_s: float | None) -> tuple[float, float]:
    """From when to when the recording is used, on its own clock."""
    first_s, last_s = float(recording.time_s[0]), float(recording.time_s[-1])
    begin_s = first_s if from_s is None else from_s
    end_s = last_s if to_s is None else to_s
    if not first_s <= begin_s < end_s <= last_s:
        raise _error(
            recording.file,
            column=_TIME,
            expected=f'"from" before "to", both from {first_s:.12g} s to {last_s:.12g} s',
            got=f"from {begin_s:.12g} s to {end_s:.12g} s",
        )
    return begin_s, end_s


def _track(recording: Recording, name: str, window_s: tuple[float, float]) -> Track:
    """The samples of one point within the window."""
    if name not in recording.tracks:
        raise _error(
            recording.file,
            1,
            name,
            expected=f"one of the tracks {', '.join(map(shown, recording.tracks)) or '(there is none)'}",
            got=shown(name),
            hint=near_miss(name, recording.tracks),
        )
    inside = np.flatnonzero((recording.time_s >= window_s[0]) & (recording.time_s <= window_s[1]))
    columns = [(column, recording.header.index(column)) for column in (f"{name}_{axis}_m" for axis in "xyz")]
    position_m = [
        [
            _number(
                recording.rows[row][at],
                recording.file,
                int(recording.line[row]),
                column,
                largest=_LARGEST_COORDINATE_M,
            )
            for column, at in columns
        ]
        for row in inside
    ]
    return Track(
        name=name,
        file=recording.file,
        time_s=recording.time_s[inside],
        position_m=np.array(position_m, dtype=np.float64).reshape(-1, 3),
        line=recording.line[inside],
        window_s=window_s,
    )


def _common_times(mended: list[MendedTrack], file: Path) -> NDArray[np.float64]:
    """The times of samples usable in any track, from when all are known until one is no more."""
    begin_s = max(float(one.track.time_s[one.usable][0]) for one in mended)
    end_s = min(float(one.track.time_s[one.usable][-1]) for one in mended)
    any_usable = np.logical_or.reduce([one.usable for one in mended])
    time_s = mended[0].track.time_s[any_usable]
    time_s = time_s[(time_s >= begin_s) & (time_s <= end_s)]
    if len(time_s) < 2:
        names = " and ".join(one.track.name for one in mended)
        raise _error(file, expected=f"at least two samples with {names}", got=str(len(time_s)))
    return time_s


def _turned(vector: NDArray[np.float64], angle_rad: float) -> NDArray[np.float64]:
    """(n, 3) turned about z; written out, since a matrix product may round otherwise elsewhere."""
    cosine, sine = math.cos(angle_rad), math.sin(angle_rad)
    x, y, z = vector.T
    return np.stack([cosine * x - sine * y, sine * x + cosine * y, z], axis=1)


def _elbows_towards(
    towards_in_base_m: Vector3, hand_in_base_m: NDArray[np.float64], length_m: float, file: Path
) -> NDArray[np.float64]:
    """(n, 3) elbows ``length_m`` from the hand towards one point."""
    forearm = np.array(towards_in_base_m) - hand_in_base_m
    distance_m = np.linalg.norm(forearm, axis=1, keepdims=True)
    if distance_m.min() < _NEAREST_ELBOW_M:
        raise _error(
            file, expected='"elbow towards" off the way of the hand', got="a hand that passes through it"
        )
    elbows: NDArray[np.float64] = hand_in_base_m + length_m * forearm / distance_m
    return elbows


def _error(
    file: Path, line: int | None = None, column: str | None = None, *, expected: str, got: str, hint: str = ""
) -> RecordingError:
    place = Place(file=file, line=line, field=column)
    return RecordingError(place=place, expected=expected, got=got, hint=hint)
