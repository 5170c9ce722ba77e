"""Recorded hands: a CSV file of marker positions becomes a motion in the robot's base frame.

The file has a column ``time_s`` and, for each tracked point, ``<track>_x_m``, ``<track>_y_m`` and
``<track>_z_m``.  Real recordings have gaps (empty cells) and swapped markers (jumps of several
metres a second); both are mended by straight motion as far as the user's bounds allow, reported
in words, and refused beyond.  Nothing is smoothed.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import lru_cache
from pathlib import Path
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from safety_harness.exceptions import Place, RecordingError
from safety_harness.scenario.model import RecordedMotion
from safety_harness.scenario.recording_table import (
    LARGEST_COORDINATE_M,
    TIME_COLUMN,
    Recording,
    number_in,
    recording_error,
)
from safety_harness.scenario.tracks import MendedTrack, Track, mend
from safety_harness.scenario.units import near_miss, shown
from safety_harness.settings import Vector3

_NEAREST_ELBOW_M = 1e-3


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
    delay_s: float = 0.0,
    places: Mapping[str, Place] = MappingProxyType({}),
) -> RecordedMotion:
    """The recording's window, mended, turned about the vertical and put where the user wants it.

    The first used sample of ``track`` comes to ``starts_at_in_base_m`` at time 0, and the hand rests
    there for ``delay_s``.  Gaps and jumps are measured in the recording's own time, before
    ``speed_factor``.  The elbow is that of ``elbow_track``; without one it lies ``forearm_length_m``
    from the hand towards ``elbow_towards_in_base_m``.  RecordingError says what cannot be used, and
    where: in the recording, or at the one of ``places`` whose key (``track``, ``from``, ...) asks for
    what is not there.
    """
    window_s = _window(recording, from_s, to_s, places)
    names = (track,) if elbow_track is None else (track, elbow_track)
    for key, name in zip(("track", "elbow track"), names, strict=False):
        _refuse_unknown_track(recording, name, places.get(key))
    mended = [_mended(recording, name, window_s, longest_gap_s, fastest_jump_mps) for name in names]
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
            elbow_towards_in_base_m, hand_in_base_m, forearm_length_m, recording, places
        )
    played_s = (time_s - time_s[0]) / speed_factor + delay_s
    if delay_s > 0.0:
        played_s = np.concatenate([[0.0], played_s])
        hand_in_base_m, elbow_in_base_m = (
            np.concatenate([one[:1], one]) for one in (hand_in_base_m, elbow_in_base_m)
        )
    return RecordedMotion(
        time_s=played_s,
        hand_position_in_base_m=hand_in_base_m,
        elbow_position_in_base_m=elbow_in_base_m,
        notes=tuple(one.note for one in mended if one.note),
        sha256=recording.sha256,
    )


def _window(
    recording: Recording, from_s: float | None, to_s: float | None, places: Mapping[str, Place]
) -> tuple[float, float]:
    """From when to when the recording is used, on its own clock."""
    first_s, last_s = float(recording.time_s[0]), float(recording.time_s[-1])
    begin_s = first_s if from_s is None else from_s
    end_s = last_s if to_s is None else to_s
    if not first_s <= begin_s < end_s <= last_s:
        wrong = "to" if to_s is not None and (from_s is None or first_s <= from_s < last_s) else "from"
        raise RecordingError(
            place=places.get(wrong, Place(file=recording.file, field=TIME_COLUMN)),
            expected=f'"from" before "to", both from {first_s:.12g} s to {last_s:.12g} s of {recording.file}',
            got=f"from {begin_s:.12g} s to {end_s:.12g} s",
        )
    return begin_s, end_s


def _refuse_unknown_track(recording: Recording, name: str, place: Place | None) -> None:
    if name not in recording.tracks:
        known = ", ".join(map(shown, recording.tracks)) or "(there is none)"
        raise RecordingError(
            place=place or Place(file=recording.file, line=1, field=name),
            expected=f"one of the tracks {known} of {recording.file}",
            got=shown(name),
            hint=near_miss(name, recording.tracks),
        )


@lru_cache(maxsize=32)  # the variations of one recording differ in where and how fast it is repeated
def _mended(
    recording: Recording,
    name: str,
    window_s: tuple[float, float],
    longest_gap_s: float,
    fastest_jump_mps: float,
) -> MendedTrack:
    return mend(
        _track(recording, name, window_s), longest_gap_s=longest_gap_s, fastest_jump_mps=fastest_jump_mps
    )


def _track(recording: Recording, name: str, window_s: tuple[float, float]) -> Track:
    """The samples of one point within the window."""
    inside = np.flatnonzero((recording.time_s >= window_s[0]) & (recording.time_s <= window_s[1]))
    columns = [(column, recording.header.index(column)) for column in (f"{name}_{axis}_m" for axis in "xyz")]
    position_m = [
        [
            number_in(
                recording.rows[row][at],
                recording.file,
                int(recording.line[row]),
                column,
                largest=LARGEST_COORDINATE_M,
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
        raise recording_error(file, expected=f"at least two samples with {names}", got=str(len(time_s)))
    return time_s


def _turned(vector: NDArray[np.float64], angle_rad: float) -> NDArray[np.float64]:
    """(n, 3) turned about z; written out, since a matrix product may round otherwise elsewhere."""
    cosine, sine = math.cos(angle_rad), math.sin(angle_rad)
    x, y, z = vector.T
    return np.stack([cosine * x - sine * y, sine * x + cosine * y, z], axis=1)


def _elbows_towards(
    towards_in_base_m: Vector3,
    hand_in_base_m: NDArray[np.float64],
    length_m: float,
    recording: Recording,
    places: Mapping[str, Place],
) -> NDArray[np.float64]:
    """(n, 3) elbows ``length_m`` from the hand towards one point."""
    forearm = np.array(towards_in_base_m) - hand_in_base_m
    distance_m = np.linalg.norm(forearm, axis=1, keepdims=True)
    if distance_m.min() < _NEAREST_ELBOW_M:
        raise RecordingError(
            place=places.get("elbow towards", Place(file=recording.file)),
            expected=f"a point off the way of the hand in {recording.file}",
            got="a hand that passes through it",
        )
    elbows: NDArray[np.float64] = hand_in_base_m + length_m * forearm / distance_m
    return elbows
