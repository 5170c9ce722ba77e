"""How the settings are written in a scenario file, derived from the dataclasses themselves.

What they mean and their own bounds stand beside the fields, in ``settings``.  A field's key is its
name without the unit and the frame, in plain words: the settings field ``Avoidance.critical_distance_m``
is ``avoidance: {critical distance: 400 mm}``.  Its dimension follows from the unit at the end of its
name, the form of its value from the type of its default.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from enum import Enum
from functools import lru_cache
from typing import TYPE_CHECKING, Any, TypeVar

from safety_harness.scenario.codec import (
    Below,
    Key,
    KeyTable,
    QuantityValue,
    Several,
    Text,
    Tree,
    Value,
    Word,
)
from safety_harness.scenario.decision_times import FORM, read_decision_time, write_decision_time
from safety_harness.scenario.fields import LARGEST_ANGLE_RAD, LARGEST_COORDINATE_M, Field
from safety_harness.scenario.units import ANGLE, DIMENSIONS, LENGTH
from safety_harness.settings import DEFAULTS, DecisionCost, Described, Settings

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

G = TypeVar("G", bound="DataclassInstance")  # one dataclass of settings

EVERY_TICK = "every tick"  # how a rate of None is written

# The longer suffix first: "_per_m" also ends in "_m".
_BY_SUFFIX = sorted(DIMENSIONS, key=lambda dimension: -len(dimension.suffix))
# The three groups of settings that have a key of their own at the top.
TOP_GROUPS = {"object": "object", "hand sensor": "hand_sensor", "camera": "camera"}
SETTINGS_KEYS = {
    field.name.replace("_", " "): field.name
    for field in fields(Settings)
    if field.name not in TOP_GROUPS.values()
}
_FRAMES = (" in base", " in tcp")
_OF_THE_OBJECT = ("polygon", "position", "yaw")  # keys that stood in the settings of the cell
_MOVED = {f"object {key}": f"object: {{{key}: ...}} at the top of the file" for key in _OF_THE_OBJECT}
# Keys that share these first words stand in a mapping of their own: what it means, and an example.
_MAPPINGS = {
    "calibration error": (
        "what the controller believes wrongly about the mount",
        "camera: {calibration error: {rotation: [0 deg, 0 deg, 2 deg]}}",
    )
}


@dataclass(frozen=True, kw_only=True)
class SettingKey(Key):
    """One field of a settings dataclass, ``attribute``, and how it is written."""

    above: str = ""  # the key of the mapping in which it stands: "calibration error"; mostly none
    number: QuantityValue  # its value, or each of its numbers; of a word without a meaning
    own_bounds: bool  # narrower than those of every setting of that dimension

    @property
    def path(self) -> tuple[str, ...]:
        """The keys that lead to it: ("critical distance",), or ("calibration error", "offset")."""
        return (self.above, self.name) if self.above else (self.name,)


def setting_keys(group: type[Any]) -> tuple[SettingKey, ...]:
    """The keys of one settings dataclass, in its order."""
    return _setting_keys(group)  # type: ignore[arg-type]  # a class can be hashed, whatever its instances


@lru_cache
def _setting_keys(group: type[Any]) -> tuple[SettingKey, ...]:
    return tuple(_setting_key(one.name, one.default, one.metadata["described"]) for one in fields(group))


def _setting_key(attribute: str, default: Any, described: Described) -> SettingKey:
    dimension = next(one for one in _BY_SUFFIX if attribute.endswith(one.suffix))
    name = attribute.removesuffix(dimension.suffix).replace("_", " ")
    for frame in _FRAMES:
        name = name.removesuffix(frame)
    above = next((first for first in _MAPPINGS if name.startswith(first + " ")), "")
    least, most = dimension.least, dimension.most
    if described.least is not None and described.most is not None:
        least, most = described.least, described.most
    elif isinstance(default, tuple):  # of coordinates or angles, which may have either sign
        most = LARGEST_ANGLE_RAD if dimension is ANGLE else LARGEST_COORDINATE_M
        least = -most
    number = QuantityValue(
        dimension,
        least=least,
        most=most,
        whole=isinstance(default, int),
        or_word=EVERY_TICK if default is None else None,
    )
    value = _value(default, number)
    said = described.takes
    if not said and described.least is None and not isinstance(value, Word):
        # Without the bounds that its dimension gives to every setting.
        said = value.name if isinstance(value, QuantityValue) else value.words.partition(", each")[0]
    return SettingKey(
        name=name.removeprefix(f"{above} "),
        value=value,
        meaning=described.meaning,
        example=described.example or (dimension.example if default is None else ""),
        said=said,
        attribute=attribute,
        fallback=default,
        above=above,
        number=number,
        own_bounds=described.least is not None,
    )


def _value(default: Any, number: QuantityValue) -> Value:
    if isinstance(default, DecisionCost):
        return Text(form=FORM, or_mapping=True, reads=read_decision_time, writes=write_decision_time)
    if isinstance(default, Enum):
        return Word(type(default))
    if not isinstance(default, tuple):
        return number
    each = f", each {number.range_words}"
    if isinstance(default[0], tuple):
        expected = "a list of three to 100 corners, each a list of two lengths such as [40 mm, -30 mm]"
        corner = Several(of=number, form="a corner", expected="a corner such as [40 mm, -30 mm]", count=2)
        form = f"list of three to 100 corners{each}"
        return Several(of=corner, form=form, expected=expected, least=3, most=100)
    dimension, count = number.dimension, len(default)
    form = {LENGTH: "point", ANGLE: "rotation"}[dimension] if count == 3 else "list of six angles"
    expected = f"a list of {count}, each {dimension.expected}"
    return Several(of=number, form=form + each, expected=expected, count=count)


def read_group(field: Field, default: G) -> G:
    """``default`` with the values that the mapping ``field`` changes."""
    keys = setting_keys(type(default))
    given = field.fields(tuple(dict.fromkeys(key.path[0] for key in keys)), hints=_MOVED)
    changes: dict[str, Any] = {}
    for above in _MAPPINGS:
        inner = given.optional(above)
        if inner is not None:
            names = {key.name: key for key in keys if key.above == above}
            within = inner.fields(tuple(names))
            for name in within:
                changes[names[name].attribute] = names[name].value.read(within.required(name))
    for key in keys:
        value = given.optional(key.name)
        if value is not None and not key.above:
            changes[key.attribute] = key.value.read(value)
    return replace(default, **changes)


def write_group(group: DataclassInstance, default: DataclassInstance | None) -> dict[str, Tree]:
    """The values of ``group`` that differ from ``default``'s (all of them for None), SI, exact."""
    written: dict[str, Any] = {}
    for key in setting_keys(type(group)):
        value = getattr(group, key.attribute)
        # repr, because a negative zero equals a positive one and is another number all the same.
        if default is None or repr(getattr(default, key.attribute)) != repr(value):
            inner = written.setdefault(key.above, {}) if key.above else written
            inner[key.name] = key.value.write(value)
    return written


def group_table(group: str, path: str) -> KeyTable:
    """The table of one group of settings; ``path`` leads to it from the top of a file."""
    keys: dict[str, Key] = {}
    inner: dict[str, list[Key]] = {}
    for one in setting_keys(type(getattr(DEFAULTS, group.replace(" ", "_")))):
        key = replace(one, within=(*path.split("."), *one.path[:-1]))
        keys[one.path[0]] = key  # of a mapping only its place, filled below
        if one.above:
            inner.setdefault(one.above, []).append(key)
    for name, members in inner.items():
        table = KeyTable(name=name, where=f"{name} of {group}", keys=tuple(members))
        keys[name] = Key(name, Below(tables=(table,)), *_MAPPINGS[name], or_else="none")
    return KeyTable(name=group, where=group, keys=tuple(keys.values()), path=path)
