"""Put the controller's reports onto the ticks of a trace; each report is valid until the next report.

Because stamps are uncertain, a tick may have several possible reports. The uncertainty of a number covers all
these reports. A field without numbers, such as the mode, has a gap at a tick if its value differs between the
possible reports.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from safety_harness.claims.properties.base import runs_of
from safety_harness.claims.signals.true_motion import true_motion
from safety_harness.extensions.field.logs.controller_reports import (
    FIELDS,
    POSITIONS,
    ControllerReports,
    ReportedStream,
    width_of,
)
from safety_harness.extensions.field.logs.model import CellLog
from safety_harness.trace.known import OF_DECISIONS, Gap, Measurement, Source, measurement
from safety_harness.trace.records import decision_dtype
from safety_harness.trace.trace import Trace
from safety_harness.trace.unmeasured import knowing

Floats = NDArray[np.float64]
Truths = NDArray[np.bool_]
TRACKED = ("track_valid", "predicted_hand_in_base_m")
NEAREST, TCP = "predicted_distance_m", "transform_tcp_to_base"


def with_reports(trace: Trace, log: CellLog, columns: dict[str, Measurement]) -> Trace:
    """Return ``trace`` with the reports, and add their uncertainty and gaps to ``columns``.

    ``trace`` must already have the TCP and the hands.
    """
    reports, ticks = log.told, trace.ticks.copy()
    for name, stream in (("mode", reports.mode), ("limits", reports.limits)):
        if stream is not None:
            stand = _standing(stream, log, passed_too=True)
            ticks[name] = stream.values[stand.at, 0]
            gaps = stand.gaps(stand.same(stream.values))
            if name == "mode":
                gaps = stand.either_gaps(stream.values)
            columns[name] = Measurement(source=Source.LOG, gaps=gaps)
    if reports.commands is not None:
        stand, name = _standing(reports.commands, log), "demanded_joint_velocity_radps"
        ticks[name] = reports.commands.values[stand.at]
        off_by = np.where(stand.known, stand.off_by(reports.commands.values, each=True), 0.0)
        columns[name] = measurement(Source.LOG, off_by, stand.gaps(stand.known))
    if reports.tracks:
        _track(trace, log, ticks, columns)
    decisions = trace.decisions
    if reports.decisions is not None:
        decisions = _decided(trace, log, reports, reports.decisions, ticks, columns)
    # Logs do not report how long the decisions took.
    latency_s = np.full(len(decisions), np.nan)
    trace = replace(trace, ticks=ticks, decisions=decisions, decision_latency_s=latency_s)
    return knowing(trace, columns)


@dataclass(frozen=True, eq=False)
class _Standing:
    """The indices of the reports at n ticks, as arrays (n,).

    ``at`` is the valid report at a tick. The possible reports are those from ``first`` to ``last``. ``known``
    is false where no report is valid.
    """

    at: NDArray[np.int64]
    first: NDArray[np.int64]
    last: NDArray[np.int64]
    known: Truths

    def same(self, values: Floats) -> Truths:
        """Return whether all possible reports at a tick have the same ``values`` (k, c), shape (n,)."""
        # Two reports without a number are the same report, although NaN differs from NaN.
        changes = (np.diff(values, axis=0) != 0.0) & ~(np.isnan(values[1:]) & np.isnan(values[:-1]))
        kept = np.concatenate([[0], np.cumsum(changes.any(axis=1))])
        return np.asarray(self.known & (kept[self.first] == kept[self.last]))

    def off_by(self, values: Floats, *, each: bool = False) -> Floats:
        """Return the largest distance of a possible report from the valid report at each tick, shape (n,).

        The distance is Euclidean. If ``each`` is True, the largest difference of a single number is used
        instead.
        """
        farthest = np.zeros(len(self.at))
        for step in range(int((self.last - self.first).max(initial=0)) + 1):
            differences = values[np.minimum(self.first + step, self.last)] - values[self.at]
            away = np.abs(differences).max(axis=1) if each else np.linalg.norm(differences, axis=1)
            farthest = np.fmax(farthest, away)
        return farthest

    def gaps(self, known: Truths) -> tuple[Gap, ...]:
        """Return a gap for each series of successive ticks at which ``known`` (n,) is False."""
        return tuple(Gap(first=int(a), after=int(b)) for a, b in zip(*runs_of(~known), strict=True))

    def either_gaps(self, codes: Floats) -> tuple[Gap, ...]:
        """Return the gaps of ``codes`` (k, 1): ticks without a valid report, and ticks with several codes."""
        gaps = [Gap(first=gap.first, after=gap.after) for gap in self.gaps(self.known)]
        for gap in self.gaps(self.same(codes) | ~self.known):
            ticks = slice(gap.first, gap.after)
            may = codes[self.first[ticks].min() : self.last[ticks].max() + 1, 0]
            gaps.append(replace(gap, either=tuple(int(code) for code in np.unique(may))))
        return tuple(sorted(gaps, key=lambda gap: gap.first))


def _standing(stream: ReportedStream, log: CellLog, *, passed_too: bool = False) -> _Standing:
    """Return the reports that are valid at the ticks.

    If ``passed_too`` is True, the possible reports at a tick include reports that were valid only between the
    previous tick and this tick.
    """
    tick_ns = np.arange(log.ticks, dtype=np.int64) * log.period_ns + log.origin_ns

    def stands(when_ns: NDArray[np.int64]) -> NDArray[np.int64]:
        return np.searchsorted(stream.time_ns, when_ns, side="right") - 1

    at, first, last = (stands(tick_ns + shift_ns) for shift_ns in (0, -stream.off_ns, stream.off_ns))
    known = first >= 0
    at, first, last = (np.maximum(index, 0) for index in (at, first, last))
    if passed_too:
        passed = np.diff(at) > 1
        first[1:][passed] = np.minimum(first[1:], at[:-1] + 1)[passed]
    if stream.longest_ns is not None:
        known = known & (tick_ns - stream.time_ns[at] <= stream.longest_ns)
    return _Standing(at, first, last, np.asarray(known))


def _track(trace: Trace, log: CellLog, ticks: NDArray[np.void], columns: dict[str, Measurement]) -> None:
    """Add the reported hands to ``ticks``, and the distance from the TCP to the nearest reported hand."""
    most = ticks["track_valid"].shape[1]
    if len(log.told.tracks) > most:
        field = log.said.fields(tuple(key for key, _ in log.said.entries("a log"))).required("log")
        raise field.error(f"at most {most} tracked hands beside so many hands", got=str(len(log.told.tracks)))
    known, off_m = np.ones(log.ticks, np.bool_), np.zeros(log.ticks)
    ticks["predicted_hand_in_base_m"] = np.nan
    for track, stream in enumerate(log.told.tracks):
        stand, there = _standing(stream, log), np.asarray(np.isfinite(stream.values).all(axis=1))
        known &= stand.same(there[:, None].astype(float))
        ticks["track_valid"][:, track] = there[stand.at]
        ticks["predicted_hand_in_base_m"][:, track] = stream.values[stand.at]
        off_m = np.fmax(off_m, stand.off_by(stream.values))
    off_m = np.where(known, off_m, 0.0)
    gaps = _Standing(*(np.zeros(0, np.int64),) * 3, known).gaps(known)
    columns[TRACKED[0]] = Measurement(source=Source.LOG, gaps=gaps)
    columns[TRACKED[1]] = measurement(Source.LOG, off_m, gaps)
    tcp_m = true_motion(trace).tcp_m
    apart_m = np.linalg.norm(ticks["predicted_hand_in_base_m"] - tcp_m[:, None], axis=2)
    ticks[NEAREST] = np.where(ticks["track_valid"], apart_m, np.inf).min(axis=1)
    both = (*gaps, *trace.known.column(TCP).gaps)
    columns[NEAREST] = measurement(Source.DERIVED, off_m + trace.known.uncertainty_of(TCP, log.ticks), both)


def _decided(
    trace: Trace,
    log: CellLog,
    reports: ControllerReports,
    stream: ReportedStream,
    ticks: NDArray[np.void],
    columns: dict[str, Measurement],
) -> NDArray[np.void]:
    """Return the decisions, each assigned to the tick that is nearest to the decision's stamp.

    Raise LogError if two decisions would be assigned to the same tick.
    """
    since_ns = stream.time_ns - log.origin_ns
    # The nearest tick: a stamp may be half a period off, which ``_moved`` adds to the uncertainty.
    number = (since_ns + log.period_ns // 2) // log.period_ns
    inside = np.flatnonzero((number >= 0) & (number < log.ticks))
    for item in np.flatnonzero(np.diff(number[inside]) < 1)[:1].tolist():
        expected = f"decisions in ticks of their own, {log.period_ns / 1e6:g} ms apart at least"
        raise stream.samples.error(int(inside[item + 1]), expected, "two in one")
    decisions = np.zeros(len(inside), decision_dtype(ticks["joint_position_rad"].shape[1]))
    tick = decisions["tick"] = number[inside]
    decisions["time_s"] = ticks["time_s"][tick]
    known: dict[str, Measurement] = dict.fromkeys(("tick", "time_s"), Measurement(source=Source.LOG))
    for joint_or_tcp, column in (("joint_position_rad", "joint_position_rad"), (POSITIONS["tcp"], TCP)):
        values = ticks[column][tick]
        decisions[joint_or_tcp] = values if column != TCP else values[:, :3, 3]
        off_by = trace.known.column(column)
        lost = bool(len(tick)) and not trace.known.measured(column, ticks)[tick].all()
        uncertainty = off_by.uncertainty + _moved(ticks, column)
        known[joint_or_tcp] = (
            Measurement(source=Source.NONE)
            if lost
            else Measurement(source=Source.DERIVED, uncertainty=uncertainty)
        )
    first = 0
    for name in reports.fields:
        width = width_of(name)
        values = stream.values[inside, first : first + width]
        decisions[FIELDS[name]] = values if width > 1 else values[:, 0]
        known[FIELDS[name]] = Measurement(source=Source.LOG)
        first += width
    if "hand" in reports.fields:  # the place of the hand when the avoider was asked
        decisions["asked_tick"], known["asked_tick"] = tick, Measurement(source=Source.LOG)
    if "proposed" in reports.fields:
        nowhere = ~np.isfinite(decisions[FIELDS["proposed"]]).all(axis=1)
        decisions["fault"] = np.where(nowhere, "no position in the log", "")
        known["fault"] = Measurement(source=Source.LOG)
    columns |= {f"{OF_DECISIONS}{name}": item for name, item in known.items()}
    ticks["decision"] = -1
    ticks["decision"][tick] = np.arange(len(tick))
    unsure = np.zeros(log.ticks, np.bool_)
    # With such uncertain stamps, a decision may belong to a neighbouring tick.
    if 2 * stream.off_ns > log.period_ns:
        for begin, end in zip(
            since_ns[inside] - stream.off_ns, since_ns[inside] + stream.off_ns, strict=True
        ):
            unsure[max(int(begin // log.period_ns), 0) : int(-(-end // log.period_ns)) + 1] = True
    gaps = _Standing(*(np.zeros(0, np.int64),) * 3, unsure).gaps(~unsure)
    columns["decision"] = Measurement(source=Source.LOG, gaps=gaps)
    return decisions


def _moved(ticks: NDArray[np.void], column: str) -> float:
    """Return the largest motion of the joints or of the TCP from one tick to the next.

    A decision's stamp may differ by half a period from its tick, and the result bounds the error due to this
    difference.
    """
    values = ticks[column] if column != TCP else ticks[column][:, :3, 3]
    steps = np.linalg.norm(np.diff(values, axis=0), axis=1)
    return float(np.nanmax(steps, initial=0.0))
