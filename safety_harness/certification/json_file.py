"""JSON that may be a stranger's: of a bounded size, and every mistake an error with its file."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from safety_harness.exceptions import InputError, Place
from safety_harness.scenario.files import decode, read_bytes

LARGEST_BYTES = 64 * 2**20
WORDS = {dict: "an object", list: "a list", str: "a text", int: "a whole number", bool: "true or false"}


def read_json(path: Path, expected: str, *, most: int = LARGEST_BYTES) -> Any:
    """What the file says; InputError for no file, one of more than ``most`` bytes, or no JSON."""
    data = read_bytes(path, most=most, place=Place(file=path), error=InputError)
    text = decode(data, most=most, file=path, error=InputError)
    try:
        return json.loads(text)
    except (ValueError, RecursionError) as error:
        raise InputError(place=Place(file=path), expected=f"{expected}, in JSON", got=str(error)) from error


def read_object(path: Path, form: str, *, words: str = "", most: int = LARGEST_BYTES) -> dict[str, Any]:
    """An object of the format ``form`` (for people ``words``); InputError for another, as ``read_json``."""
    found = read_json(path, words or form, most=most)
    if not isinstance(found, dict) or found.get("format") != form:
        got = repr(found.get("format"))[:80] if isinstance(found, dict) else type(found).__name__
        raise InputError(place=Place(file=path, field="format"), expected=repr(form), got=got)
    return found


def part(path: Path, found: Any, name: str, kind: type, where: str = "") -> Any:
    """A field of an object, which has to be of a kind; InputError naming it if it is not."""
    value = found.get(name) if isinstance(found, dict) else None
    if not isinstance(value, kind) or (kind is int and isinstance(value, bool)):
        place = Place(file=path, field=f"{where}{name}")
        raise InputError(place=place, expected=WORDS[kind], got=repr(value)[:60])
    return value
