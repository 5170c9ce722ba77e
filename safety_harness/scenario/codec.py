"""One declaration of a field: from it a value is read, written, explained, tabled and put into the schema.

A field of a ``declared`` dataclass, ``speed_mps: float = key("speed", ...)``, says how it is called in a
file, the kind of its value with unit and bounds, what it means, an example and its default.
``table_of`` gathers the keys of one dataclass.  A kind of value ``read``s a ``Field`` (ScenarioError with
its line), ``write``s what reads back to the same bits, and has ``words`` for people.  ``schema`` and
``reference_tables`` make the rest of these.
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

from safety_harness.scenario.fields import LARGEST_ANGLE_RAD, LARGEST_COORDINATE_M, Field, Fields
from safety_harness.scenario.units import ANGLE, FRACTION, LENGTH, NUMBER, Dimension, format_quantity, nice

REQUIRED = "required"
T = TypeVar("T")
# What a file is made of: a value on its line, or a mapping or a list below its key.
Tree: TypeAlias = "str | Mapping[str, Tree] | Sequence[Tree]"
_PLAIN = re.compile(r"[A-Za-z][A-Za-z0-9_./()%-]*(?: [A-Za-z0-9_./()%-]+)*")
_ESCAPES = {'"': '\\"', "\\": "\\\\", "\n": "\\n"}


def scalar_text(text: str) -> str:
    """``text`` as a YAML scalar: bare where nothing in it could be taken for notation."""
    if _PLAIN.fullmatch(text):
        return text
    return '"' + "".join(_ESCAPES.get(c, c if c.isprintable() else f"\\U{ord(c):08x}") for c in text) + '"'


def in_a_line(tree: Tree) -> str | None:
    """A text, a list of texts such as ``[0.1 m, 0.0 m]`` or an empty mapping on one line; None for others."""
    if isinstance(tree, str):
        return tree
    if isinstance(tree, Mapping):
        return None if tree else "{}"
    parts = [None if isinstance(item, Mapping) else in_a_line(item) for item in tree]
    texts = [part for part in parts if part is not None]
    return f"[{', '.join(texts)}]" if len(texts) == len(parts) else None


@dataclass(frozen=True)
class QuantityValue:
    """A number with a unit, within bounds in SI; ``or_word`` may stand in its place, and is None."""

    dimension: Dimension
    above: float | None = None
    least: float | None = None
    most: float | None = None
    whole: bool = False
    or_word: str | None = None

    @property
    def name(self) -> str:
        """``length``; without the bounds."""
        name = self.dimension.name
        if self.whole:
            name = "whole number" if name == "number" else f"{name}, whole"
        return f"{name}, or `{self.or_word}`" if self.or_word else name

    @property
    def words(self) -> str:
        """``length, 1 mm to 2 m``."""
        if self.least is not None and self.most is not None:
            return f"{self.name}, {self.range_words}"
        bounds = (("above", self.above), ("at least", self.least), ("at most", self.most))
        parts = [f"{word} {nice(bound, self.dimension)}" for word, bound in bounds if bound is not None]
        return f"{self.name}, {' and '.join(parts)}" if parts else self.name

    @property
    def range_words(self) -> str:
        """``1 mm to 2 m``, of one that has both bounds."""
        assert self.least is not None
        assert self.most is not None
        return f"{nice(self.least, self.dimension)} to {nice(self.most, self.dimension)}"

    def read(self, field: Field) -> float | None:
        """The number in SI."""
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
        """In SI, exact."""
        if value is None:
            return self.or_word or ""
        return (
            f"{value} {self.dimension.si}".rstrip() if self.whole else format_quantity(value, self.dimension)
        )


@dataclass(frozen=True, kw_only=True)
class _Formed:
    """A value whose ``words`` say of what kind it is, and ``expected`` in those of a message."""

    words: str
    expected: str = ""


@dataclass(frozen=True, kw_only=True)
class Text(_Formed):
    """A text; ``pattern`` is what a schema can tell of it.

    ``reads`` and ``writes`` are for a value of another type than one line that ``expected`` names.
    ``or_mapping``: what we write ourselves may be a mapping in its place.
    """

    pattern: str = ""
    or_mapping: bool = False
    reads: Callable[[Field], Any] | None = None
    writes: Callable[[Any], Any] | None = None

    def read(self, field: Field) -> Any:
        """The text, or what ``reads`` makes of it."""
        return self.reads(field) if self.reads else field.sentence(self.expected)

    def write(self, value: Any) -> Any:
        """A YAML scalar, or what ``writes`` makes of the value."""
        return self.writes(value) if self.writes else scalar_text(str(value))


@dataclass(frozen=True)
class Word:
    """One of a few words: the members of an enumeration, or texts."""

    members: type[Enum] | tuple[str, ...]

    @property
    def options(self) -> tuple[str, ...]:
        """The words."""
        return tuple(str(one.value) if isinstance(one, Enum) else one for one in self.members)

    @property
    def words(self) -> str:
        """``exact, raster or rendered``."""
        *others, last = self.options
        return f"{', '.join(others)} or {last}" if others else last

    def read(self, field: Field) -> Enum:
        """The member of the enumeration."""
        assert isinstance(self.members, type)
        return field.choice(self.members)

    def write(self, value: Enum) -> str:
        """The word."""
        return str(value.value)


@dataclass(frozen=True, kw_only=True)
class Several(_Formed):
    """A list of values of one kind: ``count`` of them, or from ``least`` to ``most``."""

    of: Value
    count: int | None = None
    least: int = 0
    most: int | None = None

    def read(self, field: Field) -> tuple[Any, ...]:
        """The members."""
        items = field.items(self.expected, count=self.count, least=self.least, most=self.most)
        return tuple(self.of.read(item) for item in items)

    def write(self, values: Sequence[Any]) -> list[Tree]:
        """The members' texts or mappings."""
        return [self.of.write(value) for value in values]


@dataclass(frozen=True, kw_only=True)
class Below(_Formed):
    """A mapping with the keys of one of several tables; ``noun`` is what a message calls it.

    Which table is meant is told by its ``told_by``; ``order`` is in which a message lists these.
    ``or_text`` is the pattern of a text that may stand in its place.
    """

    words: str = "mapping"
    tables: tuple[KeyTable, ...]
    noun: str = ""
    order: tuple[str, ...] = ()
    or_text: str = ""

    @cached_property
    def by_key(self) -> Mapping[str, KeyTable]:
        """The tables by the keys that tell them apart."""
        found = {table.told_by: table for table in self.tables}
        return {name: found[name] for name in self.order or found}

    def read(self, field: Field) -> Any:
        """The object that the mapping stands for."""
        one = self.tables[0] if len(self.tables) == 1 else self.by_key[field.only_key(self.noun, self.by_key)]
        return one.read(field)

    def table_of(self, value: object) -> KeyTable:
        """The table by which ``value`` is read and written."""
        several = len(self.tables) > 1
        return next(table for table in self.tables if not several or table.kind is type(value))

    def write(self, value: object) -> dict[str, Tree]:
        """The mapping from which ``value`` is read again."""
        return self.table_of(value).write(value)


@dataclass(frozen=True, kw_only=True)
class FreeKeys(_Formed):
    """A mapping whose keys are the user's own words."""

    words: str = "mapping"
    of: Value
    least: int = 0

    def read(self, field: Field) -> tuple[tuple[str, Field], ...]:
        """The words and what stands below them, still to be read."""
        entries = field.entries(self.expected)
        if len(entries) < self.least:
            raise field.error(self.expected)
        return entries

    def write(self, value: Mapping[str, Any]) -> dict[str, Tree]:
        """The mapping of these values."""
        return {scalar_text(word): self.of.write(one) for word, one in value.items()}


Value = QuantityValue | Text | Word | Several | Below | FreeKeys


@dataclass(frozen=True)
class Key:
    """A key: its name, its value, what it means.

    ``example`` is a value, or lines, as they may stand in a file; without one the default is shown, in
    the mappings ``within``.  ``said`` is for a value that its type cannot say alone, and ``or_else`` for
    a default that the value itself cannot.  ``table_of`` fills in the field of the dataclass,
    ``attribute``, and its default, ``fallback`` (REQUIRED for none).
    """

    name: str
    value: Value
    meaning: str
    example: str = ""
    or_else: str | None = None
    said: str = ""
    attribute: str = ""
    fallback: Any = REQUIRED
    within: tuple[str, ...] = ()

    @property
    def default(self) -> str:
        """As people write it: REQUIRED, a value, or words."""
        if self.or_else is not None:
            return self.or_else
        return REQUIRED if self.fallback is REQUIRED else _nice(self.fallback, self.value)

    @property
    def lines(self) -> str:
        """The example as it may stand in a file."""
        if ": " in self.example and self.example[0] != "{":
            return self.example
        text = f"{self.name}: {self.example or self.default}"
        for name in reversed(self.within):
            text = f"{name}: {{{text}}}"
        return text

    @property
    def path(self) -> tuple[str, ...]:
        """The keys that lead to it: ("critical distance",), or ("calibration error", "offset")."""
        return (*self.within, self.name)

    @property
    def required(self) -> bool:
        """Has it to be there?"""
        return self.fallback is REQUIRED if self.or_else is None else self.or_else == REQUIRED

    @property
    def words(self) -> str:
        """What values it takes, in words."""
        return self.said or self.value.words


@dataclass(frozen=True, kw_only=True)
class KeyTable:
    """The keys of one kind of mapping.  ``name`` is for the page; ``where`` (the same) completes "of ...".

    ``beside`` are the tables of objects, by the fields that hold them, whose keys stand in the same
    mapping: all that are required, or none.
    """

    name: str
    where: str = ""
    keys: tuple[Key, ...]
    kind: type[Any] | None = None  # what is made of the mapping
    path: str = ""  # how it is reached from the top of a file: "settings.avoidance"
    told_by: str = ""  # the key that tells this mapping from its alternatives; its first one by default
    beside: tuple[tuple[str, KeyTable], ...] = ()
    names: tuple[str, ...] = dataclass_field(init=False)  # in the order of a well laid out file

    def __post_init__(self) -> None:
        object.__setattr__(self, "where", self.where or self.name)
        object.__setattr__(self, "told_by", self.told_by or self.keys[0].name)
        object.__setattr__(self, "names", tuple(key.name for key in self.keys))

    def below(self) -> Iterator[KeyTable]:
        """The tables that its values lead to."""
        for key in self.keys:
            yield from _tables(key.value)

    def name_of(self, attribute: str) -> str:
        """The key of a field of the dataclass."""
        return next(key.name for key in self.keys if key.attribute == attribute)

    def read(self, field: Field) -> Any:
        """The object that the mapping ``field`` stands for."""
        return self.made_of(field.fields(self.names))

    def made_of(self, given: Fields) -> Any:
        """The object with the values of the keys that are given."""
        assert self.kind is not None
        return self.kind(**self.values(given))

    def values(self, given: Fields) -> dict[str, Any]:
        """What the keys of a mapping give, by the names of the dataclass's fields; defaults elsewhere."""
        found: dict[str, Any] = {}
        for key in self.keys:
            field = given.optional(key.name)
            if not key.attribute:
                continue
            if field is not None or key.required:
                found[key.attribute] = key.value.read(
                    field or given.required(key.name, f"safety-harness explain {key.name}")
                )
            elif key.fallback is not REQUIRED:
                found[key.attribute] = key.fallback
        for attribute, table in self.beside:
            if any(name in given for name in table.names):
                found[attribute] = table.made_of(given)
        return found

    def write(self, value: object) -> dict[str, Tree]:
        """The keys and values from which ``read`` gives ``value`` again; what is None is left out."""
        written = {
            key.name: key.value.write(found)
            for key in self.keys
            if key.attribute and (found := getattr(value, key.attribute, None)) is not None
        }
        for attribute, table in self.beside:
            inner = getattr(value, attribute)
            written |= {} if inner is None else table.write(inner)
        return written


def key(
    name: str,
    value: Value,
    meaning: str,
    example: str = "",
    or_else: str | None = None,
    *,
    said: str = "",
    default: Any = MISSING,
) -> Any:
    """A field of a ``declared`` dataclass with its ``Key``."""
    return keyed(Key(name, value, meaning, example, or_else, said), default=default)


def keyed(said: Key | KeyTable, *, default: Any = MISSING) -> Any:
    """A field of a ``declared`` dataclass: its key, or the table of the object whose keys stand beside."""
    return dataclass_field(default=default, metadata={"said": said})


@typing.dataclass_transform(frozen_default=True, kw_only_default=True, field_specifiers=(key, keyed))
def declared(kind: type[T]) -> type[T]:
    """A frozen dataclass of keywords, for fields that have keys."""
    return dataclass(frozen=True, kw_only=True)(kind)


def table_of(kind: type[Any], name: str, **of_table: Any) -> KeyTable:
    """The table of a ``declared`` dataclass."""
    keys: list[Key] = []
    beside: list[tuple[str, KeyTable]] = []
    for one in fields(kind):
        said = one.metadata.get("said")
        if isinstance(said, Key):
            fallback = REQUIRED if one.default is MISSING else one.default
            keys.append(replace(said, attribute=one.name, fallback=fallback))
        elif isinstance(said, KeyTable):
            beside.append((one.name, said))
            keys += [replace(key, attribute="", or_else="none") for key in said.keys]
    return KeyTable(name=name, keys=tuple(keys), kind=kind, beside=tuple(beside), **of_table)


def _nice(value: Any, kind: Value) -> str:
    """A default as people write it."""
    if isinstance(value, Enum):
        return str(value.value)
    if value is None:
        return getattr(kind, "or_word", None) or "none"
    if isinstance(kind, Several):
        return f"[{', '.join(_nice(one, kind.of) for one in value)}]"
    if not isinstance(kind, QuantityValue):
        return str(value or "none")
    if value == 0.0 and kind.dimension is LENGTH:
        return "0 mm"  # as its neighbours in a list
    if kind.dimension is FRACTION:
        return f"{100 * value:g} %"
    return f"{value} {kind.dimension.si}".rstrip() if kind.whole else nice(value, kind.dimension)


def _tables(value: Value) -> Iterator[KeyTable]:
    """The tables that a value leads to."""
    if isinstance(value, Below):
        for table in value.tables:
            yield table
            yield from table.below()
    elif isinstance(value, Several | FreeKeys):
        yield from _tables(value.of)


def vector_of(dimension: Dimension, form: str, most: float) -> Several:
    """Three quantities, none larger than ``most`` either way."""
    number = QuantityValue(dimension, least=-most, most=most)
    return Several(of=number, words=form, expected=f"a list of three, each {dimension.expected}", count=3)


TURN = QuantityValue(ANGLE, least=-LARGEST_ANGLE_RAD, most=LARGEST_ANGLE_RAD)
POINT = vector_of(LENGTH, "point", LARGEST_COORDINATE_M)  # in the base frame, or a shift
ROTATION = vector_of(ANGLE, "rotation", LARGEST_ANGLE_RAD)
