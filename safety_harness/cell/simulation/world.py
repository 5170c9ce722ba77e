"""Define the interface of every world.

The loop of ``simulate`` needs a truth, an observation and a step.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol, Self, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from safety_harness.base.exceptions import InadmissibleError
from safety_harness.base.geometry.arrays import ArrayN
from safety_harness.base.settings import DetectorKind, ImageSource
from safety_harness.cell.controller.cycle import ControllerRecords
from safety_harness.cell.simulation.records import world_records
from safety_harness.cell.simulation.steps import now_s, sense
from safety_harness.seams.contract import Image

if TYPE_CHECKING:
    from safety_harness.cell.perception.detector import BoundingBoxDetector
    from safety_harness.cell.robot.description import ArmModel
    from safety_harness.scenario.model import Scenario
    from safety_harness.trace.trace import Provenance

UNNOTICED_RADPS = 1e-7  # motors miss their speeds by less than this unless they are saturated
AMPLE = 1e4  # this factor on torque limits is enough for several times the mass within a sub-step
TABLE_HALF_M = (1.5, 1.5, 0.02)  # half the edges of the table's body
TABLE_CENTRE_M = (1.0, 0.0, -TABLE_HALF_M[2])  # in the base frame, for a table at height 0


class World(Protocol):
    """An episode of a scenario, as a context manager for a single use.

    The context manager closes the world even after an error.
    """

    @property
    def name(self) -> str:
        """The world's name in traces and reports."""

    @property
    def time_s(self) -> float:
        """The present time [s], which is the start of the coming control tick."""

    @property
    def acted_faults(self) -> int:
        """The faults of the scenario that have acted since the last observation, as bits."""

    def true_state(self, tick: NDArray[np.void]) -> None:
        """Write the truth into ``tick`` (1,), which is a record TICK."""

    def observe(self) -> NDArray[np.void]:
        """Return the OBSERVATION (1,) that the sensors have delivered by now."""

    def step(self, command: NDArray[np.void]) -> bool:
        """Execute a command for a control period, and return True while the brakes act.

        ``command`` (1,) is a record COMMAND.
        """


class BatchWorld(World, Protocol):
    """A world in which many episodes run together.

    Each episode continues to its next decision. Then the caller decides for all episodes.
    """

    def advance(
        self, controller: ControllerRecords, ticks: NDArray[np.void], decided: bool
    ) -> NDArray[np.void] | None:
        """Continue to the next decision, and return its OBSERVATION (1,).

        Return None at the end of the run.

        Args:
            controller: The controller's records.
            ticks: The records TICK to fill, shape (n,).
            decided: Whether the run is at a decision that the controller has already made.

        """


@runtime_checkable
class ShowsImages(Protocol):
    """A world with a renderer."""

    def image(self) -> Image:
        """Return the last rendered image that the object's camera has delivered."""


@runtime_checkable
class NamesProgram(Protocol):
    """A world that is a user's program."""

    def provenance_of(self, made: Provenance) -> Provenance:
        """Return the provenance of a run, with the name, version and hash of the program."""


def overshoot_radps(before_radps: ArrayN, own_radps: NDArray[np.float64]) -> ArrayN:
    """Return by how much the joint speeds leave a range during a tick.

    The range of a joint lies between its speed at the start of the tick and its speed at the end.

    Args:
        before_radps: The speeds (n,) at the tick's start.
        own_radps: The speeds (m, n) after each sub-step.

    Returns:
        The excess of the speeds (n,) over that range. It is 0 if the motors reached their set points in the
            first sub-step.

    """
    if not np.abs(own_radps - own_radps[-1]).max() > UNNOTICED_RADPS:
        return np.zeros(len(before_radps))
    ends_radps = np.stack([before_radps, own_radps[-1]])
    above = own_radps.max(axis=0) - ends_radps.max(axis=0)
    below = ends_radps.min(axis=0) - own_radps.min(axis=0)
    return np.asarray(np.maximum(np.maximum(above, below), 0.0))


def refuse_rendered(scenario: Scenario, world: str) -> None:
    """Raise ``InadmissibleError`` if the scenario needs rendered images.

    ``world`` is the name of a world that cannot make such images.
    """
    settings = scenario.settings
    rendered = {
        "camera.source": settings.camera.source is ImageSource.RENDERED,
        "hand sensor.detector": settings.hand_sensor.detector is DetectorKind.RENDERED,
    }
    for key, is_rendered in rendered.items():
        if is_rendered:
            expected = f"exact or raster images in the {world} world, which has no renderer"
            hint = "the PyBullet world renders"
            raise InadmissibleError(place=scenario.place(key), expected=expected, got="rendered", hint=hint)


class RecordedWorld:
    """The common part of all worlds whose state is in ``WorldRecords``.

    This part has the clock, the truth and exact cameras. A subclass adds its ``name`` and its ``step``. The
    constructor raises ``InadmissibleError`` for a scenario with rendered images, unless ``renders`` is True.
    """

    name: str
    renders = False

    def __init__(
        self,
        scenario: Scenario,
        arm: ArmModel,
        joint_position_rad: ArrayN,
        *,
        detector: BoundingBoxDetector | None = None,
    ) -> None:
        if not self.renders:
            refuse_rendered(scenario, self.name)
        self.records = world_records(scenario, arm, joint_position_rad)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    def close(self) -> None:
        """Release the world's resources.

        A second call has no effect.
        """

    @property
    def time_s(self) -> float:
        """The start of the coming control tick [s]."""
        return now_s(self.records.clock)

    @property
    def acted_faults(self) -> int:
        """The faults that have acted since the last observation, as bits."""
        return int(self.records.clock[0]["acted_faults"])

    def true_state(self, tick: NDArray[np.void]) -> None:
        """Write the truth part of ``tick`` (1,), which is a record TICK.

        The controller fills the remaining part.
        """
        tick.view(self.records.truth.dtype)[0] = self.records.truth[0]

    def observe(self) -> NDArray[np.void]:
        """Let the cameras take each frame that is due, and deliver each frame that has arrived.

        Encoders are exact.
        """
        sense(*self.records[4:])
        return self.records.observation
