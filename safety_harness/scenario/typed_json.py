"""JSON that a stranger may have written, as the dataclass that is to be in it: msgspec compares the two.

Nothing is converted silently: no text or boolean is a number, only an integer may stand for a float, and no
number is NaN or infinite.  Bounds are declared with the types: ``Annotated[float, Meta(gt=0)]``.
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

LARGEST_BYTES = 64 * 2**20
INSTEAD = {"Invalid": "a value that this version knows", "Number": "a finite number"}  # of msgspec's words

T = TypeVar("T")


def read_json(
    path: Path, what: str, *, most: int = LARGEST_BYTES, error: type[InputError] = InputError
) -> Any:
    """What the file says; ``error`` for no file, one of more than ``most`` bytes, or no JSON."""
    refuse_other_kind(path, *JSON, error=error, expected=f"{what}, in JSON")
    data = read_bytes(path, most=most, place=Place(file=path), error=error)
    return parsed(decode(data, most=most, file=path, error=error), path, what, error)


def parsed(text: str | bytes, file: Path, what: str, error: type[InputError] = InputError) -> Any:
    """What the text in ``file`` says; ``error``, which expects ``what``, for no JSON."""
    try:
        return msgspec.json.decode(text)
    except (ValueError, RecursionError) as reason:
        raise error(place=Place(file=file), expected=f"{what}, in JSON", got=str(reason)) from reason


def of_format(found: Any, form: str, file: Path, error: type[InputError] = InputError) -> dict[str, Any]:
    """``found`` if it is an object of the format ``form``, else ``error``."""
    if not isinstance(found, dict):
        expected = f"a JSON object of the format {form!r}"
        raise error(place=Place(file=file), expected=expected, got=type(found).__name__)
    if found.get("format") != form:
        got = repr(found.get("format"))[:80]
        kind = kind_of(file)
        hint = command_for(file, kind) if kind in JSON else ""
        raise error(place=Place(file=file, field="format"), expected=repr(form), got=got, hint=hint)
    return found


def typed(
    found: Any,
    kind: type[T],
    file: Path,
    *,
    where: str = "",
    others: bool = False,
    defaults: bool = False,
    error: type[InputError] = InputError,
) -> T:
    """``found`` as ``kind``; ``error`` with the path of the first field that is wrong, below ``where``.

    Objects have all fields of their dataclass, and no others unless ``others``; what has a default may be
    missing with ``others`` or ``defaults``.
    """

    def refused(path: str, expected: str, got: str) -> InputError:
        field = f"{where}{path}".removeprefix(".")
        return error(place=Place(file=file, field=field or None), expected=expected, got=got)

    try:
        made = msgspec.convert(found, kind)
        wrong = [] if others else list(_other_fields(found, made, "", defaults))
    except ValueError as reason:
        words, path = re.fullmatch(r"(.*?)(?: - at `\$(.*)`)?", str(reason), re.DOTALL).groups("")  # type: ignore[union-attr]
        expected, _, got = words.removeprefix("Expected ").replace("`", "").partition(", got ")
        if words.startswith("Object missing"):
            raise refused(f"{path}.{words.split('`')[1]}", "this field", "none") from reason
        expected = INSTEAD.get(words.split(" ")[0], expected)
        raise refused(path, expected, got or _short(_value_at(found, path))) from reason
    except RecursionError as reason:
        raise refused("", "values that lie less deep", "too deep a nesting") from reason
    if wrong:
        raise refused(*wrong[0])
    return made


def _other_fields(found: Any, made: Any, path: str, defaults: bool) -> Iterator[tuple[str, str, str]]:
    """Path, what is expected and what is there of each field that is not one of ``made``'s, or missing."""
    if is_dataclass(made):
        known = [one.name for one in fields(made)]
        for name in sorted(found.keys() ^ set(known)):
            if name in found:
                yield path, "only the fields " + ", ".join(known), _short(name)
            elif not defaults:
                yield f"{path}.{name}", "this field", "none"
        for name in known:
            if name in found:
                yield from _other_fields(found[name], getattr(made, name), f"{path}.{name}", defaults)
    elif isinstance(made, tuple):
        for k, pair in enumerate(zip(found, made, strict=True)):
            yield from _other_fields(*pair, f"{path}[{k}]", defaults)


def _value_at(found: Any, path: str) -> Any:
    """What stands at a path of msgspec's; where that has "[...]" for a key of the file's own, its object."""
    for name, index in re.findall(r"([^.\[\]]+)|\[(\d+)\]", path):
        try:
            found = found[int(index)] if index else found[name]
        except (LookupError, TypeError):
            break
    return found


def _short(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= 80 else text[:77] + "..."


def plain(value: Any) -> Any:
    """``value`` in the types that JSON has: dataclasses as objects, tuples, enumerations by their values.

    Numbers of NumPy become Python's; times stay what they are, for ``json.dumps``.
    """
    own = asdict(value) if is_dataclass(value) and not isinstance(value, type) else value
    return msgspec.to_builtins(own, enc_hook=_number)


def _number(value: Any) -> float:
    if not isinstance(value, float):
        raise TypeError(f"no place in JSON for {type(value).__name__}")
    return float(value)
