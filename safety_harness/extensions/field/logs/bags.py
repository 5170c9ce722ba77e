"""Read streams in MCAP files and ROS 2 bags (sqlite3 and MCAP), without a ROS installation.

For messages of standard types, the reader knows which fields have the values. For messages of other types, it
needs the definition in the bag and the path of the wanted field. Lengths are metres and angles are radians by
REP 103, unless LOG.yaml states another unit. The memory that is needed to read a stream does not depend on
the rest of the bag.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

from safety_harness.base.exceptions import LogError, Place, near_miss
from safety_harness.base.extras import LOGS
from safety_harness.extensions.field.logs.containers import Bag, UnreadableDefinitionError, opened
from safety_harness.extensions.field.logs.foxglove import (
    JOINT_STATE,
    POSE_ARRAY,
    POSE_STAMPED,
    TF,
    as_standard,
    fields_of,
    nanoseconds,
)
from safety_harness.extensions.field.logs.sample_bound import SampleBound
from safety_harness.extensions.field.logs.streams import Collector, LogSource
from safety_harness.extensions.field.logs.tables import as_word
from safety_harness.scenario.units import shown

POSITIONS = {  # where a position is in a message of a standard type
    POSE_STAMPED: "pose.position",
    "geometry_msgs/msg/PoseWithCovarianceStamped": "pose.pose.position",
    "geometry_msgs/msg/PointStamped": "point",
    "geometry_msgs/msg/TransformStamped": "transform.translation",
}
STAMP, RECEIVED = "stamp", "received"
_STEP = re.compile(r"([A-Za-z_][A-Za-z0-9_]*)((?:\[[0-9]{1,4}\])*)")


@dataclass(frozen=True)
class Message:
    """One message of a topic: its number from 1, its time of receipt, its type and its content."""

    number: int
    received_ns: int
    kind: str
    content: Any


@dataclass(frozen=True)
class Part:
    """A field that each message has at ``path``.

    The field contains either ``width`` numbers, or one word that ``words`` maps to a number. ``si`` is the
    factor that converts the numbers to SI units. In a message such as ``JointState``, another field lists the
    joint to which each number belongs. ``names`` is the path of that field, or empty if the message has no
    such field.
    """

    path: str
    width: int
    si: float
    words: Mapping[str, float] | None = None
    names: str = ""


def read_parts(
    source: LogSource,
    collector: Collector,
    parts: Sequence[Part],
    names: Sequence[str],
    *,
    time: str,
    framed: Callable[[str, Message], object] | None = None,
) -> None:
    """Read the ``parts`` of each report in a topic; missing numbers become NaN.

    Args:
        source: The topic.
        collector: The collector to which the samples are added.
        parts: The fields to read.
        names: The joints whose numbers are read. They concern only the parts that have ``names``.
        time: STAMP or RECEIVED.
        framed: A function that raises LogError if a message's frame is not the stated frame, or None.

    """
    for message in messages(source):
        content, values = message.content, []
        for part in parts:
            field = _follow(content, source, message, part.path)
            if part.words is not None:
                term = as_word(field)
                if term not in part.words:
                    hint = near_miss(term, part.words)
                    expected = f"one of {', '.join(part.words)} for {part.path}"
                    raise error(source, message, expected, shown(term) or "none", hint)
                values.append(part.words[term])
                continue
            values += [value * part.si for value in _part_numbers(part, field, names, source, message)]
        _refuse_infinite(values, source, message)
        header = getattr(content, "header", None)
        if framed is not None:
            framed(_frame_of(header), message)
        _add(collector, message, time, header, values)


def _part_numbers(
    part: Part, value: Any, names: Sequence[str], source: LogSource, message: Message
) -> Sequence[float]:
    """Return the numbers of ``part`` in a message; ``value`` is the content of the part's field."""
    if value is None:
        return [math.nan] * part.width
    if part.width == 1:
        return _numbers([value], source, message)
    if not part.names:
        if part.width == 3 and not names:
            return _xyz(value, source, message)
        numbers = _numbers(value, source, message)
    else:
        listed = list(_follow(message.content, source, message, part.names))
        numbers = _numbers(value, source, message)
        lacking = [name for name in names if name not in listed]
        if lacking or len(numbers) != len(listed):
            expected = f"a number for each of {', '.join(names)}"
            raise error(source, message, expected, f"{len(numbers)} for {shown(', '.join(listed))}")
        numbers = [numbers[listed.index(name)] for name in names]
    if len(numbers) != part.width:
        raise error(source, message, f"{part.width} numbers in {part.path}", str(len(numbers)))
    return numbers


@contextmanager
def _opened(source: LogSource) -> Iterator[Bag]:
    """Open the bag of a stream, and raise LogError for any failure of the bag's reader."""
    with LOGS.needed("logs in MCAP files and bags of ROS", source.file):
        import rosbags.rosbag1
        import rosbags.rosbag2  # noqa: F401
    place, hint = Place(file=source.file, field=source.what), ""
    error: Exception
    try:
        with opened(source.file) as bag:
            yield bag
        return
    except LogError:
        raise
    except UnreadableDefinitionError as unreadable:
        expected, error = f"a definition of the messages of {source.topic} that can be read", unreadable
    except ModuleNotFoundError as missing:
        expected, error, hint = "a package that decodes these messages", missing, "pip install protobuf"
    except Exception as damage:  # a damaged storage, compression or message may raise anything
        expected, error = "a bag, whole", damage
        hint = "for a cut-off recording: mcap recover FILE.mcap, or ros2 bag reindex FOLDER"
    got = " ".join(f"{type(error).__name__}: {error}".split())
    raise LogError(place=place, expected=expected, got=got, hint=hint) from error


def messages(source: LogSource) -> Iterator[Message]:
    """Yield every message of the stream's topic in the order in which the messages were received.

    Raise LogError if the topic is missing, if the bag is damaged, or if the number of messages differs from
    the number that the bag states.
    """
    with _opened(source) as reader:
        connections = [link for link in reader.connections if link.topic == source.topic]
        source.seen.update(link.topic for link in reader.connections)
        source.used.add(source.topic)
        if not connections:
            topics = sorted(source.seen)
            raise LogError(
                place=source.place,
                expected=f"a topic of {source.file.name}",
                got=source.topic,
                hint=near_miss(source.topic, topics) or f"its topics: {shown(', '.join(topics))}",
            )
        number = 0
        for connection, received_ns, content in reader.messages(connections):
            number += 1
            try:
                message = Message(number, received_ns, *as_standard(connection.msgtype, content))
            except AttributeError as lacking:
                place = Place(file=source.file, field=f"message {number} of {source.topic}")
                expected = f"the fields of a message of {connection.msgtype}"
                raise LogError(place=place, expected=expected, got=str(lacking)) from lacking
            yield message
        # A reader may end early without an error, so that only the count shows that messages are missing.
        promised = sum(link.msgcount for link in connections)
        if number != promised:
            raise LogError(
                place=Place(file=source.file, field=source.topic),
                expected=f"{promised} messages, as the bag says",
                got=str(number),
                hint="it was cut off, or its index is not of this file",
            )


def topics_of(source: LogSource) -> dict[str, str]:
    """Return the topics of a stream's bag with their types."""
    with _opened(source) as reader:
        return {link.topic: link.msgtype for link in reader.connections}


def read_joints(
    source: LogSource, collector: Collector, names: Sequence[str], *, time: str, angle: float
) -> None:
    """Read the positions and the velocities of the joints ``names``; a missing velocity becomes NaN.

    Each sample contains all positions, followed by all velocities.

    Args:
        source: The topic.
        collector: The collector to which the samples are added.
        names: The log's names of the joints, in the arm's order.
        time: STAMP or RECEIVED.
        angle: The unit of angles [rad].

    """
    wanted, places = tuple(names), dict[tuple[str, ...], list[int]]()
    skipped: dict[tuple[str, ...], int] = {}  # numbers of messages from a gripper, or another arm
    first: Message | None = None  # the first of the skipped messages
    for message in messages(source):
        content = message.content
        if message.kind != JOINT_STATE and not source.path:
            raise _unknown(message, source, "the joints", JOINT_STATE)
        if source.path:
            values = _numbers(_follow(content, source, message), source, message)
            if len(values) != len(wanted):
                raise error(source, message, f"{len(wanted)} joint angles", str(len(values)))
            rates = [math.nan] * len(wanted)
        else:
            listed = tuple(content.name)
            # A topic may have messages of a gripper or of another arm; the places of the names are found
            # once.
            if listed not in places:
                source.seen.update(listed)
                places[listed] = []
                if set(wanted) & set(listed):
                    _refuse_lacking(wanted, listed, source, message)
                    places[listed] = [listed.index(name) for name in wanted]
                    source.used.update(wanted)
            at = places[listed]
            if not at:
                skipped[listed] = skipped.get(listed, 0) + 1
                first = first or message
                continue
            if len(content.position) != len(listed):
                raise error(source, message, f"{len(listed)} positions", str(len(content.position)))
            values = [float(content.position[k]) for k in at]
            rates = [math.nan] * len(at)
            if len(content.velocity) == len(listed):
                rates = [float(content.velocity[k]) for k in at]
        _refuse_infinite(values, source, message)
        numbers = [value * angle for value in (*values, *rates)]
        _add(collector, message, time, getattr(content, "header", None), numbers)
    if first is not None and not collector.seen:
        # No message had a joint of the arm, so the names are probably different ones.
        _refuse_lacking(wanted, first.content.name, source, first)
    if skipped:
        count, them = sum(skipped.values()), shown(", ".join(name for listed in skipped for name in listed))
        collector.notes.append(f"{count} messages that name no joint of the arm are skipped: {them}")


def _refuse_lacking(wanted: Sequence[str], names: Sequence[str], source: LogSource, message: Message) -> None:
    """Raise LogError for a message that lacks a joint of the arm."""
    for name in wanted:
        if name not in names:
            hint = near_miss(name, names) or 'the key "names" lists the names of joints in the log'
            raise error(source, message, f'the joint "{name}"', f"the joints {shown(', '.join(names))}", hint)


def read_positions(
    source: LogSource,
    collector: Collector,
    time: str,
    length: float,
    to_base: Callable[[str, Message], Callable[[Sequence[float]], Sequence[float]]],
    *,
    halves: bool = True,
    bound: SampleBound | None = None,
    speeds: str | None = None,
) -> None:
    """Read the positions of a body, and transform them to the base frame.

    If a message does not contain the body, its position is NaN.

    Args:
        source: The topic.
        collector: The collector to which the samples are added.
        time: STAMP or RECEIVED.
        length: The unit of lengths [m].
        to_base: A function that takes a message's frame, and returns the function that moves positions from
            it to the base frame.
        halves: True to accept a position even if some of its three numbers are missing. If False, such a
            position raises LogError.
        bound: The field with the uncertainty [m] of each sample, or None. The uncertainty is appended to the
            position.
        speeds: The path of the field with the velocity [m/s] in the same frame, or None. The velocity is
            appended last.

    """
    for message in messages(source):
        content = message.content
        header = getattr(content, "header", None)
        if message.kind == TF:
            if not source.path:
                raise error(source, message, "a frame after the topic, such as /tf:right_hand", "none")
            for transform in content.transforms:
                if transform.child_frame_id.lstrip("/") == source.path.lstrip("/"):
                    where, header = transform.transform.translation, transform.header
                    break
            else:
                collector.frames.update(a.child_frame_id.lstrip("/") for a in content.transforms)
                continue
        elif message.kind == POSE_ARRAY and not source.path:
            if source.index is None:
                raise error(source, message, "which of the poses, such as /poses[0]", "none")
            poses = content.poses
            where = poses[source.index].position if source.index < len(poses) else None
        else:
            path = source.path or POSITIONS.get(message.kind, "")
            if not path:
                raise _unknown(message, source, "a position", ", ".join((*POSITIONS, POSE_ARRAY, TF)))
            where = _follow(content, source, message, path)
        place = [math.nan] * 3 if where is None else _xyz(where, source, message)
        if not any(place):  # trackers write zeros for a body that they do not see
            place = [math.nan] * 3
        _refuse_infinite(place, source, message)
        if not halves and 0 < sum(map(math.isnan, place)) < 3:
            raise error(source, message, "all three numbers of a position, or three NaN", str(place))
        collector.bodies.update(_bodies(source, message))
        moved = to_base(_frame_of(header), message)
        position = moved([value * length for value in place])
        if bound is not None:
            position = [*position, _bound(bound, content, source, message) * length]
        if speeds is not None:
            speed = _xyz(_follow(content, source, message, speeds), source, message)
            # A velocity only turns with the frame, so subtract the shift of the frame's origin.
            ends = moved([value * length for value in speed]), moved([0.0] * 3)
            position = [*position, *(a - b for a, b in zip(*ends, strict=True))]
        _add(collector, message, time, header, position)


def _bodies(source: LogSource, message: Message) -> Iterator[str]:
    """Yield the names of all bodies in a message.

    The bodies are either the entries of a list, or the frames that have the same parent as the stream's own
    frame.
    """
    content = message.content
    if message.kind == TF:
        parents = {item.child_frame_id.lstrip("/"): item.header.frame_id for item in content.transforms}
        own = parents.get(source.path.lstrip("/"))
        yield from (f"{source.topic}:{child}" for child, parent in parents.items() if parent == own)
    elif message.kind == POSE_ARRAY and not source.path:
        there = (k for k, pose in enumerate(content.poses) if any(_xyz(pose, source, message)))
        yield from (f"{source.topic}[{k}]" for k in there)
    elif "[" in source.path:
        list_path, _, rest = source.path.partition("[")
        count = len(_follow(content, source, message, list_path))
        yield from (f"{source.topic}:{list_path}[{k}{rest[rest.index(']') :]}" for k in range(count))


def _bound(bound: SampleBound, content: Any, source: LogSource, message: Message) -> float:
    """Return a position's uncertainty in the position's unit, or NaN if the message does not state it."""
    value = _follow(content, source, message, bound.field)
    if value is None:
        return math.nan
    if hasattr(value, "x"):
        return bound.reach_m(_xyz(value, source, message))
    return bound.reach_m(_numbers([value] if isinstance(value, int | float) else value, source, message))


def error(source: LogSource, message: Message, expected: str, got: str, hint: str = "") -> LogError:
    """Return a LogError that refers to ``message``."""
    place = Place(file=source.file, field=f"message {message.number} of {source.topic}")
    return LogError(place=place, expected=expected, got=got, hint=hint)


def _unknown(message: Message, source: LogSource, wanted: str, types: str) -> LogError:
    hint = f"say which field of it, such as {source.topic}:wrist.position"
    return error(source, message, f"{wanted}, in a message of {types}", message.kind, hint)


def _frame_of(header: Any) -> str:
    return str(getattr(header, "frame_id", ""))


def _add(collector: Collector, message: Message, time: str, header: Any, values: Iterable[float]) -> None:
    """Add the sample of a message to ``collector``.

    If the message has no valid time, the collector does not keep the sample but only counts it.
    """
    try:
        time_ns = _time_ns(message, collector.source, time, header)
    except LogError as refused:
        collector.unstamped(refused)
    else:
        collector.add(time_ns, values, message.number)


def _time_ns(message: Message, source: LogSource, time: str, header: Any) -> int:
    if time == RECEIVED:
        return message.received_ns
    stamp = getattr(header, "stamp", None)
    time_ns = 0 if stamp is None else nanoseconds(stamp)
    if time_ns == 0:
        hint = 'the key "time: received" takes the time at which each was received'
        raise error(source, message, "a stamp in its header", "none", hint)
    return time_ns


def _follow(content: Any, source: LogSource, message: Message, path: str = "") -> Any:
    """Return the value at a path such as ``markers[2].pose.position``, or None if a list is too short."""
    for step in (path or source.path).split("."):
        match = _STEP.fullmatch(step)
        fields = fields_of(content)
        if match is None or match[1] not in fields:
            hint = near_miss(step, fields) or f"its fields: {shown(', '.join(fields))}"
            raise error(source, message, "a path of fields such as wrist.position", step, hint)
        content = getattr(content, match[1])
        for index in re.findall(r"[0-9]+", match[2]):
            if int(index) >= len(content):
                return None  # not there in this message
            content = content[int(index)]
    return content


def _xyz(where: Any, source: LogSource, message: Message) -> list[float]:
    """Return x, y and z of a point, of a pose, or of a list of three numbers."""
    where = getattr(where, "position", where)
    try:
        if all(hasattr(where, axis) for axis in "xyz"):
            return [float(where.x), float(where.y), float(where.z)]
        values = [float(value) for value in where]
    except (TypeError, ValueError):
        values = []
    if len(values) != 3:
        raise error(
            source, message, "a position: a field with x, y and z, or three numbers", type(where).__name__
        )
    return values


def _numbers(values: Any, source: LogSource, message: Message) -> list[float]:
    try:
        return [float(value) for value in values]
    except (TypeError, ValueError):
        raise error(source, message, "a list of numbers", type(values).__name__) from None


def _refuse_infinite(values: Sequence[float], source: LogSource, message: Message) -> None:
    if any(math.isinf(value) for value in values):
        raise error(source, message, "numbers, or NaN for a missing measurement", str(list(values)))
