"""Derive the JSON Schema (draft 2020-12) of scenario files from the reference tables.

Editors use the schema to check files. A schema checks less than the reader. The schema ignores the bounds of
values with units, contradictions between keys, and the content of a recording. The reader refuses everything
that the schema refuses.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from safety_harness.scenario.codec import FreeKeys, Key, KeyTable, QuantityValue, Several, Text, Value, Word
from safety_harness.scenario.reference_tables import COMPOSED, SUITE, TOP
from safety_harness.scenario.units import Dimension

Schema = dict[str, Any]
_NUMBER = r"[+-]?([0-9]+(\.[0-9]*)?|\.[0-9]+)([eE][+-]?[0-9]+)?"
_SPACED = {"2": "(2|\\^2|²)", "/": " */ *", "deg": "(deg|°)"}  # the ways to write a unit
_ANY_TEXT: Schema = {
    "type": ["string", "number", "boolean", "null"]
}  # where a text belongs, the reader takes 12 as a text


def scenario_schema() -> Schema:
    """Return the schema of every kind of scenario file: scenario, extending scenario and suite.

    The schema accepts any space, because only the reader checks spaces.
    """
    scenario = _table(TOP, further=COMPOSED)
    required = scenario.pop("required")
    extending = {"if": {"required": ["extends"]}, "else": {"required": required}}
    space = {"required": ["scenario space"]}
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": "A scenario file of safety-harness",
        "type": "object",
        "if": space,
        "else": {
            "if": {"required": ["suite"]},
            "then": _table(SUITE),
            "else": {**scenario, "allOf": [extending]},
        },
        "$defs": {_name(table): _table(table) for table in TOP.below()},
    }


def table_schema(top: KeyTable, title: str) -> Schema:
    """Return the schema of a file with the keys of one table."""
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": title,
        **_table(top),
        "$defs": {_name(table): _table(table) for table in top.below()},
    }


def _name(table: KeyTable) -> str:
    """Return the name under which the schema contains the definition of a table."""
    return (f"{table.path} {table.name}" if table.path != table.name else table.name).strip()


def _table(table: KeyTable, further: KeyTable | None = None) -> Schema:
    """Return the schema of a table with its own keys and with the keys of ``further``."""
    keys = (*table.keys, *(further.keys if further else ()))
    schema: Schema = {
        "type": "object",
        "additionalProperties": False,
        "properties": {key.name: _key(key) for key in keys},
    }
    required = [key.name for key in table.keys if key.required]
    if required:
        schema["required"] = required
    return schema


def _key(key: Key) -> Schema:
    """Return the schema of a key."""
    default = f" Default: {key.default}." if key.default else ""
    return {"description": f"{key.meaning}. Takes: {key.kind}.{default}", **_value(key.value)}


def _value(value: Value) -> Schema:
    """Return the schema of a kind of value."""
    if isinstance(value, QuantityValue):
        return _quantity(value)
    if isinstance(value, Word):
        return {"enum": list(value.options)}
    if isinstance(value, Text) and value.or_mapping:
        return {"type": [*_ANY_TEXT["type"], "object"]}
    if isinstance(value, Text):
        return {"type": "string", "pattern": value.pattern} if value.pattern else _ANY_TEXT
    if isinstance(value, Several):
        least, most = (value.count, value.count) if value.count else (value.least, value.most)
        schema: Schema = {"type": "array", "items": _value(value.of)}
        if least:
            schema["minItems"] = least
        return schema if most is None else {**schema, "maxItems": most}
    if isinstance(value, FreeKeys):
        free: Schema = {"type": "object", "additionalProperties": _value(value.of)}
        return {**free, "minProperties": value.least} if value.least else free
    # One table, or several tables, which the key ``told_by`` of each table distinguishes.
    if not value.tables:
        return {"type": "object"}
    if value.or_text:
        return {"anyOf": [{"type": "string", "pattern": value.or_text}, _value(replace(value, or_text=""))]}
    references = [{"$ref": f"#/$defs/{_pointer(_name(table))}"} for table in value.tables]
    if len(references) == 1:
        return references[0]
    return {
        "type": "object",
        "anyOf": [{"required": [table.told_by]} for table in value.tables],
        "allOf": [
            {"if": _begins(table, value.tables), "then": reference}
            for table, reference in zip(value.tables, references, strict=True)
        ],
    }


def _begins(table: KeyTable, tables: tuple[KeyTable, ...]) -> Schema:
    """Return the schema of the condition that a mapping belongs to ``table``.

    The mapping has the table's first key. The mapping lacks the first key of every other table that also
    accepts this key.
    """
    first = table.told_by
    wider = [rival.told_by for rival in tables if first in rival.names and rival is not table]
    mine: Schema = {"required": [first]}
    return {**mine, "not": {"anyOf": [{"required": [name]} for name in wider]}} if wider else mine


def _pointer(name: str) -> str:
    """Return a name escaped for a JSON pointer."""
    return name.replace("~", "~0").replace("/", "~1").replace(" ", "%20")


def _quantity(value: QuantityValue) -> Schema:
    """Return the schema of a quantity.

    The quantity is a text. If the unit may be absent, a number is also allowed.
    """
    texts: list[Schema] = [{"type": "string", "pattern": _pattern(value.dimension, value.whole)}]
    if value.dimension.bare:
        number: Schema = {"type": "integer" if value.whole else "number"}
        bounds = {"exclusiveMinimum": value.above, "minimum": value.least, "maximum": value.most}
        texts.insert(0, number | {keyword: bound for keyword, bound in bounds.items() if bound is not None})
    if value.or_word:
        texts.append({"const": value.or_word})
    return texts[0] if len(texts) == 1 else {"anyOf": texts}


def _pattern(dimension: Dimension, whole: bool) -> str:
    """Return the pattern of a number with its unit, in every spelling that the reader accepts."""
    number = "[+-]?[0-9]+" if whole and dimension.bare else _NUMBER
    units = "|".join(map(_unit, dimension.units))
    unit = f" *({units}){'?' if dimension.bare else ''}" if units else ""
    return f"^ *{number}{unit} *$"


def _unit(unit: str) -> str:
    """Return the pattern of a unit."""
    first, rest = ("deg", unit[3:]) if unit.startswith("deg") else ("1?" * unit.startswith("/"), unit)
    return "".join(_SPACED.get(part, part) for part in (first, *rest))
