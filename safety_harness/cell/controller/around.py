"""Define the base class of controllers that wrap another controller."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from safety_harness.cell.controller.controller import AvoidingServo


class ControllerWrapper:
    """A controller that passes every call to its ``pilot``.

    A subclass overrides some of the methods.
    """

    def __init__(self, pilot: AvoidingServo) -> None:
        self.pilot = pilot
        self.name = pilot.name

    def step(self, observation: NDArray[np.void]) -> NDArray[np.void]:
        """Return the pilot's command.

        ``observation`` (1,) is a record OBSERVATION.
        """
        return self.pilot.step(observation)

    def report(self, tick: NDArray[np.void]) -> None:
        """Let the pilot write into the record of a tick.

        ``tick`` (1,) is a record TICK.
        """
        self.pilot.report(tick)

    @property
    def decisions(self) -> NDArray[np.void]:
        """The pilot's decisions."""
        return self.pilot.decisions

    @property
    def predicted(self) -> NDArray[np.void]:
        """The pilot's predicted sets of hands."""
        return self.pilot.predicted

    @property
    def interventions(self) -> NDArray[np.void]:
        """The pilot's interventions."""
        return self.pilot.interventions

    @property
    def decision_latencies_s(self) -> NDArray[np.float64]:
        """The latencies [s] of the pilot's decisions."""
        return self.pilot.decision_latencies_s
