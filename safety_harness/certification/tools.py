"""What is known of the tools: agreement of the worlds, step sizes, oracles, seeded faults, coverage."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum


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
class Credibility:
    """Why a number from the simulator may be believed; ``absent`` says what was not measured, and why."""

    agreement: WorldAgreement | None
    reruns: tuple[Rerun, ...]
    oracles: tuple[Oracle, ...]
    oracles_measured_with: str
    absent: tuple[str, ...]


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
class CellCount:
    """Runs in one cell of the coverage map; ``violating`` ones violate a claim."""

    direction: str
    speed: str
    distance: str
    seen: str
    outcome: str
    runs: int
    violating: int


@dataclass(frozen=True, kw_only=True)
class CoverageOfRuns:
    """Where the declared runs were, by approach, speed, distance, seen or unseen, outcome."""

    runs: int
    without_hand: int
    cells: tuple[CellCount, ...]
    about: str
