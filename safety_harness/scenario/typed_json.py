"""Turn JSON of unknown origin into a dataclass that msgspec has checked.

A conversion is never silent. A text or a boolean is not accepted as a number. An integer is accepted as a
float, and no number may be NaN or infinite. Types declare their bounds: ``Annotated[float, Meta(gt=0)]``.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import asdict, fields, is_dataclass
from pathlib import Path
from typing import Any, TypeVar

import msgspec

from safety_harness.base.exceptions import InputError, Place
from safety_harness.scenario.files import decode, read_bytes
from safety_harness.scenario.kinds import JSON, command_for, kind_of, refuse_other_kind

LARGEST_BYTES = 64 * 2**20  # of a file
INSTEAD = {"Invalid": "a value that this version knows", "Number": "a finite number"}  # for msgspec's words

T = TypeVar("T")


def read_json(
    path: Path, noun: str, *, most: int = LARGEST_BYTES, error: type[InputError] = InputError
) -> Any:
    """Return the content of a JSON file.

    Args:
        path: The file.
        noun: The expected content, for errors.
        most: The largest size, in bytes.
        error: The type of the error for a file that is absent, too large or not JSON.

    """
    refuse_other_kind(path, *JSON, error=error, expected=f"{noun}, in JSON")
    data = read_bytes(path, most=most, place=Place(file=path), error=error)
    return parsed(decode(data, most=most, file=path, error=error), path, noun, error)


def parsed(text: str | bytes, file: Path, noun: str, error: type[InputError] = InputError) -> Any:
    """Return the content of a JSON text.

    If the text is invalid, raise ``error``, which states that ``noun`` was expected in ``file``.
    """
    try:
        return msgspec.json.decode(text)
    except (ValueError, RecursionError) as reason:
        raise error(place=Place(file=file), expected=f"{noun}, in JSON", got=str(reason)) from reason


def of_format(document: Any, form: str, file: Path, error: type[InputError] = InputError) -> dict[str, Any]:
    """Return ``document`` if it is an object of the format ``form``.

    Otherwise raise ``error``.
    """
    if not isinstance(document, dict):
        expected = f"a JSON object of the format {form!r}"
        raise error(place=Place(file=file), expected=expected, got=type(document).__name__)
    if document.get("format") != form:
        got = repr(document.get("format"))[:80]
        kind = kind_of(file)
        hint = command_for(file, kind) if kind in JSON else ""
        raise error(place=Place(file=file, field="format"), expected=repr(form), got=got, hint=hint)
    return document


def typed(
    data: Any,
    kind: type[T],
    file: Path,
    *,
    where: str = "",
    further_fields: bool = False,
    defaults: bool = False,
    error: type[InputError] = InputError,
) -> T:
    """Return plain JSON data as an object of the type ``kind``.

    Args:
        data: The data.
        kind: The type; an object must have all fields of its dataclass.
        file: The file, for errors.
        where: The path to the data in the file.
        further_fields: Whether objects may have additional fields. If this is true, they may also lack fields
            that have a default.
        defaults: Whether objects may lack fields that have a default.
        error: The type of the error, which states the path of the first wrong field.

    """

    def refused(path: str, expected: str, got: str) -> InputError:
        field = f"{where}{path}".removeprefix(".")
        return error(place=Place(file=file, field=field or None), expected=expected, got=got)

    try:
        made = msgspec.convert(data, kind)
        refusals = [] if further_fields else list(_other_fields(data, made, "", defaults))
    except ValueError as reason:
        message, path = re.fullmatch(r"(.*?)(?: - at `\$(.*)`)?", str(reason), re.DOTALL).groups("")  # type: ignore[union-attr]
        expected, _, got = message.removeprefix("Expected ").replace("`", "").partition(", got ")
        if message.startswith("Object missing"):
            raise refused(f"{path}.{message.split('`')[1]}", "this field", "none") from reason
        expected = INSTEAD.get(message.split(" ")[0], expected)
        raise refused(path, expected, got or _short(_value_at(data, path))) from reason
    except RecursionError as reason:
        raise refused("", "values that lie less deep", "too deep a nesting") from reason
    if refusals:
        raise refused(*refusals[0])
    return made


def _other_fields(data: Any, made: Any, path: str, defaults: bool) -> Iterator[tuple[str, str, str]]:
    """Yield a tuple for each field in ``data`` that is unexpected or missing.

    The tuple contains the path, the expectation and the content. The expected fields are those of ``made``.
    """
    if is_dataclass(made):
        known = [column.name for column in fields(made)]
        for name in sorted(data.keys() ^ set(known)):
            if name in data:
                yield path, "only the fields " + ", ".join(known), _short(name)
            elif not defaults:
                yield f"{path}.{name}", "this field", "none"
        for name in known:
            if name in data:
                yield from _other_fields(data[name], getattr(made, name), f"{path}.{name}", defaults)
    elif isinstance(made, tuple):
        for k, pair in enumerate(zip(data, made, strict=True)):
            yield from _other_fields(*pair, f"{path}[{k}]", defaults)


def _value_at(data: Any, path: str) -> Any:
    """Return the value at a path in msgspec's notation.

    The search ends at "[...]", which stands for a key of the file.
    """
    for name, index in re.findall(r"([^.\[\]]+)|\[(\d+)\]", path):
        try:
            data = data[int(index)] if index else data[name]
        except (LookupError, TypeError):
            break
    return data


def _short(value: Any) -> str:
    """Return a value as text with at most 80 characters."""
    text = repr(value)
    return text if len(text) <= 80 else text[:77] + "..."


def plain(value: Any) -> Any:
    """Return ``value`` in JSON's types.

    Dataclasses become objects, and enumerations become their values. NumPy's numbers become Python's numbers,
    and dates and times become texts in the form of ISO 8601.
    """
    own = asdict(value) if is_dataclass(value) and not isinstance(value, type) else value
    return msgspec.to_builtins(own, enc_hook=_number)


def _number(value: Any) -> float:
    """Return a NumPy number as a float.

    Raise TypeError for any other type.
    """
    if not isinstance(value, float):
        raise TypeError(f"no place in JSON for {type(value).__name__}")
    return float(value)
