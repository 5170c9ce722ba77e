"""An avoider around another: the base of those that change what it is asked or what it answers."""

from __future__ import annotations

from dataclasses import dataclass

from safety_harness.avoidance.avoider import Avoider, decision_time_of, spread_threshold_of


@dataclass(frozen=True, eq=False)
class AvoiderAround:
    """Everything as the ``avoider`` has it but ``propose``, which those that inherit give."""

    avoider: Avoider

    @property
    def name(self) -> str:
        """The avoider's own."""
        return self.avoider.name

    @property
    def spread_threshold_m(self) -> float | None:
        """The avoider's own; AvoiderError as there."""
        return spread_threshold_of(self.avoider)

    @property
    def decision_time_s(self) -> float:
        """The avoider's own; AvoiderError as there."""
        return decision_time_of(self.avoider)
