"""What every world offers to the loop of ``simulate``: a truth, an observation and a step."""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import NDArray


class World(Protocol):
    """One episode of one scenario; used once, closed on every path (a context manager)."""

    @property
    def name(self) -> str:
        """How traces and reports call it."""
        ...

    @property
    def time_s(self) -> float:
        """Now: the start of the coming control tick."""
        ...

    @property
    def acted_faults(self) -> int:
        """Bits of the scenario's faults that acted since the last observation was asked for."""
        ...

    def true_state(self, tick: NDArray[np.void]) -> None:
        """Write the truth into ``tick`` (1,) TICK."""
        ...

    def observe(self) -> NDArray[np.void]:
        """(1,) OBSERVATION: what the sensors have delivered by now."""
        ...

    def step(self, command: NDArray[np.void]) -> bool:
        """Obey ``command`` (1,) COMMAND for one control period; True while the brakes act."""
        ...
