"""How faults are written in a scenario file: ``- hand sensor: is late``, ``delay: 200 ms``.

One table serves reading, writing and reports; docs/scenario-language.md has it for people.
"""

from __future__ import annotations

from dataclasses import replace
from math import inf
from typing import Any

from safety_harness.scenario.codec import Key, KeyTable, Several, Tree, Word, only_key, table_of
from safety_harness.scenario.faults import (
    EVERY_FAULT,
    MOST_FALSE_HANDS,
    MOST_FAULTS,
    FalseHand,
    Fault,
    JointStuck,
    Timed,
)
from safety_harness.scenario.fields import Field, Fields
from safety_harness.scenario.units import TIME, near_miss

_TIMES = table_of(Timed, "the time of a fault")
TIMES = _TIMES.names


def _own(kind: type[Any]) -> KeyTable:
    """The keys of one fault without those of its time; one of them has to be there."""
    table = table_of(kind, kind.said.predicate)
    return replace(table, keys=table.keys[len(TIMES) :], told_by=kind.said.subject)


OWN_KEYS = {kind: _own(kind) for kind in EVERY_FAULT}
SUBJECTS = {
    subject: {table.name: table for table in OWN_KEYS.values() if table.told_by == subject}
    for subject in dict.fromkeys(table.told_by for table in OWN_KEYS.values())
}


def fault_tables() -> tuple[KeyTable, ...]:
    """A table for each thing that can fail."""
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
        where = f"a fault of the {subject}"
        tables.append(KeyTable(name=where, where=where, keys=keys, path=f"faults.{subject}"))
    return tuple(tables)


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
    subject = only_key(field, "fault", SUBJECTS)
    predicates = SUBJECTS[subject]
    said = dict(field.entries("a fault"))[subject]
    expected = f"what the {subject} does: one of {', '.join(predicates)}"
    words = said.scalar(expected).strip()
    if words not in predicates:
        raise said.error(expected, hint=near_miss(words, predicates))
    table = predicates[words]
    fields = field.fields((subject, *table.names, *TIMES))
    values = table.values(fields)
    if table.keys and not any(name in fields for name in table.names):
        raise field.error(f"one of the keys {', '.join(table.names)}", got="none")
    assert table.kind is not None
    fault: Fault = table.kind(**values, **_times(fields, duration_s))
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


def write_fault(fault: Fault) -> dict[str, Tree]:
    """The keys and values of one fault, from which ``read_faults`` gives it again."""
    own = OWN_KEYS[type(fault)]
    return {own.told_by: own.name, **own.write(fault), **_TIMES.write(fault)}


def fault_words(fault: Fault) -> str:
    """A fault as a sentence for people: "hand sensor is late (delay 0.2 s), from 1 s until 3 s"."""
    own = OWN_KEYS[type(fault)]
    words = f"{own.told_by} {own.name}"
    if isinstance(fault, JointStuck):
        words = f"{fault.joint.value} joint {own.name}"
    values = [(key, getattr(fault, key.attribute)) for key in own.keys if not isinstance(key.value, Word)]
    if values:
        told = (
            f"{key.name} {key.value.write(value) if isinstance(key.value, Several) else f'{value:g} s'}"
            for key, value in values
        )
        words += f" ({', '.join(told)})"
    if fault.end_s == inf:
        return words + (f", from {fault.from_s:g} s" if fault.from_s else ", all the time")
    return f"{words}, from {fault.from_s:g} s until {fault.end_s:g} s"
