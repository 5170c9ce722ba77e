"""Read recorded hands: a CSV file of marker positions becomes a motion in the robot's base frame.

The file has a column ``time_s``. For each tracked point, it has the columns ``<track>_x_m``, ``<track>_y_m``
and ``<track>_z_m``. The size of the table is limited. The cells of the table are converted to numbers only
when a hand uses their track.

Real recordings have gaps (empty cells) and swapped markers (jumps of several metres per second). Up to the
user's limits, gaps and jumps are bridged by straight motion, and notes describe them. Larger gaps and jumps
raise an error. The module smooths no position.
"""

from __future__ import annotations

import csv
import hashlib
import io
import itertools
import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property, lru_cache
from pathlib import Path
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from safety_harness.base.elementary import cos, length, sin
from safety_harness.base.exceptions import Place, RecordingError, near_miss
from safety_harness.base.settings import Vector3
from safety_harness.scenario.files import decode
from safety_harness.scenario.model import RecordedHand, RecordedMotion
from safety_harness.scenario.moves import shifted
from safety_harness.scenario.units import shown

MAX_BYTES = 20_000_000  # a limit of the memory; a choice
MAX_ROWS = 200_000  # half an hour at 100 Hz
MAX_COLUMNS = 1_000  # a choice
TIME_COLUMN = "time_s"
_LARGEST_TIME_S = 1e10  # a clock that counts from 1970 still fits
LARGEST_COORDINATE_M = 100.0  # a larger coordinate means a mistaken unit
_SHORTEST_STEP_S = 1e-6  # between two rows
_NEAREST_ELBOW_M = 1e-3  # from the hand; nearer, the forearm has no direction
_MISSING_ROWS = 1.5  # sampling periods; if two rows are farther apart, rows are missing
_ROUNDING_S = 1e-9  # 10.67 - 10.47 is not quite 0.2
_ADVICE = 'leave it out with "from" and "to", or raise "longest gap"'


@dataclass(frozen=True, eq=False)
class Recording:
    """A recording as it is in its file.

    The reader converts the cells of a track to numbers only when a hand uses this track.
    """

    file: Path
    sha256: str
    header: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    line: NDArray[np.int64]  # (n,) of each row in the file
    time_s: NDArray[np.float64]  # (n,) rising strictly

    @property
    def tracks(self) -> tuple[str, ...]:
        """The names of the points for which the file has all three columns."""
        stems = (name.removesuffix("_x_m") for name in self.header if name.endswith("_x_m"))
        return tuple(stem for stem in stems if {f"{stem}_y_m", f"{stem}_z_m"} <= set(self.header))

    def elbow_of(self, track: str) -> str | None:
        """Return the elbow on the same side as ``track``, or None.

        For example, the elbow of ``right_hand`` is ``right_elbow``.
        """
        elbow = track.replace("hand", "elbow")
        return elbow if elbow != track and elbow in self.tracks else None


@lru_cache(maxsize=8)  # once for all the scenarios that repeat the same bytes
def parse_recording(data: bytes, file: Path) -> Recording:
    """Return the recording in the bytes of a CSV file.

    Raise RecordingError if they are not a table with a time column.
    """
    text = decode(data, most=MAX_BYTES, file=file, error=RecordingError)
    header, rows, lines = _read_table(text, file)
    column = header.index(TIME_COLUMN)
    time_s = np.array(
        [
            _number(row[column], file, line, TIME_COLUMN, _LARGEST_TIME_S)
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
    """Return the header, the rows and the rows' line numbers.

    The result omits empty lines.
    """
    reader = csv.reader(io.StringIO(text, newline=""), strict=True)
    rows: list[tuple[str, ...]] = []
    lines: list[int] = []
    try:
        for row in reader:
            if not row:
                continue
            if len(row) > MAX_COLUMNS:
                expected, got = f"at most {MAX_COLUMNS:,} columns", f"{len(row):,}"
                raise _error(file, reader.line_num, expected=expected, got=got)
            if len(rows) > MAX_ROWS:  # the first is the header
                raise _error(file, reader.line_num, expected=f"at most {MAX_ROWS:,} samples", got="more")
            rows.append(tuple(cell.strip() for cell in row))
            lines.append(reader.line_num)
    except csv.Error as error:
        raise _error(
            file, reader.line_num, expected="a table of cells with commas", got=str(error)
        ) from error
    if not rows:
        raise _error(file, 1, expected="a line with the names of the columns", got="an empty file")
    header = rows[0]
    if TIME_COLUMN not in header:
        ours = any(name.endswith("_x_m") for name in header)  # no quote: a foreign file may be secret
        got = f"the columns {shown(', '.join(header))}" if ours else "none of that name"
        hint = near_miss(TIME_COLUMN, header)
        raise _error(file, lines[0], expected=f'a column "{TIME_COLUMN}"', got=got, hint=hint)
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
    """Raise RecordingError if there are fewer than two samples, or if the times do not rise."""
    if len(time_s) < 2:
        raise _error(file, expected="at least two samples", got=str(len(time_s)))
    for index in np.flatnonzero(~np.isfinite(time_s)):
        raise _error(file, lines[index], TIME_COLUMN, expected="a time", got="an empty cell")
    for index in np.flatnonzero(np.diff(time_s) < _SHORTEST_STEP_S):
        got = f"{time_s[index + 1]:.12g} s after {time_s[index]:.12g} s"
        expected = "a time later than the one before"
        raise _error(file, lines[index + 1], TIME_COLUMN, expected=expected, got=got)


def _number(cell: str, file: Path, line: int | np.int64, column: str, largest: float) -> float:
    """Return the number in a table cell, or NaN for a gap, which is an empty cell or "nan".

    Args:
        cell: The text of the cell.
        file: The file, for errors.
        line: The line of the cell.
        column: The column's name.
        largest: The largest allowed absolute value.

    """
    if cell.lower() in ("", "nan"):
        return math.nan
    expected = f"a number of at most {largest:g}, or an empty cell for a gap"
    try:
        value = float(cell)
    except ValueError:
        value = math.inf
    if not abs(value) <= largest or "_" in cell:
        raise _error(file, int(line), column, expected=expected, got=shown(cell))
    return value


def _error(
    file: Path, line: int | None = None, column: str | None = None, *, expected: str, got: str, hint: str = ""
) -> RecordingError:
    """Return the error for a place in a recording."""
    place = Place(file=file, line=line, field=column)
    return RecordingError(place=place, expected=expected, got=got, hint=hint)


@dataclass(frozen=True, eq=False)
class Track:
    """The samples of one tracked point in the used part of a recording.

    ``time_s`` (n,) rises strictly. ``position_m`` (n, 3) has the positions; an empty table cell becomes NaN.
    ``line`` (n,) states on which line of ``file`` each sample is, for messages. ``window_s`` states which
    part of the recording the hand uses.
    """

    name: str
    file: Path
    time_s: NDArray[np.float64]
    position_m: NDArray[np.float64]
    line: NDArray[np.int64]
    window_s: tuple[float, float]

    @cached_property
    def longest_step_s(self) -> float:
        """The longest time between two consecutive rows at which no row is regarded as missing."""
        return _MISSING_ROWS * (float(np.median(np.diff(self.time_s))) if len(self.time_s) > 1 else 0.0)

    def speed_mps(self, first: int, second: int) -> float:
        """Return the speed [m/s] of straight motion from sample ``first`` to sample ``second``."""
        way_m = length(self.position_m[second] - self.position_m[first])
        return float(way_m / (self.time_s[second] - self.time_s[first]))


@dataclass(frozen=True, eq=False)
class MendedTrack:
    """A track whose swapped samples have been found.

    ``usable`` (n,) is true for samples that are present and not swapped.
    """

    track: Track
    usable: NDArray[np.bool_]
    note: str  # the bridged gaps and removed jumps; empty without any

    def at(self, time_s: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the positions (k, 3) at the times ``time_s`` (k,).

        Straight lines connect the usable samples.
        """
        known_s, known_m = self.track.time_s[self.usable], self.track.position_m[self.usable]
        return np.stack([np.interp(time_s, known_s, known_m[:, axis]) for axis in range(3)], axis=1)


def _mend(track: Track, longest_gap_s: float, fastest_jump_mps: float) -> MendedTrack:
    """Return ``track`` with its swapped samples marked, and a note on the bridged gaps.

    Raise RecordingError if fewer than two samples are usable, or if a gap exceeds ``longest_gap_s``.
    """
    seen: NDArray[np.bool_] = np.asarray(np.isfinite(track.position_m).all(axis=1))
    usable, jumps = _without_jumps(track, seen, fastest_jump_mps)
    good = np.flatnonzero(usable).tolist()
    if good:
        _check_ends(track, good, seen, longest_gap_s)
    if len(good) < 2:
        begin, end = map(_seconds, track.window_s)
        expected = f"at least two usable samples from {begin} to {end}"
        raise _error(track.file, None, track.name, expected=expected, got=str(len(good)))
    bridged_s = []
    for last, following in itertools.pairwise(good):
        gap_s = float(track.time_s[following] - track.time_s[last])
        if gap_s > longest_gap_s + _ROUNDING_S:
            ends_s = float(track.time_s[last]), float(track.time_s[following])
            raise _too_long(track, last + 1, ends_s, seen, longest_gap_s)
        if following - last > 1 or gap_s > track.longest_step_s:
            bridged_s.append(gap_s)
    return MendedTrack(track, usable, _note(track, good, bridged_s, jumps))


def _without_jumps(
    track: Track, seen: NDArray[np.bool_], fastest_mps: float
) -> tuple[NDArray[np.bool_], str]:
    """Return a mask of the samples that show the tracked marker, and a note on the jumps to other markers.

    The mask has the shape (n,). ``seen`` (n,) is true for the samples that are present. A sample shows
    another marker if reaching it from the last good sample would require a speed above ``fastest_mps``. The
    samples after such a sample also show the other marker, until a row is missing or a second jump occurs.
    Without this second rule, a swapped marker would become plausible after some time, although the tracked
    marker has not returned.
    """
    usable = np.zeros(len(seen), dtype=np.bool_)
    indices = np.flatnonzero(seen).tolist()
    last_good = previous = -1
    jumps, fastest = 0, 0.0
    for index in indices:
        if last_good < 0:
            usable[index], last_good, previous = True, index, index
            continue
        speed_mps = track.speed_mps(previous, index)
        step_s = track.time_s[index] - track.time_s[previous]
        unbroken = index == previous + 1 and step_s <= track.longest_step_s
        swapped = not usable[previous] and unbroken and speed_mps <= fastest_mps
        good = not swapped and track.speed_mps(last_good, index) <= fastest_mps
        if speed_mps > fastest_mps:
            fastest = max(fastest, speed_mps)
        if good:
            usable[index], last_good = True, index
        elif usable[previous]:
            jumps += 1
        previous = index
    samples = _count(len(indices) - int(usable.sum()), "sample")
    note = f"{_count(jumps, 'jump')} removed ({samples}, fastest {fastest:.3g} m/s)"
    return usable, note if jumps else ""


def _check_ends(track: Track, good: list[int], seen: NDArray[np.bool_], longest_gap_s: float) -> None:
    """Refuse a window whose first or last gap is longer than the allowed gap."""
    begin_s, end_s = track.window_s
    first_s, last_s = float(track.time_s[good[0]]), float(track.time_s[good[-1]])
    if first_s - begin_s > longest_gap_s + _ROUNDING_S:
        raise _too_long(track, 0, (begin_s, first_s), seen, longest_gap_s)
    if end_s - last_s > longest_gap_s + _ROUNDING_S:
        following = min(good[-1] + 1, len(seen) - 1)
        raise _too_long(track, following, (last_s, end_s), seen, longest_gap_s)


def _too_long(
    track: Track, index: int, gap_s: tuple[float, float], seen: NDArray[np.bool_], longest_gap_s: float
) -> RecordingError:
    """Return the error for a gap that exceeds ``longest_gap_s``."""
    begin, end, length = (_seconds(time_s) for time_s in (*gap_s, gap_s[1] - gap_s[0]))
    got = f"none for {length}, from {begin} to {end} of the file"
    if seen[index] and index > 0:
        got += f", after a jump of {track.speed_mps(index - 1, index):.3g} m/s"
    expected = f"a usable sample every {_seconds(longest_gap_s)} or sooner"
    line = int(track.line[index])
    return _error(track.file, line, track.name, expected=expected, got=got, hint=_ADVICE)


def _note(track: Track, good: list[int], bridged_s: list[float], jumps: str) -> str:
    """Return a note on a late start, bridged gaps, an early end and jumps.

    The note is empty if the track has no such defect.
    """
    parts = []
    if good[0] > 0:
        parts.append(f"starts {_seconds(track.time_s[good[0]] - track.time_s[0])} late")
    if bridged_s:
        parts.append(f"{_count(len(bridged_s), 'gap')} of at most {_seconds(max(bridged_s))} bridged")
    if good[-1] < len(track.time_s) - 1:
        parts.append(f"ends {_seconds(track.time_s[-1] - track.time_s[good[-1]])} early")
    parts += [jumps] if jumps else []
    return f"{track.name.replace('_', ' ')}: {', '.join(parts)}" if parts else ""


def _count(number: int, noun: str) -> str:
    """Return a number with its noun in the singular or the plural."""
    return f"{number} {noun}" if number == 1 else f"{number} {noun}s"


def _seconds(time_s: float) -> str:
    """Return a time in seconds, rounded to milliseconds."""
    return f"{round(float(time_s), 3):.12g} s"


def load_recording(
    recording: Recording,
    hand: RecordedHand,
    *,
    forearm_length_m: float,
    places: Mapping[str, Place] = MappingProxyType({}),
) -> RecordedMotion:
    """Return the motion of ``hand``.

    It is a part of the recording, with its gaps bridged, turned about the vertical axis and moved. At time 0,
    the hand is at its start, which is the first used sample of ``hand.track``. The hand rests at its start
    for ``delay_s``. Gaps and jumps are measured in the time of the recording, independently of
    ``speed_factor``. The elbow follows the track ``elbow_track``. Without such a track, the elbow lies at the
    distance ``forearm_length_m`` from the hand, in the direction of the point ``elbow_towards_in_base_m``.

    Args:
        recording: The recording.
        hand: The hand that repeats the recording.
        forearm_length_m: The length of a forearm without a recorded elbow.
        places: The places of the hand's keys (``track``, ``from``, ...), for errors.

    Raises:
        RecordingError: A part is unusable.  The place is in the recording, or the key that requests the
            missing part.

    """
    window_s = _window(recording, hand, places)
    names = (hand.track,) if hand.elbow_track is None else (hand.track, hand.elbow_track)
    for key, name in zip(("track", "elbow track"), names, strict=False):
        _refuse_unknown_track(recording, name, places.get(key))
    mended = [_mended(recording, name, window_s, hand.longest_gap_s, hand.fastest_jump_mps) for name in names]
    time_s = _common_times(mended, recording.file)
    start_in_base_m = np.array(shifted(hand.starts_at_in_base_m, hand.shift_in_base_m))
    # Turn about the hand's first sample, for the elbow too, and then move that sample to the start.
    recorded_m = mended[0].at(time_s)
    hand_in_base_m = _turned(recorded_m - recorded_m[0], hand.turn_rad) + start_in_base_m
    if hand.elbow_track is not None:
        elbow_in_base_m = _turned(mended[1].at(time_s) - recorded_m[0], hand.turn_rad) + start_in_base_m
    else:
        assert hand.elbow_towards_in_base_m is not None
        elbow_in_base_m = _elbows_towards(
            hand.elbow_towards_in_base_m, hand_in_base_m, forearm_length_m, recording, places
        )
    played_s = (time_s - time_s[0]) / hand.speed_factor + hand.delay_s
    if hand.delay_s > 0.0:
        # A second sample at the start keeps the hand there during the delay.
        played_s = np.concatenate([[0.0], played_s])
        hand_in_base_m, elbow_in_base_m = (
            np.concatenate([track[:1], track]) for track in (hand_in_base_m, elbow_in_base_m)
        )
    return RecordedMotion(
        time_s=played_s,
        hand_position_in_base_m=hand_in_base_m,
        elbow_position_in_base_m=elbow_in_base_m,
        notes=tuple(track.note for track in mended if track.note),
        sha256=recording.sha256,
    )


def _window(recording: Recording, hand: RecordedHand, places: Mapping[str, Place]) -> tuple[float, float]:
    """Return the times on the recording's clock at which the used part begins and ends."""
    first_s, last_s = float(recording.time_s[0]), float(recording.time_s[-1])
    begin_s = first_s if hand.from_s is None else hand.from_s
    end_s = last_s if hand.to_s is None else hand.to_s
    if not first_s <= begin_s < end_s <= last_s:
        key = "to" if hand.to_s is not None and first_s <= begin_s < last_s else "from"
        expected = f'"from" before "to", both from {first_s:.12g} s to {last_s:.12g} s of {recording.file}'
        got = f"from {begin_s:.12g} s to {end_s:.12g} s"
        place = places.get(key, Place(file=recording.file, field=TIME_COLUMN))
        raise RecordingError(place=place, expected=expected, got=got)
    return begin_s, end_s


def _refuse_unknown_track(recording: Recording, name: str, place: Place | None) -> None:
    """Raise RecordingError if the recording has no track ``name``."""
    if name not in recording.tracks:
        known = ", ".join(map(shown, recording.tracks)) or "(there is none)"
        raise RecordingError(
            place=place or Place(file=recording.file, line=1, field=name),
            expected=f"one of the tracks {known} of {recording.file}",
            got=shown(name),
            hint=near_miss(name, recording.tracks),
        )


@lru_cache(maxsize=32)  # variations of one recording change only its place and its speed
def _mended(
    recording: Recording,
    name: str,
    window_s: tuple[float, float],
    longest_gap_s: float,
    fastest_jump_mps: float,
) -> MendedTrack:
    """Return the track of one point within ``window_s``, with its swapped samples marked."""
    inside = np.flatnonzero((recording.time_s >= window_s[0]) & (recording.time_s <= window_s[1]))
    columns = [(column, recording.header.index(column)) for column in (f"{name}_{axis}_m" for axis in "xyz")]
    position_m = [
        [
            _number(
                recording.rows[row][at], recording.file, recording.line[row], column, LARGEST_COORDINATE_M
            )
            for column, at in columns
        ]
        for row in inside
    ]
    track = Track(
        name=name,
        file=recording.file,
        time_s=recording.time_s[inside],
        position_m=np.array(position_m, dtype=np.float64).reshape(-1, 3),
        line=recording.line[inside],
        window_s=window_s,
    )
    return _mend(track, longest_gap_s, fastest_jump_mps)


def _common_times(mended: list[MendedTrack], file: Path) -> NDArray[np.float64]:
    """Return the times at which any track has a usable sample.

    Only times that all tracks cover are included.
    """
    begin_s = max(float(track.track.time_s[track.usable][0]) for track in mended)
    end_s = min(float(track.track.time_s[track.usable][-1]) for track in mended)
    any_usable = np.logical_or.reduce([track.usable for track in mended])
    time_s = mended[0].track.time_s[any_usable]
    time_s = time_s[(time_s >= begin_s) & (time_s <= end_s)]
    if len(time_s) < 2:
        names = " and ".join(track.track.name for track in mended)
        raise _error(file, expected=f"at least two samples with {names}", got=str(len(time_s)))
    return time_s


def _turned(vector: NDArray[np.float64], angle_rad: float) -> NDArray[np.float64]:
    """Return the vectors (n, 3) after a rotation about the z axis.

    The product is written out, because a matrix product may round differently on another machine.
    """
    cosine, sine = cos(angle_rad), sin(angle_rad)
    x, y, z = vector.T
    return np.stack([cosine * x - sine * y, sine * x + cosine * y, z], axis=1)


def _elbows_towards(
    towards_in_base_m: Vector3,
    hand_in_base_m: NDArray[np.float64],
    length_m: float,
    recording: Recording,
    places: Mapping[str, Place],
) -> NDArray[np.float64]:
    """Return the elbows (n, 3).

    Each elbow is ``length_m`` away from the hand, in the direction of one point.
    """
    forearm = np.array(towards_in_base_m) - hand_in_base_m
    distance_m = np.linalg.norm(forearm, axis=1, keepdims=True)
    if distance_m.min() < _NEAREST_ELBOW_M:
        expected = f"a point off the way of the hand in {recording.file}"
        got = "a hand that passes through it"
        place = places.get("elbow towards", Place(file=recording.file))
        raise RecordingError(place=place, expected=expected, got=got)
    elbows: NDArray[np.float64] = hand_in_base_m + length_m * forearm / distance_m
    return elbows
