"""The worlds that there are, in one table: what each is called, what it can do, and what confirms it.

A new one is a class (``RecordedWorld`` has what worlds share) and an entry of ``WORLDS``; a program may
append an entry of its own.  Other modules receive an entry and ask it what they need.  Only names and labels
in files are looked up here.  Importing this loads no engine.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Protocol

from safety_harness.base.exceptions import InstallationError, Place, ScenarioError, TraceError, near_miss
from safety_harness.base.extension_points import ExtensionPoint, Registry
from safety_harness.base.extras import IMAGES
from safety_harness.base.extras import PYBULLET as PYBULLET_EXTRA
from safety_harness.base.geometry.arrays import ArrayN
from safety_harness.base.settings import DetectorKind, ImageSource
from safety_harness.cell.controller.named import LEARNED
from safety_harness.scenario.references import names_onnx

if TYPE_CHECKING:
    from safety_harness.cell.perception.detector import BoundingBoxDetector
    from safety_harness.cell.robot.description import ArmModel
    from safety_harness.cell.simulation.world import World
    from safety_harness.scenario.model import Scenario


class OpensWorld(Protocol):
    """The class of a world, or a function in its place."""

    def __call__(
        self,
        scenario: Scenario,
        arm: ArmModel,
        joint_position_rad: ArrayN,
        *,
        detector: BoundingBoxDetector | None = None,
    ) -> AbstractContextManager[World]:
        """One scenario with the arm at joints (n,) [rad]; ``detector`` is for rendered images of hands."""


@dataclass(frozen=True, kw_only=True)
class WorldEntry:
    """One world.  ``name`` is its own in traces, ``label`` that in plans and on pages.

    ``load`` imports its class, and its engine with it: of the ``libraries``, named in traces beside those of
    every run.  ``renders``: has it a camera's pictures, pixel by
    pixel?  ``substeps``: does it divide a control period by ``physics_substeps``?  ``batch``: is it a
    ``BatchWorld``, of which a great many run together?  ``known_to_radps``: by how much a joint's recorded
    speed may miss what its motor was told because the engine's solver stops there.  What it shows is of the
    model only, bounds too, until ``confirmed_by`` shows it; None for a reference.
    """

    name: str
    label: str
    load: Callable[[], OpensWorld] = field(repr=False)
    renders: bool = False
    substeps: bool = False
    batch: bool = False
    known_to_radps: float = 0.0
    libraries: tuple[str, ...] = ()
    confirmed_by: WorldEntry | None = None

    def __str__(self) -> str:
        return f"the {self.label} world" if self.model_only else self.label

    @property
    def model_only(self) -> bool:
        """Whether it says something of the model only, and nothing of the reference."""
        return self.confirmed_by is not None

    @property
    def is_installed(self) -> bool:
        """Whether its engine can be loaded, which this does."""
        try:
            self.opener()
        except InstallationError:
            return False
        return True

    def opener(self) -> OpensWorld:
        """Its class; InstallationError if its engine is not installed."""
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
        """As ``OpensWorld``; InadmissibleError as of ``refuse``, InstallationError as of ``opener``."""
        self.refuse(scenario)
        return self.opener()(scenario, arm, joint_position_rad, detector=detector)

    def refuse(self, scenario: Scenario) -> None:
        """InadmissibleError for rendered images in a world that has no renderer.

        MissingPackageError for them where OpenCV is missing.
        """
        if not self.renders:
            from safety_harness.cell.simulation.world import refuse_rendered

            refuse_rendered(scenario, self.label)
        if has_rendered_images(scenario):
            IMAGES.require("rendered images", scenario.file)


def _pybullet() -> OpensWorld:
    with PYBULLET_EXTRA.needed("the world PyBullet"):
        from safety_harness.cell.simulation.pybullet_world import PyBulletWorld

    return PyBulletWorld


def _kinematic() -> OpensWorld:
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
)
"""The reference world: rigid bodies, motors with torque limits, a renderer.

Its motors miss their speeds by at most 4e-9 rad/s with UR arms, iiwa and xArm, by 1.2e-5 rad/s with a Panda.
"""
KINEMATIC = WorldEntry(
    name="kinematic", label="kinematic", load=_kinematic, batch=True, confirmed_by=PYBULLET
)
"""Joints do what the drives are told; many episodes run together."""
REFERENCE = PYBULLET
DEFAULTED = f"no world is named, and {REFERENCE} is not installed: runs are made in {KINEMATIC}"
WORLDS = Registry([PYBULLET, KINEMATIC], ExtensionPoint.WORLDS, WorldEntry)
"""Every world; another is a class and an entry here, or an entry point of a package."""


def default_world() -> WorldEntry:
    """Return the world of runs that name none: the reference if it is installed, else the kinematic world."""
    return REFERENCE if REFERENCE.is_installed else KINEMATIC


def has_rendered_images(scenario: Scenario) -> bool:
    """Whether any of its images are a renderer's."""
    settings = scenario.settings
    source, detector = settings.camera.source, settings.hand_sensor.detector
    return source is ImageSource.RENDERED or detector is DetectorKind.RENDERED


def libraries_of(world: str, scenario: Scenario) -> tuple[str, ...]:
    """What a run of ``scenario`` uses beside the libraries of every run, in the world of this ``name``."""
    engines = next((one.libraries for one in WORLDS if one.name == world), ())
    images = ("cv2",) if has_rendered_images(scenario) else ()
    in_onnx = names_onnx(scenario.under_test) or scenario.controller == LEARNED
    return (*engines, *images, *(("onnxruntime",) if in_onnx else ()))


def worlds_by_label() -> dict[str, WorldEntry]:
    """As plans and ledgers name them."""
    return {world.label: world for world in WORLDS}


def world_named(label: str, option: str) -> WorldEntry:
    """The world that an option of a command names; ScenarioError for one that is not there."""
    worlds = worlds_by_label()
    for known, world in worlds.items():
        if known.casefold() == label.casefold():
            return world
    raise ScenarioError.of_option(option, " or ".join(worlds), label, near_miss(label, worlds))


def world_of_trace(name: str) -> WorldEntry:
    """The world that a trace names; TraceError for one that is not there."""
    for world in WORLDS:
        if world.name == name:
            return world
    names = " or ".join(world.name for world in WORLDS)
    raise TraceError(place=Place(field="world"), expected=f"a trace made in {names}", got=name)
