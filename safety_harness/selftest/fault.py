"""What a seeded fault is: a name, the hazard it stands for, and a ladder of magnitudes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum

from safety_harness.selftest.system import ChangedSystem

Seeds = Callable[[ChangedSystem, float], ChangedSystem]


class FaultyPart(Enum):
    """Where in the system a fault sits."""

    AVOIDER = "avoider"
    GATE = "gate"
    PERCEPTION = "perception"
    SERVOING = "servoing"
    MOTION = "motion"
    TIMING = "timing"


@dataclass(frozen=True)
class SeverityLevels:
    """Magnitudes in SI, the gravest first, and how people read them: with a unit, or each by its name."""

    values: tuple[float, ...]
    unit: str = ""
    per_si: float = 1.0
    names: tuple[str, ...] = ()

    def words(self, value: float) -> str:
        """One of them for people."""
        if self.names:
            return self.names[self.values.index(value)]
        number = f"{value * self.per_si:.4g}"
        return f"{number} {self.unit}" if self.unit else number


ONLY = SeverityLevels((1.0,), names=("there",))  # a fault that is there or not


@dataclass(frozen=True, eq=False)
class Precondition:
    """What the faulty and the sound system have in common beside the scenario."""

    name: str
    bring_about: Callable[[ChangedSystem], ChangedSystem]


AS_IT_IS = Precondition("as it is", lambda system: system)


@dataclass(frozen=True, eq=False, kw_only=True)
class SeededFault:
    """A mistake that somebody could make, and that hurts somebody or ends the task.

    ``seed_into`` a sound system, with a magnitude of the ``ladder``, gives the faulty one.  Both are
    tried in ``circumstance``.  ``of_spread``: it does not apply to an avoider that states none.
    ``harmless``: why it cannot matter, said beforehand; whatever is violated with it is a false alarm.
    ``limit``: why nothing here can catch it, said beforehand.
    """

    name: str
    part: FaultyPart
    hazard: str
    seed_into: Seeds
    ladder: SeverityLevels = ONLY
    circumstance: Precondition = AS_IT_IS
    of_spread: bool = False
    harmless: str = ""
    limit: str = ""
