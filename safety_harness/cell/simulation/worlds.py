"""List all worlds, with their names and abilities.

The list also states which worlds confirm results.

To add a world, write a class and an entry of ``WORLDS``. The class ``RecordedWorld`` has the common part. A
program may append an entry of its own. Other modules receive an entry and call its methods. Only this module
looks up worlds by the names and labels in files. The import of this module does not load an engine.
"""

from __future__ import annotations

import shlex
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager
from dataclasses import dataclass, field, replace
from functools import lru_cache
from types import FunctionType
from typing import TYPE_CHECKING, Protocol

from safety_harness.base.exceptions import (
    InadmissibleError,
    InstallationError,
    Place,
    ScenarioError,
    TraceError,
    near_miss,
)
from safety_harness.base.extension_points import ExtensionPoint, Registry, loaded
from safety_harness.base.extras import IMAGES
from safety_harness.base.extras import PYBULLET as PYBULLET_EXTRA
from safety_harness.base.geometry.arrays import ArrayN
from safety_harness.base.settings import DetectorKind, ImageSource
from safety_harness.scenario.references import LEARNED, names_onnx

if TYPE_CHECKING:
    from safety_harness.cell.perception.detector import BoundingBoxDetector
    from safety_harness.cell.robot.description import ArmModel
    from safety_harness.cell.simulation.world import World
    from safety_harness.scenario.model import Scenario
    from safety_harness.trace.trace import Provenance


class OpensWorld(Protocol):
    """The interface of a world's class, or of a function in its place."""

    def __call__(
        self,
        scenario: Scenario,
        arm: ArmModel,
        joint_position_rad: ArrayN,
        *,
        detector: BoundingBoxDetector | None = None,
    ) -> AbstractContextManager[World]:
        """Open a scenario with the arm at ``joint_position_rad`` (n,).

        ``detector`` detects hands in rendered images.
        """


@dataclass(frozen=True, kw_only=True)
class WorldEntry:
    """A world with its abilities.

    Traces refer to it by ``name``, and plans and pages by ``label``. ``load`` imports the world's class and
    thereby the engine. Traces list the ``libraries`` in addition to the libraries of every run. If
    ``renders`` is True, the world renders camera images. If ``substeps`` is True, the world divides a control
    period into ``physics_substeps`` steps. If ``batch`` is True, the world is a ``BatchWorld``, in which many
    episodes run together. The recorded speed of a joint may differ from the motor's set point by up to
    ``known_to_radps``, because the engine's solver stops at this error. If ``model_only`` is True, a result
    or a bound in this world only applies to the model until a reference world confirms it. If ``reference``
    is True, the world confirms results, and runs may use it by default. If ``program`` is True, a run
    executes the user's simulator.
    """

    name: str
    label: str
    load: Callable[[], OpensWorld] = field(repr=False)
    renders: bool = False
    substeps: bool = False
    batch: bool = False
    known_to_radps: float = 0.0
    libraries: tuple[str, ...] = ()
    model_only: bool = False
    reference: bool = False
    program: bool = False

    def __str__(self) -> str:
        if self.program:
            return f"the simulator {self.label}"
        return f"the {self.label} world" if self.model_only else self.label

    @property
    def is_installed(self) -> bool:
        """Whether the world's engine can be loaded, or whether its program exists.

        The property loads the engine.
        """
        try:
            self.opener()
        except (InadmissibleError, InstallationError):
            return False
        return True

    def makes_images_of(self, scenario: Scenario) -> bool:
        """Return whether the world makes all images of a scenario."""
        return self.renders or not has_rendered_images(scenario)

    def opener(self) -> OpensWorld:
        """Return the world's class.

        Raise ``InstallationError`` if the world's engine is not installed.
        """
        try:
            return self.load()
        except ModuleNotFoundError as error:
            place, expected = Place(field=f"the world {self.label}"), "its engine to be installed"
            raise InstallationError(place=place, expected=expected, got=f"no module {error.name}") from error

    def open(
        self,
        scenario: Scenario,
        arm: ArmModel,
        joint_position_rad: ArrayN,
        *,
        detector: BoundingBoxDetector | None = None,
    ) -> AbstractContextManager[World]:
        """Open a scenario in this world.

        Args:
            scenario: The scenario, which admission has accepted.
            arm: The arm's model.
            joint_position_rad: The arm's joint position (n,) at the start.
            detector: A detector of hands in rendered images. None means that the world detects hands by skin
                colour.

        Returns:
            The world as a context manager, to be used once.

        Raises:
            InadmissibleError: The scenario needs rendered images and the world has no renderer.
            InstallationError: The world's engine is not installed.

        """
        self.refuse(scenario)
        return self.opener()(scenario, arm, joint_position_rad, detector=detector)

    def refuse(self, scenario: Scenario) -> None:
        """Raise an error if this world cannot make a scenario's images.

        Args:
            scenario: The scenario.

        Raises:
            InadmissibleError: The scenario needs rendered images and the world has no renderer.
            MissingPackageError: The scenario needs rendered images and OpenCV is not installed.

        """
        if not self.renders:
            from safety_harness.cell.simulation.world import refuse_rendered

            refuse_rendered(scenario, self.label)
        if has_rendered_images(scenario):
            IMAGES.require("rendered images", scenario.file)


def _pybullet() -> OpensWorld:
    """Import the class of the PyBullet world."""
    with PYBULLET_EXTRA.needed("the world PyBullet"):
        from safety_harness.cell.simulation.pybullet_world import PyBulletWorld

    return PyBulletWorld


def _kinematic() -> OpensWorld:
    """Import the class of the kinematic world."""
    from safety_harness.cell.simulation.kinematic_world import KinematicWorld

    return KinematicWorld


PYBULLET = WorldEntry(
    name="pybullet",
    label="PyBullet",
    load=_pybullet,
    renders=True,
    substeps=True,
    known_to_radps=2e-5,
    libraries=("pybullet",),
    reference=True,
)
"""The first reference world: rigid bodies, motors with torque limits, a renderer.

Its motors miss their speeds by at most 4e-9 rad/s with UR arms, iiwa and xArm, by 1.2e-5 rad/s with a Panda.
"""
KINEMATIC = WorldEntry(name="kinematic", label="kinematic", load=_kinematic, batch=True, model_only=True)
"""Joints follow the drives exactly; many episodes run together."""
REFERENCE = PYBULLET
SIMULATOR = "simulator"  # the user's, among the libraries of a trace
OTHER_BITS = "other bits"  # in a simulator's second episode, as its description in a trace says
WORLDS = Registry([PYBULLET, KINEMATIC], ExtensionPoint.WORLDS, WorldEntry)
"""Every world. A new one is a class and an entry here, or an entry point of a package."""


def references() -> Iterator[WorldEntry]:
    """Yield the installed worlds that confirm results, in the order of preference.

    The function loads their engines.
    """
    return (world for world in WORLDS if world.reference and world.is_installed)


def default_world() -> WorldEntry:
    """Return the world for runs that do not state a world.

    This world is the first installed reference or, if there is no such reference, the kinematic world.
    """
    return next(references(), KINEMATIC)


def confirming_world() -> WorldEntry:
    """Return the first installed reference, or ``REFERENCE`` if no reference is installed."""
    return next(references(), REFERENCE)


def defaulted(world: WorldEntry | str) -> str:
    """Return a sentence that states the world of runs for which the user chose no world."""
    return f"no world is named, and {REFERENCE} is not installed: runs are made in {world}"


def has_rendered_images(scenario: Scenario) -> bool:
    """Return whether any image of a scenario comes from a renderer."""
    settings = scenario.settings
    source, detector = settings.camera.source, settings.hand_sensor.detector
    return source is ImageSource.RENDERED or detector is DetectorKind.RENDERED


def libraries_of(world: str, scenario: Scenario) -> tuple[str, ...]:
    """Return the libraries that a run of ``scenario`` uses in addition to the libraries of every run.

    ``world`` is the world's name in traces.
    """
    entry = entry_of(world)
    engines = () if entry is None else entry.libraries
    images = ("cv2",) if has_rendered_images(scenario) else ()
    in_onnx = names_onnx(scenario.under_test) or scenario.controller == LEARNED
    return (*engines, *images, *(("onnxruntime",) if in_onnx else ()))


def worlds_by_label() -> dict[str, WorldEntry]:
    """Return the worlds by the labels that plans and ledgers use."""
    return {world.label: world for world in WORLDS}


def world_named(label: str, option: str) -> WorldEntry:
    """Return the world with the label ``label``, which is the value of a command's ``option``.

    Raise ``ScenarioError`` if the label is unknown.
    """
    for world in WORLDS:
        if world.label.casefold() == label.casefold():
            return world
    if (made := _of_reference.__wrapped__(label)) is not None:  # an edited simulator begins anew
        return named_by_user(made)
    worlds = worlds_by_label()
    raise ScenarioError.of_option(option, " or ".join(worlds), label, near_miss(label, worlds))


def world_labelled(label: str) -> WorldEntry | None:
    """Return the world to which a plan refers by ``label``, or None if the label is unknown.

    The function does not execute a simulator.
    """
    return worlds_by_label().get(label) or _of_reference(label)


def named_by_user(world: WorldEntry) -> WorldEntry:
    """Record that the user has chosen ``world``, and return ``world``.

    This process may then repeat traces of this world.
    """
    _named.add(world.name)
    return world


_named: set[str] = set()  # references that the user named in this process


@lru_cache
def _of_reference(reference: str) -> WorldEntry | None:
    """Return the world of a reference such as ``exec:./my_cell``, or None if its prefix is unknown."""
    prefix, colon, _ = reference.partition(":")
    makers = dict(loaded(ExtensionPoint.WORLD_PROGRAMS, FunctionType)) if colon else {}
    return replace(makers[prefix](reference), program=True) if prefix in makers else None


def entry_of(name: str) -> WorldEntry | None:
    """Return the world with the ``name`` that a trace states, or None if the name is unknown."""
    return next((world for world in WORLDS if world.name == name), None) or _of_reference(name)


def is_simulator(name: str) -> bool:
    """Return whether the world with this ``name`` in a trace is a user's simulator."""
    return ":" in name and (entry := entry_of(name)) is not None and entry.program


def world_option(name: str) -> list[str]:
    """Return the option with which a command repeats a trace of the world ``name``.

    The option is empty unless the world is a user's simulator.
    """
    return ["--world", name] if is_simulator(name) else []


def world_of_trace(name: str) -> WorldEntry:
    """Return the world with the ``name`` that a trace states, to repeat the run.

    Raise ``TraceError`` for an unknown name. Also raise ``TraceError`` for a program that the user has not
    named in this process, because a trace must not choose a program to execute.
    """
    for world in WORLDS:
        if world.name == name:
            return world
    if name in _named and (made := _of_reference(name)) is not None:
        return made
    names = " or ".join(world.name for world in WORLDS)
    hint = f"--world {shlex.quote(name)} names the simulator" if is_simulator(name) else ""
    raise TraceError(place=Place(field="world"), expected=f"a trace made in {names}", got=name, hint=hint)


def engine_elsewhere(then: Provenance, now: Provenance) -> bool:
    """Return whether an engine made a trace on another kind of machine.

    The last bits of its numbers may then differ.
    """
    return now.world != KINEMATIC.name and then.machine != now.machine
