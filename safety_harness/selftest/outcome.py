"""What became of one fault on trial, and of all of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum

from safety_harness.selftest.fault import Fault
from safety_harness.selftest.trial import Alarm, Rung


class State(Enum):
    """What the trial of a fault says."""

    CAUGHT = "caught"
    SURVIVES = "survives"
    LIMIT = "a stated limit"
    UNTOUCHED = "does not apply"
    QUIET = "quiet"  # a harmless one, as it should be
    FALSE_ALARM = "false alarm"
    TRUE_ALARM = "true alarm"  # about a change that was declared harmless: geometry confirms it


@dataclass(frozen=True, kw_only=True)
class Outcome:
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
    def state(self) -> State:
        """Caught means: at its gravest magnitude at least."""
        caught = bool(self.rungs) and self.rungs[0].caught
        if not self.applies:
            return State.UNTOUCHED
        if self.harmless:
            return self._harmless_state
        if caught:
            return State.CAUGHT
        return State.LIMIT if self.limit else State.SURVIVES

    @property
    def _harmless_state(self) -> State:
        alarms = [alarm for rung in self.rungs for alarm in rung.alarms]
        contradicted = any(rung.geometry.contradicted for rung in self.rungs if rung.geometry)
        if contradicted or not all(alarm.true for alarm in alarms):
            return State.FALSE_ALARM
        return State.TRUE_ALARM if alarms else State.QUIET

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


def outcome_of(fault: Fault, rungs: Sequence[Rung], *, applies: bool = True) -> Outcome:
    """What a fault's rungs say of it."""
    return Outcome(
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
class Tally:
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


def tally_of(outcomes: Sequence[Outcome]) -> Tally:
    """Count."""
    states = [one.state for one in outcomes]
    tried = [rung for one in outcomes if not one.harmless for rung in one.rungs]
    geometries = [rung.geometry for one in outcomes for rung in one.rungs if rung.geometry]
    caught, survivors = states.count(State.CAUGHT), states.count(State.SURVIVES)
    limits = states.count(State.LIMIT)
    return Tally(
        faults=caught + survivors + limits,
        caught=caught,
        survivors=survivors,
        limits=limits,
        rungs=len(tried),
        rungs_caught=sum(rung.caught for rung in tried),
        harmless=sum(map(states.count, (State.QUIET, State.FALSE_ALARM, State.TRUE_ALARM))),
        false_alarms=states.count(State.FALSE_ALARM),
        true_alarms=states.count(State.TRUE_ALARM),
        unconfirmed=sum(one.confirmed is False for one in outcomes),
        geometry_runs=sum(one.runs for one in geometries),
        geometry_contradicted=sum(len(one.contradicted) for one in geometries),
    )
