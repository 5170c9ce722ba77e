"""What a seeded fault is: a name, the hazard it stands for, and a ladder of magnitudes.

A file of faults declares each where it says what is wrong, by two decorators:

    @of_motion("overspeed", "the arm is faster than it is told: nobody can step back in time")
    @seeded(told, (4.0, 1.5, 1.1, 1.02), "times")
    def _faster(factor: float, command: Records) -> None:
        command[0]["joint_velocity_radps"] *= factor

``seeded`` says where the change is made (here in what the arm is told), at which magnitudes, the gravest
first, and how people read them; without magnitudes it is there or not.  The other one, of the part, makes a
SeededFault of it, which ``faults_in`` the file finds.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from enum import Enum
from functools import partial
from typing import TypeVar

from safety_harness.admission.admit import Admitted
from safety_harness.cell.controller.cycle import ControllerRecords
from safety_harness.extensions.selftest.system import Change, ChangedSystem, Records

Seeds = Callable[[ChangedSystem, float], ChangedSystem]
What = TypeVar("What")  # is wrong, as a function of its magnitude


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


@dataclass(frozen=True, eq=False)
class SeededFault:
    """A mistake that somebody could make, and that hurts somebody or ends the task.

    ``seed_into`` a sound system, with a magnitude of the ``ladder``, gives the faulty one.  Both are
    tried in ``circumstance``.  ``of_spread``: it does not apply to an avoider that states none.
    ``harmless``: why it cannot matter, said beforehand; whatever is violated with it is a false alarm.
    ``limit``: why nothing here can catch it, said beforehand.
    """

    part: FaultyPart
    name: str
    hazard: str
    seed_into: Seeds
    ladder: SeverityLevels = ONLY
    circumstance: Precondition = AS_IT_IS
    of_spread: bool = False
    harmless: str = ""
    limit: str = ""


Graded = tuple[Seeds, SeverityLevels]


def seeded(
    where: Callable[[What], Seeds],
    values: tuple[float, ...] = (),
    unit: str = "",
    per_si: float = 1.0,
    names: tuple[str, ...] = (),
) -> Callable[[What], Graded]:
    """Decorates what is wrong, with where it is seeded and the SeverityLevels; ``ONLY`` without values."""
    ladder = SeverityLevels(values, unit, per_si, names) if values else ONLY
    return lambda what: (where(what), ladder)


def fault_of(
    part: FaultyPart, name: str, hazard: str, circumstance: Precondition = AS_IT_IS, of_spread: bool = False
) -> Callable[[Graded], SeededFault]:
    """Makes a fault of what is ``seeded``."""
    return lambda graded: SeededFault(part, name, hazard, *graded, circumstance, of_spread)


of_avoider = partial(fault_of, FaultyPart.AVOIDER)
of_gate = partial(fault_of, FaultyPart.GATE)
of_motion = partial(fault_of, FaultyPart.MOTION)
of_perception = partial(fault_of, FaultyPart.PERCEPTION)
of_servoing = partial(fault_of, FaultyPart.SERVOING)
of_timing = partial(fault_of, FaultyPart.TIMING)


def declared(*, harmless: str = "", limit: str = "") -> Callable[[SeededFault], SeededFault]:
    """Says beforehand why a fault cannot matter, or why nothing here can catch it."""
    return lambda fault: replace(fault, harmless=harmless, limit=limit)


def faults_in(file: Mapping[str, object]) -> tuple[SeededFault, ...]:
    """Those that a file declares, in its order; ``file`` are its globals."""
    return tuple(one for one in file.values() if isinstance(one, SeededFault))


def outright(seeds: Seeds) -> Seeds:
    """Seeded by a function of the whole system."""
    return seeds


def known(edit: Callable[[ControllerRecords, float], None]) -> Seeds:
    """Seeded into what the controller takes for given."""
    return lambda system, magnitude: system.with_records(lambda records: edit(records, magnitude))


def seen(change: Callable[[Admitted, float, Records], None]) -> Seeds:
    """Seeded into each observation by a change that remembers nothing."""
    return seeing(lambda magnitude, admitted: _in_place(partial(change, admitted, magnitude)))


def seeing(make: Callable[[float, Admitted], Change]) -> Seeds:
    """Seeded into the observations by a change that is made afresh for each run."""
    return lambda system, magnitude: system.seeing(partial(make, magnitude))


def told(change: Callable[[float, Records], None]) -> Seeds:
    """Seeded into each command by a change that remembers nothing."""
    return obeying(lambda magnitude, _: _in_place(partial(change, magnitude)))


def obeying(make: Callable[[float, Admitted], Change]) -> Seeds:
    """Seeded into the commands by a change that is made afresh for each run."""
    return lambda system, magnitude: system.obeying(partial(make, magnitude))


def _in_place(change: Callable[[Records], None]) -> Change:
    def changed(records: Records) -> Records:
        change(records)
        return records

    return changed
