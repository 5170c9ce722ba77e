"""Read single values and check their types.

A ``Field`` is a node of the tree together with its place in the file. Every method returns a checked value,
or raises ScenarioError. The error states the file, the line, the field, the expected and the actual value.
"""

from __future__ import annotations

import re
import unicodedata
from collections import abc
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, replace
from enum import Enum
from functools import cached_property, lru_cache
from math import pi
from pathlib import Path
from typing import NamedTuple, TypeVar

from safety_harness.base.exceptions import InputError, Place, ScenarioError, near_miss
from safety_harness.scenario.nodes import Mapping, Node, Scalar, Sequence, join
from safety_harness.scenario.units import Dimension, parse_quantity, shown

LARGEST_COORDINATE_M = 10.0  # beyond it: a slip of the unit, not a workplace
LARGEST_ANGLE_RAD = 2.0 * pi

E = TypeVar("E", bound=Enum)
V = TypeVar("V")
T = TypeVar("T")

_INTEGER = re.compile(r"[+-]?[0-9]{1,20}")
_LONGEST_SENTENCE = 200  # characters; YAML allows 1,024 in a key, and escapes need room
SENTENCE = f"one line of 1 to {_LONGEST_SENTENCE} printable characters"


def is_sentence(text: str) -> bool:
    """Return whether ``text`` is valid as a name or as a sentence, such as a claim."""
    return bool(text.strip()) and text.isprintable() and len(text) <= _LONGEST_SENTENCE


_mistakes: ContextVar[list[InputError] | None] = ContextVar("_mistakes", default=None)


@contextmanager
def every_mistake() -> Iterator[list[InputError]]:
    """Yield a list that collects all mistakes within the context.

    In this context, readers continue after a mistake.
    """
    mistakes: list[InputError] = []
    token = _mistakes.set(mistakes)
    try:
        yield mistakes
    except InputError as error:
        noted(error)
    finally:
        _mistakes.reset(token)


@contextmanager
def one_mistake() -> Iterator[None]:
    """Make readers stop at the first mistake, even within ``every_mistake``.

    Draws of a space use this mode, because a reader may refuse a draw.
    """
    token = _mistakes.set(None)
    try:
        yield
    finally:
        _mistakes.reset(token)


def noted(error: InputError) -> InputError:
    """Append a mistake to the list that ``every_mistake`` collects, and return the mistake.

    If there is no such list, raise the mistake.
    """
    mistakes = _mistakes.get()
    if mistakes is None:
        raise error
    if error not in mistakes:
        mistakes.append(error)
    return error


def each(read: Callable[[T], V], items: Iterable[T]) -> list[V]:
    """Return the result of ``read`` for each item.

    Raise the first mistake if there is any. Within ``every_mistake``, all items are read before the first
    mistake is raised.
    """
    made, mistakes = [], list[InputError]()
    for item in items:
        try:
            made.append(read(item))
        except InputError as error:
            mistakes.append(noted(error))
    if mistakes:
        raise mistakes[0]
    return made


class Field(NamedTuple):
    """One value of a scenario file.

    Args:
        node: The value.
        file: The scenario's own file, whose folder is the start of relative paths; None: a text without a
            file.
        path: The name of the value in messages, such as ``hands[0].starts at``.
        line: The number of the line in the value's file, counted from 1.
        origin: The file that contains the value, if it differs from ``file``.

    A field is a tuple because tuples are created quickly, and a search creates a million fields per minute.

    """

    node: Node
    file: Path | None
    path: str
    line: int
    origin: Path | None = None

    @property
    def place(self) -> Place:
        """The place of the value, for errors that this module or a later check raises."""
        return Place(file=self.origin or self.file, line=self.line, field=self.path or None)

    def error(self, expected: str, *, got: str | None = None, hint: str = "") -> ScenarioError:
        """Return the error for a value that is not as expected.

        Args:
            expected: Completes "expected ...".
            got: Completes "got ..."; None: the value itself.
            hint: One more line of help.

        """
        return ScenarioError(
            place=self.place, expected=expected, got=got if got is not None else self.got(), hint=hint
        )

    def got(self) -> str:
        """Return the actual value in the form that a message states."""
        if isinstance(self.node, Scalar):
            return shown(self.node.text)
        count = len(self.node.items if isinstance(self.node, Sequence) else self.node.entries)
        kind = "list" if isinstance(self.node, Sequence) else "mapping"
        return f"an empty {kind}" if count == 0 else f"a {kind} of {count}"

    def scalar(self, expected: str) -> str:
        """Return the text of a single value."""
        if not isinstance(self.node, Scalar):
            raise self.error(expected)
        return self.node.text

    def quantity(
        self,
        dimension: Dimension,
        *,
        above: float | None = None,
        least: float | None = None,
        most: float | None = None,
    ) -> float:
        """Return a quantity in SI.

        Args:
            dimension: Its dimension.
            above: An exclusive lower bound in SI; None: no such bound.
            least: An inclusive lower bound in SI; None: no such bound.
            most: An inclusive upper bound in SI; None: no such bound.

        """
        if isinstance(self.node, Scalar) and self.node.drawn and self.node.drawn[1] == dimension.si:
            value = self.node.drawn[0]
        else:
            value = parse_quantity(self.scalar(dimension.expected), dimension, self.place)
        if (
            (above is None or value > above)
            and (least is None or value >= least)
            and (most is None or value <= most)
        ):
            return value
        bounds = (("above", above), ("at least", least), ("at most", most))
        wanted = " and ".join(f"{relation} {bound:g}" for relation, bound in bounds if bound is not None)
        raise self.error(f"{dimension.expected}, {wanted} {dimension.si}".rstrip())

    def integer(self, *, least: int, most: int) -> int:
        """Return a whole number without a unit.

        The number must lie from ``least`` to ``most``.
        """
        expected = f"a whole number from {least} to {most}"
        text = self.scalar(expected).strip()
        if not _INTEGER.fullmatch(text) or not least <= int(text) <= most:
            raise self.error(expected)
        return int(text)

    def choice(self, choices: type[E]) -> E:
        """Return the member of an enumeration whose value is the field's text."""
        return self.one_of({str(member.value): member for member in choices})

    def one_of(self, choices: dict[str, V]) -> V:
        """Return the value in ``choices`` whose key is the field's text."""
        names = list(choices)
        expected = names[0] if len(names) == 1 else f"{', '.join(names[:-1])} or {names[-1]}"
        text = self.scalar(expected)
        if text not in names:
            raise self.error(expected, hint=near_miss(text, names))
        return choices[text]

    def sentence(self, expected: str) -> str:
        """Return one line of printable characters: a name, or a sentence for a later parser."""
        text = self.scalar(expected)
        if not is_sentence(text):
            raise self.error(f"{expected}: {SENTENCE}")
        return text

    def prose(self, expected: str, *, lines: bool = False) -> str:
        """Return a text for people, in any script and without control characters.

        The text must be on one line unless ``lines`` is True.
        """
        text = self.scalar(expected)
        for character in text:
            category = unicodedata.category(character)
            if category in ("Cc", "Cs", "Zl", "Zp") and not (lines and character == "\n"):
                raise self.error(expected, got=f"a text with the character U+{ord(character):04X}")
        return text

    def items(
        self, expected: str, *, count: int | None = None, least: int = 0, most: int | None = None
    ) -> tuple[Field, ...]:
        """Return the members of a list.

        The list must have exactly ``count`` members if ``count`` is given, and otherwise from ``least`` to
        ``most`` members.
        """
        if not isinstance(self.node, Sequence):
            raise self.error(expected)
        length = len(self.node.items)
        if (count is not None and length != count) or length < least or (most is not None and length > most):
            raise self.error(expected)
        return tuple(
            Field(node, self.file, f"{self.path}[{index}]", node.line, node.file)
            for index, node in enumerate(self.node.items)
        )

    def entries(self, expected: str) -> tuple[tuple[str, Field], ...]:
        """Return the keys and values of a mapping in which any key is allowed."""
        if not isinstance(self.node, Mapping):
            raise self.error(expected)
        return tuple(
            (key.text, Field(node, self.file, join(self.path, key.text), key.line, key.file))
            for key, node in self.node.entries
        )

    def only_key(self, noun: str, names: abc.Mapping[str, object]) -> str:
        """Return the key of a mapping that is among ``names``.

        The mapping must have exactly one such key, which determines the kind of object that the mapping
        describes.
        """
        listed = ", ".join(names)
        given = [key for key, _ in self.entries(f"a {noun}: a mapping with one of the keys {listed}")]
        chosen = [key for key in given if key in names]
        if len(chosen) != 1:
            hint = near_miss(given[0], names) if given and not chosen else ""
            got = f"the keys {', '.join(map(shown, given))}" if given else "an empty mapping"
            raise self.error(f"one {noun}: one of the keys {listed}", got=got, hint=hint)
        return chosen[0]

    def fields(
        self,
        allowed: tuple[str, ...],
        *,
        hints: dict[str, str] | None = None,
        former: abc.Mapping[str, str] | None = None,
    ) -> Fields:
        """Return the values of a mapping.

        Mistakes in its keys are in the field ``wrong`` of the result.

        Args:
            allowed: The keys that the mapping may have.
            hints: Advice for wrong keys that people are likely to try.
            former: A mapping from the names of keys in earlier releases to their present names.

        """
        given = self.entries(_mapping_with(allowed))
        renamed = {old: new for old, new in (former or {}).items() if new not in dict(given)}
        entries = [(renamed.get(key, key), field) for key, field in given]
        mistakes = list[InputError]()
        for key, field in entries:
            if key not in allowed:
                hint = (hints or {}).get(key) or near_miss(key, allowed)
                expected = f"one of the keys {', '.join(allowed)}"
                mistakes.append(noted(field.error(expected, got=f'the key "{shown(key)}"', hint=hint)))
        return Fields(self, {key: field for key, field in entries if key in allowed}, tuple(mistakes))


def is_meant(key: str, error: InputError) -> bool:
    """Return whether the hint of ``error`` suggests that the user meant ``key``."""
    return f'"{key}"' in error.hint


@lru_cache
def _mapping_with(keys: tuple[str, ...]) -> str:
    """Return the phrase "a mapping with the keys ..." for these keys."""
    return f"a mapping with the keys {', '.join(keys)}"


@dataclass(frozen=True)
class Fields:
    """The values of a mapping by their keys.

    ``wrong`` holds the mistakes that were found in the keys.
    """

    whole: Field
    by_key: dict[str, Field]
    wrong: tuple[InputError, ...] = ()

    def __contains__(self, key: str) -> bool:
        return key in self.by_key

    def __iter__(self) -> Iterator[str]:
        return iter(self.by_key)

    def required(self, key: str, hint: str = "") -> Field:
        """Return the value of ``key``.

        If the key is absent, raise ScenarioError with ``hint``.
        """
        if key not in self.by_key:
            for error in self.wrong:
                if is_meant(key, error):
                    raise error
            present = ", ".join(map(shown, self.by_key))
            place = replace(self.whole.place, field=join(self.whole.path, key))
            got = f"only {present}" if present else "nothing"
            raise ScenarioError(place=place, expected=f'the key "{key}"', got=got, hint=hint)
        return self.by_key[key]

    def optional(self, key: str) -> Field | None:
        """Return the value of ``key``, or None if the key is absent."""
        return self.by_key.get(key)


def walk(field: Field) -> Iterator[Field]:
    """Yield ``field`` and all values below it, in the order of the file."""
    yield field
    below: tuple[Field, ...] = ()
    if isinstance(field.node, Sequence):
        below = field.items("a list")
    elif isinstance(field.node, Mapping):
        below = tuple(child for _, child in field.entries("a mapping"))
    for child in below:
        yield from walk(child)


@dataclass(frozen=True)
class Places(abc.Mapping[str, Place]):
    """The places of all values below ``root``, with the paths of the values as keys.

    The places are computed at the first access, because few scenarios have a mistake.
    """

    root: Field

    @cached_property
    def _by_path(self) -> dict[str, Place]:
        """A mapping from the path of each field to the field's place in the file."""
        return {field.path: field.place for field in walk(self.root) if field.path}

    def __getitem__(self, path: str) -> Place:
        return self._by_path[path]

    def __iter__(self) -> Iterator[str]:
        return iter(self._by_path)

    def __len__(self) -> int:
        return len(self._by_path)
