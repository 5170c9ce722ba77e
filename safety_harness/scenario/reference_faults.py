"""The keys of faults, from the table of their phrases."""

from __future__ import annotations

from safety_harness.scenario.fault_phrases import PHRASES, SUBJECTS
from safety_harness.scenario.fault_phrases import FaultKey as Further
from safety_harness.scenario.faults import Joint
from safety_harness.scenario.reference import REQUIRED, Key, KeyTable, QuantityValue, Several, Value, Word
from safety_harness.scenario.units import ANGLE, TIME

_MEANINGS = {
    "delay": "how much later everything comes that is late",
    "offset": "by how much every hand is measured off, in base",
    "at": "where the hand is that is none, in base",
    "turned": "rotation of the camera, in its frame",
    "shifted": "shift of the camera, in the TCP frame",
    "which": "the joint",
}
_EXAMPLES = {
    "delay": "delay: 200 ms",
    "offset": "offset: [50 mm, 0 mm, 0 mm]",
    "at": "at: [800 mm, -350 mm, 250 mm]",
    "turned": "turned: [2 deg, 0 deg, 0 deg]",
    "shifted": "shifted: [5 mm, 0 mm, 0 mm]",
    "which": "which: elbow",
}
_TIME = QuantityValue(dimension=TIME, least=0.0)
_TIMES = (
    Key(name="from", value=_TIME, default="0 s", meaning="when the fault begins", example="from: 500 ms"),
    Key(
        name="for",
        value=QuantityValue(dimension=TIME, above=0.0),
        default="to the end of the run",
        meaning="how long it lasts",
        example="for: 200 ms",
    ),
    Key(
        name="until",
        value=_TIME,
        default="the end of the run",
        meaning="in place of `for`: when it ends; that moment is not in it",
        example="until: 2 s",
    ),
)


def fault_tables() -> tuple[KeyTable, ...]:
    """A table for each thing that can fail."""
    return tuple(_table(subject) for subject in SUBJECTS)


def _table(subject: str) -> KeyTable:
    phrases = [phrase for phrase in PHRASES if phrase.subject == subject]
    predicates = tuple(phrase.predicate for phrase in phrases)
    further = {key.word: _key(key) for phrase in phrases for key in phrase.keys}
    first = Key(
        name=subject,
        value=Word(options=predicates),
        default=REQUIRED,
        meaning=f"what the {subject} does wrongly",
        example=f"faults:\n  - {subject}: {predicates[0]}\n    from: 500 ms\n    for: 200 ms",
    )
    return KeyTable(
        name=f"a fault of the {subject}",
        where=f"a fault of the {subject}",
        keys=(first, *further.values(), *_TIMES),
        path=f"faults.{subject}",
    )


def _key(further: Further) -> Key:
    return Key(
        name=further.word,
        value=_value(further),
        default="required where it belongs",
        meaning=_MEANINGS[further.word],
        example=_EXAMPLES[further.word],
    )


def _value(further: Further) -> Value:
    if further.dimension is None:
        return Word(options=tuple(joint.value for joint in Joint))
    if not further.several:
        return QuantityValue(dimension=further.dimension, above=0.0, most=further.most)
    number = QuantityValue(dimension=further.dimension, least=-further.most, most=further.most)
    return Several(of=number, form="rotation" if further.dimension is ANGLE else "point", count=3)
