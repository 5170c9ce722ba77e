"""Declare the fields of files.

One declaration of a field serves several uses. The uses are reading, writing, explaining, tables and the
schema. A field of a ``declared`` dataclass declares its name in a file, its kind of value, its meaning, an
example and its default. The kind of value includes the unit and the bounds. An example is ``speed_mps: float
= key("speed", ...)``. ``table_of`` gathers the keys of a dataclass.

A kind of value has three members. A field of a ``declared`` dataclass declares the name that the field has in
a file, the kind of its value, its meaning, an example and its default. ``write`` returns a text from which
``read`` returns exactly the same value. ``kind`` describes the value for people. The modules ``schema`` and
``reference_tables`` use these members.
"""

from __future__ import annotations

import re
import typing
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import MISSING, dataclass, fields, replace
from dataclasses import field as dataclass_field
from enum import Enum
from functools import cached_property
from typing import Any, TypeAlias, TypeVar

from safety_harness.scenario.fields import LARGEST_ANGLE_RAD, LARGEST_COORDINATE_M, Field, Fields, each
from safety_harness.scenario.units import ANGLE, FRACTION, LENGTH, NUMBER, Dimension, format_quantity, nice

REQUIRED = "required"
T = TypeVar("T")
# The content of a file: a value on its key's line, or a mapping or a list below the key.
Tree: TypeAlias = "str | Mapping[str, Tree] | Sequence[Tree]"
_PLAIN = re.compile(r"[A-Za-z][A-Za-z0-9_./()%-]*(?: [A-Za-z0-9_./()%-]+)*")
_ESCAPES = {'"': '\\"', "\\": "\\\\", "\n": "\\n"}
_UNESCAPED = {escape: character for character, escape in _ESCAPES.items()}
_ESCAPED = re.compile(r'\\(?:["\\n]|U[0-9a-f]{8})')


def scalar_text(text: str) -> str:
    """Return ``text`` as a YAML scalar.

    The scalar is in quotes if YAML could interpret any part of the text as YAML syntax.
    """
    if _PLAIN.fullmatch(text):
        return text
    return '"' + "".join(_ESCAPES.get(c, c if c.isprintable() else f"\\U{ord(c):08x}") for c in text) + '"'


def plain_text(scalar: str) -> str:
    """Return the text that ``scalar_text`` has converted into ``scalar``."""
    if not scalar.startswith('"'):
        return scalar
    return _ESCAPED.sub(lambda escape: _UNESCAPED.get(escape[0]) or chr(int(escape[0][2:], 16)), scalar[1:-1])


def in_a_line(tree: Tree) -> str | None:
    """Return ``tree`` written on one line, or None if it needs several lines."""
    if isinstance(tree, str):
        return tree
    if isinstance(tree, Mapping):
        return None if tree else "{}"
    parts = [None if isinstance(item, Mapping) else in_a_line(item) for item in tree]
    texts = [part for part in parts if part is not None]
    return f"[{', '.join(texts)}]" if len(texts) == len(parts) else None


@dataclass(frozen=True)
class QuantityValue:
    """A kind of value: a number with a unit.

    The bounds of the number are in SI. A file may contain the word ``or_word`` instead of the number; the
    value is then None.
    """

    dimension: Dimension
    above: float | None = None
    least: float | None = None
    most: float | None = None
    whole: bool = False
    or_word: str | None = None

    @property
    def name(self) -> str:
        """The kind without the bounds: ``length``."""
        name = self.dimension.name
        if self.whole:
            name = "whole number" if name == "number" else f"{name}, whole"
        return f"{name}, or `{self.or_word}`" if self.or_word else name

    @property
    def kind(self) -> str:
        """The kind with the bounds: ``length, 1 mm to 2 m``."""
        if self.least is not None and self.most is not None:
            return f"{self.name}, {self.range_words}"
        bounds = (("above", self.above), ("at least", self.least), ("at most", self.most))
        parts = [f"{side} {nice(bound, self.dimension)}" for side, bound in bounds if bound is not None]
        return f"{self.name}, {' and '.join(parts)}" if parts else self.name

    @property
    def range_words(self) -> str:
        """The bounds alone, such as ``1 mm to 2 m``.

        The value must have a lower and an upper bound.
        """
        assert self.least is not None
        assert self.most is not None
        return f"{nice(self.least, self.dimension)} to {nice(self.most, self.dimension)}"

    def read(self, field: Field) -> float | None:
        """Return the number in SI, or None for ``or_word``."""
        if self.or_word and field.scalar(self.dimension.expected).strip() == self.or_word:
            return None
        if self.whole and self.dimension is NUMBER:
            assert self.least is not None
            assert self.most is not None
            return field.integer(least=int(self.least), most=int(self.most))
        value = field.quantity(self.dimension, above=self.above, least=self.least, most=self.most)
        if self.whole and value != int(value):
            raise field.error(f"a whole {self.dimension.name}")
        return int(value) if self.whole else value

    def write(self, value: float | None) -> str:
        """Return the SI number ``value`` as text, from which ``read`` returns the same number."""
        if value is None:
            return self.or_word or ""
        return (
            f"{value} {self.dimension.si}".rstrip() if self.whole else format_quantity(value, self.dimension)
        )


@dataclass(frozen=True, kw_only=True)
class _Formed:
    """A kind of value with the description ``kind``.

    The phrase ``expected`` is for messages.
    """

    kind: str
    expected: str = ""


@dataclass(frozen=True, kw_only=True)
class Text(_Formed):
    """A text, or another value that a file contains as text.

    Args:
        kind: The kind of value, for people.
        expected: Completes "expected ..." of a message.
        pattern: The pattern for the schema.
        or_mapping: Whether ``write`` may return a mapping instead of a text.
        reads: The function that reads a value that is not a text. None means that the value is one line of
            text.
        writes: The function that writes a value that is not a text. None means that the value becomes a YAML
            scalar.

    """

    pattern: str = ""
    or_mapping: bool = False
    reads: Callable[[Field], Any] | None = None
    writes: Callable[[Any], Any] | None = None

    def read(self, field: Field) -> Any:
        """Return the text of the field, or the result of ``reads``."""
        return self.reads(field) if self.reads else field.sentence(self.expected)

    def write(self, value: Any) -> Any:
        """Return the value as a YAML scalar, or the result of ``writes``."""
        return self.writes(value) if self.writes else scalar_text(str(value))


@dataclass(frozen=True)
class Word:
    """A choice among a few words, which are the members of an enumeration or given texts."""

    members: type[Enum] | tuple[str, ...]

    @property
    def options(self) -> tuple[str, ...]:
        """The words."""
        return tuple(str(member.value) if isinstance(member, Enum) else member for member in self.members)

    @property
    def kind(self) -> str:
        """The options as a phrase, such as ``exact, raster or rendered``."""
        *first, last = self.options
        return f"{', '.join(first)} or {last}" if first else last

    def read(self, field: Field) -> Enum:
        """Return the member of the enumeration whose word the field contains."""
        assert isinstance(self.members, type)
        return field.choice(self.members)

    def write(self, value: Enum) -> str:
        """Return the word of the enumeration's member ``value``."""
        return str(value.value)


@dataclass(frozen=True, kw_only=True)
class Several(_Formed):
    """A list of values of one kind.

    The list must have exactly ``count`` values; without ``count``, it must have from ``least`` to ``most``
    values.
    """

    of: Value
    count: int | None = None
    least: int = 0
    most: int | None = None

    def read(self, field: Field) -> tuple[Any, ...]:
        """Return the values of the list in ``field``."""
        items = field.items(self.expected, count=self.count, least=self.least, most=self.most)
        return tuple(each(self.of.read, items))

    def write(self, values: Sequence[Any]) -> list[Tree]:
        """Return a list with the text or the mapping that a file contains for each of ``values``."""
        return [self.of.write(value) for value in values]


@dataclass(frozen=True, kw_only=True)
class Below(_Formed):
    """A mapping whose keys belong to one of several tables.

    Args:
        kind: The kind of value, for people.
        expected: Completes "expected ..." of a message.
        tables: The possible tables. A mapping belongs to a table if it has the key ``told_by`` of this table.
        noun: The name of such a mapping in messages.
        order: The order in which messages list the identifying keys. An empty order means the order of
            ``tables``.
        or_text: The pattern of a text that a file may contain instead of the mapping.

    """

    kind: str = "mapping"
    tables: tuple[KeyTable, ...]
    noun: str = ""
    order: tuple[str, ...] = ()
    or_text: str = ""

    @cached_property
    def by_key(self) -> Mapping[str, KeyTable]:
        """The tables, each under the key that identifies its mappings."""
        tables = {table.told_by: table for table in self.tables}
        return {name: tables[name] for name in self.order or tables}

    def read(self, field: Field) -> Any:
        """Return the object that the mapping ``field`` describes."""
        own = self.tables[0] if len(self.tables) == 1 else self.by_key[field.only_key(self.noun, self.by_key)]
        return own.read(field)

    def table_of(self, value: object) -> KeyTable:
        """Return the table that reads and writes ``value``."""
        several = len(self.tables) > 1
        return next(table for table in self.tables if not several or table.kind is type(value))

    def write(self, value: object) -> dict[str, Tree]:
        """Return the mapping from which ``read`` returns ``value``."""
        return self.table_of(value).write(value)


@dataclass(frozen=True, kw_only=True)
class FreeKeys(_Formed):
    """A mapping whose keys are the user's own words."""

    kind: str = "mapping"
    of: Value
    least: int = 0

    def read(self, field: Field) -> tuple[tuple[str, Field], ...]:
        """Return pairs (word, field).

        The user has chosen the words, and each field is the value under its word. The caller still has to
        read the fields.
        """
        entries = field.entries(self.expected)
        if len(entries) < self.least:
            raise field.error(self.expected)
        return entries

    def write(self, mapping: Mapping[str, Any]) -> dict[str, Tree]:
        """Return the mapping in the form that a file contains, with the user's words as keys."""
        return {scalar_text(name): self.of.write(value) for name, value in mapping.items()}


Value = QuantityValue | Text | Word | Several | Below | FreeKeys


@dataclass(frozen=True)
class Key:
    """A key of a file: its name, its kind of value and its meaning.

    Args:
        name: The name in a file.
        value: The kind of value.
        meaning: The meaning, for people.
        example: A value or lines, as in a file. If this text is empty, the default serves as the example.
        or_else: A text that describes the default. None means that ``fallback`` is the default.
        said: A description of the kind of value, if ``value`` cannot provide it.
        former: The name in earlier releases, which files may still use. It is empty if the name never
            changed.
        attribute: The name of the dataclass's field. The function ``table_of`` sets it.
        fallback: The default of that field, which ``table_of`` also fills in; REQUIRED if the field has no
            default.
        within: The keys of the mappings that surround this key in the example.

    """

    name: str
    value: Value
    meaning: str
    example: str = ""
    or_else: str | None = None
    said: str = ""
    former: str = ""
    attribute: str = ""
    fallback: Any = REQUIRED
    within: tuple[str, ...] = ()

    @property
    def default(self) -> str:
        """The default in the form in which people would write it.

        It is REQUIRED, a value, or a description.
        """
        if self.or_else is not None:
            return self.or_else
        return REQUIRED if self.fallback is REQUIRED else _nice(self.fallback, self.value)

    @property
    def lines(self) -> str:
        """The example as lines that a file may contain."""
        if ": " in self.example and self.example[0] != "{":
            return self.example
        text = f"{self.name}: {self.example or self.default}"
        for name in reversed(self.within):
            text = f"{name}: {{{text}}}"
        return text

    @property
    def path(self) -> tuple[str, ...]:
        """The keys from the table's mapping to this key, such as ("calibration error", "offset")."""
        return (*self.within, self.name)

    @property
    def required(self) -> bool:
        """Whether a file must have the key."""
        return self.fallback is REQUIRED if self.or_else is None else self.or_else == REQUIRED

    @property
    def kind(self) -> str:
        """The values that the key accepts, in words."""
        return self.said or self.value.kind


@dataclass(frozen=True, kw_only=True)
class KeyTable:
    """The keys of one kind of mapping.

    Args:
        name: The name for the page.
        where: A text that completes "of ..." in messages. An empty text means ``name``.
        keys: The keys.
        kind: The dataclass of such a mapping.
        path: The keys from the top of a file to the mapping, such as "settings.avoidance".
        told_by: The key that identifies this mapping among its alternatives. If it is empty, the first key
            identifies the mapping.
        beside: Tables of inner objects, each under the name of the field that holds the object. A file gives
            the keys of an inner object in the same mapping, and gives all required keys or none.

    """

    name: str
    where: str = ""
    keys: tuple[Key, ...]
    kind: type[Any] | None = None  # the class of the object that the mapping describes
    path: str = ""  # the keys from the top of a file, such as "settings.avoidance"
    told_by: str = ""  # the key that identifies this mapping; the first key by default
    beside: tuple[tuple[str, KeyTable], ...] = ()
    names: tuple[str, ...] = dataclass_field(init=False)  # in the order of a well laid out file
    former: Mapping[str, str] = dataclass_field(
        init=False, compare=False
    )  # today's names by those of earlier releases

    def __post_init__(self) -> None:
        object.__setattr__(self, "where", self.where or self.name)
        object.__setattr__(self, "told_by", self.told_by or self.keys[0].name)
        object.__setattr__(self, "names", tuple(key.name for key in self.keys))
        former = {key.former: key.name for key in self.keys if key.former}
        object.__setattr__(self, "former", former)

    def below(self) -> Iterator[KeyTable]:
        """Yield the tables of the mappings that the values of the table's keys may contain."""
        for key in self.keys:
            yield from _tables(key.value)

    def name_of(self, attribute: str) -> str:
        """Return the name that files use for the dataclass's field ``attribute``."""
        return next(key.name for key in self.keys if key.attribute == attribute)

    def read(self, field: Field) -> Any:
        """Return the object that the mapping ``field`` describes."""
        return self.made_of(field.fields(self.names, former=self.former))

    def made_of(self, given: Fields) -> Any:
        """Return the object that the keys in ``given`` describe, with defaults for all other keys."""
        assert self.kind is not None
        return self.kind(**self.values(given))

    def values(self, given: Fields) -> dict[str, Any]:
        """Return the values in ``given``, with the names of the dataclass's fields as keys.

        If ``given`` lacks a key, the result has the default of the key.
        """

        def pair(key: Key) -> tuple[str, Any]:
            field = given.optional(key.name)
            if field is None and not key.required:
                return key.attribute, key.fallback
            field = field or given.required(key.name, f"safety-harness explain {key.name}")
            return key.attribute, key.value.read(field)

        own = (key for key in self.keys if key.attribute)
        read_values = {name: value for name, value in each(pair, own) if value is not REQUIRED}
        if given.wrong:
            raise given.wrong[0]
        for attribute, table in self.beside:
            if any(name in given for name in table.names):
                read_values[attribute] = table.made_of(given)
        return read_values

    def write(self, value: object) -> dict[str, Tree]:
        """Return the keys and texts that ``read`` converts into ``value``.

        A field with the value None gets no key.
        """
        written = {
            key.name: key.value.write(inner)
            for key in self.keys
            if key.attribute and (inner := getattr(value, key.attribute, None)) is not None
        }
        for attribute, table in self.beside:
            beside_value = getattr(value, attribute)
            written |= {} if beside_value is None else table.write(beside_value)
        return written


def key(
    name: str,
    value: Value,
    meaning: str,
    example: str = "",
    or_else: str | None = None,
    *,
    values_text: str = "",
    former: str = "",
    default: Any = MISSING,
) -> Any:
    """Return a field of a ``declared`` dataclass.

    The arguments are those of ``Key``.
    """
    return keyed(Key(name, value, meaning, example, or_else, values_text, former), default=default)


def keyed(declaration: Key | KeyTable, *, default: Any = MISSING) -> Any:
    """Return a field of a ``declared`` dataclass from an existing key.

    Args:
        declaration: The key of the field. If the field is an object whose keys stand in the same mapping, it
            is the object's table.
        default: The default of the field; MISSING: the key is required.

    """
    return dataclass_field(default=default, metadata={"said": declaration})


@typing.dataclass_transform(frozen_default=True, kw_only_default=True, field_specifiers=(key, keyed))
def declared(kind: type[T]) -> type[T]:
    """Return the class ``kind`` as a frozen dataclass that accepts keywords only."""
    return dataclass(frozen=True, kw_only=True)(kind)


def table_of(kind: type[Any], name: str, **of_table: Any) -> KeyTable:
    """Return the table of a ``declared`` dataclass.

    Args:
        kind: The dataclass.
        name: The name of the table.
        **of_table: Further arguments of ``KeyTable``.

    """
    keys: list[Key] = []
    beside: list[tuple[str, KeyTable]] = []
    for column in fields(kind):
        declaration = column.metadata.get("said")
        if isinstance(declaration, Key):
            fallback = REQUIRED if column.default is MISSING else column.default
            keys.append(replace(declaration, attribute=column.name, fallback=fallback))
        elif isinstance(declaration, KeyTable):
            beside.append((column.name, declaration))
            keys += [replace(key, attribute="", or_else="none") for key in declaration.keys]
    return KeyTable(name=name, keys=tuple(keys), kind=kind, beside=tuple(beside), **of_table)


def _nice(value: Any, kind: Value) -> str:
    """Return the default ``value`` in the form in which people would write it."""
    if isinstance(value, Enum):
        return str(value.value)
    if value is None:
        return getattr(kind, "or_word", None) or "none"
    if isinstance(kind, Several):
        return f"[{', '.join(_nice(part, kind.of) for part in value)}]"
    if not isinstance(kind, QuantityValue):
        return str(value or "none")
    if value == 0.0 and kind.dimension is LENGTH:
        return "0 mm"  # as its neighbours in a list
    if kind.dimension is FRACTION:
        return f"{100 * value:g} %"
    return f"{value} {kind.dimension.si}".rstrip() if kind.whole else nice(value, kind.dimension)


def _tables(value: Value) -> Iterator[KeyTable]:
    """Yield the tables of the mappings that the kind ``value`` allows."""
    if isinstance(value, Below):
        for table in value.tables:
            yield table
            yield from table.below()
    elif isinstance(value, Several | FreeKeys):
        yield from _tables(value.of)


def vector_of(dimension: Dimension, form: str, most: float) -> Several:
    """Return the kind of value for a list of three quantities, each from -``most`` to ``most``."""
    number = QuantityValue(dimension, least=-most, most=most)
    return Several(of=number, kind=form, expected=f"a list of three, each {dimension.expected}", count=3)


TURN = QuantityValue(ANGLE, least=-LARGEST_ANGLE_RAD, most=LARGEST_ANGLE_RAD)
POINT = vector_of(LENGTH, "point", LARGEST_COORDINATE_M)  # in the base frame, or a shift
ROTATION = vector_of(ANGLE, "rotation", LARGEST_ANGLE_RAD)
