"""How faults are written in a scenario file: ``- hand sensor: is late``, ``delay: 200 ms``.

One table serves reading, writing and reports; docs/scenario-language.md has it for people.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from math import inf
from typing import Any

from safety_harness.scenario.faults import (
    MOST_FALSE_HANDS,
    MOST_FAULTS,
    AvoiderLate,
    AvoiderNaN,
    AvoiderSilent,
    CameraBlind,
    CameraFrozen,
    CameraHidden,
    CameraKnocked,
    CameraLate,
    FalseHand,
    Fault,
    HandSensorBlind,
    HandSensorFrozen,
    HandSensorLate,
    HandSensorOff,
    Joint,
    JointStuck,
)
from safety_harness.scenario.fields import LARGEST_ANGLE_RAD, LARGEST_COORDINATE_M, Field, Fields
from safety_harness.scenario.settings_keys import write_vector
from safety_harness.scenario.units import ANGLE, LENGTH, TIME, Dimension, format_quantity, near_miss, shown

TIMES = ("from", "for", "until")
LATEST_S = 10.0
FARTHEST_OFF_M = 1.0


@dataclass(frozen=True)
class FaultKey:
    """One further key of a fault: its word, its attribute, and the least and most of its number(s).

    ``dimension`` None is the word of a joint.
    """

    word: str
    name: str
    dimension: Dimension | None
    most: float = 0.0
    several: bool = False

    def read(self, field: Field) -> Any:
        """The value of the attribute."""
        if self.dimension is None:
            return field.choice(Joint)
        if self.several:
            return field.vector(self.dimension, largest=self.most)
        return field.quantity(self.dimension, above=0.0, most=self.most)

    def write(self, value: Any) -> str:
        """The text from which ``read`` gives ``value`` again."""
        if self.dimension is None:
            return str(value.value)
        if self.several:
            return write_vector(value, self.dimension)
        return format_quantity(value, self.dimension)


@dataclass(frozen=True)
class Phrase:
    """A fault in words: ``subject: predicate``, then its keys; ``optional`` ones may be left out, not all."""

    subject: str
    predicate: str
    kind: type[Any]
    keys: tuple[FaultKey, ...] = ()
    optional: bool = False


_DELAY = FaultKey("delay", "delay_s", TIME, LATEST_S)
PHRASES: tuple[Phrase, ...] = (
    Phrase("hand sensor", "sees nothing", HandSensorBlind),
    Phrase("hand sensor", "freezes", HandSensorFrozen),
    Phrase("hand sensor", "is late", HandSensorLate, (_DELAY,)),
    Phrase(
        "hand sensor",
        "is off",
        HandSensorOff,
        (FaultKey("offset", "offset_in_base_m", LENGTH, FARTHEST_OFF_M, True),),
    ),
    Phrase(
        "hand sensor",
        "sees a false hand",
        FalseHand,
        (FaultKey("at", "position_in_base_m", LENGTH, LARGEST_COORDINATE_M, True),),
    ),
    Phrase("camera", "sees nothing", CameraBlind),
    Phrase("camera", "freezes", CameraFrozen),
    Phrase("camera", "is late", CameraLate, (_DELAY,)),
    Phrase(
        "camera",
        "is knocked",
        CameraKnocked,
        (
            FaultKey("turned", "turned_in_camera_rad", ANGLE, LARGEST_ANGLE_RAD, True),
            FaultKey("shifted", "shifted_in_tcp_m", LENGTH, FARTHEST_OFF_M, True),
        ),
        optional=True,
    ),
    Phrase("camera", "is hidden by hands", CameraHidden),
    Phrase("joint", "is stuck", JointStuck, (FaultKey("which", "joint", None),)),
    Phrase("avoider", "is late", AvoiderLate, (_DELAY,)),
    Phrase("avoider", "never answers", AvoiderSilent),
    Phrase("avoider", "answers NaN", AvoiderNaN),
)
SUBJECTS = tuple(dict.fromkeys(phrase.subject for phrase in PHRASES))
_BY_KIND: Mapping[type[Any], Phrase] = {phrase.kind: phrase for phrase in PHRASES}


def read_faults(field: Field | None, *, duration_s: float) -> tuple[Fault, ...]:
    """The faults of a scenario that lasts ``duration_s``, in the order of the file."""
    if field is None:
        return ()
    expected = f"a list of at most {MOST_FAULTS} faults"
    faults = tuple(_fault(item, duration_s) for item in field.items(expected, most=MOST_FAULTS))
    false_hands = sum(isinstance(fault, FalseHand) for fault in faults)
    if false_hands > MOST_FALSE_HANDS:
        raise field.error(f"at most {MOST_FALSE_HANDS} false hands", got=str(false_hands))
    return faults


def _fault(field: Field, duration_s: float) -> Fault:
    subjects = ", ".join(SUBJECTS)
    given = [key for key, _ in field.entries(f"a fault: a mapping with one of the keys {subjects}")]
    found = [key for key in given if key in SUBJECTS]
    if len(found) != 1:
        hint = near_miss(given[0], SUBJECTS) if given and not found else ""
        got = f"the keys {', '.join(map(shown, given))}" if given else "an empty mapping"
        raise field.error(f"one fault: one of the keys {subjects}", got=got, hint=hint)
    predicates = {phrase.predicate: phrase for phrase in PHRASES if phrase.subject == found[0]}
    said = dict(field.entries("a fault"))[found[0]]
    expected = f"what the {found[0]} does: one of {', '.join(predicates)}"
    words = said.scalar(expected).strip()
    if words not in predicates:
        raise said.error(expected, hint=near_miss(words, tuple(predicates)))
    phrase = predicates[words]
    fields = field.fields((phrase.subject, *(key.word for key in phrase.keys), *TIMES))
    values: dict[str, Any] = {}
    for key in phrase.keys:
        value = fields.optional(key.word) if phrase.optional else fields.required(key.word)
        if value is not None:
            values[key.name] = key.read(value)
    if phrase.keys and not values:
        raise field.error(f"one of the keys {', '.join(key.word for key in phrase.keys)}", got="none")
    fault: Fault = phrase.kind(**values, **_times(fields, duration_s))
    return fault


def _times(fields: Fields, duration_s: float) -> dict[str, float]:
    """``from_s``, ``for_s`` and ``until_s``, those that are given."""
    times = {f"{word}_s": fields.required(word).quantity(TIME, least=0.0) for word in TIMES if word in fields}
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


def write_fault(fault: Fault) -> dict[str, str]:
    """The keys and values of one fault, from which ``read_faults`` gives it again."""
    phrase = _BY_KIND[type(fault)]
    tree = {phrase.subject: phrase.predicate}
    tree.update({key.word: key.write(getattr(fault, key.name)) for key in phrase.keys})
    tree["from"] = format_quantity(fault.from_s, TIME)
    if fault.for_s is not None:
        tree["for"] = format_quantity(fault.for_s, TIME)
    if fault.until_s is not None:
        tree["until"] = format_quantity(fault.until_s, TIME)
    return tree


def fault_words(fault: Fault) -> str:
    """A fault as a sentence for people: "hand sensor is late (delay 0.2 s), from 1 s until 3 s"."""
    phrase = _BY_KIND[type(fault)]
    words = f"{phrase.subject} {phrase.predicate}"
    if isinstance(fault, JointStuck):
        words = f"{fault.joint.value} joint {phrase.predicate}"
    values = [(key, getattr(fault, key.name)) for key in phrase.keys if key.dimension is not None]
    if values:
        told = (f"{key.word} {key.write(value) if key.several else f'{value:g} s'}" for key, value in values)
        words += f" ({', '.join(told)})"
    if fault.end_s == inf:
        return words + (f", from {fault.from_s:g} s" if fault.from_s else ", all the time")
    return f"{words}, from {fault.from_s:g} s until {fault.end_s:g} s"
