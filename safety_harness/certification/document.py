"""Frozen dataclasses as JSON and back, and the JSON schema of them: all three read off the types.

Dataclasses become objects, tuples arrays, enumerations their values.  A number that is not finite has no
place here and is refused when it is written.
"""

from __future__ import annotations

import json
import types
from dataclasses import fields, is_dataclass
from enum import Enum
from math import isfinite
from pathlib import Path
from typing import Any, TypeVar, Union, get_args, get_origin, get_type_hints

from safety_harness.certification.evidence import FORMAT, Evidence
from safety_harness.certification.json_file import read_object
from safety_harness.exceptions import InputError, Place

T = TypeVar("T")
PLAIN = {str: "string", int: "integer", float: "number", bool: "boolean", types.NoneType: "null"}


def as_text(evidence: Evidence) -> str:
    """The whole report as JSON."""
    return json.dumps(plain(evidence), indent=1, allow_nan=False, ensure_ascii=False) + "\n"


def read_evidence(path: Path) -> Evidence:
    """What ``as_text`` wrote; InputError with the place of what is not as it should be."""
    found = read_object(path, FORMAT, words="an evidence report")
    evidence: Evidence = from_plain(Evidence, found, path, "")
    return evidence


def plain(value: Any) -> Any:
    """``value`` in the types that JSON has."""
    if isinstance(value, Enum):
        return value.value
    if is_dataclass(value) and not isinstance(value, type):
        return {field.name: plain(getattr(value, field.name)) for field in fields(value)}
    if isinstance(value, tuple):
        return [plain(one) for one in value]
    if isinstance(value, float):
        if not isfinite(value):
            raise ValueError(f"a number that is not finite has no place in the evidence: {value}")
        return float(value)
    if value is None or isinstance(value, str | int | bool):
        return value
    raise TypeError(f"no place in the evidence for {type(value).__name__}")


def from_plain(kind: Any, value: Any, path: Path, where: str) -> Any:
    """The value of type ``kind`` that ``plain`` made ``value`` from; else an InputError naming ``where``."""
    origin, arguments = get_origin(kind), get_args(kind)
    if origin in (Union, types.UnionType):
        if value is None and types.NoneType in arguments:
            return None
        (inner,) = (one for one in arguments if one is not types.NoneType)
        return from_plain(inner, value, path, where)
    if origin is tuple:
        if not isinstance(value, list):
            raise _refused(path, where, "a list", value)
        if arguments[-1] is Ellipsis:
            return tuple(from_plain(arguments[0], one, path, f"{where}[{k}]") for k, one in enumerate(value))
        if len(value) != len(arguments):
            raise _refused(path, where, f"{len(arguments)} values", value)
        return tuple(
            from_plain(one, v, path, f"{where}[{k}]")
            for k, (one, v) in enumerate(zip(arguments, value, strict=True))
        )
    if is_dataclass(kind):
        return _dataclass(kind, value, path, where)
    if issubclass(kind, Enum):
        try:
            return kind(value)
        except ValueError as error:
            raise _refused(path, where, f"one of {[member.value for member in kind]}", value) from error
    if kind is float and isinstance(value, int) and not isinstance(value, bool):
        try:
            return float(value)
        except OverflowError as error:
            raise _refused(path, where, "a finite number", value) from error
    if not isinstance(value, kind) or (kind is int and isinstance(value, bool)):
        raise _refused(path, where, f"a {PLAIN[kind]}", value)
    if kind is float and not isfinite(value):
        raise _refused(path, where, "a finite number", value)
    return value


def _dataclass(kind: Any, value: Any, path: Path, where: str) -> Any:
    names = [field.name for field in fields(kind)]
    if not isinstance(value, dict) or set(value) != set(names):
        raise _refused(path, where, f"an object with {', '.join(names)}", value)
    hints = get_type_hints(kind)
    return kind(**{n: from_plain(hints[n], value[n], path, f"{where}.{n}".lstrip(".")) for n in names})


def _refused(path: Path, where: str, expected: str, value: Any) -> InputError:
    got = ", ".join(map(str, value)) if isinstance(value, dict) and value else repr(value)
    return InputError(place=Place(file=path, field=where or None), expected=expected, got=got[:120])


def schema() -> dict[str, Any]:
    """The published schema of the JSON (draft 2020-12)."""
    definitions: dict[str, Any] = {}
    root = _schema_of(Evidence, definitions)
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": FORMAT,
        "$defs": dict(sorted(definitions.items())),
        **root,
    }


def _schema_of(kind: Any, definitions: dict[str, Any]) -> dict[str, Any]:
    origin, arguments = get_origin(kind), get_args(kind)
    if origin in (Union, types.UnionType):
        return {"anyOf": [_schema_of(one, definitions) for one in arguments]}
    if origin is tuple and arguments[-1] is Ellipsis:
        return {"type": "array", "items": _schema_of(arguments[0], definitions)}
    if origin is tuple:
        items = [_schema_of(one, definitions) for one in arguments]
        return {"type": "array", "prefixItems": items, "minItems": len(items), "maxItems": len(items)}
    if is_dataclass(kind):
        name = kind.__name__  # type: ignore[union-attr]
        if name not in definitions:
            definitions[name] = {}
            hints = get_type_hints(kind)
            properties = {f.name: _schema_of(hints[f.name], definitions) for f in fields(kind)}
            if "format" in properties:
                properties["format"] = {"const": FORMAT}
            definitions[name] = {
                "description": " ".join((kind.__doc__ or "").split()),
                "type": "object",
                "properties": properties,
                "required": list(properties),
                "additionalProperties": False,
            }
        return {"$ref": f"#/$defs/{name}"}
    if issubclass(kind, Enum):
        return {"enum": [member.value for member in kind]}
    return {"type": PLAIN[kind]}
