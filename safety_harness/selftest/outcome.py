"""What became of one fault on trial, and of all of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from safety_harness.certification.tools import FaultState
from safety_harness.selftest.fault import SeededFault
from safety_harness.selftest.trial import Alarm, Rung


@dataclass(frozen=True, kw_only=True)
class FaultOutcome:
    """One fault's rungs, the gravest first; for a harmless one the alarms, of which there should be none.

    ``limit``: why nothing here can catch it, said beforehand.
    """

    fault: str
    part: str
    hazard: str
    circumstance: str
    harmless: str
    rungs: tuple[Rung, ...]
    slightest: str  # the last magnitude of the ladder, in words
    limit: str = ""
    applies: bool = True

    @property
    def state(self) -> FaultState:
        """Caught means: at its gravest magnitude at least."""
        caught = bool(self.rungs) and self.rungs[0].caught
        if not self.applies:
            return FaultState.UNTOUCHED
        if self.harmless:
            return self._harmless_state
        if caught:
            return FaultState.CAUGHT
        return FaultState.LIMIT if self.limit else FaultState.SURVIVES

    @property
    def _harmless_state(self) -> FaultState:
        alarms = [alarm for rung in self.rungs for alarm in rung.alarms]
        contradicted = any(rung.geometry.contradicted for rung in self.rungs if rung.geometry)
        if contradicted or not all(alarm.true for alarm in alarms):
            return FaultState.FALSE_ALARM
        return FaultState.TRUE_ALARM if alarms else FaultState.QUIET

    @property
    def smallest(self) -> Rung | None:
        """The slightest magnitude that was caught, down to the first that was not."""
        caught = [rung for rung in self.rungs if rung.caught]
        return caught[-1] if caught else None

    @property
    def survivor(self) -> Rung | None:
        """The magnitude that nothing caught, if there is one."""
        return next((rung for rung in self.rungs if not rung.caught), None)

    @property
    def alarm(self) -> Alarm | None:
        """The first one at the slightest magnitude caught."""
        smallest = self.smallest
        return smallest.alarms[0] if smallest else None

    @property
    def confirmed(self) -> bool | None:
        """Does PyBullet say so as well?"""
        smallest = self.smallest
        return smallest.confirmed if smallest else None


def outcome_of(fault: SeededFault, rungs: Sequence[Rung], *, applies: bool = True) -> FaultOutcome:
    """What a fault's rungs say of it."""
    return FaultOutcome(
        fault=fault.name,
        part=fault.part.value,
        hazard=fault.hazard,
        circumstance=fault.circumstance.name,
        harmless=fault.harmless,
        limit=fault.limit,
        rungs=tuple(rungs),
        slightest=fault.ladder.words(fault.ladder.values[-1]),
        applies=applies,
    )


@dataclass(frozen=True, kw_only=True)
class SelfTestTally:
    """The figures of a whole trial.

    ``geometry_runs`` with harmless changes were judged by PyBullet's geometry as well, to the contrary of our
    word on the hand distance in ``geometry_contradicted`` of them.
    """

    faults: int
    caught: int
    survivors: int
    limits: int
    rungs: int
    rungs_caught: int
    harmless: int
    false_alarms: int
    true_alarms: int
    unconfirmed: int
    geometry_runs: int
    geometry_contradicted: int

    @property
    def kill_rate(self) -> float:
        """Faults caught, of those that apply."""
        return self.caught / self.faults if self.faults else 0.0


def tally_of(outcomes: Sequence[FaultOutcome]) -> SelfTestTally:
    """Count."""
    states = [one.state for one in outcomes]
    tried = [rung for one in outcomes if not one.harmless for rung in one.rungs]
    geometries = [rung.geometry for one in outcomes for rung in one.rungs if rung.geometry]
    caught, survivors = states.count(FaultState.CAUGHT), states.count(FaultState.SURVIVES)
    limits = states.count(FaultState.LIMIT)
    return SelfTestTally(
        faults=caught + survivors + limits,
        caught=caught,
        survivors=survivors,
        limits=limits,
        rungs=len(tried),
        rungs_caught=sum(rung.caught for rung in tried),
        harmless=sum(map(states.count, (FaultState.QUIET, FaultState.FALSE_ALARM, FaultState.TRUE_ALARM))),
        false_alarms=states.count(FaultState.FALSE_ALARM),
        true_alarms=states.count(FaultState.TRUE_ALARM),
        unconfirmed=sum(one.confirmed is False for one in outcomes),
        geometry_runs=sum(one.runs for one in geometries),
        geometry_contradicted=sum(len(one.contradicted) for one in geometries),
    )
