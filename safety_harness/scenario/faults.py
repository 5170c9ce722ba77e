"""Faults of a sensor, a joint or the avoider, with their times.

Each fault is a frozen dataclass, written in a file as ``- hand sensor: is late``, ``delay: 200 ms``. A single
table of these words serves reading, writing and reports (docs/reference/scenario.md explains the words). A
fault acts from ``from_s`` until ``end_s``. A file states the end as a time after the beginning, or as a time
of the run. If the file states no end, the fault lasts until the end of the run.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import Enum, IntEnum
from math import inf
from typing import Any, ClassVar, get_args

from safety_harness.base.exceptions import near_miss
from safety_harness.base.settings import Vector3
from safety_harness.scenario.codec import (
    POINT,
    ROTATION,
    Key,
    KeyTable,
    QuantityValue,
    Tree,
    Word,
    declared,
    in_a_line,
    key,
    keyed,
    table_of,
    vector_of,
)
from safety_harness.scenario.fields import Field, Fields, each
from safety_harness.scenario.units import LENGTH, TIME

MOST_FAULTS = 16  # a trace has a bit for each
MOST_FALSE_HANDS = 2  # a frame holds two boxes for each hand that there is room for
LATEST_S = 10.0
FARTHEST_OFF_M = 1.0  # along an axis; a choice

_MOMENT = QuantityValue(TIME, least=0.0)
_SHIFT = vector_of(LENGTH, "point", FARTHEST_OFF_M)
_DELAY = Key(
    "delay",
    QuantityValue(TIME, above=0.0, most=LATEST_S),
    "how much later everything comes that is late",
    "200 ms",
)


class Joint(Enum):
    """The joints of the arm, counted from its foot, with the names that UR uses."""

    PAN = "pan"
    LIFT = "lift"
    ELBOW = "elbow"
    WRIST_1 = "wrist 1"
    WRIST_2 = "wrist 2"
    WRIST_3 = "wrist 3"
    SEVENTH = "seventh"
    EIGHTH = "eighth"


class FaultKind(IntEnum):
    """The effect of a fault on a run, as a number in a record."""

    HAND_SENSOR_BLIND = 0
    HAND_SENSOR_FROZEN = 1
    HAND_SENSOR_LATE = 2
    HAND_SENSOR_OFF = 3
    FALSE_HAND = 4
    CAMERA_BLIND = 5
    CAMERA_FROZEN = 6
    CAMERA_LATE = 7
    CAMERA_KNOCKED = 8
    CAMERA_HIDDEN = 9
    JOINT_STUCK = 10
    AVOIDER_LATE = 11
    AVOIDER_SILENT = 12
    AVOIDER_NAN = 13


@dataclass(frozen=True)
class Phrase:
    """The description of a fault as a text, ``subject: predicate``.

    ``kind`` is the fault's kind in compiled code.
    """

    subject: str
    predicate: str
    kind: FaultKind


@declared
class Timed:
    """The time of a fault; a file may state ``for_s`` or ``until_s``, but not both."""

    phrase: ClassVar[Phrase]
    from_s: float = key("from", _MOMENT, "when the fault begins", "500 ms", default=0.0)
    for_s: float | None = key(
        "for",
        QuantityValue(TIME, above=0.0),
        "how long it lasts",
        "200 ms",
        "to the end of the run",
        default=None,
    )
    until_s: float | None = key(
        "until",
        _MOMENT,
        "in place of `for`: when it ends; that moment is not in it",
        "2 s",
        "the end of the run",
        default=None,
    )

    @property
    def end_s(self) -> float:
        """The time at which the fault ends; infinity if it never ends."""
        if self.for_s is not None:
            return self.from_s + self.for_s
        return inf if self.until_s is None else self.until_s


@declared
class HandSensorBlind(Timed):
    """The hand sensor's pictures show no hand."""

    phrase = Phrase("hand sensor", "sees nothing", FaultKind.HAND_SENSOR_BLIND)


@declared
class HandSensorFrozen(Timed):
    """The hand sensor repeats its last picture with new times.

    Without an earlier picture it shows no hand.
    """

    phrase = Phrase("hand sensor", "freezes", FaultKind.HAND_SENSOR_FROZEN)


@declared
class HandSensorLate(Timed):
    """The hand sensor's pictures arrive later by ``delay_s``, in their order."""

    phrase = Phrase("hand sensor", "is late", FaultKind.HAND_SENSOR_LATE)
    delay_s: float = keyed(_DELAY)


@declared
class HandSensorOff(Timed):
    """The hand sensor measures every hand at a place that is off by ``offset_in_base_m``."""

    phrase = Phrase("hand sensor", "is off", FaultKind.HAND_SENSOR_OFF)
    offset_in_base_m: Vector3 = key(
        "offset", _SHIFT, "by how much every hand is measured off, in base", "[50 mm, 0 mm, 0 mm]"
    )


@declared
class FalseHand(Timed):
    """The hand sensor sees an additional hand with its centre at ``position_in_base_m``, which is empty."""

    phrase = Phrase("hand sensor", "sees a false hand", FaultKind.FALSE_HAND)
    position_in_base_m: Vector3 = key(
        "at", POINT, "where the hand is that is none, in base", "[800 mm, -350 mm, 250 mm]"
    )


@declared
class CameraBlind(Timed):
    """The servoing camera's pictures do not show the object."""

    phrase = Phrase("camera", "sees nothing", FaultKind.CAMERA_BLIND)


@declared
class CameraFrozen(Timed):
    """The camera repeats its last picture with new times.

    Without an earlier picture it shows no object.
    """

    phrase = Phrase("camera", "freezes", FaultKind.CAMERA_FROZEN)


@declared
class CameraLate(Timed):
    """The camera's pictures arrive later by ``delay_s``, in their order."""

    phrase = Phrase("camera", "is late", FaultKind.CAMERA_LATE)
    delay_s: float = keyed(_DELAY)


@declared
class CameraKnocked(Timed):
    """The camera has moved since its calibration and since the desired picture.

    It is turned by a rotation vector in the camera frame and shifted in the TCP frame.  If several such
    faults act at a time, the turns follow one another and the shifts add up.
    """

    phrase = Phrase("camera", "is knocked", FaultKind.CAMERA_KNOCKED)
    turned_in_camera_rad: Vector3 = key(
        "turned",
        ROTATION,
        "rotation of the camera, in its frame",
        "[2 deg, 0 deg, 0 deg]",
        default=(0.0, 0.0, 0.0),
    )
    shifted_in_tcp_m: Vector3 = key(
        "shifted",
        _SHIFT,
        "shift of the camera, in the TCP frame",
        "[5 mm, 0 mm, 0 mm]",
        default=(0.0, 0.0, 0.0),
    )


@declared
class CameraHidden(Timed):
    """A hand or forearm between the camera and any part of the object hides the object."""

    phrase = Phrase("camera", "is hidden by hands", FaultKind.CAMERA_HIDDEN)


@declared
class JointStuck(Timed):
    """A joint stands still and ignores commands."""

    phrase = Phrase("joint", "is stuck", FaultKind.JOINT_STUCK)
    joint: Joint = key("which", Word(Joint), "the joint, counted from the foot", "elbow")


@declared
class AvoiderLate(Timed):
    """The avoider answers a question of this time ``delay_s`` later; from the decision deadline on, never."""

    phrase = Phrase("avoider", "is late", FaultKind.AVOIDER_LATE)
    delay_s: float = keyed(_DELAY)


@declared
class AvoiderSilent(Timed):
    """A question of this time never gets an answer."""

    phrase = Phrase("avoider", "never answers", FaultKind.AVOIDER_SILENT)


@declared
class AvoiderNaN(Timed):
    """A question of this time gets a position of NaN as its answer."""

    phrase = Phrase("avoider", "answers NaN", FaultKind.AVOIDER_NAN)


HandSensorFault = HandSensorBlind | HandSensorFrozen | HandSensorLate | HandSensorOff | FalseHand
CameraFault = CameraBlind | CameraFrozen | CameraLate | CameraKnocked | CameraHidden
AvoiderFault = AvoiderLate | AvoiderSilent | AvoiderNaN
Fault = HandSensorFault | CameraFault | JointStuck | AvoiderFault
EVERY_FAULT: tuple[type[Any], ...] = get_args(Fault)

_TIMES = table_of(Timed, "the time of a fault")
TIMES = _TIMES.names


def _own(kind: type[Any]) -> KeyTable:
    """Return the table of a fault's keys, without the keys for its time."""
    table = table_of(kind, kind.phrase.predicate)
    return replace(table, keys=table.keys[len(TIMES) :], told_by=kind.phrase.subject)


OWN_KEYS = {kind: _own(kind) for kind in EVERY_FAULT}
SUBJECTS = {
    subject: {table.name: table for table in OWN_KEYS.values() if table.told_by == subject}
    for subject in dict.fromkeys(table.told_by for table in OWN_KEYS.values())
}


def fault_tables() -> tuple[KeyTable, ...]:
    """Return a table of keys for each subject that can have a fault."""
    tables = []
    for subject, own in SUBJECTS.items():
        first, *_ = own
        example = f"faults:\n  - {subject}: {first}\n    from: 500 ms\n    for: 200 ms"
        meaning = f"what the {subject} does wrongly"
        predicate = Key(subject, Word(tuple(own)), meaning, example)
        further = {key.name: key for table in own.values() for key in table.keys}
        keys = (
            predicate,
            *(replace(key, or_else="required where it belongs") for key in further.values()),
            *_TIMES.keys,
        )
        tables.append(KeyTable(name=f"a fault of the {subject}", keys=keys, path=f"faults.{subject}"))
    return tuple(tables)


def read_faults(field: Field | None, *, duration_s: float) -> tuple[Fault, ...]:
    """Return the faults in ``field``, in the order of the file.

    The scenario lasts ``duration_s``.
    """
    if field is None:
        return ()
    expected = f"a list of at most {MOST_FAULTS} faults"
    items = field.items(expected, most=MOST_FAULTS)
    faults = tuple(each(lambda item: _fault(item, duration_s), items))
    false_hands = sum(isinstance(fault, FalseHand) for fault in faults)
    if false_hands > MOST_FALSE_HANDS:
        raise field.error(f"at most {MOST_FALSE_HANDS} false hands", got=str(false_hands))
    return faults


def _fault(field: Field, duration_s: float) -> Fault:
    """Return the fault that a mapping describes.

    Raise ScenarioError if a key or a time is not valid.
    """
    subject = field.only_key("fault", SUBJECTS)
    predicates = SUBJECTS[subject]
    clause = dict(field.entries("a fault"))[subject]
    expected = f"what the {subject} does: one of {', '.join(predicates)}"
    predicate = clause.scalar(expected).strip()
    if predicate not in predicates:
        raise clause.error(expected, hint=near_miss(predicate, predicates))
    table = predicates[predicate]
    fields = field.fields((subject, *table.names, *TIMES))
    values = table.values(fields)
    if table.keys and not any(name in fields for name in table.names):
        raise field.error(f"one of the keys {', '.join(table.names)}", got="none")
    assert table.kind is not None
    fault: Fault = table.kind(**values, **_times(fields, duration_s))
    return fault


def _times(fields: Fields, duration_s: float) -> dict[str, float]:
    """Return the times among ``from_s``, ``for_s`` and ``until_s`` that the file states in ``fields``."""
    times = {f"{name}_s": fields.required(name).quantity(TIME, least=0.0) for name in TIMES if name in fields}
    begin_s = times.get("from_s", 0.0)
    if begin_s >= duration_s:
        raise fields.required("from").error(f"a fault that begins before the run ends, at {duration_s:g} s")
    if "for" in fields and "until" in fields:
        raise fields.required("until").error("either for or until", got="both")
    if "for" in fields and not times["for_s"] > 0.0:
        raise fields.required("for").error("a time such as 0.5 s, above 0 s")
    if "until" in fields and not times["until_s"] > begin_s:
        raise fields.required("until").error(f"a time after the fault's beginning, {begin_s:g} s")
    return times


def write_fault(fault: Fault) -> dict[str, Tree]:
    """Return the keys and values from which ``read_faults`` returns the fault."""
    own = OWN_KEYS[type(fault)]
    return {own.told_by: own.name, **own.write(fault), **_TIMES.write(fault)}


def fault_words(fault: Fault) -> str:
    """Return a fault as a sentence, such as "hand sensor is late (delay 0.2 s), from 1 s until 3 s"."""
    own = OWN_KEYS[type(fault)]
    sentence = f"{own.told_by} {own.name}"
    if isinstance(fault, JointStuck):
        sentence = f"{fault.joint.value} joint {own.name}"
    written = own.write(fault)
    values = [(key, getattr(fault, key.attribute)) for key in own.keys if not isinstance(key.value, Word)]
    if values:
        details = (
            f"{key.name} {in_a_line(written[key.name]) if isinstance(value, tuple) else f'{value:g} s'}"
            for key, value in values
        )
        sentence += f" ({', '.join(details)})"
    if fault.end_s == inf:
        return sentence + (f", from {fault.from_s:g} s" if fault.from_s else ", all the time")
    return f"{sentence}, from {fault.from_s:g} s until {fault.end_s:g} s"
