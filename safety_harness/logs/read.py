"""LOG.yaml: which streams, on which clocks, in which frames and units, and how well they are known.

The keys that a scenario has too (robot, settings, obstacles, claims) are read as a scenario's are, when the
trace is made.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from safety_harness.exceptions import LogError, Place
from safety_harness.geometry.rotations import rotation_from_vector
from safety_harness.geometry.transforms import transform_from
from safety_harness.logs.bags import RECEIVED, STAMP, read_joints, read_positions
from safety_harness.logs.checked import (
    joints_checked,
    positions_checked,
    refuse_contradicting_speeds,
    refuse_jumping_joints,
    refuse_the_same,
    with_bounds,
)
from safety_harness.logs.frames import ToBase, by_given, by_header
from safety_harness.logs.model import (
    JOINTS_KNOWN_TO_RAD,
    JOINTS_LONGEST_GAP_S,
    Body,
    CellLog,
    HandFacts,
    JointFacts,
)
from safety_harness.logs.sample_bound import SampleBound, sample_bound
from safety_harness.logs.streams import LATEST_S, NS, Collector, LogSamples, LogSource, read_source
from safety_harness.logs.tables import (
    ANGLE_UNITS,
    LENGTH_UNITS,
    RATE_UNITS,
    Table,
    header_of,
    optional_column,
    read_table,
    required_column,
    time_column,
)
from safety_harness.logs.told import STREAMS, Told, ToldClock, read_told
from safety_harness.robot.description import ArmModel
from safety_harness.robot.robots import arm_model, refuse_unenclosed
from safety_harness.scenario.codec import POINT, ROTATION
from safety_harness.scenario.compose import MAX_BYTES
from safety_harness.scenario.fields import Field, Fields
from safety_harness.scenario.files import decode, read_bytes
from safety_harness.scenario.kinds import FileKind, refuse_other_kind
from safety_harness.scenario.nodes import Mapping, Scalar, parse_tree
from safety_harness.scenario.robots import Robot, read_robot
from safety_harness.scenario.units import (
    ANGLE,
    ANGULAR_ACCELERATION,
    ANGULAR_SPEED,
    LENGTH,
    SPEED,
    TIME,
    Dimension,
)

KEYS = (
    *("log", "title", "about", "clock", "joints", "hands", *STREAMS),
    *("robot", "obstacles", "settings", "claims"),
)
OF_LOG = ("joints", "hands", *STREAMS, "from", "to", "period")
OF_CLOCK = ("hands are ahead by", "known to")
OF_JOINTS = (
    *("names", "unit", "time", "known to", "speeds known to"),
    *("move at most", "accelerate at most", "longest gap"),
)
OF_HANDS = ("forearm", "left out", "longest gap", "moves at most", "known to", "frame", "unit", "time")
NOT_MEASURED, NO_FOREARM, BASE, ELBOW = "not measured", "none", "base", "elbow"
PERIOD_STEP_NS, SHORTEST_PERIOD_NS, LONGEST_PERIOD_NS = 100_000, 1_000_000, 50_000_000
_LENGTHS = {"m": 1.0, "cm": 1e-2, "mm": 1e-3}
_ANGLES = {"rad": 1.0, "deg": np.pi / 180.0}


def read_log(path: str | Path, *, align: bool = False) -> CellLog:
    """The log that a file describes; an InputError with its place for whatever cannot be used.

    ``align``: its clocks need not be said, and all of its hands is read.
    """
    file = Path(path)
    return log_of(said_in(file), name=file.stem, align=align)


def said_in(file: Path) -> Field:
    """What a LOG.yaml says, before any of it is read; LogError for what is none."""
    refuse_other_kind(file, FileKind.LOG, error=LogError)
    data = read_bytes(file, most=MAX_BYTES, place=Place(file=file), error=LogError)
    text = decode(data, most=MAX_BYTES, file=file, error=LogError)
    return Field(parse_tree(text, file), file, path="", line=1)


def log_of(said: Field, *, name: str, align: bool = False) -> CellLog:
    """As ``read_log``, of a file that is a tree already; ``align``: its clocks need not be said."""
    given = said.fields(KEYS)
    robot = read_robot(given.optional("robot") or Robot.UR10, {})
    refuse_unenclosed(robot)
    streams = given.required("log").fields(OF_LOG)
    arm = arm_model(robot)
    reading = _Reading(given, streams, arm)
    joints = reading.joints()
    facts = reading.joint_facts(joints)
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
    told = (
        Told()
        if align
        else reading.told(ToldClock(hands_ahead_ns=clock_ns, hands_known_to_ns=round(known_to_s * NS)))
    )
    left_out, unmapped = ((), ()) if hand_facts is None else reading.neither(of_hands, bodies)
    found = CellLog(
        name=name,
        file=said.file,
        said=said,
        robot=robot,
        joints=joints,
        joint_facts=facts,
        hands=bodies,
        hand_facts=hand_facts,
        hands_ahead_ns=ahead_ns,
        clock_known_to_s=known_to_s,
        period_ns=period_ns,
        files=tuple(dict.fromkeys(one for source in reading.sources for one in source.files)),
        told=told,
        left_out=left_out,
        unmapped=unmapped,
    )
    if found.ticks < 2:
        raise streams.required("joints").error("two control periods of joints, at least", got="less")
    return found


@dataclass
class _Reading:
    """Reads the streams that a file names, the joints first."""

    given: Fields
    streams: Fields
    arm: ArmModel

    def __post_init__(self) -> None:
        self.sources: list[LogSource] = []
        self.mapped: set[str] = set()
        self.bodies_seen: set[str] = set()

    def joints(self) -> LogSamples:
        """(n, 2 j) positions and velocities."""
        source = self._source(self.streams.required("joints"))
        said = self._said_of_joints()
        names = _names(said.optional("names"), self.arm)
        window = [self._seconds(key) for key in ("from", "to")]

        def begin(first_ns: int) -> tuple[int | None, int | None]:
            begin_s, end_s = window
            return (
                None if begin_s is None else first_ns + round(begin_s * NS),
                None if end_s is None else first_ns + round(end_s * NS),
            )

        collector = Collector(source, 2 * len(names), _counts(source), begin=begin)
        unit = said.optional("unit")
        if source.is_bag:
            angle = _ANGLES[_word(unit, _ANGLES)] if unit else 1.0
            read_joints(source, collector, names, time=_time(said), angle=angle)
        else:
            header = header_of(source)
            word = _word(unit, _ANGLES) if unit else None
            at = [required_column(source, header, f"{source.what}{n}", ANGLE_UNITS, word) for n in names]
            rates = [
                optional_column(source, header, f"{source.what}{n}", RATE_UNITS, None, bare=False)
                for n in names
            ]
            time = time_column(source, header, _said(said.optional("time")))
            read_table(Table(*time, (*at, *rates)), collector)
        return joints_checked(collector.samples(), names)

    def joint_facts(self, joints: LogSamples) -> JointFacts:
        """What is said of the joints, and by how much a slip would show."""
        facts = facts_of_joints(self._said_of_joints(), self.arm)
        refuse_jumping_joints(joints, facts, self.arm.joint_names)
        refuse_contradicting_speeds(joints, facts, self.arm.joint_names)
        return facts

    def bodies(
        self, joints: LogSamples, of_hands: Fields, ahead_ns: int, slack_ns: int | None
    ) -> tuple[Body, ...]:
        """The hands, whose clock is ahead by so much, ``slack_ns`` longer than the joints (None: all)."""
        window = (None, None)
        if slack_ns is not None:
            begin, end = int(joints.time_ns[0]), int(joints.time_ns[-1])
            window = begin + ahead_ns - slack_ns, end + ahead_ns + slack_ns  # type: ignore[assignment]
        field = self.streams.required("hands")
        forearm = of_hands.required("forearm")
        named = isinstance(field.node, Mapping)
        hands = field.entries("hands by their names") if named else ((_only_name(field), field),)
        if not hands:
            raise field.error("a hand at least")
        known, found = of_hands.required("known to"), []
        bound = sample_bound(known) if isinstance(known.node, Mapping) else None
        for name, one in hands:
            own = forearm
            if isinstance(forearm.node, Mapping):
                own = forearm.fields(tuple(name for name, _ in hands)).required(name)
            hand = self._positions(one, of_hands, window, bound=bound)
            elbow, there = None, True
            if isinstance(own.node, Scalar) and own.node.text in (NOT_MEASURED, NO_FOREARM):
                there = own.node.text == NOT_MEASURED
            else:
                elbow = self._positions(own, of_hands, window, bound=bound)
            found.append(Body(name, hand, elbow, there))
        refuse_the_same([one for body in found for one in (body.hand, body.elbow) if one is not None])
        return tuple(found)

    def told(self, clock: ToldClock) -> Told:
        """What the controller said."""
        names = _names(self._said_of_joints().optional("names"), self.arm)

        def placed(frame: Field, samples: LogSamples, first: int) -> LogSamples:
            transform, values = _given_transform(frame), samples.values.copy()
            values[:, first : first + 3] = (
                values[:, first : first + 3] @ transform[:3, :3].T + transform[:3, 3]
            )
            return replace(samples, values=values)

        def positions(field: Field, said: Fields) -> LogSamples:
            return self._positions(field, said, (None, None), keep=True)

        return read_told(self.given, self.streams, names, clock, self._source, positions, placed, self._given)

    def _positions(
        self,
        field: Field,
        said: Fields,
        window: tuple[int | None, int | None],
        *,
        keep: bool = False,
        bound: SampleBound | None = None,
    ) -> LogSamples:
        """Of a body, in the base frame; ``keep`` those samples in which it is nowhere."""
        source = self._source(field)
        width = 3 if bound is None else 4
        collector = Collector(source, width, _counts(source), *window, least=2 - keep)
        unit = said.optional("unit")
        word = _word(unit, _LENGTHS) if unit else None
        frame = said.optional("frame")
        if source.is_bag:
            to_base = self._to_base(source, frame)
            length = _LENGTHS[word or "m"]
            read_positions(
                source,
                collector,
                time=_time(said),
                length=length,
                to_base=to_base,
                halves=not keep,
                bound=bound,
            )
            index = "" if source.index is None else f"[{source.index}]"
            path = f":{source.path.lstrip('/')}" if source.path else ""
            self._saw(source, f"{source.topic}{index}{path}", set() if keep else collector.bodies)
            return positions_checked(with_bounds(collector.samples()), keep)
        if frame is None:
            expected = 'the key "frame": base, or {at: ..., turned: ...} of the frame in which positions are'
            raise said.whole.error(expected, got=f"none, and {source.name} is a table that cannot say it")
        header = header_of(source)
        track = source.what or _only_track(source, header)
        at = [required_column(source, header, f"{track}_{axis}", LENGTH_UNITS, word) for axis in "xyz"]
        self._saw(source, track, set() if keep else tracks_of(header, bare=word is not None))
        time = time_column(source, header, _said(said.optional("time")))
        if bound is not None:
            self._saw(source, f"{track}_{bound.field}", set())
            stem = f"{track}_{bound.field}"
            box = [optional_column(source, header, f"{stem}_{axis}", LENGTH_UNITS, word) for axis in "xyz"]
            sides = [side for side in box if side is not None]
            at += sides if len(sides) == 3 else [required_column(source, header, stem, LENGTH_UNITS, word)]
            collector.width = len(at)
        read_table(Table(*time, tuple(at)), collector)
        found = with_bounds(collector.samples(), bound)
        found.values[~found.values.any(axis=1)] = np.nan  # zeros: what trackers write for not seen
        gone = np.isnan(found.values)
        half = gone.any(axis=1) & ~gone.all(axis=1)
        if keep and half.any():
            expected = "a position, or none of its three numbers"
            raise found.error(int(np.argmax(half)), expected, str(found.values[half][0].tolist()))
        transform = _given_transform(frame)
        values = found.values @ transform[:3, :3].T + transform[:3, 3]
        return positions_checked(replace(found, values=values), keep)

    def _saw(self, source: LogSource, mapped: str, bodies: set[str]) -> None:
        """A body of a stream, and all those of its messages or columns, by the names of streams."""
        links = {f"/tf:{name}" for name in self.arm.link_names}
        self.mapped.add(f"{source.file.name}#{mapped}")
        self.bodies_seen |= {f"{source.file.name}#{one}" for one in bodies - links}

    def neither(self, of_hands: Fields, bodies: tuple[Body, ...]) -> tuple[tuple[str, ...], tuple[str, ...]]:
        """Bodies that the file maps not: those that it leaves out, and those of which it says nothing.

        Elbows are left out where the file says that a forearm is not measured.
        """
        beside, field = sorted(self.bodies_seen - self.mapped), of_hands.optional("left out")
        items = () if field is None else field.items("streams that no hand is in, such as hands.csv#marker")
        if items and not beside:
            raise items[0].error("a stream beside the hands", hint="all bodies of the messages are mapped")
        left = {one.one_of({name: name for name in beside}) for one in items}
        if any(body.forearm and body.elbow is None for body in bodies):
            left |= {name for name in beside if ELBOW in name.partition("#")[2].lower()}
        return tuple(sorted(left)), tuple(name for name in beside if name not in left)

    def _to_base(self, source: LogSource, frame: Field | None) -> ToBase:
        """How positions of a bag come to the base frame."""
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
        """By the frame that is said, which no header may contradict."""
        base = self.arm.link_names[0] if np.array_equal(self.arm.transform_seat, np.eye(4)) else BASE
        return by_given(_given_transform(frame), _frame_name(frame, base), base, source)

    def _said_of_joints(self) -> Fields:
        return said_of_joints(self.given)

    def _source(self, field: Field) -> LogSource:
        source = read_source(field)
        self.sources.append(source)
        return source

    def _seconds(self, key: str) -> float | None:
        field = self.streams.optional(key)
        return None if field is None else field.quantity(TIME, least=0.0, most=LATEST_S)


def _given_transform(frame: Field) -> NDArray[np.float64]:
    """(4, 4) from the frame of the positions to the base frame, as it is said."""
    if isinstance(frame.node, Scalar):
        frame.one_of({BASE: None})
        return np.eye(4)
    given = frame.fields(("at", "turned", "of"))
    turned = given.optional("turned")
    vector = (0.0, 0.0, 0.0) if turned is None else ROTATION.read(turned)
    return transform_from(rotation_from_vector(np.array(vector)), np.array(POINT.read(given.required("at"))))


def _frame_name(frame: Field, base: str) -> str | None:
    """Return the name of the frame that is stated; None for a pose of a frame without a name."""
    if isinstance(frame.node, Scalar):
        return base
    name = frame.fields(("at", "turned", "of")).optional("of")
    return None if name is None else name.sentence("the name of the frame in headers")


def _names(field: Field | None, arm: ArmModel) -> tuple[str, ...]:
    """What the log calls the arm's joints, in their order."""
    if field is None:
        return arm.joint_names
    said = field.fields(arm.joint_names)
    names = tuple(
        said.required(name).sentence("what the log calls the joint") if name in said else name
        for name in arm.joint_names
    )
    for at, name in enumerate(names):
        if name in names[:at]:
            got = f'"{name}" for {arm.joint_names[names.index(name)]} and {arm.joint_names[at]}'
            raise field.error("another one of the log's joints for each of the arm's", got=got)
    return names


def said_of_joints(given: Fields) -> Fields:
    """What stands below the key "joints", nothing if it is not there."""
    field = given.optional("joints")
    return Fields(given.whole, {}) if field is None else field.fields(OF_JOINTS)


def facts_of_joints(said: Fields, arm: ArmModel) -> JointFacts:
    """What is said of the joints below the key of that name."""
    most = arm.velocity_limit_radps.copy()
    if (field := said.optional("move at most")) is not None:
        most = np.full(len(most), field.quantity(ANGULAR_SPEED, above=0.0))
    hard = said.optional("accelerate at most")
    rates = said.optional("speeds known to")
    return JointFacts(
        known_to_rad=_quantity(said, "known to", ANGLE, JOINTS_KNOWN_TO_RAD),
        speeds_known_to_radps=None if rates is None else rates.quantity(ANGULAR_SPEED, least=0.0),
        move_at_most_radps=most,
        accelerate_at_most_radps2=None if hard is None else hard.quantity(ANGULAR_ACCELERATION, above=0.0),
        longest_gap_s=_quantity(said, "longest gap", TIME, JOINTS_LONGEST_GAP_S, LATEST_S),
    )


def facts_of_hands(said: Fields, *, each: bool = False) -> HandFacts:
    """What is said of the hands below the key of that name; ``each`` sample may say how well it is known."""
    known = said.required("known to")
    by_sample = each and isinstance(known.node, Mapping)
    return HandFacts(
        known_to_m=np.inf if by_sample else known.quantity(LENGTH, least=0.0),
        moves_at_most_mps=said.required("moves at most").quantity(SPEED, above=0.0),
        longest_gap_s=said.required("longest gap").quantity(TIME, above=0.0, most=LATEST_S),
    )


def _period_ns(streams: Fields, joints: LogSamples) -> int:
    """From tick to tick: what is said, or what the joints' samples are apart, to a tenth of a millisecond."""
    field = streams.optional("period")
    if field is not None:
        return round(field.quantity(TIME, least=SHORTEST_PERIOD_NS / NS, most=LONGEST_PERIOD_NS / NS) * NS)
    apart_ns = float(np.median(np.diff(joints.time_ns)))
    rounded = round(apart_ns / PERIOD_STEP_NS) * PERIOD_STEP_NS
    return min(max(rounded, SHORTEST_PERIOD_NS), LONGEST_PERIOD_NS)


def tracks_of(header: tuple[str, ...], *, bare: bool) -> set[str]:
    """The names of all tracks of a table: x, y and z in a unit of length, or in none if ``bare``."""
    ends = (*(f"_{unit}" for unit in LENGTH_UNITS), *[""] * bare)
    found = {(name[: -len(f"_x{end}")], end) for name in header for end in ends if name.endswith(f"_x{end}")}
    return {stem for stem, end in found if {f"{stem}_y{end}", f"{stem}_z{end}"} <= set(header)}


def _only_track(source: LogSource, header: tuple[str, ...]) -> str:
    """The one track of a table."""
    tracks = sorted(tracks_of(header, bare=True))
    if len(tracks) != 1:
        got = ", ".join(tracks) or f"the columns {', '.join(header)}"
        expected = f"which track, such as {source.file.name}#right_hand"
        raise LogError(place=source.place, expected=expected, got=got)
    return tracks[0]


def _only_name(field: Field) -> str:
    return "hand"


def _quantity(
    said: Fields, key: str, dimension: Dimension, default: float, most: float | None = None
) -> float:
    field = said.optional(key)
    return default if field is None else field.quantity(dimension, least=0.0, most=most)


def _word(field: Field, words: dict[str, float]) -> str:
    return field.one_of({word: word for word in words})


def _said(field: Field | None) -> str | None:
    return None if field is None else field.sentence("the name of a column, with its unit: stamp in ns")


def _time(said: Fields) -> str:
    """Of a bag: by the stamp of each message, or by when it was received."""
    field = said.optional("time")
    return STAMP if field is None else field.one_of({one: one for one in (STAMP, RECEIVED)})


def _counts(source: LogSource) -> str:
    if source.is_bag:
        return "message"
    return "line" if source.file.suffix == ".csv" else "row"
