"""Evidence on the tools: agreement of the worlds, step sizes, oracles, seeded faults, coverage.

The results of the self-test and of the independent oracles come from files. The self-test uses seeded faults.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum
from pathlib import Path
from typing import Annotated

from msgspec import Meta

from safety_harness.base.compiled import source_hash
from safety_harness.base.exceptions import InputError, Place
from safety_harness.base.shipped.contents import located
from safety_harness.extensions.field.recorded.compare import CellComparison, read_comparison
from safety_harness.scenario.typed_json import of_format, read_json, typed
from safety_harness.search.coverage import CoverageCell
from safety_harness.trace.system import SystemUnderTest


@dataclass(frozen=True, kw_only=True)
class WorldAgreement:
    """The kinematic world beside PyBullet on the same scenarios.

    ``optimistic`` counts the disagreements in which a claim holds in the kinematic world and is violated in
    PyBullet. ``present`` is true if the source of the measurement is that of this report.
    """

    scenarios: int
    verdicts: int
    disagreements: int
    optimistic: int
    differences: tuple[tuple[str, str], ...]  # quantity, its largest difference
    source_hash: str
    present: bool


@dataclass(frozen=True, kw_only=True)
class Rerun:
    """Declared random runs of this plan, repeated with one change: smaller physics steps, or another world.

    ``changed`` counts the verdicts that differ.  ``optimistic`` counts the changes from holds to violated.
    ``largest`` has (claim, the largest change of its margin), and how far the joints are apart.
    """

    place: str
    title: str
    how: str
    runs: int
    verdicts: int
    changed: int
    optimistic: int
    largest: tuple[tuple[str, str], ...]


@dataclass(frozen=True, kw_only=True)
class Oracle:
    """A part with its comparison against independent software."""

    part: str
    against: str
    largest: str


@dataclass(frozen=True, kw_only=True)
class RecordedCell:
    """Both worlds beside the log of a real cell.

    ``present`` is true if the source of the runs is that of this report.  ``sha256`` is the hash of the file
    that ``compare-worlds`` wrote.
    """

    comparison: CellComparison
    sha256: str
    present: bool

    def foreign_to(self, tested: Sequence[SystemUnderTest]) -> str:
        """Return the differences between the cell's system and the nearest system in ``tested``.

        Parts of a system are compared by their hashes. The text is empty if the cell's system is in
        ``tested``.
        """
        own = self.comparison.system
        if own is None:
            return "which arm, controller and settings it is of is not noted; write it again"
        changes = sorted((list(own.changes(system)) for system in tested), key=len)
        return "; ".join(changes[0]) if changes else "no system is tested"

    @property
    def decided(self) -> int:
        """The number of verdicts that both the log and the run decide."""
        return sum(claim.decided for claim in self.comparison.claims)

    @property
    def differing(self) -> int:
        """The number of decided verdicts in which log and run differ."""
        return sum(claim.differs for claim in self.comparison.claims)

    @property
    def optimistic(self) -> int:
        """The number of claims that hold in simulation and were violated in the cell."""
        return sum(claim.optimistic for claim in self.comparison.claims)


@dataclass(frozen=True, kw_only=True)
class Credibility:
    """The reasons to believe a number from the simulator.

    ``absent`` has each missing measurement with its reason.
    """

    agreement: WorldAgreement | None
    reruns: tuple[Rerun, ...]
    oracles: tuple[Oracle, ...]
    oracles_measured_with: str
    absent: tuple[str, ...]
    cells: tuple[RecordedCell, ...] = ()


class FaultState(Enum):
    """What happened to a seeded fault in the self-test."""

    CAUGHT = "caught"
    SURVIVES = "survives"
    LIMIT = "a stated limit"
    UNTOUCHED = "does not apply"
    QUIET = "quiet"  # a harmless change without an alarm, as expected
    FALSE_ALARM = "false alarm"
    TRUE_ALARM = "true alarm"  # geometry confirms the alarm about a change that was declared harmless


@dataclass(frozen=True, kw_only=True)
class CaughtFault:
    """A seeded fault and the claim that caught it; ``caught_by`` is empty for a fault that survived.

    ``known_limit`` is the reason for its survival, stated beforehand.
    """

    name: str
    part: str
    hazard: str
    caught_by: str
    smallest: str
    known_limit: str = ""


@dataclass(frozen=True, kw_only=True)
class SelfTest:
    """The self-test of the harness: seeded faults, and whether a claim caught them.

    ``whole`` is true if it covered every fault of the catalogue.  ``present`` is true if its source is that
    of this report.
    """

    profile: str
    faults: tuple[CaughtFault, ...]
    false_alarms: tuple[str, ...]
    source_hash: str
    present: bool
    whole: bool

    @property
    def caught(self) -> int:
        """The number of caught faults."""
        return sum(bool(fault.caught_by) for fault in self.faults)


@dataclass(frozen=True, kw_only=True)
class HarnessTrials:
    """The user's files on the harness itself: self-test, oracles and recorded cells."""

    selftest: SelfTest | None = None
    oracles: tuple[Oracle, ...] = ()
    oracles_with: str = ""
    cells: tuple[RecordedCell, ...] = ()


NO_TRIALS = HarnessTrials()


@dataclass(frozen=True, kw_only=True)
class CellCount(CoverageCell):
    """The runs in a cell of the coverage map; ``violating`` counts the runs that violate a claim."""

    runs: int
    violating: int


@dataclass(frozen=True, kw_only=True)
class CoverageOfRuns:
    """The declared runs by approach, speed, distance, seen or unseen, and outcome."""

    runs: int
    without_hand: int
    cells: tuple[CellCount, ...]
    about: str


FORMAT = "safety-harness selftest 1"
ON_TRIAL = (FaultState.CAUGHT, FaultState.SURVIVES, FaultState.LIMIT)
Difference = Annotated[float, Meta(gt=-1e100, lt=1e100)]


@dataclass(frozen=True)
class _About:
    profile: str
    planned: int
    interrupted: bool
    command: str
    source_hash: str


@dataclass(frozen=True)
class _Fault:
    state: FaultState
    fault: str | None = None
    part: str | None = None
    hazard: str | None = None
    caught_by: str | None = None
    slightest_caught: str | None = None
    limit: str | None = None


@dataclass(frozen=True)
class _Trial:
    about: _About
    faults: tuple[_Fault, ...]


@dataclass(frozen=True)
class _Oracle:
    what: str
    oracle: str
    unit: str
    largest: Difference


def read_selftest(path: Path) -> SelfTest:
    """Read the self-test in ``path``, a selftest.json.

    Raises:
        InputError: The file is no selftest.json, or the self-test has no fault. The error states the wrong
            field.

    """
    trial = typed(
        of_format(read_json(path, "a selftest.json"), FORMAT, path), _Trial, path, further_fields=True
    )
    facts, tried = trial.about, trial.faults
    faults = tuple(_caught(fault) for fault in tried if fault.state in ON_TRIAL)
    if not faults:
        place = Place(file=path, field="faults")
        raise InputError(place=place, expected="at least one fault that was on trial", got="none")
    return SelfTest(
        profile=facts.profile,
        faults=faults,
        false_alarms=tuple(str(fault.fault) for fault in tried if fault.state is FaultState.FALSE_ALARM),
        source_hash=facts.source_hash,
        present=facts.source_hash == source_hash(),
        whole=not facts.interrupted
        and len(tried) >= facts.planned
        and "--fault" not in facts.command.split(),
    )


def read_cell(path: Path) -> RecordedCell:
    """Read ``path``, a file that ``compare-worlds`` wrote.

    Raises:
        InputError: ``compare-worlds`` did not write the file.

    """
    comparison = read_comparison(path)
    data = hashlib.sha256(path.read_bytes()).hexdigest()
    return RecordedCell(comparison=comparison, sha256=data, present=comparison.source_hash == source_hash())


def read_oracles(path: Path) -> tuple[Oracle, ...]:
    """Read ``path``, the table that ``make oracles`` writes.

    Raises:
        InputError: ``make oracles`` did not write the file.

    """
    path = located(path)
    table = typed(read_json(path, "a table of oracles"), list[_Oracle], path, further_fields=True)
    return tuple(
        Oracle(part=row.what, against=row.oracle, largest=f"{row.largest:.2g} {row.unit}") for row in table
    )


def _caught(fault: _Fault) -> CaughtFault:
    caught = fault.state is FaultState.CAUGHT
    return CaughtFault(
        name=fault.fault or "",
        part=fault.part or "",
        hazard=fault.hazard or "",
        caught_by=(fault.caught_by or "an unnamed claim") if caught else "",
        smallest=fault.slightest_caught or "",
        known_limit=fault.limit or "",
    )
