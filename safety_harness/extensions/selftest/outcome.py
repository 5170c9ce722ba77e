"""What became of one fault on trial, and of all of them: in figures, and as rows of the kill table."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from safety_harness.extensions.assurance.certification.tools import FaultState
from safety_harness.extensions.selftest.fault import SeededFault
from safety_harness.extensions.selftest.trial import Alarm, Geometry, Rung
from safety_harness.report.words import count_words

HEAD = ("part", "fault", "caught by", "in", "episodes", "slightest caught", "survives", "PyBullet")
HARMLESS_HEAD = ("part", "change", "why it cannot matter", "episodes", "alarms", "hand distance by PyBullet")
NONE = "-"


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


def row(one: FaultOutcome) -> tuple[str, ...]:
    """A fault's row under HEAD."""
    smallest, alarm, survivor = one.smallest, one.alarm, one.survivor
    first = one.rungs[0] if one.rungs else None
    if smallest is None or alarm is None or first is None:
        tried = str(first.episodes) if first else "0"
        words = f"{one.state.value}: {one.limit}" if one.limit else one.state.value
        return (one.part, one.fault, words, NONE, tried, NONE, first.words if first else NONE, NONE)
    return (
        one.part,
        one.fault,
        alarm.claim,
        alarm.scenario,
        str(smallest.episodes),
        smallest.words,
        survivor.words if survivor else NONE,
        {True: "too", False: "not there", None: "not asked"}[one.confirmed],
    )


def harmless_row(one: FaultOutcome) -> tuple[str, ...]:
    """A harmless change's row under HARMLESS_HEAD."""
    alarms = [str(alarm) for rung in one.rungs for alarm in rung.alarms]
    episodes = sum(rung.episodes for rung in one.rungs)
    geometry = "; ".join(geometry_words(rung.geometry) for rung in one.rungs if rung.geometry) or NONE
    return (one.part, one.fault, one.harmless, str(episodes), "; ".join(alarms) or "none", geometry)


def geometry_words(found: Geometry) -> str:
    """How often it is kept and broken, and where our verdict is the opposite."""
    words = f"kept in {found.kept} of {found.runs}, broken in {found.broken}"
    return f"{words}, to the contrary in {', '.join(found.contradicted)}" if found.contradicted else words


def summary(tally: SelfTestTally) -> str:
    """One line."""
    words = f"{tally.caught} of {count_words(tally.faults, 'fault', 'faults')} caught ({tally.kill_rate:.0%})"
    words += f", {tally.rungs_caught} of {tally.rungs} magnitudes tried"
    if tally.limits:
        words += f"; {count_words(tally.limits, 'survivor', 'survivors')} by a stated limit"
    if tally.survivors:
        words += f"; {count_words(tally.survivors, 'survivor', 'survivors')}"
    words += f"; {count_words(tally.false_alarms, 'false alarm', 'false alarms')} on "
    words += count_words(tally.harmless, "harmless change", "harmless changes")
    if tally.true_alarms:
        words += f", {count_words(tally.true_alarms, 'true alarm', 'true alarms')}"
    if tally.geometry_runs:
        contradicted = tally.geometry_contradicted or "none"
        words += f"; PyBullet's geometry contradicts {contradicted} of {tally.geometry_runs} hand distances"
    if tally.unconfirmed:
        words += f"; {tally.unconfirmed} not seen in PyBullet"
    return words


def markdown(head: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    """The same for the docs."""
    written = ["| " + " | ".join(head) + " |", "|" + "---|" * len(head)]
    return written + ["| " + " | ".join(cell.replace("|", "\\|") for cell in one) + " |" for one in rows]


def in_table(outcomes: Sequence[FaultOutcome]) -> tuple[list[FaultOutcome], list[FaultOutcome]]:
    """Faults and harmless changes."""
    faults = [one for one in outcomes if not one.harmless]
    return faults, [one for one in outcomes if one.harmless]


def bad(outcomes: Sequence[FaultOutcome]) -> list[FaultOutcome]:
    """What speaks against the harness: survivors without a stated limit, and false alarms."""
    return [one for one in outcomes if one.state in (FaultState.SURVIVES, FaultState.FALSE_ALARM)]
