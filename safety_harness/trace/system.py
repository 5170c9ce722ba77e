"""The system under test as data: a name and a hash for each of its parts."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator
from dataclasses import asdict, dataclass, fields, replace
from functools import lru_cache
from typing import Annotated, Any

from msgspec import Meta

from safety_harness.base.settings import GateKind, HandSensorKind, ImageSource, Settings
from safety_harness.scenario.model import VISUAL_SERVO, Scenario
from safety_harness.scenario.robots import OwnRobot, Robot
from safety_harness.scenario.shield import Shield

Line = Annotated[str, Meta(max_length=4_096, pattern=r"\A[^\0\n\r]*\Z")]  # it is printed, and may name a file


@dataclass(frozen=True, kw_only=True)
class Component:
    """A part of the system.

    ``sha256`` is the hash of the part's file or settings; it is empty if the part has no file or settings.
    The hash of the package's source covers the shipped parts too.
    """

    name: Line
    sha256: Line = ""

    def __str__(self) -> str:
        return f"{self.name} (sha256 {self.sha256[:12]}...)" if self.sha256 else self.name


@dataclass(frozen=True, kw_only=True)
class SystemUnderTest:
    """The system under test in a run: its controller, its arm and its perception.

    Traces, ledgers and pages contain this record. Only the visual servo has ``avoider`` and ``gate``. The
    hash of ``robot`` covers its URDF and all other files of the robot. Each of ``gate``, ``perception`` and
    ``settings`` has the hash of its own settings. ``shield``, ``safety_filter`` and ``predictor`` are None if
    the run does not have them.
    """

    controller: Component
    avoider: Component | None = None
    gate: Component | None = None
    perception: Component
    robot: Component
    settings: Component
    shield: Component | None = None
    safety_filter: Component | None = None
    predictor: Component | None = None

    @property
    def tested(self) -> Component:
        """The part that the user tests: the avoider, or the controller if there is no avoider."""
        return self.controller if self.avoider is None else self.avoider

    def of_file(self, sha256: str) -> SystemUnderTest:
        """Return the system with ``sha256`` as the hash of the file that contains the user's part."""
        part = replace(self.tested, sha256=sha256)
        return replace(self, controller=part) if self.avoider is None else replace(self, avoider=part)

    def with_hashes(self, **sha256: str) -> SystemUnderTest:
        """Return the system with new hashes for the files of its parts.

        The names in ``sha256`` are the names of parts. Parts that the system does not have are ignored.
        """
        parts = {
            name: replace(self.parts[name], sha256=sha256[name]) for name in sha256 if name in self.parts
        }
        return replace(self, **parts)

    @property
    def label(self) -> str:
        """The kind and name of the user's part, such as ``controller stop when near``."""
        return f"{'controller' if self.avoider is None else 'avoider'} {self.tested.name}"

    @property
    def parts(self) -> dict[str, Component]:
        """The existing parts of the system, by field."""
        pairs = ((field.name, getattr(self, field.name)) for field in fields(self))
        return {name: part for name, part in pairs if part is not None}

    @property
    def as_dict(self) -> dict[str, Any]:
        """The parts as a dictionary for storage.

        Optional parts are included only if the system has them.
        """
        optional = ("shield", "safety_filter", "predictor")
        return {name: part for name, part in asdict(self).items() if name not in optional or part is not None}

    @property
    def as_json(self) -> str:
        """The dictionary as JSON; equal systems have the same text."""
        return json.dumps(self.as_dict, sort_keys=True)

    def changes(self, now: SystemUnderTest) -> Iterator[str]:
        """Yield a line for each part that differs between this system and ``now``.

        If an old file lacks a hash, this hash is not compared.
        """
        then, new = self.parts, now.parts
        for name in dict.fromkeys([*then, *new]):
            earlier, later = then.get(name), new.get(name)
            if earlier is None or later is None or earlier.name != later.name:
                yield f"{name}: {earlier or 'none'} then, {later or 'none'} now"
            elif earlier.sha256 and earlier.sha256 != later.sha256:
                yield f"{name}: {earlier} then, {later} now"


def system_of(
    scenario: Scenario,
    *,
    avoider: Component | None = None,
    controller: Component | None = None,
    robot_sha256: str = "",
    safety_filter: Component | None = None,
    predictor: Component | None = None,
) -> SystemUnderTest:
    """Return the system of a run.

    A ``controller`` or the visual servo drives its arm.

    Args:
        scenario: The scenario of the run.
        avoider: The avoider. None means that a controller drives the arm.
        controller: The user's controller. None means that the visual servo drives the arm.
        robot_sha256: The hash of the robot's URDF, without the settings of its mounting.
        safety_filter: The user's filter between controller and drives, if any.
        predictor: The scenario's predictor, if any.

    """
    settings, robot = scenario.settings, scenario.robot
    mounted = replace(robot, **_NAMES) if isinstance(robot, OwnRobot) else robot
    if not isinstance(mounted, Robot):
        robot_sha256 = hashlib.sha256(f"{robot_sha256} {_text(mounted)}".encode()).hexdigest()
    servo, gate, perception, whole = _parts(settings)
    if scenario.gate is not None:
        gate = replace(gate, name=", ".join([gate.name, *scenario.gate.demands]))
    return SystemUnderTest(
        controller=controller or servo,
        avoider=avoider if controller is None else None,
        gate=gate if controller is None else None,
        perception=perception,
        robot=Component(name=robot.label, sha256=robot_sha256),
        settings=whole,
        shield=_shield(scenario.shield),
        safety_filter=safety_filter,
        predictor=predictor,
    )


@lru_cache(maxsize=16)
def _shield(shield: Shield | None) -> Component | None:
    """Return the shield as a component, with the hash of its assumptions."""
    if shield is None:
        return None
    text = json.dumps(asdict(shield), sort_keys=True, default=_plain)
    return Component(name=shield.kind.value, sha256=hashlib.sha256(text.encode()).hexdigest())


# Of the user's own arm: the hashes of its files matter, but not their paths.
_NAMES: Any = dict.fromkeys(("urdf", "package", "capsules", "files", "urdf_text", "capsules_text"), "")
_UNKNOWN = Component(name="not noted")
NOT_NOTED = SystemUnderTest(
    controller=_UNKNOWN, avoider=_UNKNOWN, perception=_UNKNOWN, robot=_UNKNOWN, settings=_UNKNOWN
)
_GATES = {kind: f"{kind.value} gate" for kind in GateKind}
_SENSORS = {kind: f"hands {kind.value}" for kind in HandSensorKind}
_IMAGES = {source: f"object {source.value}" for source in ImageSource}


@lru_cache
def _parts(settings: Settings) -> tuple[Component, Component, Component, Component]:
    """Return the parts that the settings alone determine: servo, gate, perception, and the settings."""
    sees = f"{_SENSORS[settings.hand_sensor.kind]}, {_IMAGES[settings.camera.source]}"
    return (
        Component(name=VISUAL_SERVO, sha256=_hash_of(settings, "servo", "motion")),
        Component(name=_GATES[settings.avoidance.gate], sha256=_hash_of(settings, "avoidance")),
        Component(name=sees, sha256=_hash_of(settings, "camera", "hand_sensor", "hand_filter")),
        Component(name="settings", sha256=_hash_of(settings, *(entry.name for entry in fields(settings)))),
    )


def _hash_of(settings: Settings, *names: str) -> str:
    """Return the hash of the groups ``names`` of the settings.

    The hash covers the exact values of the settings, sorted by name.
    """
    values = ", ".join(f'"{name}": {_text(getattr(settings, name))}' for name in sorted(names))
    return hashlib.sha256(f"{{{values}}}".encode()).hexdigest()


@lru_cache(maxsize=256)
def _text(part: Any) -> str:
    """Return a part of the settings as JSON.

    The results are cached, because the draws of a space seldom differ in this part.
    """
    return json.dumps(asdict(part), sort_keys=True, default=_plain)


def _plain(value: Any) -> Any:
    return value.value  # of an Enum
