"""Read LOG.yaml.

LOG.yaml lists the streams of a log, and states the clock, the frame, the unit and the uncertainty of each
stream. LOG.yaml also has keys of a scenario (robot, settings, obstacles, claims). The code that makes the
trace reads these keys in the same way as a scenario's keys.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from safety_harness.base.elementary import product
from safety_harness.base.exceptions import LogError, Place
from safety_harness.cell.robot.description import ArmModel
from safety_harness.cell.robot.robots import arm_model, refuse_unenclosed
from safety_harness.extensions.field.logs.bags import RECEIVED, STAMP, read_joints, read_positions
from safety_harness.extensions.field.logs.checked import (
    joints_checked,
    noted_beyond_ends,
    positions_checked,
    refuse_another_unit,
    refuse_contradicting_speeds,
    refuse_jumping_joints,
    refuse_the_same,
    the_short_way,
    with_bounds,
)
from safety_harness.extensions.field.logs.controller_reports import (
    STREAMS,
    ControllerReports,
    ReportClock,
    read_reports,
)
from safety_harness.extensions.field.logs.facts import (
    FORMAT,
    OF_HANDS,
    RATE,
    facts_of_hands,
    facts_of_joints,
    said_of_joints,
)
from safety_harness.extensions.field.logs.frames import (
    ToBase,
    by_given,
    by_header,
    frame_name,
    given_transform,
)
from safety_harness.extensions.field.logs.frozen import REPEATS, with_frozen
from safety_harness.extensions.field.logs.model import Body, CellLog, JointFacts, TcpCheck
from safety_harness.extensions.field.logs.sample_bound import SampleBound, sample_bound
from safety_harness.extensions.field.logs.streams import (
    LATEST_S,
    NS,
    Collector,
    LogSamples,
    LogSource,
    read_source,
)
from safety_harness.extensions.field.logs.tables import (
    ANGLE_UNITS,
    LENGTH_UNITS,
    RATE_UNITS,
    RTDE_BASE,
    RTDE_JOINTS,
    RTDE_TCP,
    RTDE_TIME,
    SPEED_UNITS,
    Table,
    along,
    header_of,
    only_track,
    optional_column,
    read_table,
    required_column,
    time_column,
    tracks_of,
)
from safety_harness.extensions.field.logs.tcp import checked_tcp
from safety_harness.scenario.compose import MAX_BYTES
from safety_harness.scenario.fields import Field, Fields
from safety_harness.scenario.files import decode, read_bytes
from safety_harness.scenario.kinds import FileKind, refuse_other_kind
from safety_harness.scenario.nodes import Mapping, Scalar, parse_tree
from safety_harness.scenario.robots import AnyRobot, Robot, read_robot
from safety_harness.scenario.units import LENGTH, SPEED, TIME
from safety_harness.scenario.units import RATE as HERTZ

TCP = "tcp"
KEYS = (
    *("log", "title", "about", "clock", "joints", "hands", TCP, *STREAMS),
    *("robot", "obstacles", "camera", "settings", "claims"),
)
OF_LOG = ("joints", "hands", TCP, *STREAMS, "from", "to", "period")
OF_CLOCK = ("hands are ahead by", "known to")
OF_TCP = ("known to", FORMAT, "frame", "unit", "time", REPEATS)
NOT_MEASURED, NO_FOREARM, BASE, ELBOW = "not measured", "none", "base", "elbow"
DEG, MM = ("deg", 180.0 / np.pi), ("mm", 1e3)
FIELD = "a column after the track's name, or the path of a field"
PERIOD_STEP_NS, SHORTEST_PERIOD_NS, LONGEST_PERIOD_NS = 100_000, 1_000_000, 50_000_000  # of the ticks


def read_log(path: str | Path, *, align: bool = False) -> CellLog:
    """Return the log that a file describes.

    Args:
        path: The LOG.yaml.
        align: True to read the hands at all times, even if LOG.yaml states no clock.

    Raises:
        InputError: A part of the file cannot be used (the error states its place).

    """
    file = Path(path)
    return log_of(said_in(file), name=file.stem, align=align)


def said_in(file: Path) -> Field:
    """Return the tree of a LOG.yaml without checks; raise LogError if ``file`` is a file of another kind."""
    refuse_other_kind(file, FileKind.LOG, error=LogError)
    data = read_bytes(file, most=MAX_BYTES, place=Place(file=file), error=LogError)
    text = decode(data, most=MAX_BYTES, file=file, error=LogError)
    return Field(parse_tree(text, file), file, path="", line=1)


def log_of(tree: Field, *, name: str, align: bool = False) -> CellLog:
    """Return the log that a tree describes.

    Args:
        tree: The tree of the LOG.yaml.
        name: The name of the log.
        align: As for ``read_log``.

    """
    given = tree.fields(KEYS)
    robot = read_robot(given.optional("robot") or Robot.UR10, {})
    refuse_unenclosed(robot)
    streams = given.required("log").fields(OF_LOG)
    arm = arm_model(robot)
    reading = _Reading(given, streams, arm)
    joints = reading.joints()
    joints, facts = reading.with_facts(joints)
    period_ns = _period_ns(streams, joints)
    bodies: tuple[Body, ...] = ()
    hand_facts, ahead_ns, known_to_s = None, 0, 0.0
    if "hands" in streams:
        of_hands = given.required("hands").fields(OF_HANDS)
        hand_facts = facts_of_hands(of_hands, each=True)
        if not align:
            clock = given.required("clock").fields(OF_CLOCK)
            ahead_ns = round(clock.required(OF_CLOCK[0]).quantity(TIME, least=-LATEST_S, most=LATEST_S) * NS)
            known_to_s = clock.required(OF_CLOCK[1]).quantity(TIME, least=0.0, most=LATEST_S)
        slack_ns = None if align else round((hand_facts.longest_gap_s + known_to_s) * NS)
        bodies = reading.bodies(joints, of_hands, ahead_ns, slack_ns)
    elif "hands" in given or "clock" in given:
        key = "hands" if "hands" in given else "clock"
        raise given.required(key).error("a stream of hands below log", got="none", hint="log: {hands: FILE}")
    clock_ns = None if hand_facts is None else ahead_ns
    reports = (
        ControllerReports()
        if align
        else reading.reports(ReportClock(hands_ahead_ns=clock_ns, hands_known_to_ns=round(known_to_s * NS)))
    )
    left_out, unmapped = ((), ()) if hand_facts is None else reading.neither(of_hands, bodies)
    tcp = reading.tcp(joints, facts, robot)
    log = CellLog(
        name=name,
        file=tree.file,
        said=tree,
        robot=robot,
        joints=joints,
        joint_facts=facts,
        hands=bodies,
        hand_facts=hand_facts,
        hands_ahead_ns=ahead_ns,
        clock_known_to_s=known_to_s,
        period_ns=period_ns,
        files=tuple(dict.fromkeys(file for source in reading.sources for file in source.files)),
        told=reports,
        left_out=left_out,
        unmapped=unmapped,
        tcp=tcp,
        unused=reading.unused((*left_out, *unmapped)),
    )
    if log.ticks < 2:
        raise streams.required("joints").error("two control periods of joints, at least", got="less")
    return log


@dataclass
class _Reading:
    """A reader of the streams that LOG.yaml lists; it reads the joints before the other streams."""

    given: Fields
    streams: Fields
    arm: ArmModel

    def __post_init__(self) -> None:
        self.sources: list[LogSource] = []
        self.mapped: set[str] = set()
        self.bodies_seen: set[str] = set()

    def joints(self) -> LogSamples:
        """Return the positions and velocities (n, 2 j) of the joints."""
        source = self._source(self.streams.required("joints"))
        keys = said_of_joints(self.given)
        names = _names(keys.optional("names"), self.arm)
        rtde = _is_of_rtde(keys, source)
        window = [self._seconds(key) for key in ("from", "to")]

        def begin(first_ns: int) -> list[int | None]:
            return [None if at_s is None else first_ns + round(at_s * NS) for at_s in window]

        collector = Collector(source, 2 * len(names), begin=begin, unstamped_before=self._chooses_begin)
        unit = keys.optional("unit")
        if source.is_bag:
            angle = ANGLE_UNITS[_unit_of(unit, ANGLE_UNITS)] if unit else 1.0
            read_joints(source, collector, names, time=_time(keys), angle=angle)
        else:
            header = header_of(source)
            label, when = _unit_of(unit, ANGLE_UNITS) if unit else None, _time_text(keys.optional("time"))
            columns, rate = [(f"{source.what}{name}",) * 2 for name in names], None
            if rtde:
                label, rate, when = label or "rad", "radps", when or RTDE_TIME
                stems = [f"{source.what}{col}" for col in RTDE_JOINTS]
                columns = [(f"{stems[0]}{k}", f"{stems[1]}{k}") for k in range(len(names))]
            at = [required_column(source, header, col, ANGLE_UNITS, label) for col, _ in columns]
            rates = [optional_column(source, header, col, RATE_UNITS, rate, bare=False) for _, col in columns]
            time = time_column(source, header, when)
            read_table(Table(*time, (*at, *rates)), collector)
        samples = collector.samples()
        return joints_checked(with_frozen(samples, [*samples.values.T[: len(names), :, None]], keys), names)

    def with_facts(self, joints: LogSamples) -> tuple[LogSamples, JointFacts]:
        """Check the joints against the statements in LOG.yaml, and return the joints and the statements.

        The returned joints have no wraps.
        """
        facts = facts_of_joints(said_of_joints(self.given), self.arm)
        joints = noted_beyond_ends(the_short_way(joints, facts, self.arm), self.arm)
        refuse_jumping_joints(joints, facts, self.arm.joint_names)
        if facts.speeds_known_to_radps is None:
            refuse_another_unit(joints, self.arm.joint_names)
        else:
            angles, speeds = np.split(joints.values, 2, axis=1)
            known, hard = (facts.known_to_rad, facts.speeds_known_to_radps), facts.accelerate_at_most_radps2
            refuse_contradicting_speeds(joints, angles, speeds, known, hard, self.arm.joint_names, DEG)
        return joints, facts

    def bodies(
        self, joints: LogSamples, of_hands: Fields, ahead_ns: int, slack_ns: int | None
    ) -> tuple[Body, ...]:
        """Return the hands.

        Args:
            joints: The joints, whose times determine the window.
            of_hands: The keys below "hands".
            ahead_ns: The lead of the hands' clock.
            slack_ns: The time before and after the joints for which hands are read. None: all times.

        """
        window = (None, None)
        if slack_ns is not None:
            begin, end = int(joints.time_ns[0]), int(joints.time_ns[-1])
            window = begin + ahead_ns - slack_ns, end + ahead_ns + slack_ns  # type: ignore[assignment]
        field = self.streams.required("hands")
        forearm = of_hands.required("forearm")
        named = isinstance(field.node, Mapping)
        hands = field.entries("hands by their names") if named else (("hand", field),)
        if not hands:
            raise field.error("a hand at least")
        known, result = of_hands.required("known to"), []
        bound = sample_bound(known) if isinstance(known.node, Mapping) else None
        speed_keys = of_hands.optional("speeds")
        speeds = None if speed_keys is None else speed_keys.fields(("known to", "field"))
        for name, item in hands:
            own = forearm
            if isinstance(forearm.node, Mapping):
                own = forearm.fields(tuple(name for name, _ in hands)).required(name)
            hand = self._positions(item, of_hands, window, bound=bound, speeds=speeds)
            if speeds is not None and hand.speeds_mps is not None:
                off_m = known.quantity(LENGTH) if hand.known_to_m is None else float(hand.known_to_m.max())
                of_both = off_m, speeds.required("known to").quantity(SPEED, least=0.0)
                axes = [f"{axis} of {hand.source.name}" for axis in "xyz"]
                refuse_contradicting_speeds(hand, hand.values, hand.speeds_mps, of_both, None, axes, MM)
            elbow, there = None, True
            if isinstance(own.node, Scalar) and own.node.text in (NOT_MEASURED, NO_FOREARM):
                there = own.node.text == NOT_MEASURED
            else:
                elbow = self._positions(own, of_hands, window, bound=bound)
            result.append(Body(name, hand, elbow, there))
        # A stream that is named twice would make one body look like two.
        refuse_the_same([item for body in result for item in (body.hand, body.elbow) if item is not None])
        return tuple(result)

    def tcp(self, joints: LogSamples, facts: JointFacts, robot: AnyRobot) -> TcpCheck | None:
        """Check the TCP positions in the log, and return the result, or None if the log has no TCP positions.

        Their times must be on the clock of the joints.
        """
        if TCP not in self.streams:
            if TCP in self.given:
                hint = "log: {tcp: FILE#TRACK}"
                raise self.given.required(TCP).error("a stream of tcp below log", got="none", hint=hint)
            return None
        keys, bodies = self.given.required(TCP).fields(OF_TCP), self.bodies_seen.copy()
        known_to_m = keys.required("known to").quantity(LENGTH, least=0.0)
        window = int(joints.time_ns[0]), int(joints.time_ns[-1])
        samples = self._positions(self.streams.required(TCP), keys, window)
        self.bodies_seen = bodies
        return checked_tcp(samples, known_to_m, joints, facts, robot)

    def unused(self, bodies: tuple[str, ...]) -> tuple[str, ...]:
        """Return the columns, topics and joints that no key uses and that do not belong to ``bodies``.

        Other notes list ``bodies``.
        """
        seen, used = (
            {f"{item.file.name}#{name}" for item in self.sources for name in (item.seen, item.used)[k]}
            for k in range(2)
        )
        return tuple(sorted(item for item in seen - used if not item.startswith(bodies)))

    def reports(self, clock: ReportClock) -> ControllerReports:
        """Return the controller's reports."""
        names = _names(said_of_joints(self.given).optional("names"), self.arm)

        def placed(frame: Field, samples: LogSamples, first: int) -> LogSamples:
            transform, values = given_transform(frame), samples.values.copy()
            values[:, first : first + 3] = (
                product(values[:, first : first + 3], transform[:3, :3].T) + transform[:3, 3]
            )
            return replace(samples, values=values)

        def positions(field: Field, keys: Fields) -> LogSamples:
            return self._positions(field, keys, (None, None), keep=True)

        return read_reports(
            self.given, self.streams, names, clock, self._source, positions, placed, self._given
        )

    def _positions(
        self,
        field: Field,
        keys: Fields,
        window: tuple[int | None, int | None],
        *,
        keep: bool = False,
        bound: SampleBound | None = None,
        speeds: Fields | None = None,
    ) -> LogSamples:
        """Return the positions of a body in the base frame.

        If ``keep`` is True, the result includes samples without a position.
        """
        source = self._source(field)
        width = 3 + (bound is not None) + 3 * (speeds is not None)
        collector = Collector(source, width, *window, least=2 - keep, unstamped_before=self._chooses_begin)
        read = self._read_bag if source.is_bag else self._read_table
        return positions_checked(read(collector, keys, keep, bound, speeds), keep)

    def _read_bag(
        self, into: Collector, keys: Fields, keep: bool, bound: SampleBound | None, speeds: Fields | None
    ) -> LogSamples:
        """Return positions as ``_positions`` does, from the messages of a topic."""
        source, unit = into.source, keys.optional("unit")
        _is_of_rtde(keys, source)
        length = LENGTH_UNITS[_unit_of(unit, LENGTH_UNITS) if unit else "m"]
        to_base = self._to_base(source, keys.optional("frame"))
        path = None if speeds is None else speeds.required("field").sentence(FIELD)
        read_positions(source, into, _time(keys), length, to_base, halves=not keep, bound=bound, speeds=path)
        index = "" if source.index is None else f"[{source.index}]"
        path = f":{source.path.lstrip('/')}" if source.path else ""
        self._saw(source, f"{source.topic}{index}{path}", set() if keep else into.bodies)
        samples = with_bounds(into.samples(), speeds=speeds is not None)
        return samples if keep else with_frozen(samples, [samples.values], keys)

    def _read_table(
        self, into: Collector, keys: Fields, keep: bool, bound: SampleBound | None, speeds: Fields | None
    ) -> LogSamples:
        """Return positions as ``_positions`` does, from the columns of a table."""
        source, unit, frame = into.source, keys.optional("unit"), keys.optional("frame")
        label, when = _unit_of(unit, LENGTH_UNITS) if unit else None, _time_text(keys.optional("time"))
        track, axes, transform = source.what, "xyz", product(self.arm.transform_seat, RTDE_BASE)
        if _is_of_rtde(keys, source):
            track, axes, label, when = track or RTDE_TCP, "012", label or "m", when or RTDE_TIME
        elif frame is None:
            expected = 'the key "frame": base, or {at: ..., turned: ...} of the frame in which positions are'
            raise keys.whole.error(expected, got=f"no key, and the table {source.name} cannot state it")
        header = header_of(source)
        track = track or only_track(source, header)
        at = [required_column(source, header, along(track, axis), LENGTH_UNITS, label) for axis in axes]
        self._saw(source, track, set() if keep else tracks_of(header, bare=label is not None))
        rate = keys.optional(RATE)
        rate_hz = None if rate is None else rate.quantity(HERTZ, above=0.0)
        time = time_column(source, header, when, rate_hz)
        if bound is not None:
            stem = along(track, bound.field)
            self._saw(source, stem, set())
            box = [optional_column(source, header, f"{stem}_{axis}", LENGTH_UNITS, label) for axis in "xyz"]
            sides = [side for side in box if side is not None]
            at += sides if len(sides) == 3 else [required_column(source, header, stem, LENGTH_UNITS, label)]
        if speeds is not None:
            name = speeds.optional("field")
            stem = track if name is None else along(track, name.sentence(FIELD))
            at += [required_column(source, header, along(stem, axis), SPEED_UNITS, None) for axis in "xyz"]
        into.width = len(at)
        read_table(Table(*time, tuple(at)), into)
        samples = with_bounds(into.samples(), bound, speeds=speeds is not None)
        samples.values[~samples.values.any(axis=1)] = np.nan  # trackers write zeros if they see no body
        gone = np.isnan(samples.values)
        half = gone.any(axis=1) & ~gone.all(axis=1)
        if keep and half.any():
            expected = "all three numbers of a position, or three NaN"
            raise samples.error(int(np.argmax(half)), expected, str(samples.values[half][0].tolist()))
        if not keep:
            samples = with_frozen(samples, [samples.values], keys)
        transform = transform if frame is None else given_transform(frame)
        if samples.speeds_mps is not None:
            samples = replace(samples, speeds_mps=product(samples.speeds_mps, transform[:3, :3].T))
        return replace(samples, values=product(samples.values, transform[:3, :3].T) + transform[:3, 3])

    def _saw(self, source: LogSource, mapped: str, bodies: set[str]) -> None:
        """Record that LOG.yaml uses the body ``mapped``, and that the stream contains ``bodies``."""
        links = {f"/tf:{name}" for name in self.arm.link_names}
        self.mapped.add(f"{source.file.name}#{mapped}")
        self.bodies_seen |= {f"{source.file.name}#{body}" for body in bodies - links}

    def neither(self, of_hands: Fields, bodies: tuple[Body, ...]) -> tuple[tuple[str, ...], tuple[str, ...]]:
        """Return the unmapped bodies that LOG.yaml excludes, then those that it does not mention.

        Elbows are excluded if LOG.yaml states that a forearm is not measured.
        """
        beside, field = sorted(self.bodies_seen - self.mapped), of_hands.optional("left out")
        items = () if field is None else field.items("streams that no hand is in, such as hands.csv#marker")
        if items and not beside:
            raise items[0].error("a stream beside the hands", hint="all bodies of the messages are mapped")
        left = {item.one_of({name: name for name in beside}) for item in items}
        if any(body.forearm and body.elbow is None for body in bodies):
            left |= {name for name in beside if ELBOW in name.partition("#")[2].lower()}
        return tuple(sorted(left)), tuple(name for name in beside if name not in left)

    def _to_base(self, source: LogSource, frame: Field | None) -> ToBase:
        """Return the transform from the frame of a bag's positions to the base frame."""
        base = self.arm.link_names[0]
        seat = self.arm.transform_seat
        if frame is None:
            return by_header(base, source, seat, None)
        keys = {key.text for key, _ in frame.node.entries} if isinstance(frame.node, Mapping) else set()
        if keys & {"tf", "base"}:
            given = frame.fields(("tf", "base"))
            name, tf = given.optional("base"), given.optional("tf")
            base = base if name is None else name.sentence("the name of the base frame in the bag")
            return by_header(base, source, seat, None if tf is None else self._source(tf))
        return self._given(source, frame)

    def _given(self, source: LogSource, frame: Field) -> ToBase:
        """Return the transform from the frame in LOG.yaml; a header with another frame is an error."""
        base = self.arm.link_names[0] if np.array_equal(self.arm.transform_seat, np.eye(4)) else BASE
        return by_given(given_transform(frame), frame_name(frame, base), base, source)

    def _source(self, field: Field) -> LogSource:
        source = read_source(field)
        self.sources.append(source)
        return source

    @property
    def _chooses_begin(self) -> bool:
        """Return True if LOG.yaml states where the log begins."""
        return "from" in self.streams

    def _seconds(self, key: str) -> float | None:
        field = self.streams.optional(key)
        return None if field is None else field.quantity(TIME, least=0.0, most=LATEST_S)


def _names(field: Field | None, arm: ArmModel) -> tuple[str, ...]:
    """Return the log's names of the joints, in the arm's order."""
    if field is None:
        return arm.joint_names
    keys = field.fields(arm.joint_names)
    names = tuple(
        keys.required(name).sentence("the log's name for the joint") if name in keys else name
        for name in arm.joint_names
    )
    for at, name in enumerate(names):
        if name in names[:at]:
            got = f'"{name}" for {arm.joint_names[names.index(name)]} and {arm.joint_names[at]}'
            raise field.error("a different joint of the log for each joint of the arm", got=got)
    return names


def _period_ns(streams: Fields, joints: LogSamples) -> int:
    """Return the period of the trace's ticks [ns].

    If LOG.yaml states no period, it is the median interval of the joints' samples, rounded to 0.1 ms.
    """
    field = streams.optional("period")
    if field is not None:
        return round(field.quantity(TIME, least=SHORTEST_PERIOD_NS / NS, most=LONGEST_PERIOD_NS / NS) * NS)
    apart_ns = float(np.median(np.diff(joints.time_ns)))
    rounded = round(apart_ns / PERIOD_STEP_NS) * PERIOD_STEP_NS
    return min(max(rounded, SHORTEST_PERIOD_NS), LONGEST_PERIOD_NS)


def _is_of_rtde(keys: Fields, source: LogSource) -> bool:
    """Return whether ``source`` is a table of UR's recorder; raise LogError if it is a bag instead."""
    field = keys.optional(FORMAT)
    if field is not None and field.one_of({"rtde": True}) and source.is_bag:
        raise field.error("a table of the UR recorder", got=source.name)
    return field is not None


def _unit_of(field: Field, units: dict[str, float]) -> str:
    return field.one_of({name: name for name in units})


def _time_text(field: Field | None) -> str | None:
    return None if field is None else field.sentence("the name of a column, with its unit: stamp in ns")


def _time(keys: Fields) -> str:
    """Return the kind of time to use for the messages of a bag: STAMP or RECEIVED."""
    field = keys.optional("time")
    return STAMP if field is None else field.one_of({clock: clock for clock in (STAMP, RECEIVED)})
