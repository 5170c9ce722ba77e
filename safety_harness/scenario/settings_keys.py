"""The form of the settings in a scenario file, derived from the dataclasses of the settings.

Meanings and bounds are in the declarations of the fields, in ``settings``. The key of a field is the field's
name in plain words, without the unit and the frame. Therefore ``Avoidance.critical_distance_m`` becomes
``avoidance: {critical distance: 400 mm}``. The dimension follows from the unit at the end of the name. The
form of the value follows from the type of the default.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields, replace
from enum import Enum
from typing import Any

from safety_harness.base.settings import DEFAULTS, DecisionCost, Settings
from safety_harness.scenario.codec import Below, Key, KeyTable, QuantityValue, Several, Text, Value, Word
from safety_harness.scenario.decision_times import FORM, read_decision_time, write_decision_time
from safety_harness.scenario.fields import LARGEST_ANGLE_RAD, LARGEST_COORDINATE_M, Field, each
from safety_harness.scenario.units import ANGLE, DIMENSIONS, LENGTH

EVERY_TICK = "every tick"  # how a rate of None is written

# The longer suffix comes first, because "_per_m" also ends in "_m".
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
# Keys with these first words stand in a mapping of their own, given here with meaning and example.
_MAPPINGS = {
    "calibration error": (
        "what the controller believes wrongly about the mount",
        "camera: {calibration error: {rotation: [0 deg, 0 deg, 2 deg]}}",
    )
}


def setting_keys(group: type[Any]) -> tuple[Key, ...]:
    """Return the keys of one settings dataclass, in the order of its fields."""
    return _KEYS[group]


def _setting_key(attribute: str, default: Any, description: Mapping[str, Any]) -> Key:
    """Return the key of a field, determined by its name, its default and its metadata."""
    dimension = next(unit for unit in _BY_SUFFIX if attribute.endswith(unit.suffix))
    name = attribute.removesuffix(dimension.suffix).replace("_", " ")
    for frame in _FRAMES:
        name = name.removesuffix(frame)
    above = next((first for first in _MAPPINGS if name.startswith(first + " ")), "")
    least, most = dimension.least, dimension.most
    if description["least"] is not None:
        least, most = description["least"], description["most"]
    elif isinstance(default, tuple):  # coordinates or angles, which may have either sign
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
    takes = description["takes"]
    if not takes and description["least"] is None and not isinstance(value, Word):
        # The reference omits the bounds that the dimension sets for every setting.
        takes = value.name if isinstance(value, QuantityValue) else value.kind.partition(", each")[0]
    return Key(
        name=name.removeprefix(f"{above} "),
        value=value,
        meaning=description["meaning"],
        example=description["example"] or (dimension.example if default is None else ""),
        said=takes,
        attribute=attribute,
        fallback=default,
        within=(above,) if above else (),
    )


def _value(default: Any, number: QuantityValue) -> Value:
    """Return the kind of value of a setting with the default ``default``.

    ``number`` is the kind of a single number.
    """
    if isinstance(default, DecisionCost):
        return Text(kind=FORM, or_mapping=True, reads=read_decision_time, writes=write_decision_time)
    if isinstance(default, Enum):
        return Word(type(default))
    if not isinstance(default, tuple):
        return number
    each = f", each {number.range_words}"
    if isinstance(default[0], tuple):
        expected = "a list of three to 100 corners, each a list of two lengths such as [40 mm, -30 mm]"
        corner = Several(of=number, kind="a corner", expected="a corner such as [40 mm, -30 mm]", count=2)
        form = f"list of three to 100 corners{each}"
        return Several(of=corner, kind=form, expected=expected, least=3, most=100)
    dimension, count = number.dimension, len(default)
    if count != 3:  # of joints: as many as the arm has
        expected = f"a list of 3 to 8, each {dimension.expected}"
        return Several(of=number, kind=f"list of 3 to 8 angles{each}", expected=expected, least=3, most=8)
    form = {LENGTH: "point", ANGLE: "rotation"}[dimension]
    expected = f"a list of {count}, each {dimension.expected}"
    return Several(of=number, kind=form + each, expected=expected, count=count)


_KEYS: dict[type[Any], tuple[Key, ...]] = {
    type(group): tuple(_setting_key(item.name, item.default, item.metadata) for item in fields(group))
    for group in (getattr(DEFAULTS, item.name) for item in fields(DEFAULTS))
}


def read_group(field: Field, name: str) -> Any:
    """Return the group ``name`` of the default settings, changed by the values in ``field``."""
    default = getattr(DEFAULTS, name)
    keys = setting_keys(type(default))
    given = field.fields(tuple(dict.fromkeys(key.path[0] for key in keys)), hints=_MOVED)
    pairs: list[tuple[Key, Field]] = []
    for above in _MAPPINGS:
        inner = given.optional(above)
        if inner is not None:
            names = {key.name: key for key in keys if key.within == (above,)}
            pairs += [(names[name], value) for name, value in inner.fields(tuple(names)).by_key.items()]
    pairs += [(key, given.required(key.name)) for key in keys if key.name in given and not key.within]
    return replace(
        default, **dict(each(lambda pair: (pair[0].attribute, pair[0].value.read(pair[1])), pairs))
    )


def group_table(group: str, path: str) -> KeyTable:
    """Return the table of one group of settings.

    ``path`` is the path of the group's mappings from the top of a file.
    """
    keys: dict[str, Key] = {}
    inner: dict[str, list[Key]] = {}
    for setting in setting_keys(type(getattr(DEFAULTS, group.replace(" ", "_")))):
        key = replace(setting, within=(*path.split("."), *setting.within))
        keys[setting.path[0]] = key  # for a mapping only a place, which is filled below
        if setting.within:
            inner.setdefault(setting.within[0], []).append(key)
    for name, members in inner.items():
        table = KeyTable(name=name, where=f"{name} of {group}", keys=tuple(members))
        keys[name] = Key(name, Below(tables=(table,)), *_MAPPINGS[name], or_else="none")
    return KeyTable(name=group, keys=tuple(keys.values()), path=path)
