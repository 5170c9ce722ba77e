"""What a controller told, at the ticks of a trace: each word stands until the next one.

At a tick every word counts that may have stood then, as stamps are known to within so much: numbers are known
to within the farthest of them, and what is no number has a gap where they differ.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from safety_harness.claims.properties.base import runs_of
from safety_harness.claims.signals.true_motion import true_motion
from safety_harness.extensions.field.logs.model import CellLog
from safety_harness.extensions.field.logs.told import FIELDS, POSITIONS, Told, ToldStream, width_of
from safety_harness.trace.known import OF_DECISIONS, Gap, Measurement, Source, measurement
from safety_harness.trace.records import decision_dtype
from safety_harness.trace.trace import Trace
from safety_harness.trace.unmeasured import knowing

Floats = NDArray[np.float64]
Truths = NDArray[np.bool_]
TRACKED = ("track_valid", "predicted_hand_in_base_m")
NEAREST, TCP = "predicted_distance_m", "transform_tcp_to_base"


def with_told(trace: Trace, log: CellLog, columns: dict[str, Measurement]) -> Trace:
    """``trace`` with what was told, and ``columns`` with how it is known; TCP and hands are there already."""
    told, ticks = log.told, trace.ticks.copy()
    for name, stream in (("mode", told.mode), ("limits", told.limits)):
        if stream is not None:
            stand = _standing(stream, log, words=True)
            ticks[name] = stream.values[stand.at, 0]
            gaps = stand.gaps(stand.same(stream.values))
            if name == "mode":
                gaps = stand.between(stream.values)
            columns[name] = Measurement(source=Source.LOG, gaps=gaps)
    if told.commands is not None:
        stand, name = _standing(told.commands, log), "demanded_joint_velocity_radps"
        ticks[name] = told.commands.values[stand.at]
        off = np.where(stand.known, stand.off(told.commands.values, each=True), 0.0)
        columns[name] = measurement(Source.LOG, off, stand.gaps(stand.known))
    if told.tracks:
        _track(trace, log, ticks, columns)
    decisions = trace.decisions
    if told.decisions is not None:
        decisions = _decided(trace, log, told, told.decisions, ticks, columns)
    latency_s = np.full(len(decisions), np.nan)
    trace = replace(trace, ticks=ticks, decisions=decisions, decision_latency_s=latency_s)
    return knowing(trace, columns)


@dataclass(frozen=True, eq=False)
class _Standing:
    """Of each tick (n,): the word that stands, the first and last that may stand, and whether any does."""

    at: NDArray[np.int64]
    first: NDArray[np.int64]
    last: NDArray[np.int64]
    known: Truths

    def same(self, values: Floats) -> Truths:
        """(n,) is it one of the same ``values`` (k, c) whichever of them stands?"""
        changes = (np.diff(values, axis=0) != 0.0) & ~(np.isnan(values[1:]) & np.isnan(values[:-1]))
        kept = np.concatenate([[0], np.cumsum(changes.any(axis=1))])
        return np.asarray(self.known & (kept[self.first] == kept[self.last]))

    def off(self, values: Floats, *, each: bool = False) -> Floats:
        """(n,) how far any that may stand is from the one that does: by its distance, or ``each`` number."""
        found = np.zeros(len(self.at))
        for step in range(int((self.last - self.first).max(initial=0)) + 1):
            apart = values[np.minimum(self.first + step, self.last)] - values[self.at]
            away = np.abs(apart).max(axis=1) if each else np.linalg.norm(apart, axis=1)
            found = np.fmax(found, away)
        return found

    def gaps(self, known: Truths) -> tuple[Gap, ...]:
        """Where it is not ``known`` (n,)."""
        return tuple(Gap(first=int(a), after=int(b)) for a, b in zip(*runs_of(~known), strict=True))

    def between(self, words: Floats) -> tuple[Gap, ...]:
        """The gaps of ``words`` (k, 1): where none stands, and where either of several may."""
        found = [Gap(first=gap.first, after=gap.after) for gap in self.gaps(self.known)]
        for gap in self.gaps(self.same(words) | ~self.known):
            ticks = slice(gap.first, gap.after)
            may = words[self.first[ticks].min() : self.last[ticks].max() + 1, 0]
            found.append(replace(gap, either=tuple(int(one) for one in np.unique(may))))
        return tuple(sorted(found, key=lambda gap: gap.first))


def _standing(stream: ToldStream, log: CellLog, *, words: bool = False) -> _Standing:
    """Of ``words`` those that came and went since the tick before may stand as well: none is passed over."""
    tick_ns = np.arange(log.ticks, dtype=np.int64) * log.period_ns + log.origin_ns

    def stands(when_ns: NDArray[np.int64]) -> NDArray[np.int64]:
        return np.searchsorted(stream.time_ns, when_ns, side="right") - 1

    at, first, last = (stands(tick_ns + by) for by in (0, -stream.off_ns, stream.off_ns))
    known = first >= 0
    at, first, last = (np.maximum(one, 0) for one in (at, first, last))
    if words:
        passed = np.diff(at) > 1
        first[1:][passed] = np.minimum(first[1:], at[:-1] + 1)[passed]
    if stream.longest_ns is not None:
        known = known & (tick_ns - stream.time_ns[at] <= stream.longest_ns)
    return _Standing(at, first, last, np.asarray(known))


def _track(trace: Trace, log: CellLog, ticks: NDArray[np.void], columns: dict[str, Measurement]) -> None:
    """Hands that were told, a track each, and the nearest of them to the TCP."""
    room = ticks["track_valid"].shape[1]
    if len(log.told.tracks) > room:
        field = log.said.fields(tuple(key for key, _ in log.said.entries("a log"))).required("log")
        raise field.error(f"at most {room} tracked hands beside so many hands", got=str(len(log.told.tracks)))
    known, within = np.ones(log.ticks, np.bool_), np.zeros(log.ticks)
    ticks["predicted_hand_in_base_m"] = np.nan
    for track, stream in enumerate(log.told.tracks):
        stand, there = _standing(stream, log), np.asarray(np.isfinite(stream.values).all(axis=1))
        known &= stand.same(there[:, None].astype(float))
        ticks["track_valid"][:, track] = there[stand.at]
        ticks["predicted_hand_in_base_m"][:, track] = stream.values[stand.at]
        within = np.fmax(within, stand.off(stream.values))
    within = np.where(known, within, 0.0)
    gaps = _Standing(*(np.zeros(0, np.int64),) * 3, known).gaps(known)
    columns[TRACKED[0]] = Measurement(source=Source.LOG, gaps=gaps)
    columns[TRACKED[1]] = measurement(Source.LOG, within, gaps)
    tcp_m = true_motion(trace).tcp_m
    apart_m = np.linalg.norm(ticks["predicted_hand_in_base_m"] - tcp_m[:, None], axis=2)
    ticks[NEAREST] = np.where(ticks["track_valid"], apart_m, np.inf).min(axis=1)
    both = (*gaps, *trace.known.of(TCP).gaps)
    columns[NEAREST] = measurement(Source.DERIVED, within + trace.known.within(TCP, log.ticks), both)


def _decided(
    trace: Trace,
    log: CellLog,
    told: Told,
    stream: ToldStream,
    ticks: NDArray[np.void],
    columns: dict[str, Measurement],
) -> NDArray[np.void]:
    """The decisions, each at the tick that is nearest to its stamp; LogError for two of one tick."""
    since_ns = stream.time_ns - log.origin_ns
    number = (since_ns + log.period_ns // 2) // log.period_ns
    inside = np.flatnonzero((number >= 0) & (number < log.ticks))
    for one in np.flatnonzero(np.diff(number[inside]) < 1)[:1].tolist():
        expected = f"decisions in ticks of their own, {log.period_ns / 1e6:g} ms apart at least"
        raise stream.samples.error(int(inside[one + 1]), expected, "two in one")
    found = np.zeros(len(inside), decision_dtype(ticks["joint_position_rad"].shape[1]))
    tick = found["tick"] = number[inside]
    found["time_s"] = ticks["time_s"][tick]
    known: dict[str, Measurement] = dict.fromkeys(("tick", "time_s"), Measurement(source=Source.LOG))
    for joint_or_tcp, column in (("joint_position_rad", "joint_position_rad"), (POSITIONS["tcp"], TCP)):
        values = ticks[column][tick]
        found[joint_or_tcp] = values if column != TCP else values[:, :3, 3]
        off = trace.known.of(column)
        lost = bool(len(tick)) and not trace.known.measured(column, ticks)[tick].all()
        uncertainty = off.uncertainty + _moved(ticks, column)
        known[joint_or_tcp] = (
            Measurement(source=Source.NONE)
            if lost
            else Measurement(source=Source.DERIVED, uncertainty=uncertainty)
        )
    first = 0
    for name in told.fields:
        width = width_of(name)
        values = stream.values[inside, first : first + width]
        found[FIELDS[name]] = values if width > 1 else values[:, 0]
        known[FIELDS[name]] = Measurement(source=Source.LOG)
        first += width
    if "hand" in told.fields:  # which the avoider was asked about then
        found["asked_tick"], known["asked_tick"] = tick, Measurement(source=Source.LOG)
    if "proposed" in told.fields:
        nowhere = ~np.isfinite(found[FIELDS["proposed"]]).all(axis=1)
        found["fault"] = np.where(nowhere, "no position in the log", "")
        known["fault"] = Measurement(source=Source.LOG)
    columns |= {f"{OF_DECISIONS}{name}": one for name, one in known.items()}
    ticks["decision"] = -1
    ticks["decision"][tick] = np.arange(len(tick))
    unsure = np.zeros(log.ticks, np.bool_)
    if 2 * stream.off_ns > log.period_ns:
        for begin, end in zip(
            since_ns[inside] - stream.off_ns, since_ns[inside] + stream.off_ns, strict=True
        ):
            unsure[max(int(begin // log.period_ns), 0) : int(-(-end // log.period_ns)) + 1] = True
    gaps = _Standing(*(np.zeros(0, np.int64),) * 3, unsure).gaps(~unsure)
    columns["decision"] = Measurement(source=Source.LOG, gaps=gaps)
    return found


def _moved(ticks: NDArray[np.void], column: str) -> float:
    """How far joints, or the TCP, go in a tick at most: a decision may be half of one off."""
    values = ticks[column] if column != TCP else ticks[column][:, :3, 3]
    steps = np.linalg.norm(np.diff(values, axis=0), axis=1)
    return float(np.nanmax(steps, initial=0.0))
