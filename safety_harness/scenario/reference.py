"""What each key of a scenario file means: the one table behind the documentation, ``explain`` and the schema.

A ``Key`` has a typed value, a default, a meaning and an example; a ``KeyTable`` is the keys of one
mapping.  The tables themselves are in ``reference_tables`` and ``reference_settings``.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from fractions import Fraction

from safety_harness.exceptions import Place
from safety_harness.scenario.fields import LARGEST_ANGLE_RAD, LARGEST_COORDINATE_M
from safety_harness.scenario.units import ANGLE, LENGTH, Dimension, parse_quantity

REQUIRED = "required"
_RARE = ("cm", "/cm", "mrad", "min", "km/h", "kHz")  # understood, and not what we write ourselves


@dataclass(frozen=True, kw_only=True)
class QuantityValue:
    """A number with a unit, within bounds in SI; ``or_word`` may stand in its place."""

    dimension: Dimension
    above: float | None = None
    least: float | None = None
    most: float | None = None
    whole: bool = False
    or_word: str | None = None

    @property
    def words(self) -> str:
        """``length, 1 mm to 2 m``."""
        name = self.dimension.name
        if self.whole:
            name = "whole number" if name == "number" else f"{name}, whole"
        if self.or_word:
            name += f", or `{self.or_word}`"
        return name + _bounds(self.dimension, self.above, self.least, self.most)


@dataclass(frozen=True, kw_only=True)
class Text:
    """A text: ``form`` says of what kind; ``pattern`` is what a schema can tell of it.

    ``or_mapping``: what we write ourselves may be a mapping in its place.
    """

    form: str
    pattern: str = ""
    or_mapping: bool = False

    @property
    def words(self) -> str:
        """As written."""
        return self.form


@dataclass(frozen=True, kw_only=True)
class Word:
    """One of a few words."""

    options: tuple[str, ...]

    @property
    def words(self) -> str:
        """``exact, raster or rendered``."""
        *others, last = self.options
        return f"{', '.join(others)} or {last}" if others else last


@dataclass(frozen=True, kw_only=True)
class Several:
    """A list of values of one kind: ``count`` of them, or from ``least`` to ``most``."""

    of: Value
    form: str
    count: int | None = None
    least: int = 0
    most: int | None = None

    @property
    def words(self) -> str:
        """As written."""
        return self.form


@dataclass(frozen=True, kw_only=True)
class Below:
    """A mapping with the keys of one of several tables."""

    tables: tuple[KeyTable, ...]
    form: str = "mapping"

    @property
    def words(self) -> str:
        """As written."""
        return self.form


@dataclass(frozen=True, kw_only=True)
class FreeKeys:
    """A mapping whose keys are the user's own words."""

    of: Value
    form: str
    least: int = 0

    @property
    def words(self) -> str:
        """As written."""
        return self.form


Value = QuantityValue | Text | Word | Several | Below | FreeKeys


@dataclass(frozen=True, kw_only=True)
class Key:
    """A key: its value, its default as people write it (REQUIRED, or words), what it means.

    ``example`` are lines as they may stand in a file; ``said`` is for a value that its type cannot
    say alone.
    """

    name: str
    value: Value
    default: str
    meaning: str
    example: str = ""
    said: str = ""

    @property
    def words(self) -> str:
        """What values it takes, in words."""
        return self.said or self.value.words


@dataclass(frozen=True, kw_only=True)
class KeyTable:
    """The keys of one kind of mapping.  ``where`` completes "the key ... of"; ``name`` is for the page."""

    name: str
    where: str
    keys: tuple[Key, ...]
    path: str = ""  # how it is reached from the top of a file: "settings.avoidance"
    told_by: str = ""  # the key that tells this mapping from its alternatives; its first one by default
    required: tuple[str, ...] = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "told_by", self.told_by or self.keys[0].name)
        object.__setattr__(self, "required", tuple(k.name for k in self.keys if k.default == REQUIRED))

    @property
    def names(self) -> tuple[str, ...]:
        """The keys in their order, which is the order of a well laid out file."""
        return tuple(key.name for key in self.keys)


def below(value: Value) -> Iterator[KeyTable]:
    """The tables that a value leads to."""
    if isinstance(value, Below):
        for table in value.tables:
            yield table
            for key in table.keys:
                yield from below(key.value)
    elif isinstance(value, Several | FreeKeys):
        yield from below(value.of)


def markdown(table: KeyTable) -> str:
    """The table as a page shows it; keys of an inner mapping follow the key that they stand below."""
    rows = ["| key | value | default | meaning |", "|---|---|---|---|"]
    for key in table.keys:
        rows.append(f"| `{key.name}` | {key.words} | {key.default} | {key.meaning} |")
        for inner in (
            key.value.tables if isinstance(key.value, Below) and not key.value.tables[0].path else ()
        ):
            rows += [
                f"| `{key.name}`: `{one.name}` | {one.words} | {one.default} | {one.meaning} |"
                for one in inner.keys
            ]
    return _joined(rows)


def markdown_of_moves(moves: tuple[KeyTable, ...]) -> str:
    """The moves as a page shows them, one row for each with its further keys."""
    rows = ["| move | further keys | meaning |", "|---|---|---|"]
    for table in moves:
        named, *further = (f"`{key.name}` ({_kind(key.value)})" for key in table.keys)
        rows.append(f"| {named} | {', '.join(further)} | {table.keys[0].meaning} |")
    return _joined(rows)


def _joined(rows: list[str]) -> str:
    return "\n".join(rows).replace("|  |", "| |") + "\n"


def _kind(value: Value) -> str:
    return value.dimension.name if isinstance(value, QuantityValue) else value.words


def nice(value: float, dimension: Dimension) -> str:
    """``value`` in the unit that people would take; it reads back to the same float."""
    if not dimension.units:
        return _digits(value)
    units = [unit for unit in dimension.units if not unit.startswith(_RARE)]
    units.sort(key=lambda unit: unit != "deg")
    written = [f"{_digits(_in_unit(value, dimension.units[unit]))} {unit}" for unit in units]
    exact = [text for text in written if parse_quantity(text, dimension, Place()) == value]
    size = {text: abs(float(text.split()[0])) for text in exact}
    handy = [text for text in exact if 1.0 <= size[text] < 1000.0]
    short = [text for text in exact if size[text] >= 0.01]
    return next(iter(handy + short + exact), f"{value!r} {dimension.si}")


def _in_unit(value: float, factor: Fraction | None) -> float:
    return math.degrees(value) if factor is None else float(Fraction(value) / factor)


def _digits(value: float) -> str:
    return f"{value:.12g}".replace("e-0", "e-")


def _bounds(dimension: Dimension, above: float | None, least: float | None, most: float | None) -> str:
    if least is not None and most is not None:
        return f", {nice(least, dimension)} to {nice(most, dimension)}"
    parts = [
        f"{word} {nice(bound, dimension)}"
        for word, bound in (("above", above), ("at least", least), ("at most", most))
        if bound is not None
    ]
    return f", {' and '.join(parts)}" if parts else ""


def key_of(name: str, value: Value, default: str, meaning: str, example: str, said: str = "") -> Key:
    """A key in one line."""
    return Key(name=name, value=value, default=default, meaning=meaning, example=example, said=said)


_COORDINATE = QuantityValue(dimension=LENGTH, least=-LARGEST_COORDINATE_M, most=LARGEST_COORDINATE_M)
TURN = QuantityValue(dimension=ANGLE, least=-LARGEST_ANGLE_RAD, most=LARGEST_ANGLE_RAD)
POINT = Several(of=_COORDINATE, form="point", count=3)
ROTATION = Several(of=TURN, form="rotation", count=3)
