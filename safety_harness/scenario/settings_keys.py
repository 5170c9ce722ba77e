"""How the settings are written in a scenario file, derived from the dataclasses themselves.

A field's key is its name without the unit and the frame, in plain words: the settings field
``Avoidance.critical_distance_m`` is ``avoidance: {critical distance: 400 mm}``.  Its dimension
follows from the unit at the end of its name, the form of its value from its type.
"""

from __future__ import annotations

import typing
from dataclasses import dataclass, fields, replace
from enum import Enum
from functools import lru_cache
from typing import Any, TypeVar

from safety_harness.scenario.bounds import Bounds, bounds_of
from safety_harness.scenario.decision_times import read_decision_time, write_decision_time
from safety_harness.scenario.fields import Field
from safety_harness.scenario.units import (
    ACCELERATION,
    ANGLE,
    ANGULAR_ACCELERATION,
    ANGULAR_SPEED,
    FRACTION,
    LENGTH,
    NUMBER,
    PER_LENGTH,
    PIXEL_ACCELERATION,
    PIXEL_AREA,
    PIXEL_AREA_RATE,
    PIXEL_SPEED,
    PIXELS,
    RATE,
    SPEED,
    TIME,
    TIME_PER_SPEED,
    Dimension,
    format_quantity,
)
from safety_harness.settings import (
    Avoidance,
    Braking,
    Camera,
    Cell,
    Clock,
    DecisionCost,
    DecisionTimes,
    Hand,
    HandFilter,
    HandSensor,
    Motion,
    Object,
    Servo,
    Vector3,
)

Group = (
    Clock | Cell | Object | Camera | Hand | HandSensor | HandFilter | Servo | Motion | Avoidance | Braking
)  # one dataclass of settings
G = TypeVar("G", bound=Group)
Written = str | dict[str, str]  # a value, or a mapping of values, ready for a file

EVERY_TICK = "every tick"  # how a rate of None is written
_Polygon = tuple[tuple[float, float], ...]

# The longer suffix first: "_per_m" also ends in "_m".
_DIMENSIONS: tuple[tuple[str, Dimension], ...] = (
    ("_probability", FRACTION),
    ("_radps2", ANGULAR_ACCELERATION),
    ("_px2ps", PIXEL_AREA_RATE),
    ("_pxps2", PIXEL_ACCELERATION),
    ("_per_m", PER_LENGTH),
    ("_radps", ANGULAR_SPEED),
    ("_mps2", ACCELERATION),
    ("_s2pm", TIME_PER_SPEED),
    ("_pxps", PIXEL_SPEED),
    ("_px2", PIXEL_AREA),
    ("_mps", SPEED),
    ("_rad", ANGLE),
    ("_px", PIXELS),
    ("_hz", RATE),
    ("_m", LENGTH),
    ("_s", TIME),
)
_FRAMES = ("_in_base", "_in_tcp")
_OF_THE_OBJECT = ("polygon", "position", "yaw")  # keys that stood in the settings of the cell
_MOVED = {f"object {key}": f"object: {{{key}: ...}} at the top of the file" for key in _OF_THE_OBJECT}
_MAPPINGS = ("calibration error",)  # keys that share these first words stand in a mapping of their own


@dataclass(frozen=True, kw_only=True)
class SettingKey:
    """One field of a settings dataclass and how it is written."""

    name: str  # of the dataclass field
    words: tuple[str, ...]  # ("critical distance",), or ("calibration error", "offset")
    dimension: Dimension
    kind: object  # the field's type
    bounds: Bounds  # of the value, or of each of its numbers


def setting_keys(group: type[Any]) -> tuple[SettingKey, ...]:
    """The keys of one settings dataclass, in its order."""
    return _setting_keys(group)  # type: ignore[arg-type]  # a class can be hashed, whatever its instances


@lru_cache
def _setting_keys(group: type[Any]) -> tuple[SettingKey, ...]:
    kinds = typing.get_type_hints(group)
    return tuple(_setting_key(group.__name__, field.name, kinds[field.name]) for field in fields(group))


def _setting_key(group: str, name: str, kind: object) -> SettingKey:
    stem, dimension = name, NUMBER
    for suffix, candidate in _DIMENSIONS:
        if name.endswith(suffix):
            stem, dimension = name.removesuffix(suffix), candidate
            break
    for frame in _FRAMES:
        stem = stem.removesuffix(frame)
    key = stem.replace("_", " ")
    words: tuple[str, ...] = (key,)
    for first in _MAPPINGS:
        if key.startswith(first + " "):
            words = (first, key[len(first) + 1 :])
    several = typing.get_origin(kind) is tuple
    bounds = bounds_of(group, name, dimension, several=several)
    return SettingKey(name=name, words=words, dimension=dimension, kind=kind, bounds=bounds)


def read_group(field: Field, default: G) -> G:
    """``default`` with the values that the mapping ``field`` changes."""
    keys = setting_keys(type(default))
    given = field.fields(tuple(dict.fromkeys(key.words[0] for key in keys)), hints=_MOVED)
    changes: dict[str, Any] = {}
    for first in _MAPPINGS:
        inner = given.optional(first)
        if inner is not None:
            names = {key.words[1]: key for key in keys if key.words[0] == first}
            within = inner.fields(tuple(names))
            for word in within:
                key = names[word]
                changes[key.name] = _read(within.required(word), key, getattr(default, key.name))
    for key in keys:
        value = given.optional(key.words[0])
        if value is not None and len(key.words) == 1:
            changes[key.name] = _read(value, key, getattr(default, key.name))
    return replace(default, **changes)


def write_group(group: Group, default: Group | None) -> dict[str, Written]:
    """The values of ``group`` that differ from ``default``'s (all of them for None), SI, exact."""
    written: dict[str, Written] = {}
    for key in setting_keys(type(group)):
        value = getattr(group, key.name)
        # repr, because a negative zero equals a positive one and is another number all the same.
        if default is not None and repr(getattr(default, key.name)) == repr(value):
            continue
        if isinstance(value, DecisionCost | DecisionTimes):
            written |= {key.words[0]: write_decision_time(value)}
            continue
        text = _write(value, key.dimension)
        if len(key.words) == 1:
            written[key.words[0]] = text
        else:
            inner = written.setdefault(key.words[0], {})
            assert isinstance(inner, dict)
            inner[key.words[1]] = text
    return written


def write_vector(values: tuple[float, ...], dimension: Dimension) -> str:
    """A flow list of quantities: ``[0.1 m, 0.0 m, -0.2 m]``."""
    return "[" + ", ".join(format_quantity(value, dimension) for value in values) + "]"


def _read(field: Field, key: SettingKey, default: Any) -> Any:
    kind = key.kind
    if kind == DecisionCost | DecisionTimes:
        return read_decision_time(field)
    if isinstance(kind, type) and issubclass(kind, Enum):
        return field.choice(kind)
    if kind == _Polygon:
        return _read_polygon(field, key)
    if kind in (Vector3, tuple[float, ...]):
        expected = f"a list of {len(default)}, each {key.dimension.expected}"
        return tuple(_read_number(item, key) for item in field.items(expected, count=len(default)))
    if kind is int:
        return _read_count(field, key)
    if kind == float | None and field.scalar(key.dimension.expected).strip() == EVERY_TICK:
        return None
    if kind in (float, float | None):
        return _read_number(field, key)
    raise TypeError(f"settings field {key.name} has a type that a scenario file cannot give: {kind}")


def _read_number(field: Field, key: SettingKey) -> float:
    return field.quantity(key.dimension, least=key.bounds.least, most=key.bounds.most)


def _read_count(field: Field, key: SettingKey) -> int:
    if key.dimension is NUMBER:
        return field.integer(least=int(key.bounds.least), most=int(key.bounds.most))
    value = _read_number(field, key)
    if value != int(value):
        raise field.error(f"a whole {key.dimension.name}")
    return int(value)


def _read_polygon(field: Field, key: SettingKey) -> _Polygon:
    expected = "a list of three to 100 corners, each a list of two lengths such as [40 mm, -30 mm]"
    corners = []
    for corner in field.items(expected, least=3, most=100):
        x, y = corner.items("a corner such as [40 mm, -30 mm]", count=2)
        corners.append((_read_number(x, key), _read_number(y, key)))
    return tuple(corners)


def _write(value: Any, dimension: Dimension) -> str:
    if value is None:
        return EVERY_TICK
    if isinstance(value, Enum):
        return str(value.value)
    if isinstance(value, int):
        return f"{value} {dimension.si}".rstrip()
    if isinstance(value, tuple) and isinstance(value[0], tuple):
        return "[" + ", ".join(write_vector(corner, dimension) for corner in value) + "]"
    if isinstance(value, tuple):
        return write_vector(value, dimension)
    return format_quantity(value, dimension)
