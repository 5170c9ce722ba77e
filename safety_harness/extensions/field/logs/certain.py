"""Make the trace of a log, with the source, the uncertainty and the gaps of each measured column.

The trace interpolates joints and hands linearly between samples, at the ticks of one clock. Between two
samples, a joint or hand may have moved in many ways; the uncertainty of each number covers all of them. The
page docs/explanation/verdicts.md proves that the verdicts are certain.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from safety_harness.base.whole_file import sha256_of
from safety_harness.claims.signals.true_motion import (
    JOINTS,
    apart_moved_m,
    arm_of,
    derived,
    hand_paths,
    tcp_velocity_moved_mps,
)
from safety_harness.extensions.field.logs.assumptions import unconfirmed_note
from safety_harness.extensions.field.logs.controller_reports import ahead_s
from safety_harness.extensions.field.logs.mode_motion import refuse_retreat_while_servoing
from safety_harness.extensions.field.logs.model import Body, CellLog
from safety_harness.extensions.field.logs.reach import (
    ROUNDING_M,
    Reach,
    body_off_m,
    from_ends,
    joint_off_rad,
    over_ticks,
    rate_off,
)
from safety_harness.extensions.field.logs.reported_ticks import with_reports
from safety_harness.extensions.field.logs.streams import NS, LogSamples, strides
from safety_harness.scenario.fields import Field
from safety_harness.scenario.files import display_path
from safety_harness.scenario.model import Scenario
from safety_harness.scenario.nodes import Mapping, Node, Scalar, Sequence
from safety_harness.scenario.read import scenario_of
from safety_harness.scenario.units import ANGLE, LENGTH, TIME, format_quantity
from safety_harness.trace.known import COLUMNS_OF_A_TRACE, NOT_MEASURED, Gap, Measurement, Source, measurement
from safety_harness.trace.provenance import provenance
from safety_harness.trace.records import decision_dtype, tick_dtype
from safety_harness.trace.system import Component, SystemUnderTest, system_of
from safety_harness.trace.trace import Provenance, Trace
from safety_harness.trace.unmeasured import knowing

RECORDED = "recorded"  # the name for the world of such a trace, and for its unknown avoider
HAND, ELBOW, PRESENT = "hand_position_in_base_m", "elbow_position_in_base_m", "hand_present"
RECORDERS_APART_S = 0.25  # the time between the ends of two recordings that are made together
UNUSED_NAMED = 12  # the most unread columns, topics and joints that a note names
_LONGEST_STEP_S = 5.0  # between rows of a stored path
_PASSED_ON = ("robot", "obstacles", "camera")
_HAND_FILTER, _HORIZON = "hand filter", "prediction horizon"


@dataclass(frozen=True, eq=False)
class LoggedTrace:
    """The trace of a log, with the recorded paths of the hands and with notes for the user.

    ``recordings`` maps the SHA-256 of each path's file to the bytes of this file.
    """

    trace: Trace
    recordings: dict[str, bytes]
    notes: tuple[str, ...]


Recorded = LoggedTrace  # deprecated: the old name, for one release


def trace_from_log(log: CellLog) -> LoggedTrace:
    """Return the trace of a log.

    Raise LogError if a hand is faster than stated, or if no scenario can contain the data.
    """
    count = log.ticks
    paths = [_path(log, body) for body in log.hands]
    recordings = {hashlib.sha256(data).hexdigest(): data for data in (path.data for path in paths)}
    scenario = _scenario(log, paths, recordings)
    joints = scenario.settings.cell.preferred_joint_position_rad
    ticks = np.zeros(count, tick_dtype(scenario.hand_slots, len(joints)))
    position, rates, of_position, of_rates, reach, rate_reach = _joints(log)
    ticks["time_s"] = np.arange(count) * scenario.settings.clock.control_period_s
    ticks["joint_position_rad"], ticks["joint_velocity_radps"] = position, rates
    ticks[PRESENT][:, : len(paths)] = True
    trace = Trace(
        scenario=scenario,
        ticks=ticks,
        decisions=np.zeros(0, decision_dtype(len(joints))),
        decision_latency_s=np.zeros(0),
        provenance=_provenance(log),
        system=_system(scenario),
    )
    trace = _with_hands(trace)
    columns = dict.fromkeys(COLUMNS_OF_A_TRACE, NOT_MEASURED)
    columns[JOINTS[0]] = measurement(of_position, reach.within, reach.known_gaps())
    columns[JOINTS[1]] = measurement(of_rates, rate_reach.within, rate_reach.known_gaps())
    open_ends = [Gap(first=0, after=count)] if log.unmapped else _beyond_joints(log)[0]
    columns[PRESENT] = Measurement(source=Source.LOG, gaps=tuple(open_ends))
    columns |= _of_hands(log, paths)
    trace = replace(trace, known=knowing(trace, columns).known)
    trace = with_reports(_derived(trace, columns), log, columns)
    refuse_retreat_while_servoing(trace, log)
    return LoggedTrace(trace, recordings, tuple(_notes(log, paths)))


def _beyond_joints(log: CellLog) -> tuple[list[Gap], list[str]]:
    """Return gaps and notes for the ends of the log at which only the hands were recorded, without joints.

    Each gap consists of the first or the last tick. If LOG.yaml chooses the beginning or the end of the log
    with ``from`` or ``to``, there is a note but no gap.
    """
    gaps, notes = [], []
    chosen = dict(dict(log.said.entries("a log"))["log"].entries("streams"))
    first_ns, last_ns = (int(t_ns) for t_ns in log.joints.time_ns[[0, -1]])
    longest_s = max(log.joint_facts.longest_gap_s + log.clock_known_to_s, RECORDERS_APART_S)
    for body in log.hands:
        begin_ns, end_ns = (t_ns - log.hands_ahead_ns for t_ns in body.hand.span_ns or (first_ns, last_ns))
        for key, over_ns, tick, where in (
            ("from", first_ns - begin_ns, 0, "before the first joints"),
            ("to", end_ns - last_ns, log.ticks - 1, "after the last joints"),
        ):
            if over_ns / NS <= longest_s:
                continue
            note = f"{body.hand.source.name}: {over_ns / NS:.3f} s {where} are left out"
            if key not in chosen:
                gaps.append(Gap(first=tick, after=tick + 1))
                value = "0 s" if key == "from" else format_quantity((last_ns - first_ns) / NS, TIME)
                note += f", and no claim on hands holds beyond them: log: {{{key}: {value}}} if that is meant"
            notes.append(note)
    return sorted(set(gaps), key=lambda gap: gap.first), notes


def _with_hands(trace: Trace) -> Trace:
    """Return the trace with the hands' positions at the ticks, computed from their recorded paths."""
    ticks, moved = trace.ticks.copy(), hand_paths(trace).positions_in_base_m
    ticks[HAND][:, : moved.shape[1]] = moved[:, :, 0]
    ticks[ELBOW][:, : moved.shape[1]] = moved[:, :, 1]
    return replace(trace, ticks=ticks)


def _derived(trace: Trace, columns: dict[str, Measurement]) -> Trace:
    """Return the trace with the columns that are derived from joints and hands, and their uncertainties."""
    known, count = trace.known, len(trace.ticks)
    values, ticks = derived(trace), trace.ticks.copy()
    of_arm = [gap for name in JOINTS for gap in known.column(name).gaps]
    of_distance = [*known.column(JOINTS[0]).gaps, *known.column(HAND).gaps, *known.column(ELBOW).gaps]
    reach_m = float(arm_of(trace).reach_m.sum())
    bounds = {
        "transform_tcp_to_base": (
            known.uncertainty_of(JOINTS[0], count) * reach_m,
            known.column(JOINTS[0]).gaps,
        ),
        "tcp_speed_mps": (tcp_velocity_moved_mps(trace), tuple(of_arm)),
    }
    if not known.missing([ELBOW]) and trace.scenario.hands:
        bounds["hand_distance_m"] = apart_moved_m(trace), tuple(of_distance)
        columns["hand_distance_capsule"] = Measurement(source=Source.DERIVED, gaps=tuple(of_distance))
        ticks["hand_distance_capsule"] = values["hand_distance_capsule"]
    for name, (off_by, gaps) in bounds.items():
        ticks[name] = values[name]
        columns[name] = measurement(Source.DERIVED, _outside(off_by, gaps), dict.fromkeys(gaps))
    if not trace.scenario.hands:
        for name in (HAND, ELBOW, "hand_distance_m", "hand_distance_capsule"):
            ticks[name] = values[name]
            columns[name] = Measurement(source=Source.LOG)
    return knowing(replace(trace, ticks=ticks), columns)


def _outside(off_by: NDArray[np.float64], gaps: tuple[Gap, ...]) -> NDArray[np.float64]:
    """Return a copy of the uncertainty with zeros in the gaps that concern all hands, shape (n,).

    No code reads the uncertainty in these gaps.
    """
    outside = off_by.copy()
    for gap in gaps:
        if gap.hand is None:
            outside[gap.first : gap.after] = 0.0
    return outside


def _joints(log: CellLog) -> tuple[NDArray[np.float64], NDArray[np.float64], Source, Source, Reach, Reach]:
    """Return the joints' positions and speeds at the ticks, their sources, and their uncertainties."""
    joints, facts, count = log.joints, log.joint_facts, log.ticks
    time_s, tick_s = log.seconds(joints), np.arange(count) * log.period_s
    number, frozen = joints.values.shape[1] // 2, joints.frozen
    position_rad, told_radps = joints.values[:, :number], joints.values[:, number:]
    step_s = np.diff(time_s)
    slope = np.diff(position_rad, axis=0) / step_s[:, None]
    bounds = {"most": facts.move_at_most_radps, "hardest": facts.accelerate_at_most_radps2}
    grid = {"longest_ns": round(facts.longest_gap_s * NS), "period_ns": log.period_ns, "count": count}
    time_ns = joints.time_ns - log.origin_ns
    off_by = joint_off_rad(slope, step_s, sample_rad=facts.known_to_rad, **bounds)  # type: ignore[arg-type]
    reach = over_ticks(time_ns, off_by, frozen=frozen, **grid)
    bent = _bends(time_ns, slope, log.period_ns, count)
    for first, end in reach.gaps:
        # No code reads an uncertainty within a gap.
        bent[first:end] = 0.0
    reach = Reach(reach.within + bent, reach.gaps)
    at_ticks = np.column_stack([np.interp(tick_s, time_s, column) for column in position_rad.T])
    if np.isfinite(told_radps).all() and facts.speeds_known_to_radps is not None:
        rates = np.column_stack([np.interp(tick_s, time_s, column) for column in told_radps.T])
        off_by = np.full(len(step_s), facts.speeds_known_to_radps)
        if facts.accelerate_at_most_radps2 is not None:
            off_by = off_by + facts.accelerate_at_most_radps2 * step_s / 2.0
        else:
            fastest = np.maximum(np.abs(told_radps[:-1]), np.abs(told_radps[1:]))
            off_by = off_by + (fastest + facts.move_at_most_radps).max(axis=1)
        of_rates = Source.LOG
    else:
        # Without reported speeds, a tick has the mean speed of the span between samples that contains it.
        span = np.clip(np.searchsorted(time_s, tick_s, side="right") - 1, 0, len(slope) - 1)
        rates, of_rates = slope[span], Source.DERIVED
        off_by = rate_off(slope, step_s, sample=facts.known_to_rad, **bounds)  # type: ignore[arg-type]
    return at_ticks, rates, Source.LOG, of_rates, reach, over_ticks(time_ns, off_by, frozen=frozen, **grid)


def _bends(
    time_ns: NDArray[np.int64], slope: NDArray[np.float64], period_ns: int, count: int
) -> NDArray[np.float64]:
    """Return the largest distance between nearby samples and the straight line between ticks, shape (count,).

    The result at a tick covers the samples in the period before and in the period after the tick. A change of
    speed between two ticks moves a sample off the line by at most a quarter of the period times this change.
    """
    cells = np.zeros(max(count, 1))
    turned = np.abs(np.diff(slope, axis=0)).max(axis=1) if len(slope) > 1 else np.zeros(0)
    inner = time_ns[1:-1]
    off_grid = inner % period_ns != 0
    cell = np.clip(inner[off_grid] // period_ns, 0, len(cells) - 1)
    np.add.at(cells, cell, turned[off_grid] * period_ns / NS / 4.0)
    previous = np.concatenate([[0.0], cells[:-1]])
    return np.asarray(np.maximum(cells, previous)[:count])


@dataclass(frozen=True, eq=False)
class _Path:
    """The recorded path of a hand: the bytes of its CSV file, the start position, and two uncertainties.

    The uncertainties are those of the positions of the hand and of its elbow.
    """

    body: Body
    data: bytes
    starts_at_m: tuple[float, float, float]
    hand: Reach
    elbow: Reach | None


def _path(log: CellLog, body: Body) -> _Path:
    """Return a recording of the path of a hand and its elbow.

    The recording begins at tick 0 and is linear between samples.
    """
    assert log.hand_facts is not None
    reaches, tracks, times = [], [], [np.zeros(1, np.int64)]
    for samples in (body.hand, body.elbow):
        if samples is None:
            continue
        time_ns = samples.time_ns - log.hands_ahead_ns - log.origin_ns
        reaches.append(_body_reach(log, samples, time_ns))
        tracks.append((time_ns, samples.values))
        # The path has a row at tick 0; samples less than 1 us later would be simultaneous with it.
        times.append(time_ns[time_ns > 1_000])
    time_ns = _filled(np.unique(np.concatenate(times)))
    rows = [time_ns / NS]
    for own_ns, values in tracks:
        rows += [np.interp(time_ns, own_ns, column) for column in values.T]
    if len(tracks) == 1:
        rows += rows[1:4]
    lines = ["time_s," + ",".join(f"{track}_{axis}_m" for track in ("hand", "elbow") for axis in "xyz")]
    lines += [f"{row[0]:.9f}," + ",".join(f"{value:.6f}" for value in row[1:]) for row in np.array(rows).T]
    start = lines[1].split(",")[1:4]
    return _Path(
        body=body,
        data=("\n".join(lines) + "\n").encode(),
        starts_at_m=(float(start[0]), float(start[1]), float(start[2])),
        hand=reaches[0],
        elbow=reaches[1] if len(reaches) > 1 else None,
    )


def _filled(time_ns: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return ``time_ns`` with additional times, so that no interval exceeds the limit for recordings."""
    most = round(_LONGEST_STEP_S * NS)
    if len(time_ns) == 1:
        time_ns = np.append(time_ns, time_ns + most)
    more = [
        np.arange(begin + most, end, most)
        for begin, end in zip(time_ns[:-1].tolist(), time_ns[1:].tolist(), strict=True)
        if end - begin > most
    ]
    return np.unique(np.concatenate([time_ns, *more])) if more else time_ns


def _body_reach(log: CellLog, samples: LogSamples, time_ns: NDArray[np.int64]) -> Reach:
    """Return the uncertainty of a body's path; raise LogError if the body is faster than stated."""
    facts = log.hand_facts
    assert facts is not None
    most_mps, known_to_m = facts.moves_at_most_mps, samples.known_to_m
    if known_to_m is None:
        known_to_m = np.full(len(time_ns), facts.known_to_m)
    sample_m = known_to_m + most_mps * log.clock_known_to_s + ROUNDING_M
    for stride in strides(len(time_ns)):  # over a short step, the samples' errors hide a high speed
        _refuse_fast(samples, time_ns, known_to_m, most_mps, log.clock_known_to_s, stride)
    way_m = np.linalg.norm(np.diff(samples.values, axis=0), axis=1)
    step_s = np.diff(time_ns) / NS
    grid = {"longest_ns": round(facts.longest_gap_s * NS), "period_ns": log.period_ns}
    worse_m = np.maximum(sample_m[:-1], sample_m[1:])
    off_m = body_off_m(way_m, step_s, most_mps=most_mps, sample_m=worse_m)
    reach = over_ticks(time_ns, off_m, frozen=samples.frozen, count=log.ticks, **grid)
    first_ns, last_ns = int(time_ns[0]), int(time_ns[-1])
    at_ends_m = float(max(sample_m[0], sample_m[-1]))
    return from_ends(reach, first_ns, last_ns, most=most_mps, sample=at_ends_m, **grid)


def _refuse_fast(
    samples: LogSamples,
    time_ns: NDArray[np.int64],  # (n,)
    known_to_m: NDArray[np.float64],  # (n,)
    most_mps: float,
    clock_known_to_s: float,
    stride: int,
) -> None:
    """Raise LogError if a body certainly exceeds ``most_mps`` between samples with a distance ``stride``."""
    way_m = np.linalg.norm(samples.values[stride:] - samples.values[:-stride], axis=1)
    step_s = (time_ns[stride:] - time_ns[:-stride]) / NS
    # The clock's error may lengthen the step at both of its ends.
    most_m = most_mps * (step_s + 2.0 * clock_known_to_s) + known_to_m[:-stride] + known_to_m[stride:]
    fast = np.flatnonzero(way_m > most_m + ROUNDING_M)
    if len(fast):
        index = int(fast[0])
        speed_mps = way_m[index] / step_s[index]
        earlier = "the sample before" if stride == 1 else f"the sample {stride} before"
        raise samples.error(
            index + stride,
            f"a way from {earlier} that is possible at {most_mps:g} m/s",
            f"{way_m[index] * 1e3:.4g} mm in {step_s[index] * 1e3:.4g} ms, {speed_mps:.3g} m/s",
            "another marker, another unit or another clock from here on? or hands: {moves at most: ...}",
        )


def _of_hands(log: CellLog, paths: list[_Path]) -> dict[str, Measurement]:
    """Return the source, the uncertainty and the gaps of each column with hands or elbows."""
    if not paths:
        return {}
    assert log.hand_facts is not None
    most = log.hand_facts.moves_at_most_mps
    columns = {HAND: _together([path.hand for path in paths], most)}
    if all(path.elbow is not None or not path.body.forearm for path in paths):
        columns[ELBOW] = _together([path.elbow or path.hand for path in paths], most)
    return columns


def _together(reaches: list[Reach], most_mps: float) -> Measurement:
    off_m = np.max([reach.within for reach in reaches], axis=0)
    gaps = [gap for hand, reach in enumerate(reaches) for gap in reach.known_gaps(hand)]
    return measurement(Source.LOG, off_m, gaps, most_mps)


def _scenario(log: CellLog, paths: list[_Path], recordings: dict[str, bytes]) -> Scenario:
    """Return the scenario of the trace: the arm, the settings, the claims, and the recorded hands."""
    given = dict(log.said.entries("the log of a cell"))
    joints = log.joints.values[0, : log.joints.values.shape[1] // 2]
    stream = log.joints.source.name
    entries: dict[str, Node] = {
        "scenario": given["title"].node if "title" in given else _scalar(f"recorded in {stream}"),
        "duration": _scalar(format_quantity((log.ticks - 1) * log.period_s, TIME)),
        "avoider": _scalar(RECORDED),
        "tcp start": _mapping({"joints": _list([format_quantity(float(a), ANGLE) for a in joints])}),
        "settings": settings_with(log.period_s, given.get("settings"), ahead_s(log.told)),
        "claims": claims_of(given.get("claims")),
    }
    entries |= {key: given[key].node for key in ("about", *_PASSED_ON) if key in given}
    if paths:
        entries["hands"] = Sequence(tuple(_hand(log, path) for path in paths), 1)
    tree = Mapping(tuple((Scalar(key, node.line), node) for key, node in entries.items()), 1)
    scenario = scenario_of(tree, log.file, recordings, name=log.name, claims_required=False)
    for path in paths:
        own = scenario.settings.hand
        if not path.body.forearm and own.forearm_radius_m > own.radius_m:
            raise log.said.error(
                "a forearm no thicker than the hand, since the log's hands have no forearm",
                got=f"{own.forearm_radius_m:g} m",
            )
    return scenario


def _hand(log: CellLog, path: _Path) -> Node:
    return _mapping(
        {
            "recording": _scalar(f"{log.name}-{path.body.name.replace(' ', '-')}.csv"),
            "sha256": _scalar(hashlib.sha256(path.data).hexdigest()),
            "hand": _scalar(path.body.name),
            "track": _scalar("hand"),
            "elbow track": _scalar("elbow"),
            "starts at": _list([format_quantity(value, LENGTH) for value in path.starts_at_m]),
            # The largest values that a scenario allows, because the log's own limits have already been
            # applied.
            "longest gap": _scalar("10 s"),
            "fastest jump": _scalar("1000 m/s"),
        }
    )


def settings_with(period_s: float, given: Field | None, lead: float | None = None) -> Node:
    """Return the settings in LOG.yaml, plus the control period and the horizon of the detections.

    Args:
        period_s: The period of the ticks [s].
        given: The settings in LOG.yaml, or None if it has none.
        lead: The horizon [s] by which detections are predicted, or None if the log has no detections.

    Raises:
        InputError: The settings contain a clock, or a horizon that differs from ``lead``.

    """
    period = _mapping({"control period": _scalar(format_quantity(period_s, TIME))})
    groups = {} if given is None else dict(given.entries("a mapping of groups of settings"))
    if "clock" in groups:
        raise groups["clock"].error(
            "the period below log", got="settings of a clock", hint="log: {period: 8 ms}"
        )
    own = groups.get(_HAND_FILTER)
    if own is not None and lead is not None:
        for key, item in own.entries("settings of the filter"):
            if key == _HORIZON and item.quantity(TIME) != lead:
                raise item.error(f"{format_quantity(lead, TIME)}, the lead of the detections, or no such key")
    entries = tuple((Scalar(key, item.line), item.node) for key, item in groups.items())
    if lead is not None:
        horizon = Scalar(_HORIZON, 1), _scalar(format_quantity(lead, TIME))
        kept: tuple[tuple[Scalar, Node], ...] = ()
        if own is not None and isinstance(own.node, Mapping):
            kept = tuple(pair for pair in own.node.entries if pair[0].text != _HORIZON)
        entries = tuple(entry for entry in entries if entry[0].text != _HAND_FILTER)
        entries = (*entries, (Scalar(_HAND_FILTER, 1), Mapping((*kept, horizon), 1)))
    return Mapping((*entries, (Scalar("clock", 1), period)), 1)


def claims_of(given: Field | None) -> Node:
    """Return the claims of LOG.yaml as a mapping from each claim to its expected verdict, as in a scenario.

    If LOG.yaml has a list of claims, each of them is expected to hold.
    """
    if given is None:
        return Mapping((), 1)
    if isinstance(given.node, Mapping):
        return given.node
    items = given.items("claims: a list of sentences, or a mapping with the verdict that you expect of each")
    sentences = [(item, item.scalar("a sentence of the catalogue, or a formula")) for item in items]
    for at, (item, sentence) in enumerate(sentences):
        if sentence in [earlier for _, earlier in sentences[:at]]:
            raise item.error("each claim once", got=f'"{sentence}" twice')
    return Mapping(
        tuple(
            (Scalar(text, item.line, log_file(item)), Scalar("holds", item.line, log_file(item)))
            for item, text in sentences
        ),
        given.line,
        log_file(given),
    )


def log_file(field: Field) -> Path | None:
    """Return the file that contains ``field``."""
    return field.origin or field.file


def _scalar(text: str) -> Scalar:
    return Scalar(text, 1)


def _list(texts: list[str]) -> Sequence:
    return Sequence(tuple(_scalar(text) for text in texts), 1)


def _mapping(entries: dict[str, Node]) -> Mapping:
    return Mapping(tuple((Scalar(key, 1), node) for key, node in entries.items()), 1)


def _system(scenario: Scenario) -> SystemUnderTest:
    """Return a description of the real system as an unknown controller and an unknown perception."""
    system = system_of(scenario, controller=Component(name=RECORDED))
    return replace(system, perception=Component(name=RECORDED))


def _provenance(log: CellLog) -> Provenance:
    """Return the provenance of this package, with the hashes of the log's files."""
    ours = provenance(RECORDED)
    return replace(
        ours, files=(*ours.files, *((str(display_path(file)), sha256_of(file)) for file in log.files))
    )


def _notes(log: CellLog, paths: list[_Path]) -> Iterator[str]:
    """Yield notes for the reader about the conversion of the log to a trace."""
    origin = log.origin_ns / NS
    tail_s = (int(log.joints.time_ns[-1]) - log.origin_ns) / NS - (log.ticks - 1) * log.period_s
    yield (
        f"recorded, not simulated: time 0 is {origin:.3f} s of the joints' clock; judged every "
        f"{log.period_s * 1e3:g} ms, straight between samples"
    )
    if tail_s > 0.0:
        yield f"the last {tail_s * 1e3:.3g} ms of the joints are less than a period, and not judged"
    if log.joint_facts.accelerate_at_most_radps2 is None:
        yield (
            "no limit of the joints' acceleration is stated, so they may turn at greatest speed between "
            "samples; joints: {accelerate at most: ...} bounds their angles more closely"
        )
    bodies = [part for body in log.hands for part in (body.hand, body.elbow) if part is not None]
    for samples in (log.joints, *bodies, *(() if log.tcp is None else (log.tcp.samples,))):
        yield from samples.notes
    yield from _beyond_joints(log)[1]
    if log.unmapped:
        yield (
            f"neither mapped nor left out: {', '.join(log.unmapped)}, so any of them may be a hand, and "
            "claims on any hand are open; log: {hands: ...} maps it, hands: {left out: [...]} leaves it out"
        )
    if log.left_out:
        yield f"left out, as the file says: {', '.join(log.left_out)}"
    if log.unused:
        more = f" and {len(log.unused) - UNUSED_NAMED} more" * (len(log.unused) > UNUSED_NAMED)
        yield f"unread columns, topics and joints: {', '.join(log.unused[:UNUSED_NAMED])}{more}"
    for path in paths:
        if path.elbow is None:
            how = (
                "its forearm was not measured" if path.body.forearm else "it has no forearm, as the file says"
            )
            yield f"{path.body.name}: {how}"
    yield unconfirmed_note(log)
