"""What is known of the tools: agreement of the worlds, step sizes, oracles, seeded faults, coverage.

The trial of the harness on seeded faults, and its independent oracles, are read from files.
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
    """The kinematic world against PyBullet on the same scenarios.

    ``optimistic`` disagreements are those in which the kinematic world sees a claim hold that PyBullet sees
    violated.  ``present``: measured with the very source that made this report.
    """

    scenarios: int
    verdicts: int
    disagreements: int
    optimistic: int
    differences: tuple[tuple[str, str], ...]  # what, the largest
    source_hash: str
    present: bool


@dataclass(frozen=True, kw_only=True)
class Rerun:
    """Declared random runs of this plan made again with something else: smaller physics steps, another world.

    ``changed`` counts verdicts that differ; ``optimistic`` those of them in which the rerun sees a claim
    violated that the plan's own run sees hold.  ``largest`` are (claim, the largest change of its margin).
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
    """One part checked against software that we did not write."""

    part: str
    against: str
    largest: str


@dataclass(frozen=True, kw_only=True)
class RecordedCell:
    """Both worlds beside the log of a real cell; ``present``: run with the very source of this report.

    ``sha256`` is of the file that ``compare-worlds`` wrote.
    """

    comparison: CellComparison
    sha256: str
    present: bool

    def foreign_to(self, tested: Sequence[SystemUnderTest]) -> str:
        """Say what of its system is in none of ``tested``, by hash; empty if one of them is its system."""
        own = self.comparison.system
        if own is None:
            return "which arm, controller and settings it is of is not noted; write it again"
        changes = sorted((list(own.changes(one)) for one in tested), key=len)
        return "; ".join(changes[0]) if changes else "no system is tested"

    @property
    def decided(self) -> int:
        """Verdicts that log and run both decide."""
        return sum(one.decided for one in self.comparison.claims)

    @property
    def differing(self) -> int:
        """Those of them that contradict each other."""
        return sum(one.differs for one in self.comparison.claims)

    @property
    def optimistic(self) -> int:
        """Those in which a claim holds in simulation that was violated in the cell."""
        return sum(one.optimistic for one in self.comparison.claims)


@dataclass(frozen=True, kw_only=True)
class Credibility:
    """Why a number from the simulator may be believed; ``absent`` says what was not measured, and why."""

    agreement: WorldAgreement | None
    reruns: tuple[Rerun, ...]
    oracles: tuple[Oracle, ...]
    oracles_measured_with: str
    absent: tuple[str, ...]
    cells: tuple[RecordedCell, ...] = ()


class FaultState(Enum):
    """What the trial of a fault says."""

    CAUGHT = "caught"
    SURVIVES = "survives"
    LIMIT = "a stated limit"
    UNTOUCHED = "does not apply"
    QUIET = "quiet"  # a harmless one, as it should be
    FALSE_ALARM = "false alarm"
    TRUE_ALARM = "true alarm"  # about a change that was declared harmless: geometry confirms it


@dataclass(frozen=True, kw_only=True)
class CaughtFault:
    """One seeded fault, and what caught it; ``caught_by`` is empty for one that survived.

    ``known_limit`` is why it survives, where that was said beforehand.
    """

    name: str
    part: str
    hazard: str
    caught_by: str
    smallest: str
    known_limit: str = ""


@dataclass(frozen=True, kw_only=True)
class SelfTest:
    """The harness on trial: faults that were seeded into the system, and whether they were caught.

    ``whole``: every fault of the catalogue was tried.
    """

    profile: str
    faults: tuple[CaughtFault, ...]
    false_alarms: tuple[str, ...]
    source_hash: str
    present: bool
    whole: bool

    @property
    def caught(self) -> int:
        """How many were."""
        return sum(bool(fault.caught_by) for fault in self.faults)


@dataclass(frozen=True, kw_only=True)
class HarnessTrials:
    """What is known of the harness itself, where files of it were given."""

    selftest: SelfTest | None = None
    oracles: tuple[Oracle, ...] = ()
    oracles_with: str = ""
    cells: tuple[RecordedCell, ...] = ()


NO_TRIALS = HarnessTrials()


@dataclass(frozen=True, kw_only=True)
class CellCount(CoverageCell):
    """Runs in one cell of the coverage map; ``violating`` ones violate a claim."""

    runs: int
    violating: int


@dataclass(frozen=True, kw_only=True)
class CoverageOfRuns:
    """Where the declared runs were, by approach, speed, distance, seen or unseen, outcome."""

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
    """InputError, naming the field, for what is no such file, or for one of a trial without any fault."""
    found = typed(of_format(read_json(path, "a selftest.json"), FORMAT, path), _Trial, path, others=True)
    about, tried = found.about, found.faults
    faults = tuple(_caught(one) for one in tried if one.state in ON_TRIAL)
    if not faults:
        place = Place(file=path, field="faults")
        raise InputError(place=place, expected="at least one fault that was on trial", got="none")
    return SelfTest(
        profile=about.profile,
        faults=faults,
        false_alarms=tuple(str(one.fault) for one in tried if one.state is FaultState.FALSE_ALARM),
        source_hash=about.source_hash,
        present=about.source_hash == source_hash(),
        whole=not about.interrupted
        and len(tried) >= about.planned
        and "--fault" not in about.command.split(),
    )


def read_cell(path: Path) -> RecordedCell:
    """What ``compare-worlds`` wrote; InputError for what is none."""
    found = read_comparison(path)
    data = hashlib.sha256(path.read_bytes()).hexdigest()
    return RecordedCell(comparison=found, sha256=data, present=found.source_hash == source_hash())


def read_oracles(path: Path) -> tuple[Oracle, ...]:
    """The table that ``make oracles`` writes; InputError for what is none."""
    path = located(path)
    found = typed(read_json(path, "a table of oracles"), list[_Oracle], path, others=True)
    return tuple(
        Oracle(part=one.what, against=one.oracle, largest=f"{one.largest:.2g} {one.unit}") for one in found
    )


def _caught(one: _Fault) -> CaughtFault:
    caught = one.state is FaultState.CAUGHT
    return CaughtFault(
        name=one.fault or "",
        part=one.part or "",
        hazard=one.hazard or "",
        caught_by=(one.caught_by or "a claim that is not named") if caught else "",
        smallest=one.slightest_caught or "",
        known_limit=one.limit or "",
    )
