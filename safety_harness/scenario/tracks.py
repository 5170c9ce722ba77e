"""One tracked point of a recording: which of its samples can be used, and what mends the rest."""

from __future__ import annotations

import itertools
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from safety_harness.exceptions import Place, RecordingError

_MISSING_ROWS = 1.5  # sampling periods between two rows; beyond it, rows are missing in between
_ROUNDING_S = 1e-9  # 10.67 - 10.47 is not quite 0.2
_ADVICE = 'leave it out with "from" and "to", or raise "longest gap"'


@dataclass(frozen=True, eq=False)
class Track:
    """The samples of one point within the window that is used.

    ``time_s`` (n,) rises strictly; ``position_m`` (n, 3) is NaN where a cell was empty; ``line``
    (n,) is each sample's line in ``file``, for messages; ``window_s`` is what was asked for;
    ``longest_step_s`` is the longest time between two rows between which none is missing.
    """

    name: str
    file: Path
    time_s: NDArray[np.float64]
    position_m: NDArray[np.float64]
    line: NDArray[np.int64]
    window_s: tuple[float, float]
    longest_step_s: float = field(init=False)

    def __post_init__(self) -> None:
        usual_s = float(np.median(np.diff(self.time_s))) if len(self.time_s) > 1 else 0.0
        object.__setattr__(self, "longest_step_s", _MISSING_ROWS * usual_s)

    def error(self, index: int, *, expected: str, got: str, hint: str = "") -> RecordingError:
        """The error for the sample ``index``."""
        place = Place(file=self.file, line=int(self.line[index]), field=self.name)
        return RecordingError(place=place, expected=expected, got=got, hint=hint)


@dataclass(frozen=True, eq=False)
class MendedTrack:
    """A track whose swapped samples are gone.  ``usable`` (n,) marks what is left."""

    track: Track
    usable: NDArray[np.bool_]
    note: str  # what was bridged and removed; empty when nothing was

    def at(self, time_s: NDArray[np.float64]) -> NDArray[np.float64]:
        """(k, 3) the positions at the times (k,), straight between usable samples."""
        known_s, known_m = self.track.time_s[self.usable], self.track.position_m[self.usable]
        return np.stack([np.interp(time_s, known_s, known_m[:, axis]) for axis in range(3)], axis=1)


@dataclass(frozen=True, kw_only=True)
class _Jumps:
    """What ``_without_jumps`` took out."""

    count: int
    samples: int
    fastest_mps: float


def mend(track: Track, *, longest_gap_s: float, fastest_jump_mps: float) -> MendedTrack:
    """Take swapped samples out, hold every gap against ``longest_gap_s``, say what is bridged.

    RecordingError when fewer than two samples can be used or a gap is too long.
    """
    seen: NDArray[np.bool_] = np.asarray(np.isfinite(track.position_m).all(axis=1))
    usable, jumps = _without_jumps(track, seen, fastest_jump_mps)
    good = np.flatnonzero(usable).tolist()
    if good:
        _check_ends(track, good, seen, longest_gap_s)
    if len(good) < 2:
        begin, end = map(_seconds, track.window_s)
        raise RecordingError(
            place=Place(file=track.file, field=track.name),
            expected=f"at least two usable samples from {begin} to {end}",
            got=str(len(good)),
        )
    bridged_s = []
    for before, after in itertools.pairwise(good):
        gap_s = float(track.time_s[after] - track.time_s[before])
        if gap_s > longest_gap_s + _ROUNDING_S:
            ends_s = float(track.time_s[before]), float(track.time_s[after])
            raise _too_long(track, before + 1, ends_s, seen, longest_gap_s)
        if after - before > 1 or gap_s > track.longest_step_s:
            bridged_s.append(gap_s)
    return MendedTrack(track, usable, _note(track, good, bridged_s, jumps))


def _without_jumps(
    track: Track, seen: NDArray[np.bool_], fastest_mps: float
) -> tuple[NDArray[np.bool_], _Jumps]:
    """Which of the ``seen`` samples are the marker itself.

    A sample that could be reached from the last good one only faster than ``fastest_mps`` is
    another marker's.  So is each sample that follows it without a break or a second jump:
    time alone makes a swapped marker plausible again, although it has not come back.
    """
    time_s, position_m, limit_s = track.time_s, track.position_m, track.longest_step_s
    usable = np.zeros(len(seen), dtype=np.bool_)
    indices = np.flatnonzero(seen).tolist()
    last_good = previous = -1
    jumps, fastest = 0, 0.0
    for index in indices:
        if last_good < 0:
            usable[index], last_good, previous = True, index, index
            continue
        speed_mps = _speed(time_s, position_m, previous, index)
        unbroken = index == previous + 1 and time_s[index] - time_s[previous] <= limit_s
        swapped = not usable[previous] and unbroken and speed_mps <= fastest_mps
        good = not swapped and _speed(time_s, position_m, last_good, index) <= fastest_mps
        if speed_mps > fastest_mps:
            fastest = max(fastest, speed_mps)
        if good:
            usable[index], last_good = True, index
        elif usable[previous]:
            jumps += 1
        previous = index
    return usable, _Jumps(count=jumps, samples=len(indices) - int(usable.sum()), fastest_mps=fastest)


def _speed(time_s: NDArray[np.float64], position_m: NDArray[np.float64], one: int, other: int) -> float:
    way_m = np.linalg.norm(position_m[other] - position_m[one])
    return float(way_m / (time_s[other] - time_s[one]))


def _check_ends(track: Track, good: list[int], seen: NDArray[np.bool_], longest_gap_s: float) -> None:
    """Refuse a window that begins or ends with a gap that is too long to ignore."""
    begin_s, end_s = track.window_s
    first_s, last_s = float(track.time_s[good[0]]), float(track.time_s[good[-1]])
    if first_s - begin_s > longest_gap_s + _ROUNDING_S:
        raise _too_long(track, 0, (begin_s, first_s), seen, longest_gap_s)
    if end_s - last_s > longest_gap_s + _ROUNDING_S:
        after = min(good[-1] + 1, len(seen) - 1)
        raise _too_long(track, after, (last_s, end_s), seen, longest_gap_s)


def _too_long(
    track: Track, index: int, gap_s: tuple[float, float], seen: NDArray[np.bool_], longest_gap_s: float
) -> RecordingError:
    begin, end, length = (_seconds(time_s) for time_s in (*gap_s, gap_s[1] - gap_s[0]))
    got = f"none for {length}, from {begin} to {end} of the file"
    if seen[index] and index > 0:
        got += f", after a jump of {_speed(track.time_s, track.position_m, index - 1, index):.3g} m/s"
    return track.error(
        index, expected=f"a usable sample every {_seconds(longest_gap_s)} or sooner", got=got, hint=_ADVICE
    )


def _note(track: Track, good: list[int], bridged_s: list[float], jumps: _Jumps) -> str:
    parts = []
    if good[0] > 0:
        parts.append(f"starts {_seconds(track.time_s[good[0]] - track.time_s[0])} late")
    if bridged_s:
        parts.append(f"{_count(len(bridged_s), 'gap')} of at most {_seconds(max(bridged_s))} bridged")
    if good[-1] < len(track.time_s) - 1:
        parts.append(f"ends {_seconds(track.time_s[-1] - track.time_s[good[-1]])} early")
    if jumps.count:
        parts.append(
            f"{_count(jumps.count, 'jump')} removed ({_count(jumps.samples, 'sample')}, "
            f"fastest {jumps.fastest_mps:.3g} m/s)"
        )
    return f"{track.name.replace('_', ' ')}: {', '.join(parts)}" if parts else ""


def _count(number: int, noun: str) -> str:
    return f"{number} {noun}" if number == 1 else f"{number} {noun}s"


def _seconds(time_s: float) -> str:
    return f"{round(float(time_s), 3):.12g} s"
