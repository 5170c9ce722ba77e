"""Read a controller's reports from a log: mode, limits, commands, predicted hands and decisions.

The values in a report are exact, whereas measurements have errors. A report is valid from its stamp until the
next report. The uncertainty of the stamps is stated in LOG.yaml. If no report comes for longer than the
longest gap, a report may be lost.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import reduce
from operator import or_

import numpy as np
from numpy.typing import NDArray

from safety_harness.base.exceptions import LogError
from safety_harness.extensions.field.logs.bags import RECEIVED, STAMP, Part, read_parts
from safety_harness.extensions.field.logs.frames import ToBase
from safety_harness.extensions.field.logs.streams import LATEST_S, NS, Collector, LogSamples, LogSource
from safety_harness.extensions.field.logs.tables import (
    ANGLE_UNITS,
    LENGTH_UNITS,
    RATE_UNITS,
    Table,
    TableColumn,
    header_of,
    read_table,
    required_column,
    time_column,
)
from safety_harness.scenario.fields import Field, Fields
from safety_harness.scenario.nodes import Mapping as MappingNode
from safety_harness.scenario.units import TIME
from safety_harness.trace.records import DecisionOutcome, Limit, Mode, Trigger

MODE, LIMITS, COMMANDS, DETECTIONS, DECISIONS = "mode", "limits", "commands", "detections", "decisions"
STREAMS = (MODE, LIMITS, COMMANDS, DETECTIONS, DECISIONS)
_COMMON = ("clock", "known to", "time")
KEYS_OF = {
    MODE: (*_COMMON, "longest gap", "words"),
    LIMITS: (*_COMMON, "longest gap", "words"),
    COMMANDS: (*_COMMON, "longest gap", "unit"),
    DETECTIONS: (*_COMMON, "longest gap", "unit", "frame", "ahead by"),
    DECISIONS: (*_COMMON, "unit", "frame", "fields", "words"),
}
UNTIL_THE_NEXT = "until the next"
OF_JOINTS, OF_HANDS = "joints", "hands"
MODES = {
    "servoing": Mode.SERVOING,
    "repulsing": Mode.REPULSING,
    "stopped": Mode.PROTECTIVE_STOP,
    "object lost": Mode.OBJECT_LOST,
}
FLAGS = {"none": Limit.NONE} | {kind.name.lower().replace("_", " "): kind for kind in Limit if kind.name}
OUTCOMES = {kind.name.lower(): kind for kind in DecisionOutcome}
TRIGGERS = {kind.name.lower().replace("_", " "): kind for kind in Trigger}
POSITIONS = {
    "hand": "hand_position_in_base_m",
    "tcp": "tcp_position_in_base_m",
    "proposed": "proposed_position_in_base_m",
    "chosen": "chosen_position_in_base_m",
    "opposite": "opposite_position_in_base_m",
}
SPREAD, THRESHOLD, OUTCOME, TRIGGER = "spread", "threshold", "outcome", "trigger"
FIELDS = {
    **POSITIONS,
    SPREAD: "proposed_spread_m",
    THRESHOLD: "spread_threshold_m",
    OUTCOME: "outcome",
    TRIGGER: "trigger",
}
# Larger numbers come from a wrong unit, such as degrees or millimetres.
FASTEST_RADPS, FARTHEST_M, LARGEST_SPREAD_M = 8.0 * np.pi, 10.0, 10.0


@dataclass(frozen=True, eq=False, kw_only=True)
class ReportedStream:
    """A stream of reports.

    The stamps ``time_ns`` (n,) are on the joints' clock, and have errors of at most ``off_ns``.
    """

    samples: LogSamples
    time_ns: NDArray[np.int64]
    off_ns: int
    longest_ns: int | None

    @property
    def values(self) -> NDArray[np.float64]:
        """The numbers in the reports, with one row for each report, shape (n, k)."""
        return self.samples.values


@dataclass(frozen=True, eq=False, kw_only=True)
class ControllerReports:
    """All reports in a log.

    ``fields`` lists the fields of a decision in the order of the columns in ``decisions``.
    """

    mode: ReportedStream | None = None
    limits: ReportedStream | None = None
    commands: ReportedStream | None = None
    tracks: tuple[ReportedStream, ...] = ()
    ahead: Field | None = None  # the horizon by which the reported hands are predicted
    decisions: ReportedStream | None = None
    fields: tuple[str, ...] = ()


@dataclass(frozen=True, kw_only=True)
class ReportClock:
    """The offset by which the hands' clock is ahead of the joints' clock, with its uncertainty."""

    hands_ahead_ns: int | None
    hands_known_to_ns: int


Positions = Callable[[Field, Fields], LogSamples]  # reads positions in the base frame, and keeps NaN
Places = Callable[[Field, LogSamples, int], LogSamples]  # moves columns k to k + 2 from a frame to base


def read_reports(
    given: Fields,
    streams: Fields,
    joints: tuple[str, ...],
    clock: ReportClock,
    source_of: Callable[[Field], LogSource],
    positions: Positions,
    placed: Places,
    to_base: Callable[[LogSource, Field], ToBase],
) -> ControllerReports:
    """Return the controller's reports.

    The function reads each stream in ``STREAMS`` that LOG.yaml lists below the key ``log``.

    Args:
        given: The keys of LOG.yaml.
        streams: The keys below ``log``.
        joints: The names that the joints have in the log, in the order of the arm's joints.
        clock: The lead of the hands' clock.
        source_of: A function that returns the stream to which a field refers.
        positions: A function that reads a stream of positions in the base frame and keeps NaN.
        placed: A function that transforms positions to the base frame. The positions are three columns of
            samples.
        to_base: A function that returns the transforms of a stream's messages from a stated frame to the base
            frame.

    Raises:
        LogError: A stream or a key cannot be used (the error states its place).

    """
    parts: dict[str, object] = {}
    for name in STREAMS:
        if name not in streams:
            if name in given:
                hint = f"log: {{{name}: FILE}}"
                raise given.required(name).error(f"a stream of {name} below log", got="none", hint=hint)
            continue
        keys = given.required(name).fields(KEYS_OF[name])
        own = _Reading(name, streams.required(name), keys, clock, source_of)
        if name in (MODE, LIMITS):
            parts[name] = own.stream(own.codes_of(keys.required("words"), MODES if name == MODE else FLAGS))
        elif name == COMMANDS:
            parts[name] = own.commands(joints)
        elif name == DETECTIONS:
            parts["tracks"] = own.tracks(positions)
            parts["ahead"] = keys.required("ahead by")
        else:
            parts[name], parts["fields"] = own.decisions(placed, to_base)
    return ControllerReports(**parts)  # type: ignore[arg-type]


@dataclass(frozen=True)
class _Reading:
    """A reader of one stream.

    ``field`` is the entry of LOG.yaml that refers to the stream, and ``keys`` are the keys of LOG.yaml that
    describe it.
    """

    name: str
    field: Field
    keys: Fields
    clock: ReportClock
    source_of: Callable[[Field], LogSource]

    def codes_of(self, table: Field, ours: Mapping[str, int]) -> dict[str, float]:
        """Return a mapping from each word or number in the log to its code.

        If a word in the log stands for several flags, LOG.yaml lists these flags with "and" between them.
        """
        meanings = {}
        for term, entry in table.entries("the log's words with ours, such as RETREAT: repulsing"):
            text = entry.scalar("a word of ours")
            parts = text.split(" and ") if Limit.NONE in ours.values() else [text]
            codes = [ours[part] if part in ours else entry.one_of(dict(ours)) for part in parts]
            meanings[term] = float(reduce(or_, (int(code) for code in codes)))
        if not meanings:
            raise table.error("a word at least")
        return meanings

    def stream(self, codes: dict[str, float]) -> ReportedStream:
        """Return a stream whose samples are the codes of words."""
        source = self.source_of(self.field)
        if source.is_bag:
            return self.timed(self.read_bag(source, [Part(self.path(source), 1, 1.0, codes)]))
        return self.timed(self.read(source, [TableColumn(self.column(source), 1.0, codes)]))

    def commands(self, joints: tuple[str, ...]) -> ReportedStream:
        """Return the stream of the commanded joint speeds (n, j)."""
        source, unit = self.source_of(self.field), self.keys.optional("unit")
        angle = None if unit is None else unit.one_of({item: item for item in ANGLE_UNITS})
        if source.is_bag:
            si = ANGLE_UNITS[angle or "rad"]
            part = Part(source.path or "velocity", len(joints), si, names="" if source.path else "name")
            samples = self.read_bag(source, [part], joints)
        else:
            header, rate = header_of(source), None if angle is None else f"{angle}ps"
            columns = [
                required_column(source, header, f"{source.what}{name}", RATE_UNITS, rate) for name in joints
            ]
            samples = self.read(source, columns)
        self.refuse(samples, ~np.isfinite(samples.values), "a speed of each joint", "none")
        fast, most = np.abs(samples.values) > FASTEST_RADPS, np.degrees(FASTEST_RADPS)
        self.refuse(samples, fast, f"joint speeds of at most {most:.0f} deg/s", "more", 'the key "unit"')
        return self.timed(samples)

    def tracks(self, positions: Positions) -> tuple[ReportedStream, ...]:
        """Return one stream for each tracked hand.

        A sample without numbers means that the hand was not tracked at that time.
        """
        field, several = self.field, isinstance(self.field.node, MappingNode)
        parts = field.entries("tracked hands by their names") if several else (("", field),)
        if not parts:
            raise field.error("a tracked hand at least")
        streams = []
        for _, stream in parts:
            streams.append(self.timed(positions(stream, self.keys)))
        return tuple(streams)

    def decisions(
        self, placed: Places, to_base: Callable[[LogSource, Field], ToBase]
    ) -> tuple[ReportedStream, tuple[str, ...]]:
        """Return the stream of decisions, and the names of its fields in the order of ``FIELDS``."""
        mapped = self.keys.required("fields").fields(tuple(FIELDS))
        table_keys = self.keys.optional("words")
        given = None if table_keys is None else table_keys.fields((OUTCOME, TRIGGER))
        tables = {}
        for name, ours in ((OUTCOME, OUTCOMES), (TRIGGER, TRIGGERS)):
            table = None if given is None else given.optional(name)
            tables[name] = (
                {w: float(c) for w, c in ours.items()} if table is None else self.codes_of(table, ours)
            )
        names = tuple(name for name in FIELDS if name in mapped)
        if not names:
            raise self.keys.required("fields").error("a field at least", hint=", ".join(FIELDS))
        widths = tuple(width_of(name) for name in names)
        source, unit = self.source_of(self.field), self.keys.optional("unit")
        label = None if unit is None else unit.one_of({item: item for item in LENGTH_UNITS})
        called = {name: mapped.required(name).sentence("the log's name for it") for name in names}
        if source.is_bag:
            parts = [
                Part(
                    called[name],
                    width,
                    1.0 if name in tables else LENGTH_UNITS[label or "m"],
                    tables.get(name),
                )
                for name, width in zip(names, widths, strict=True)
            ]
            somewhere = any(name in POSITIONS for name in names)
            framed = to_base(source, self.keys.required("frame")) if somewhere else None
            samples = self.read_bag(source, parts, least=0, framed=framed)
        else:
            header, columns = header_of(source), []
            for name in names:
                stem = source.what + called[name]
                if name in tables:
                    self.column(source, stem)
                    columns.append(TableColumn(stem, 1.0, tables[name]))
                    continue
                stems = [stem] if name == THRESHOLD else [f"{stem}_{axis}" for axis in "xyz"]
                columns += [required_column(source, header, item, LENGTH_UNITS, label) for item in stems]
            samples = self.read(source, columns, least=0)
        at = dict(zip(names, np.cumsum((0, *widths)).tolist(), strict=False))
        for name in names:
            if name in POSITIONS:
                samples = placed(self.keys.required("frame"), samples, at[name])
        self.refuse_no_decision(samples, at)
        return self.timed(samples), names

    def refuse_no_decision(self, samples: LogSamples, at: Mapping[str, int]) -> None:
        """Raise LogError for impossible numbers, and for missing positions that the outcome requires."""
        values = samples.values
        stops = np.zeros(len(values), np.bool_)
        if OUTCOME in at:
            stops = values[:, at[OUTCOME]] == DecisionOutcome.STOP
        for name, first in at.items():
            here = values[:, first : first + width_of(name)]
            if name in POSITIONS:
                none = np.asarray(~np.isfinite(here).all(axis=1))
                if name == "chosen":
                    # A stop has no chosen position.
                    none &= ~stops
                elif name == "proposed" and OUTCOME in at:  # only a proposal that was used needs numbers
                    none &= values[:, at[OUTCOME]] == DecisionOutcome.PROPOSED
                elif name == "opposite":
                    none[:] = False
                self.refuse(samples, none, f'three numbers for "{name}"', "none")
                far = np.abs(here) > FARTHEST_M
                self.refuse(samples, far, f'"{name}" within {FARTHEST_M:g} m', "more", 'the key "unit"')
            elif name == SPREAD:
                self.refuse(
                    samples, (here < 0.0) | (here > LARGEST_SPREAD_M), "a spread of 0 to 10 m", "none"
                )

    def refuse(
        self, samples: LogSamples, bad: NDArray[np.bool_], expected: str, got: str, hint: str = ""
    ) -> None:
        """Raise LogError at the first sample where ``bad`` (n, ...) is true."""
        if bad.any():
            index = int(np.argmax(bad.reshape(len(bad), -1).any(axis=1)))
            numbers = ", ".join(f"{value:.6g}" for value in samples.values[index])
            raise samples.error(index, f"{self.name}: {expected}", f"{got} ({numbers})", hint)

    def path(self, source: LogSource) -> str:
        """Return the path to the word in a message."""
        return source.path or "data"

    def column(self, source: LogSource, name: str | None = None) -> str:
        """Return the name of a column; raise LogError if the table has no such column."""
        wanted, header = source.what if name is None else name, header_of(source)
        if wanted not in header:
            columns = f"the columns: {', '.join(header)}"
            raise LogError(
                place=source.place, expected="the name of a column", got=wanted or "none", hint=columns
            )
        return wanted

    def read(self, source: LogSource, columns: list[TableColumn], least: int = 1) -> LogSamples:
        """Return the samples in the ``columns`` of a table."""
        time_key = self.keys.optional("time")
        time = time_column(
            source, header_of(source), None if time_key is None else time_key.sentence("the name of a column")
        )
        collector = Collector(source, len(columns), least=least)
        read_table(Table(*time, tuple(columns)), collector)
        return collector.samples()

    def read_bag(
        self,
        source: LogSource,
        parts: list[Part],
        names: tuple[str, ...] = (),
        least: int = 1,
        framed: ToBase | None = None,
    ) -> LogSamples:
        """Return the samples in a topic; a sample consists of the ``parts`` of one message."""
        time_key = self.keys.optional("time")
        time = STAMP if time_key is None else time_key.one_of({stamp: stamp for stamp in (STAMP, RECEIVED)})
        collector = Collector(source, sum(part.width for part in parts), least=least)
        read_parts(source, collector, parts, names, time=time, framed=framed)
        return collector.samples()

    def timed(self, samples: LogSamples) -> ReportedStream:
        """Return the samples as a stream of reports whose stamps are on the clock of the joints."""
        clock, by_ns = self.keys.optional("clock"), 0
        off_ns = round(self.keys.required("known to").quantity(TIME, least=0.0, most=LATEST_S) * NS)
        if clock is not None and clock.one_of({OF_JOINTS: False, OF_HANDS: True}):
            if self.clock.hands_ahead_ns is None:
                raise clock.error("the clock of the joints, since the log has no hands", got=OF_HANDS)
            by_ns, off_ns = self.clock.hands_ahead_ns, off_ns + self.clock.hands_known_to_ns
        longest_ns = None
        # A decision is an event, while each other report is valid for some time.
        if self.name != DECISIONS:
            gap = self.keys.required("longest gap")
            if gap.scalar("a time, or: until the next") != UNTIL_THE_NEXT:
                longest_ns = round(gap.quantity(TIME, above=0.0, most=LATEST_S) * NS)
        return ReportedStream(
            samples=samples, time_ns=samples.time_ns - by_ns, off_ns=off_ns, longest_ns=longest_ns
        )


def width_of(name: str) -> int:
    """Return the number of columns for a field of a decision."""
    return 3 if name in POSITIONS or name == SPREAD else 1


def ahead_s(reports: ControllerReports) -> float | None:
    """Return the prediction horizon [s] of the reported hands, or None if the log reports no hands."""
    return None if reports.ahead is None else reports.ahead.quantity(TIME, least=0.0, most=2.0)
