"""Typed reading of a JSON text that somebody else wrote: each field is what it should be, or refused."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from math import inf, isfinite
from pathlib import Path
from typing import Any, NoReturn

from safety_harness.exceptions import ModelError, Place


@dataclass(frozen=True)
class NumberRange:
    """What a number may be: finite, within [low, high], and not ``low`` itself if ``open``."""

    low: float = -inf
    high: float = inf
    open: bool = False

    def __contains__(self, value: float) -> bool:
        return isfinite(value) and self.low <= value <= self.high and not (self.open and value == self.low)

    def __str__(self) -> str:
        parts = ["a finite number"]
        if self.low > -inf:
            parts.append(f"{'above' if self.open else 'at least'} {self.low:g}")
        if self.high < inf:
            parts.append(f"at most {self.high:g}")
        return " ".join(parts)


ANY = NumberRange()
POSITIVE = NumberRange(low=0.0, open=True)
NOT_NEGATIVE = NumberRange(low=0.0)


def refuse(path: Path, name: str | None, expected: str, got: str, hint: str = "") -> NoReturn:
    """Raise the ModelError for field ``name`` of the file ``path``."""
    raise ModelError(place=Place(file=path, field=name), expected=expected, got=got, hint=hint)


class JsonFields:
    """The fields of a JSON object; a name with a dot means a field of an object in it."""

    def __init__(self, path: Path, text: str) -> None:
        """``path`` is the file that errors name; ModelError unless ``text`` is a JSON object."""
        self._path = path
        try:
            self._root = json.loads(text, parse_constant=self._no_number)
        except (ValueError, RecursionError) as error:
            refuse(path, None, "metadata in JSON", str(error))
        if not isinstance(self._root, dict):
            self.refuse(None, "a JSON object of metadata", self._root)

    def refuse(self, name: str | None, expected: str, value: object) -> NoReturn:
        """Raise the ModelError for a value that is not what was expected."""
        text = repr(value)
        refuse(self._path, name, expected, text if len(text) <= 80 else text[:77] + "...")

    def __contains__(self, name: str) -> bool:
        value = self._root
        for part in name.split("."):
            if not isinstance(value, dict) or part not in value:
                return False
            value = value[part]
        return True

    def get(self, name: str) -> Any:
        """The value of a field that has to be there."""
        value = self._root
        for part in name.split("."):
            if not isinstance(value, dict) or part not in value:
                refuse(self._path, name, "this field", "none")
            value = value[part]
        return value

    def table(self, name: str) -> dict[str, Any]:
        """A field that is an object."""
        value = self.get(name)
        if not isinstance(value, dict):
            self.refuse(name, "an object", value)
        return dict(value)

    def one_of(self, name: str, allowed: Iterable[str]) -> str:
        """A field that is one of a few texts."""
        value, texts = self.get(name), tuple(allowed)
        if not isinstance(value, str) or value not in texts:
            self.refuse(name, " or ".join(repr(text) for text in texts), value)
        return value

    def whole(self, name: str, low: int, high: int | None = None) -> int:
        """A whole number from ``low`` to ``high``."""
        value = self.get(name)
        if type(value) is not int or value < low or (high is not None and value > high):
            some = f"at least {low}" if high is None else f"{low}" if low == high else f"{low} to {high}"
            self.refuse(name, f"a whole number, {some}", value)
        return value

    def number(self, name: str, bounds: NumberRange = ANY) -> float:
        """A number within ``bounds``."""
        return self._checked(name, self.get(name), bounds)

    def vector(self, name: str, length: int, bounds: NumberRange = ANY) -> tuple[float, ...]:
        """``length`` numbers, each within ``bounds``."""
        value = self.get(name)
        if not isinstance(value, list) or len(value) != length:
            self.refuse(name, f"a list of {length} numbers", value)
        return tuple(self._checked(f"{name}[{i}]", one, bounds) for i, one in enumerate(value))

    def no_others(self, name: str | None, known: Mapping[str, Any]) -> None:
        """Refuse a field of the object ``name`` (None: the outermost) that is not among the known."""
        for key in self._root if name is None else self.get(name):
            if key not in known:
                self.refuse(name, "only fields of this format: " + ", ".join(known), key)

    def _checked(self, name: str, value: object, bounds: NumberRange) -> float:
        try:
            if isinstance(value, int | float) and not isinstance(value, bool) and float(value) in bounds:
                return float(value)
        except OverflowError:  # an integer beyond the floats
            pass
        self.refuse(name, str(bounds), value)

    def _no_number(self, text: str) -> NoReturn:
        raise ValueError(f"{text} is no number in JSON")
