"""Define a seeded fault: its name, the hazard that it stands for, and a ladder of magnitudes.

A file of faults declares each fault beside the function that makes it, by two decorators:

    @of_motion("overspeed", "the arm is faster than commanded: people cannot step back in time")
    @seeded(commanded, (4.0, 1.5, 1.1, 1.02), "times")
    def _faster(factor: float, command: Records) -> None:
        command[0]["joint_velocity_radps"] *= factor

``seeded`` states the place of the change, here the commands to the arm. It also states the magnitudes, the
worst first, and their unit for people. A fault without magnitudes is either present or absent. The decorator
of the faulty part makes a SeededFault, which ``faults_in`` finds in the file.
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
Changing = TypeVar("Changing")  # the change, as a function of its magnitude


class FaultyPart(Enum):
    """The part of the system that contains a fault."""

    AVOIDER = "avoider"
    GATE = "gate"
    PERCEPTION = "perception"
    SERVOING = "servoing"
    MOTION = "motion"
    TIMING = "timing"


@dataclass(frozen=True)
class SeverityLevels:
    """The magnitudes of a fault in SI, the worst first, with their unit or their names for people."""

    values: tuple[float, ...]
    unit: str = ""
    per_si: float = 1.0
    names: tuple[str, ...] = ()

    def label(self, value: float) -> str:
        """Return the text that shows the magnitude ``value`` to people."""
        if self.names:
            return self.names[self.values.index(value)]
        number = f"{value * self.per_si:.4g}"
        return f"{number} {self.unit}" if self.unit else number


ONLY = SeverityLevels((1.0,), names=("there",))  # for a fault that is either present or absent


@dataclass(frozen=True, eq=False)
class Precondition:
    """A change that is made to both the faulty and the sound system."""

    name: str
    bring_about: Callable[[ChangedSystem], ChangedSystem]


BEHIND_A_SHIELD = "behind a shield alone"
AS_USUAL = Precondition("as it is", lambda system: system)


@dataclass(frozen=True, eq=False)
class SeededFault:
    """A mistake that an engineer could make, and that can hurt people or prevent the task.

    ``seed_into`` takes a sound system and a magnitude of the ``ladder``, and returns the faulty system. Both
    systems run under the precondition ``circumstance``. ``of_spread`` states that the fault does not apply to
    an avoider without a spread, ``of_filter`` that it applies only to a system with a user's safety filter.

    ``harmless`` is the reason, stated beforehand, why the change cannot matter; a violation that it causes is
    a false alarm. ``limit`` is the reason, stated beforehand, why no claim can catch the fault.
    """

    part: FaultyPart
    name: str
    hazard: str
    seed_into: Seeds
    ladder: SeverityLevels = ONLY
    circumstance: Precondition = AS_USUAL
    of_spread: bool = False
    of_filter: bool = False
    harmless: str = ""
    limit: str = ""


Graded = tuple[Seeds, SeverityLevels]


def seeded(
    where: Callable[[Changing], Seeds],
    values: tuple[float, ...] = (),
    unit: str = "",
    per_si: float = 1.0,
    names: tuple[str, ...] = (),
) -> Callable[[Changing], Graded]:
    """Decorate a change with the place ``where`` it is seeded, and with its magnitudes.

    Without ``values``, the magnitudes are ``ONLY``.
    """
    ladder = SeverityLevels(values, unit, per_si, names) if values else ONLY
    return lambda change: (where(change), ladder)


def fault_of(
    part: FaultyPart, name: str, hazard: str, circumstance: Precondition = AS_USUAL, of_spread: bool = False
) -> Callable[[Graded], SeededFault]:
    """Return a decorator that makes a SeededFault from a ``seeded`` change."""
    return lambda graded: SeededFault(part, name, hazard, *graded, circumstance, of_spread)


of_avoider = partial(fault_of, FaultyPart.AVOIDER)
of_gate = partial(fault_of, FaultyPart.GATE)
of_motion = partial(fault_of, FaultyPart.MOTION)
of_perception = partial(fault_of, FaultyPart.PERCEPTION)
of_servoing = partial(fault_of, FaultyPart.SERVOING)
of_timing = partial(fault_of, FaultyPart.TIMING)


def declared(*, harmless: str = "", limit: str = "") -> Callable[[SeededFault], SeededFault]:
    """Return a decorator that states beforehand why a fault cannot matter, or why no claim can catch it."""
    return lambda fault: replace(fault, harmless=harmless, limit=limit)


def faults_in(file: Mapping[str, object]) -> tuple[SeededFault, ...]:
    """Return the faults that a file declares, in their order there; ``file`` holds the file's globals."""
    return tuple(fault for fault in file.values() if isinstance(fault, SeededFault))


def anywhere(seeds: Seeds) -> Seeds:
    """Seed a fault that is a function of the whole system."""
    return seeds


def minds_nobody(records: ControllerRecords) -> None:
    """Let the visual servo ignore all hands."""
    records.parameters["critical_distance_m"] = 0.0


def known(edit: Callable[[ControllerRecords, float], None]) -> Seeds:
    """Seed a fault that changes the records that the controller takes as given."""
    return lambda system, magnitude: system.with_records(lambda records: edit(records, magnitude))


def seen(change: Callable[[Admitted, float, Records], None]) -> Seeds:
    """Seed a fault that changes each observation, independently of earlier observations."""
    return seeing(lambda magnitude, admitted: _in_place(partial(change, admitted, magnitude)))


def seeing(make: Callable[[float, Admitted], Change]) -> Seeds:
    """Seed a fault that changes the observations.

    ``make`` creates a new change for each run; the change may remember earlier observations.
    """
    return lambda system, magnitude: system.seeing(partial(make, magnitude))


def commanded(change: Callable[[float, Records], None]) -> Seeds:
    """Seed a fault that changes each command, independently of earlier commands."""
    return obeying(lambda magnitude, _: _in_place(partial(change, magnitude)))


def obeying(make: Callable[[float, Admitted], Change]) -> Seeds:
    """Seed a fault that changes the commands.

    ``make`` creates a new change for each run; the change may remember earlier commands.
    """
    return lambda system, magnitude: system.obeying(partial(make, magnitude))


def _in_place(change: Callable[[Records], None]) -> Change:
    def changed(records: Records) -> Records:
        change(records)
        return records

    return changed
