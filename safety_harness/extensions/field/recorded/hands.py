"""Make recordings of a log's hands for a scenario, with unchanged samples from the first instant on.

The code does not resample, smooth or repair the samples. It interpolates only the place of a hand at the
first instant, linearly between the samples before and after it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from safety_harness.base.exceptions import LogError
from safety_harness.base.settings import Vector3
from safety_harness.extensions.field.logs.model import Body, CellLog
from safety_harness.extensions.field.logs.streams import NS, LogSamples
from safety_harness.scenario.model import NOT_LOADED, RecordedHand
from safety_harness.scenario.recording import load_recording, parse_recording
from safety_harness.scenario.units import TIME

SHORTEST_NS = 1_000  # the interpolated first instant replaces a sample that is not later than this
LEAST_S = 0.1  # the shortest part of a log that a hint offers
HAND, ELBOW = "hand", "elbow"


@dataclass(frozen=True, eq=False)
class HandFile:
    """One hand of a scenario, with the bytes of its recording, and with ``notes`` for the user."""

    hand: RecordedHand
    data: bytes
    notes: tuple[str, ...]

    @property
    def name(self) -> str:
        """The name of the recording's file, which is in the scenario's folder."""
        return str(self.hand.recording)


@dataclass(frozen=True, eq=False)
class _Track:
    """The samples of a body: the times (n,) since the first instant, and the positions (n, 3) in base [m]."""

    time_ns: NDArray[np.int64]
    position_in_base_m: NDArray[np.float64]

    @property
    def fastest_mps(self) -> float:
        way_m = np.linalg.norm(np.diff(self.position_in_base_m, axis=0), axis=1)
        return float((way_m / (np.diff(self.time_ns) / NS)).max(initial=0.0))


def hand_file(
    log: CellLog, body: Body, *, elbow_towards_in_base_m: Vector3 | None, forearm_length_m: float
) -> HandFile:
    """Return a hand of a log with its recording.

    Args:
        log: The log.
        body: The hand, with its elbow if the log has one.
        elbow_towards_in_base_m: The point (3,) at which an unmeasured forearm points [m], or None if it is
            unknown.
        forearm_length_m: The length of the forearm [m].

    Raises:
        LogError: A gap is longer than the log allows, or the direction of the forearm is missing.

    """
    assert log.hand_facts is not None
    tracks, notes = {HAND: _track(log, body.hand.measured)}, []
    if body.elbow is not None:
        tracks[ELBOW] = _track(log, body.elbow.measured)
    elif not body.forearm:
        tracks[ELBOW] = tracks[HAND]
    elif elbow_towards_in_base_m is None:
        expected = f"where the forearm of {body.name} points, since it was not measured"
        hint = f'"1.6 m, -1.2 m, 0.3 m", or a hand "{body.name}" in the scenario'
        raise LogError.of_option("--elbow-towards", expected, "nothing", hint)
    late_s = (int(body.hand.time_ns[0]) - log.hands_ahead_ns - log.origin_ns) / NS
    if late_s > 0.0:
        notes.append(f"{body.name}: first seen after {late_s:.3f} s, and taken to rest there until then")
    data = _csv(tracks)
    start = tracks[HAND].position_in_base_m[0].tolist()
    hand = RecordedHand(
        recording=Path(f"{log.name}-{body.name.replace(' ', '-')}.csv"),
        motion=NOT_LOADED,
        name=body.name,
        track=HAND,
        elbow_track=ELBOW if ELBOW in tracks else None,
        elbow_towards_in_base_m=None if ELBOW in tracks else elbow_towards_in_base_m,
        starts_at_in_base_m=(start[0], start[1], start[2]),
        longest_gap_s=log.hand_facts.longest_gap_s,
        fastest_jump_mps=_above(max(track.fastest_mps for track in tracks.values())),
    )
    recording = parse_recording(data, hand.recording)
    motion = load_recording(recording, hand, forearm_length_m=forearm_length_m)
    notes += [f"{body.name}: {note}" for note in motion.notes]
    return HandFile(replace(hand, motion=motion), data, tuple(notes))


def _above(speed_mps: float) -> float:
    """Return a speed that is 1 to 2 mm/s above ``speed_mps``, in whole millimetres per second."""
    return math.ceil(speed_mps * 1e3 + 1.0) / 1e3


def _track(log: CellLog, samples: LogSamples) -> _Track:
    """Return the samples from the first instant to the first sample at or after the end of the log."""
    assert log.hand_facts is not None
    time_ns = samples.time_ns - log.hands_ahead_ns - log.origin_ns
    end_ns = (log.ticks - 1) * log.period_ns
    longest_ns = round(log.hand_facts.longest_gap_s * NS)
    first = max(int(np.searchsorted(time_ns, 0, side="right")) - 1, 0)
    last = min(int(np.searchsorted(time_ns, end_ns, side="left")), len(time_ns) - 1)
    if time_ns[first] > longest_ns // 2:
        _refuse_gap(log, samples, first, 0, int(time_ns[first]), half=True)
    for index in np.flatnonzero(np.diff(time_ns[first : last + 1]) > longest_ns)[:1].tolist():
        begin, end = (int(time_ns[first + index + k]) for k in (0, 1))
        _refuse_gap(log, samples, first + index + 1, begin, end)
    if end_ns - time_ns[last] > longest_ns // 2:
        _refuse_gap(log, samples, last, int(time_ns[last]), end_ns, half=True)
    # A sample at time 0 or just after it would repeat the first row, which is interpolated at time 0.
    used = np.arange(first, last + 1)[time_ns[first : last + 1] > SHORTEST_NS]
    at_first = [np.interp(0.0, time_ns.astype(np.float64), column) for column in samples.values.T]
    return _Track(
        np.concatenate([np.zeros(1, np.int64), time_ns[used]]), np.vstack([at_first, samples.values[used]])
    )


def _refuse_gap(
    log: CellLog, samples: LogSamples, index: int, begin_ns: int, end_ns: int, *, half: bool = False
) -> None:
    """Raise LogError for a gap from ``begin_ns`` to ``end_ns``, and suggest parts of the log without it."""
    assert log.hand_facts is not None
    most_ms = log.hand_facts.longest_gap_s * (0.5e3 if half else 1e3)
    expected = f"a sample every {most_ms:g} ms, as hands: {{longest gap: ...}} says"
    if half:
        expected = f"a sample within {most_ms:g} ms of either end, half the stated longest gap"
    begin_s, end_s = begin_ns / NS, end_ns / NS
    part_s, over_s = _part_begins_s(log), (log.ticks - 1) * log.period_s
    until, since = math.floor((part_s + begin_s) * 100.0 - 1.0), math.ceil((part_s + end_s) * 100.0 + 1.0)
    parts = [f'--to "{until / 100.0:g} s"'] * (begin_s > LEAST_S)
    parts += [f'--from "{since / 100.0:g} s"'] * (end_s < over_s - LEAST_S)
    got = f"no sample for {(end_s - begin_s) * 1e3:.0f} ms, from {begin_s:.3f} s to {end_s:.3f} s"
    hint = "the harness does not fill gaps" + (f"; another part: {' or '.join(parts)}" if parts else "")
    raise samples.error(index, expected, got, hint)


def _part_begins_s(log: CellLog) -> float:
    """Return the time [s] at which the log's part begins, on the scale of the options ``from`` and ``to``."""
    streams = dict(log.said.entries("the log of a cell"))["log"].entries("streams")
    return next((field.quantity(TIME) for key, field in streams if key == "from"), 0.0)


def _csv(tracks: dict[str, _Track]) -> bytes:
    """Return ``tracks`` as one CSV table; a cell is empty if its track has no sample at that time."""
    times = np.unique(np.concatenate([track.time_ns for track in tracks.values()]))
    header = ["time_s", *(f"{name}_{axis}_m" for name in tracks for axis in "xyz")]
    cells: list[Sequence[str]] = [[f"{time / NS:.9f}" for time in times.tolist()]]
    for track in tracks.values():
        at = {time: k for k, time in enumerate(track.time_ns.tolist())}
        for column in track.position_in_base_m.T.tolist():
            cells.append([repr(column[at[time]]) if time in at else "" for time in times.tolist()])
    rows = [",".join(header), *(",".join(row) for row in zip(*cells, strict=True))]
    return ("\n".join(rows) + "\n").encode()
