"""Define a seeded fault, which has a name, a hazard, and a list of magnitudes (the ladder).

In a file of faults, a fault is a function with two decorators. The function makes the change, and the
decorators declare the fault:

    @of_motion("overspeed", "the arm is faster than commanded: people cannot step back in time")
    @seeded(commanded, (4.0, 1.5, 1.1, 1.02), "times")
    def _faster(factor: float, command: Records) -> None:
        command[0]["joint_velocity_radps"] *= factor

In this example, the argument ``commanded`` of ``seeded`` puts the change into the commands to the arm. The
other arguments of ``seeded`` are the magnitudes, beginning with the worst, and the unit in which texts show
them. A fault without magnitudes is either present or absent. The decorator of the faulty part returns a
SeededFault, and ``faults_in`` collects the SeededFaults of the file.
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
    """The magnitudes of a fault in SI units, beginning with the worst.

    Texts show a magnitude either with ``unit`` or by its name in ``names``.
    """

    values: tuple[float, ...]
    unit: str = ""
    per_si: float = 1.0
    names: tuple[str, ...] = ()

    def label(self, value: float) -> str:
        """Return the text for the magnitude ``value``: its name, or the number with its unit."""
        if self.names:
            return self.names[self.values.index(value)]
        number = f"{value * self.per_si:.4g}"
        return f"{number} {self.unit}" if self.unit else number


ONLY = SeverityLevels((1.0,), names=("there",))  # for a fault that is either present or absent


@dataclass(frozen=True, eq=False)
class Precondition:
    """A change that applies to both the faulty and the sound system."""

    name: str
    bring_about: Callable[[ChangedSystem], ChangedSystem]


BEHIND_A_SHIELD = "behind a shield alone"
AS_USUAL = Precondition("as it is", lambda system: system)


@dataclass(frozen=True, eq=False)
class SeededFault:
    """A mistake that an engineer could make and that can hurt people or prevent the task.

    ``seed_into`` takes a sound system and a magnitude of the ``ladder``, and returns the faulty system. The
    precondition ``circumstance`` applies to the runs of both systems. If ``of_spread`` is true, the fault
    applies only to an avoider with a spread. If ``of_filter`` is true, it applies only to a system with a
    user's safety filter.

    ``harmless`` is empty for a fault. For a harmless change, it is the reason why the change cannot matter. A
    violation that such a change causes is a false alarm. ``limit`` is the reason why no claim can catch the
    fault, or empty if a claim should catch it. Both reasons are written before the fault is tried.
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
    """Return a decorator that adds the magnitudes and the place of a change.

    The place ``where`` is the part of the system into which the change is seeded. Without ``values``, the
    magnitudes are ``ONLY``.
    """
    ladder = SeverityLevels(values, unit, per_si, names) if values else ONLY
    return lambda change: (where(change), ladder)


def fault_of(
    part: FaultyPart, name: str, hazard: str, circumstance: Precondition = AS_USUAL, of_spread: bool = False
) -> Callable[[Graded], SeededFault]:
    """Return a decorator that makes a SeededFault from a change with the decorator ``seeded``."""
    return lambda graded: SeededFault(part, name, hazard, *graded, circumstance, of_spread)


of_avoider = partial(fault_of, FaultyPart.AVOIDER)
of_gate = partial(fault_of, FaultyPart.GATE)
of_motion = partial(fault_of, FaultyPart.MOTION)
of_perception = partial(fault_of, FaultyPart.PERCEPTION)
of_servoing = partial(fault_of, FaultyPart.SERVOING)
of_timing = partial(fault_of, FaultyPart.TIMING)


def declared(*, harmless: str = "", limit: str = "") -> Callable[[SeededFault], SeededFault]:
    """Return a decorator that states beforehand why a fault cannot matter or why no claim can catch it."""
    return lambda fault: replace(fault, harmless=harmless, limit=limit)


def faults_in(file: Mapping[str, object]) -> tuple[SeededFault, ...]:
    """Return the faults in a file of faults, in the order in which the file declares them.

    ``file`` is the dictionary of the file's global names.
    """
    return tuple(fault for fault in file.values() if isinstance(fault, SeededFault))


def anywhere(seeds: Seeds) -> Seeds:
    """Seed a fault that may change any part of the system."""
    return seeds


def minds_nobody(records: ControllerRecords) -> None:
    """Let the visual servo ignore all hands."""
    records.parameters["critical_distance_m"] = 0.0


def known(edit: Callable[[ControllerRecords, float], None]) -> Seeds:
    """Seed a fault that changes records on which the controller relies."""
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
