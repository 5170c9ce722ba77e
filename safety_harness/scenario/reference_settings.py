"""The keys of the settings: values, bounds and defaults come from the code, what they mean is said here."""

from __future__ import annotations

from collections.abc import Mapping
from enum import Enum
from typing import Any

from safety_harness.scenario.bounds import BY_KEY
from safety_harness.scenario.decision_times import FORM as DECISION_TIME
from safety_harness.scenario.reference import (
    Below,
    Key,
    KeyTable,
    QuantityValue,
    Several,
    Text,
    Value,
    Word,
    nice,
)
from safety_harness.scenario.settings_keys import EVERY_TICK, SettingKey, setting_keys
from safety_harness.scenario.units import ANGLE, FRACTION, LENGTH, Dimension
from safety_harness.settings import DEFAULTS, DecisionCost

MEANINGS: Mapping[str, Mapping[str, str]] = {
    "object": {
        "polygon": (
            "outline in the object's own frame, one corner after another; convex for rendered images"
        ),
        "position": "of the object's own origin",
        "yaw": "turn about the vertical",
    },
    "hand sensor": {
        "kind": (
            "`ideal` is the overhead camera without field of view, occlusion, noise and delay, so "
            "it takes none of the keys for them; `eye in hand` is blind outside the servoing "
            "camera's view and has its optics"
        ),
        "detector": "from geometry, or from rendered images",
        "overhead position": (
            "where the overhead camera hangs, looking straight down; a hand that is not below it, "
            "by its radius or more, is not seen, by the `ideal` one neither"
        ),
        "width": "of the image",
        "height": "of the image",
        "focal": "focal length",
        "pixel noise": "standard deviation of the box's place",
        "depth noise": "standard deviation of the depth, divided by the depth squared",
        "dropout": "how probable it is that an image shows no hand",
        "rate": "of the images; at most that of the control ticks",
        "latency": "from the image to the controller",
    },
    "camera": {
        "width": "of the image",
        "height": "of the image",
        "focal": "focal length",
        "mount yaw": "turn of the true mount about the tool axis",
        "mount offset": "shift of the true mount, in the TCP frame",
        "calibration error rotation": "in the camera frame",
        "calibration error offset": "in the TCP frame",
        "source": "where the object's moments come from",
        "rate": "of the images; at most that of the control ticks",
        "latency": "from the image to the controller",
    },
    "clock": {
        "control period": "from one speed command to the next",
        "physics substeps": "steps of the physics in one control period",
        "wall limit": "an avoider that takes longer in real time ends the run, which has failed",
    },
    "cell": {
        "table height": "z of the table",
        "desired tcp position": "where the servoing should end",
        "preferred joint position": "a start by `offset` takes the joint angles nearest to it",
    },
    "hand": {
        "radius": "of the sphere that is the hand",
        "forearm radius": "of the capsule that is the forearm",
        "forearm length": "from the hand's centre, where no elbow was recorded",
    },
    "hand filter": {
        "prediction horizon": "how far ahead the hand is predicted",
        "measurement std": "assumed error of the box's place",
        "measurement std depth": "assumed error of the depth",
        "measurement std area": "assumed error of the box's area",
        "measurement std aspect": "assumed error of the box's aspect ratio",
        "acceleration std": "assumed motion of the hand",
        "acceleration std depth": "assumed motion along the view",
        "area rate std": "assumed change of the area, per root second",
        "initial speed std": "of a hand that has just been seen",
        "initial speed std depth": "the same along the view",
        "gate": "how far a box may be from a track to belong to it",
        "track timeout": "how long a track lives without a box",
        "assumed hand radius": "what the controller takes the hand for",
    },
    "servo": {
        "object kind": "moments over a region, or over points",
        "interaction": "the interaction matrix that is inverted",
        "gain far": "lambda, per second, before the gain switch",
        "gain near": "lambda, per second, after it",
        "gain switch sse": "the squared feature error at which the gain switches",
    },
    "motion": {
        "max tcp speed": "that the controller may demand",
        "max tcp acceleration": "that the controller may demand",
        "max tcp angular speed": "that the controller may demand",
        "max tcp angular acceleration": "that the controller may demand",
        "min singular value": "of the Jacobian; below it the arm is stopped",
    },
    "avoidance": {
        "critical distance": "from the TCP to a predicted hand; zero is no avoidance at all",
        "radius": "how far away a repulsive position is",
        "repulsion speed": "on the way to it",
        "repulsion acceleration": "on the way to it",
        "arrival tolerance": "when it counts as reached",
        "candidate count": "candidates of the nearest-candidate avoider",
        "candidate sigma": "their spread in azimuth and elevation",
        "candidate cone": "the cone that they are cut to",
        "nominal hand position": "the hand that the cone points away from",
        "hand pull": "the factor of eq. 13 of the paper",
        "gate": (
            "what is checked before a position is used ([avoiders](avoiders.md#the-gate)); "
            "`reach` is the plain system"
        ),
        "table clearance": "the TCP is never sent nearer to the table",
        "decision deadline": "an answer that takes longer in simulated time is none",
        "decision time": (
            "what a decision costs in simulated time, drawn anew for each; as the avoider declares it "
            "([avoiders](avoiders.md#computing-time))"
        ),
        "restart delay": "how long hands must be away before a stop is released",
    },
    "braking": {
        "reaction time": "before a protective stop begins to brake",
        "stop time base": "braking time, however slow the TCP is",
        "stop time per speed": "and what each m/s of its speed adds",
    },
}
_SAID = {"restart delay": "time, at least as long as a stop takes"}
_INNER = {"calibration error": "what the controller believes wrongly about the mount"}
_EXAMPLES = {
    "decision time": "settings: {avoidance: {decision time: 40 ms}}",
    "calibration error": "camera: {calibration error: {rotation: [0 deg, 0 deg, 2 deg]}}",
    "kind": "hand sensor: {kind: eye in hand}",
}


def group_table(group: str, path: str) -> KeyTable:
    """The table of one group of settings; ``path`` leads to it from the top of a file."""
    default = getattr(DEFAULTS, group.replace(" ", "_"))
    keys: dict[str, Key] = {}
    inner: dict[str, list[Key]] = {}
    for one in setting_keys(type(default)):
        key = _key(one, type(default).__name__, getattr(default, one.name), group, path)
        if len(one.words) == 1:
            keys[key.name] = key
        else:
            inner.setdefault(one.words[0], []).append(key)
            keys[one.words[0]] = key  # its place, filled below
    for name, members in inner.items():
        table = KeyTable(name=name, where=f"{name} of {group}", keys=tuple(members))
        keys[name] = Key(
            name=name,
            value=Below(tables=(table,)),
            default="none",
            meaning=_INNER[name],
            example=_EXAMPLES[name],
        )
    return KeyTable(name=group, where=group, keys=tuple(keys.values()), path=path)


def _key(one: SettingKey, owner: str, default: Any, group: str, path: str) -> Key:
    value = _value(one, default)
    shown = _shown(default, one.dimension)
    example = f"{one.words[-1]}: {one.dimension.example if default is None else shown}"
    for name in reversed((*path.split("."), *one.words[:-1])):
        example = f"{name}: {{{example}}}"
    own = f"{owner}.{one.name}" in BY_KEY
    return Key(
        name=one.words[-1],
        value=value,
        default=shown,
        meaning=MEANINGS[group][" ".join(one.words)],
        example=_EXAMPLES.get(one.words[-1], example),
        said=_SAID.get(one.words[-1], "" if own or isinstance(value, Word) else _unbounded(value)),
    )


def _unbounded(value: Value) -> str:
    """A value's words without the bounds that its dimension gives to every setting."""
    if isinstance(value, QuantityValue):
        return QuantityValue(dimension=value.dimension, whole=value.whole, or_word=value.or_word).words
    return value.words.partition(", each")[0]


def _value(one: SettingKey, default: Any) -> Value:
    if isinstance(default, DecisionCost):
        return Text(form=DECISION_TIME, or_mapping=True)
    if isinstance(default, Enum):
        return Word(options=tuple(str(member.value) for member in type(default)))
    number = QuantityValue(
        dimension=one.dimension,
        least=one.bounds.least,
        most=one.bounds.most,
        whole=isinstance(default, int),
        or_word=EVERY_TICK if default is None else None,
    )
    if not isinstance(default, tuple):
        return number
    each = f", each {nice(one.bounds.least, one.dimension)} to {nice(one.bounds.most, one.dimension)}"
    if isinstance(default[0], tuple):
        corner = Several(of=number, form="a corner", count=2)
        return Several(of=corner, form=f"list of three to 100 corners{each}", least=3, most=100)
    form = {LENGTH.name: "point", ANGLE.name: "rotation"}[one.dimension.name]
    if len(default) == 6:
        form = "list of six angles"
    return Several(of=number, form=form + each, count=len(default))


def _shown(value: Any, dimension: Dimension) -> str:
    """A default as people write it."""
    if value is None:
        return EVERY_TICK
    if isinstance(value, Enum):
        return str(value.value)
    if isinstance(value, tuple):
        return "[" + ", ".join(_shown(one, dimension) for one in value) + "]"
    if value == 0.0 and dimension is LENGTH:
        return "0 mm"  # as its neighbours in a list
    if dimension is FRACTION:
        return f"{100 * value:g} %"
    if isinstance(value, int):
        return f"{value} {dimension.si}".rstrip()
    return nice(value, dimension)
