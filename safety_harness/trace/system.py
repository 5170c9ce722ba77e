"""The system under test as a value: its parts by name, each with the hash of what it is made of."""

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
    """A part of the system.  ``sha256`` is of its file or of its settings; empty for one with neither.

    What ships is in the hash of the package's source besides.
    """

    name: Line
    sha256: Line = ""

    def __str__(self) -> str:
        return f"{self.name} (sha256 {self.sha256[:12]}...)" if self.sha256 else self.name


@dataclass(frozen=True, kw_only=True)
class SystemUnderTest:
    """What drives the arm in a run, and what it drives and sees by; traces, ledgers and pages carry it.

    Only the visual servo has ``avoider`` and ``gate``.  ``robot`` has the hash of its URDF and
    of all that its files say, ``gate``, ``perception`` and ``settings`` of their settings.  ``shield`` is
    None where there is none.
    """

    controller: Component
    avoider: Component | None = None
    gate: Component | None = None
    perception: Component
    robot: Component
    settings: Component
    shield: Component | None = None

    @property
    def tested(self) -> Component:
        """What a user brings: the avoider, or the controller where there is none."""
        return self.controller if self.avoider is None else self.avoider

    def of_file(self, sha256: str) -> SystemUnderTest:
        """With the hash of the file that holds what a user brings."""
        part = replace(self.tested, sha256=sha256)
        return replace(self, controller=part) if self.avoider is None else replace(self, avoider=part)

    @property
    def words(self) -> str:
        """For a line: ``avoider opposite pose``, or ``controller stop when near``."""
        return f"{'controller' if self.avoider is None else 'avoider'} {self.tested.name}"

    @property
    def parts(self) -> dict[str, Component]:
        """Those that it has, by what they are."""
        found = ((one.name, getattr(self, one.name)) for one in fields(self))
        return {name: part for name, part in found if part is not None}

    @property
    def as_dict(self) -> dict[str, Any]:
        """Its parts as they are written down; a shield only where there is one."""
        return {name: one for name, one in asdict(self).items() if name != "shield" or one is not None}

    @property
    def as_json(self) -> str:
        """One text for one system."""
        return json.dumps(self.as_dict, sort_keys=True)

    def changes(self, now: SystemUnderTest) -> Iterator[str]:
        """Each part that is another now, in words; a hash that was never noted is no change."""
        then, new = self.parts, now.parts
        for name in dict.fromkeys([*then, *new]):
            before, after = then.get(name), new.get(name)
            if before is None or after is None or before.name != after.name:
                yield f"{name}: {before or 'none'} then, {after or 'none'} now"
            elif before.sha256 and before.sha256 != after.sha256:
                yield f"{name}: {before} then, {after} now"


def system_of(
    scenario: Scenario,
    *,
    avoider: Component | None = None,
    controller: Component | None = None,
    robot_sha256: str = "",
) -> SystemUnderTest:
    """The system of a run: of a ``controller``, or of the visual servo that asks ``avoider``."""
    settings, robot = scenario.settings, scenario.robot
    mounted = replace(robot, **_NAMES) if isinstance(robot, OwnRobot) else robot
    if not isinstance(mounted, Robot):
        robot_sha256 = hashlib.sha256(f"{robot_sha256} {_text(mounted)}".encode()).hexdigest()
    servo, gate, perception, whole = _parts(settings)
    if scenario.gate is not None:
        gate = replace(gate, name=", ".join([gate.name, *scenario.gate.words]))
    return SystemUnderTest(
        controller=controller or servo,
        avoider=avoider if controller is None else None,
        gate=gate if controller is None else None,
        perception=perception,
        robot=Component(name=robot.label, sha256=robot_sha256),
        settings=whole,
        shield=_shield(scenario.shield),
    )


@lru_cache(maxsize=16)
def _shield(shield: Shield | None) -> Component | None:
    """With the hash of what it takes for granted."""
    if shield is None:
        return None
    text = json.dumps(asdict(shield), sort_keys=True, default=_plain)
    return Component(name=shield.kind.value, sha256=hashlib.sha256(text.encode()).hexdigest())


# of an own arm, whose files count by their hashes, never by where they lie
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
    """What the settings alone decide: servo, gate, perception, and all of them."""
    sees = f"{_SENSORS[settings.hand_sensor.kind]}, {_IMAGES[settings.camera.source]}"
    return (
        Component(name=VISUAL_SERVO, sha256=_of(settings, "servo", "motion")),
        Component(name=_GATES[settings.avoidance.gate], sha256=_of(settings, "avoidance")),
        Component(name=sees, sha256=_of(settings, "camera", "hand_sensor", "hand_filter")),
        Component(name="settings", sha256=_of(settings, *(one.name for one in fields(settings)))),
    )


def _of(settings: Settings, *names: str) -> str:
    """The hash of some of the settings: of their exact values, in the order of their names."""
    values = ", ".join(f'"{name}": {_text(getattr(settings, name))}' for name in sorted(names))
    return hashlib.sha256(f"{{{values}}}".encode()).hexdigest()


@lru_cache(maxsize=256)
def _text(part: Any) -> str:
    """A part of the settings as JSON: few of a space's draws have another."""
    return json.dumps(asdict(part), sort_keys=True, default=_plain)


def _plain(value: Any) -> Any:
    return value.value  # of an Enum
