"""What every world offers to the loop of ``simulate``: a truth, an observation and a step."""

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


class World(Protocol):
    """One episode of one scenario; used once, closed on every path (a context manager)."""

    @property
    def name(self) -> str:
        """How traces and reports call it."""

    @property
    def time_s(self) -> float:
        """Now: the start of the coming control tick."""

    @property
    def acted_faults(self) -> int:
        """Bits of the scenario's faults that acted since the last observation was asked for."""

    def true_state(self, tick: NDArray[np.void]) -> None:
        """Write the truth into ``tick`` (1,) TICK."""

    def observe(self) -> NDArray[np.void]:
        """(1,) OBSERVATION: what the sensors have delivered by now."""

    def step(self, command: NDArray[np.void]) -> bool:
        """Obey ``command`` (1,) COMMAND for one control period; True while the brakes act."""


class BatchWorld(World, Protocol):
    """A world in which many episodes run together: each to its next decision, then all are decided."""

    def advance(
        self, controller: ControllerRecords, ticks: NDArray[np.void], decided: bool
    ) -> NDArray[np.void] | None:
        """On to the next decision, with its (1,) OBSERVATION, or to the end (None).

        Writes ``ticks`` (n,) TICK.  ``decided``: the run stands at a decision, which the controller has made.
        """


@runtime_checkable
class ShowsImages(Protocol):
    """A world with a renderer."""

    def image(self) -> Image:
        """The last rendered image of the object's camera that was delivered by now."""


def refuse_rendered(scenario: Scenario, world: str) -> None:
    """InadmissibleError for what only a world with a renderer can do, and ``world`` has none."""
    settings = scenario.settings
    rendered = {
        "camera.source": settings.camera.source is ImageSource.RENDERED,
        "hand sensor.detector": settings.hand_sensor.detector is DetectorKind.RENDERED,
    }
    for key, asked in rendered.items():
        if asked:
            expected = f"exact or raster images in the {world} world, which has no renderer"
            hint = "the PyBullet world renders"
            raise InadmissibleError(place=scenario.place(key), expected=expected, got="rendered", hint=hint)


class RecordedWorld:
    """What worlds share whose state is in ``WorldRecords``: clock, truth, exact cameras, nothing to close.

    A world adds its ``name`` and its ``step``.  InadmissibleError for rendered images unless it ``renders``.
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
        """Give back what the world holds; a second call does nothing."""

    @property
    def time_s(self) -> float:
        """The start of the coming control tick."""
        return now_s(self.records.clock)

    @property
    def acted_faults(self) -> int:
        """Bits of the scenario's faults that have acted on this tick's pictures and, after it, its step."""
        return int(self.records.clock[0]["acted_faults"])

    def true_state(self, tick: NDArray[np.void]) -> None:
        """Write the truth part of ``tick``; the rest is the controller's to fill.  ``tick`` (1,) TICK."""
        tick.view(self.records.truth.dtype)[0] = self.records.truth[0]

    def observe(self) -> NDArray[np.void]:
        """Let the cameras take what is due and deliver what has arrived; encoders are exact."""
        sense(*self.records[4:])
        return self.records.observation
