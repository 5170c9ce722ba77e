"""What is known of the tools: agreement of the worlds, step sizes, oracles, seeded faults, coverage."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class Agreement:
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
class StepSize:
    """Declared random runs of this plan made again with smaller physics steps.

    ``changed`` counts verdicts that differ; ``largest`` are (claim, the largest change of its margin).
    """

    runs: int
    substeps: int
    finer_substeps: int
    verdicts: int
    changed: int
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

    agreement: Agreement | None
    step_size: StepSize | None
    oracles: tuple[Oracle, ...]
    oracles_measured_with: str
    absent: tuple[str, ...]


@dataclass(frozen=True, kw_only=True)
class Fault:
    """One seeded fault, and what caught it; ``caught_by`` is empty for one that survived."""

    name: str
    part: str
    hazard: str
    caught_by: str
    smallest: str


@dataclass(frozen=True, kw_only=True)
class SelfTest:
    """The harness on trial: faults that were seeded into the system, and whether they were caught."""

    profile: str
    faults: tuple[Fault, ...]
    false_alarms: tuple[str, ...]
    source_hash: str
    present: bool

    @property
    def caught(self) -> int:
        """How many were."""
        return sum(bool(fault.caught_by) for fault in self.faults)


@dataclass(frozen=True, kw_only=True)
class CellCount:
    """Runs in one cell of the coverage map."""

    direction: str
    speed: str
    distance: str
    seen: str
    outcome: str
    runs: int


@dataclass(frozen=True, kw_only=True)
class Coverage:
    """Where the declared random runs were, by approach, speed, distance, seen or unseen, outcome."""

    runs: int
    without_hand: int
    cells: tuple[CellCount, ...]
    about: str
