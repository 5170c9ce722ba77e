"""The arm in the cell: an arm of the package, or the user's own arm, given by its files.

The user's own arm consists of a URDF, capsules from ``safety-harness robot fit``, stop times and a seat. The
reader stores the texts of these files together with their SHA-256, in the same way as recordings. Therefore a
trace can be judged without the files. ``safety_harness.cell.robot.robots`` turns the texts into numbers.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Callable, Mapping
from dataclasses import field as dataclass_field
from dataclasses import replace
from enum import Enum
from pathlib import Path
from typing import Any

from safety_harness.base.exceptions import ScenarioError
from safety_harness.base.settings import Braking, Vector3
from safety_harness.base.shipped.contents import is_shipped, located
from safety_harness.scenario.codec import (
    POINT,
    ROTATION,
    TURN,
    Below,
    Key,
    QuantityValue,
    Several,
    Text,
    Word,
    declared,
    key,
    keyed,
    table_of,
)
from safety_harness.scenario.fields import Field, Fields
from safety_harness.scenario.files import read_bytes
from safety_harness.scenario.nodes import Scalar, parse_tree
from safety_harness.scenario.references import seen_from
from safety_harness.scenario.units import ANGULAR_SPEED, FRACTION, LENGTH, MASS, TIME, TIME_PER_SPEED, TORQUE

MAX_URDF_BYTES = 20_000_000  # a limit of the memory, as the next number; a choice
MAX_CAPSULES_BYTES = 4_000_000
_ENDINGS = (".yaml", ".yml")
FILES = ("urdf", "capsules")  # keys that name a file
_PIECE = "{from: [0 mm, 0 mm, 20 mm], to: [0 mm, 0 mm, 120 mm], radius: 45 mm}"
_CENTRE = "[0 mm, 0 mm, 50 mm]"
_ORIGIN: Vector3 = (0.0, 0.0, 0.0)


class Robot(Enum):
    """An arm that the package contains."""

    UR10 = "UR10"
    UR5 = "UR5"
    UR3 = "UR3"

    @property
    def arm_name(self) -> str:
        """The name of the files that describe the arm."""
        return self.value.lower().replace(" ", "_")

    @property
    def label(self) -> str:
        """The name for people."""
        return self.value


ROBOT_NAMES = Word(Robot)


class YesNo(Enum):
    """The user's choice of yes or no."""

    YES = "yes"
    NO = "no"


class Angles(Enum):
    """The unit of the position limits in a URDF file.

    The URDF format prescribes one unit.
    """

    RAD = "rad"


@declared
class StopTimes:
    """The times of an arm's stop: a reaction time, and a braking time of base + slope v.

    Here, v is the TCP's speed.
    """

    reaction_time_s: float = key(
        "reaction time",
        QuantityValue(TIME, least=0.0, most=5.0),
        "before a protective stop begins to brake",
        "100 ms",
    )
    stop_time_s: float = key(
        "stop time", QuantityValue(TIME, least=0.0, most=5.0), "braking time, at worst", "450 ms"
    )
    stop_time_per_speed_s2pm: float = key(
        "stop time per speed",
        QuantityValue(TIME_PER_SPEED, least=0.0, most=10.0),
        "and what each m/s of the TCP's speed adds",
        default=0.0,
    )

    @property
    def settings(self) -> Braking:
        """The stop times as a group of settings."""
        return Braking(
            reaction_time_s=self.reaction_time_s,
            stop_time_base_s=self.stop_time_s,
            stop_time_per_speed_s2pm=self.stop_time_per_speed_s2pm,
        )


@declared
class Seat:
    """The place of an arm's base link in the base frame of the scenario, whose z axis points up.

    The rotation is Rz(yaw) R(tilt). For example, the rotation vector [180 deg, 0 deg, 0 deg] turns the arm
    upside down.
    """

    position_in_base_m: Vector3 = key("position", POINT, "of the arm's base link", default=_ORIGIN)
    yaw_rad: float = key("yaw", TURN, "turn about the vertical, after the tilt", default=0.0)
    tilt_rad: Vector3 = key(
        "tilt", ROTATION, "rotation vector; [180 deg, 0 deg, 0 deg] hangs from a ceiling", default=_ORIGIN
    )


@declared
class Piece:
    """A capsule that encloses a part of the tool.

    The capsule contains all points within ``radius_m`` of its axis.
    """

    start_m: Vector3 = key("from", POINT, "one end of the axis", _PIECE)
    end_m: Vector3 = key("to", POINT, "the other end, which may be the same", _PIECE)
    radius_m: float = key("radius", QuantityValue(LENGTH, least=0.001, most=1.0), "around the axis", _PIECE)


PIECES = Several(
    of=Below(tables=(table_of(Piece, "piece of a tool", path="robot.tool.capsules"),)),
    kind="list of at most 50",
    expected="a list of capsules, each {from: ..., to: ..., radius: ...}",
    least=1,
    most=50,
)


@declared
class Tool:
    """A tool on the link `tcp`.

    All values of the tool are in the frame of that link. The tool moves the TCP.
    """

    position_m: Vector3 = key("position", POINT, "of the TCP", "[0 mm, 0 mm, 150 mm]", default=_ORIGIN)
    tilt_rad: Vector3 = key("tilt", ROTATION, "of the TCP, a rotation vector", default=_ORIGIN)
    pieces: tuple[Piece, ...] = key(
        "capsules",
        PIECES,
        "that enclose it; `safety-harness robot enclose` makes them of a mesh",
        f"[{_PIECE}]",
    )


@declared
class Payload:
    """The load of the arm, which is a point mass for the tool and the part together."""

    mass_kg: float = key("mass", QuantityValue(MASS, least=0.0, most=1000.0), "of tool and part", "2 kg")
    centre_m: Vector3 = key(
        "centre",
        POINT,
        "of that mass, in the frame of the link `tcp`",
        "[0 mm, 0 mm, 50 mm]",
        default=_ORIGIN,
    )


@declared
class Drives:
    """The response of an arm's drives to a demanded velocity.

    A payload implies torque limits.
    """

    dead_time_s: float = key(
        "dead time",
        QuantityValue(TIME, least=0.0, most=0.1),
        "from a demand to its effect, rounded up to whole control periods",
        "8 ms",
        default=0.0,
    )
    lag_s: float = key(
        "lag",
        QuantityValue(TIME, least=0.0, most=1.0),
        "time constant with which the velocity approaches the demand",
        "20 ms",
        default=0.0,
    )
    torque_share: float | None = key(
        "torque limit",
        QuantityValue(FRACTION, least=0.01, most=1.0),
        "of the URDF's efforts, beyond which no joint accelerates or brakes",
        "100 %",
        "none; with a payload 100 %",
        default=None,
    )
    payload: Payload | None = key(
        "payload",
        Below(tables=(table_of(Payload, "payload of a robot", path="robot.drives.payload"),)),
        "what tool and part weigh; the links' masses are the URDF's",
        f"{{mass: 2 kg, centre: {_CENTRE}}}",
        default=None,
    )

    @property
    def torque_limit(self) -> float | None:
        """The fraction of the URDF's effort limits that the drives reach.

        The fraction is None without a torque limit.
        """
        return 1.0 if self.torque_share is None and self.payload is not None else self.torque_share


def _sha256(field: Field) -> str:
    """Return the SHA-256 in a field.

    Raise ScenarioError unless the text has 64 hexadecimal digits.
    """
    digest = field.scalar("a SHA-256")
    if not re.fullmatch(r"[0-9a-f]{64}", digest):
        raise field.error("a SHA-256: 64 digits and letters from a to f")
    return digest


DIGEST = Text(kind="64 hex digits", pattern="^[0-9a-f]{64}$", reads=_sha256, writes='"{}"'.format)
_FILE = Text(kind="file", expected="the name of a file")
_LINK = Text(kind="name", expected="the name of a link")
_EXAMPLE_SHA256 = "0123456789abcdef" * 4


def _one_a_joint(noun: str, number: QuantityValue) -> Several:
    """Return the kind of a list with one number for each joint.

    The word ``noun`` describes the numbers.
    """
    expected = f"a list of {noun}, one a joint, from the base"
    return Several(of=number, kind=f"list of {noun}", expected=expected, least=3, most=8)


@declared
class OwnRobot:
    """The user's own arm.

    ``urdf_text`` and ``capsules_text`` are the bytes of its files. ``files`` lists the paths of the URDF and
    of the capsules on this machine. If the arm has a file, its path is also listed. Meshes are found relative
    to the URDF's path.
    """

    urdf: str | None = key("urdf", _FILE, "the arm's description; or `package`", "panda.urdf", default=None)
    package: str | None = key(
        "package",
        Text(kind="name", expected="the name of a URDF in an installed package"),
        "a URDF of an installed package; where it is missing, `urdf` ([robots](how-to/robot.md))",
        "pybullet/kuka_iiwa/model",
        default=None,
    )
    base: str = key("base", _LINK, "the link that stands still", "panda_link0")
    tcp: str = key("tcp", _LINK, "the link whose frame is the TCP's", "panda_hand_tcp")
    capsules: str = key(
        "capsules", _FILE, "what `safety-harness robot fit` wrote for this arm", "panda.capsules.json"
    )
    braking: StopTimes = key(
        "braking",
        Below(tables=(table_of(StopTimes, "braking of a robot", path="robot.braking"),)),
        "how it stops; another arm's data would be wrong, so there is no default",
        "{reaction time: 100 ms, stop time: 450 ms}",
    )
    seat: Seat | None = key(
        "seated at",
        Below(tables=(table_of(Seat, "seat of a robot", path="robot.seated at"),)),
        "where its base link stands in the base frame; by default they are one",
        "{position: [0 mm, 0 mm, 0 mm], yaw: 30 deg}",
        default=None,
    )
    tool: Tool | None = key(
        "tool",
        Below(tables=(table_of(Tool, "tool of a robot", path="robot.tool"),)),
        "what is fixed to the link `tcp`",
        f"{{position: [0 mm, 0 mm, 150 mm], capsules: [{_PIECE}]}}",
        default=None,
    )
    part: tuple[Piece, ...] | None = key(
        "carries",
        PIECES,
        "a part, in the TCP's frame: the capsules that enclose it",
        f"[{_PIECE}]",
        default=None,
    )
    tcp_beyond_m: float | None = key(
        "tcp beyond capsules",
        QuantityValue(LENGTH, least=0.0, most=1.0),
        "how far the TCP may lie from every capsule, as that of a welding torch does",
        "150 mm",
        "20 mm",
        default=None,
    )
    without_geometry: tuple[str, ...] | None = key(
        "without geometry",
        Several(of=_LINK, kind="list of names", expected="a list of links"),
        "links between others that nothing encloses, which are accepted so",
        "[forearm]",
        "none",
        default=None,
    )
    drives: Drives | None = key(
        "drives",
        Below(tables=(table_of(Drives, "drives of a robot", path="robot.drives"),)),
        "how they follow a demand; by default at once and exactly",
        "{dead time: 8 ms, lag: 20 ms, torque limit: 100 %}",
        default=None,
    )
    joint_speed_limits_radps: tuple[float, ...] | None = key(
        "joint speed limits",
        _one_a_joint("angular speeds", QuantityValue(ANGULAR_SPEED, least=0.001, most=20.0)),
        "where the URDF's are not the maker's",
        "[85 deg/s, 85 deg/s, 100 deg/s, 75 deg/s, 130 deg/s, 135 deg/s, 135 deg/s]",
        default=None,
    )
    joint_torque_limits_nm: tuple[float, ...] | None = key(
        "joint torque limits",
        _one_a_joint("torques", QuantityValue(TORQUE, least=0.01, most=1e5)),
        "where the URDF's efforts are 0 or missing, for drives with a torque limit and for PyBullet",
        "[87 Nm, 87 Nm, 87 Nm, 87 Nm, 12 Nm, 12 Nm, 12 Nm]",
        default=None,
    )
    soft_limits: YesNo | None = key(
        "soft limits",
        Word(YesNo),
        "`yes` takes the limits of the URDF's <safety_controller> as the joints' ends",
        "yes",
        "no",
        default=None,
    )
    angles: Angles | None = key(
        "angles",
        Word(Angles),
        "accepts position limits of 90, 180, 270 or 360 beside speeds above 30 as radians",
        "rad",
        "such limits are refused: they look like degrees",
        default=None,
    )
    urdf_sha256: str | None = key(
        "urdf sha256", DIGEST, "refuse a URDF with other contents", _EXAMPLE_SHA256, default=None
    )
    capsules_sha256: str | None = key(
        "capsules sha256", DIGEST, "refuse capsules with other contents", _EXAMPLE_SHA256, default=None
    )
    files: tuple[Path, ...] = dataclass_field(default=(), compare=False)
    urdf_text: bytes = dataclass_field(default=b"", compare=False, repr=False)
    capsules_text: bytes = dataclass_field(default=b"", compare=False, repr=False)

    @property
    def label(self) -> str:
        """The name for people."""
        return Path(self.urdf or self.package or "").stem

    @property
    def texts(self) -> dict[str, bytes]:
        """The contents of the arm's files, with their SHA-256 as keys."""
        return {str(self.urdf_sha256): self.urdf_text, str(self.capsules_sha256): self.capsules_text}

    def named(self, name: Callable[[str], str]) -> OwnRobot:
        """Return this arm after renaming its files by ``name``."""
        urdf = None if self.urdf is None else name(self.urdf)
        return replace(self, urdf=urdf, capsules=name(self.capsules))


_OWN = table_of(OwnRobot, "robot", path="robot")
_MOUNTED = {key.attribute: key for key in _OWN.keys}


@declared
class EquippedArm:
    """An arm of the package with a seat, a tool or a part.

    The braking data of such an arm come from the settings.
    """

    arm: Robot = keyed(Key("arm", Word(Robot), "an arm of the package"))
    seat: Seat | None = keyed(_MOUNTED["seat"], default=None)
    tool: Tool | None = keyed(_MOUNTED["tool"], default=None)
    part: tuple[Piece, ...] | None = keyed(_MOUNTED["part"], default=None)
    tcp_beyond_m: float | None = keyed(_MOUNTED["tcp_beyond_m"], default=None)

    @property
    def label(self) -> str:
        """The name for people, including the equipment."""
        mounted = {"another seat": self.seat, "a tool": self.tool, "a part": self.part}
        return f"{self.arm.label} with {' and '.join(name for name, part in mounted.items() if part)}"


AnyRobot = Robot | OwnRobot | EquippedArm


def robot_seen_from(folder: Path, text: str, standing_in: Path) -> str:
    """Return the robot's file ``text`` in the form that a file in ``folder`` needs.

    A name is unchanged.
    """
    return seen_from(folder, text, standing_in) if text.endswith(_ENDINGS) else text


_EQUIPPED = table_of(EquippedArm, "robot", path="robot")
_ARM = Key(
    "arm",
    Text(kind=f"file, or {ROBOT_NAMES.kind}", expected="a file with these keys"),
    f"a file with these keys; what is said beside it comes first. Beside {ROBOT_NAMES.kind} only "
    "`seated at`, `tool`, `carries` and `tcp beyond capsules`",
    "shipped:iiwa14",
    "none",
)
_BESIDE = tuple(replace(key, or_else="said there or here") if key.required else key for key in _OWN.keys)
ROBOT = replace(_OWN, keys=(_ARM, *_BESIDE))


class _RobotValue(Below):
    """The value of the key ``robot``.

    It is a name, a file that contains the keys of a user's own arm, or a mapping with these keys.
    """

    def read(self, field: Field) -> Field:
        """Return the field itself.

        Later, ``read_robot`` reads the field together with the texts that a trace carries.
        """
        return field

    def write(self, value: object) -> Any:
        """Return the name of an arm of the package, or the mapping of any other arm."""
        if isinstance(value, Robot):
            return value.value
        return (_EQUIPPED if isinstance(value, EquippedArm) else _OWN).write(value)


ROBOT_VALUE = _RobotValue(
    kind=f"{ROBOT_NAMES.kind}, a file, or a mapping",
    tables=(ROBOT,),
    or_text=rf"^({'|'.join(ROBOT_NAMES.options)})$|\.ya?ml$|^shipped:",
)


def read_robot(field: Field | Robot, carried: Mapping[str, bytes]) -> AnyRobot:
    """Return the arm that a field describes.

    Args:
        field: The name of an arm, a file, or a mapping. A value of type Robot is the default, and the
            function returns it unchanged.
        carried: The texts of files, with their SHA-256 as keys. These texts replace the files.

    """
    if isinstance(field, Robot):  # the default
        return field
    arm: tuple[Path, ...] = ()
    if isinstance(field.node, Scalar):
        if not is_arm_file(field.node.text):
            return field.choice(Robot)
        arm = (_path(field),)
        given = _keys_of_file(field)
    else:
        given = field.fields(ROBOT.names)
        if "arm" in given and not is_arm_file(given.required("arm").scalar("the name of an arm or a file")):
            return _equipped(field)
        if "arm" in given:
            arm = (_path(given.required("arm")),)
            given = Fields(field, _keys_of_file(given.required("arm")).by_key | given.by_key)
    if "urdf" not in given and "package" not in given:
        raise given.whole.error('the key "urdf" or "package"', got="neither")
    values = _OWN.values(given)
    urdf = _urdf(given, carried)
    values["urdf_text"] = _text(given, "urdf", urdf, MAX_URDF_BYTES, carried)
    capsules = _path(given.required("capsules"))
    values["capsules_text"] = _text(given, "capsules", capsules, MAX_CAPSULES_BYTES, carried)
    for name in ("urdf", "capsules"):
        values[f"{name}_sha256"] = hashlib.sha256(values[f"{name}_text"]).hexdigest()
        if name in given:
            values[name] = _named_from(field, given.required(name))
    return OwnRobot(**values, files=(urdf, capsules, *arm))


def _equipped(field: Field) -> Robot | EquippedArm:
    """Return an arm of the package with its equipment, or only the arm if it has no equipment."""
    given = field.fields(_EQUIPPED.names, hints={"braking": "settings: {braking: ...}"})
    arm: EquippedArm = _EQUIPPED.made_of(given)
    return arm if arm.seat or arm.tool or arm.part else arm.arm


def robot_named(text: str) -> AnyRobot:
    """Return the arm with the name ``text``, or the arm in the file ``text`` of the working directory.

    Raise ScenarioError if there is no such arm.
    """
    return read_robot(Field(Scalar(text, 1), None, path="FILE", line=1), {})


def is_arm_file(text: str) -> bool:
    """Return whether a text is the name of a file that contains the keys of an arm."""
    return text.endswith(_ENDINGS) or is_shipped(text)


def _keys_of_file(field: Field) -> Fields:
    """Return the keys in an arm's file.

    Errors state the place in that file.
    """
    file = _path(field)
    data = read_bytes(file, most=MAX_CAPSULES_BYTES, place=field.place, error=ScenarioError)
    tree = parse_tree(data.decode("utf-8", "replace"), file)
    return Field(tree, file, path="", line=1).fields(ROBOT.names[1:])


def _path(field: Field) -> Path:
    """Return the path in a field, which is relative to the field's file."""
    text = field.sentence("the name of a file")
    return located((field.file.parent if field.file else Path()) / text, field.place)


def _named_from(whole: Field, field: Field) -> str:
    """Return the file name in ``field``, rewritten relative to the scenario's own file."""
    text = field.sentence("the name of a file")
    if field.file == whole.file:
        return text
    here, there = (file.parent if file else Path() for file in (whole.file, field.file))
    return seen_from(here, text, there)


def _urdf(given: Fields, carried: Mapping[str, bytes]) -> Path:
    """Return the path of the user's URDF.

    The URDF is in an installed package or is given by its own path. The file need not exist if a trace
    carries its text.
    """
    if "package" not in given:
        return _path(given.required("urdf"))
    package = given.required("package")
    text = package.sentence("the name of a URDF in an installed package")
    digest = given.optional("urdf sha256")
    try:
        from safety_harness.scenario.urdf_packages import urdf_of_package

        return urdf_of_package(text, package.place)
    except ScenarioError:
        if digest and _sha256(digest) in carried:
            # The trace carries the text, so the package is not necessary; the path is only a name.
            return Path(text)
        if "urdf" in given:
            return _path(given.required("urdf"))
        raise


def _text(given: Fields, name: str, file: Path, most: int, carried: Mapping[str, bytes]) -> bytes:
    """Return the text from ``carried``, or otherwise from the file.

    Raise ScenarioError if the text does not have the stated SHA-256.
    """
    digest, field = given.optional(f"{name} sha256"), given.optional(name) or given.whole
    wanted = _sha256(digest) if digest else ""
    if wanted in carried:
        return carried[wanted]
    data = read_bytes(file, most=most, place=field.place, error=ScenarioError)
    if len(data) > most:
        raise field.error(f"a file of at most {most:,} bytes", got=f"a longer one: {file}")
    actual = hashlib.sha256(data).hexdigest()
    if digest and actual != wanted:
        raise digest.error("a file with this SHA-256", got=f"one with {actual}: {file}")
    return data
