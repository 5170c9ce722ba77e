"""Define the outcome of one fault, the figures of a whole self-test, and the rows of the tables."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from safety_harness.extensions.assurance.certification.tools import FaultState
from safety_harness.extensions.selftest.fault import SeededFault
from safety_harness.extensions.selftest.trial import Alarm, Geometry, Rung
from safety_harness.report.words import count_words

HEAD = ("part", "fault", "caught by", "in", "episodes", "slightest caught", "survives", "elsewhere")
HARMLESS_HEAD = ("part", "change", "why it cannot matter", "episodes", "alarms", "hand distance by PyBullet")
NONE = "-"


@dataclass(frozen=True, kw_only=True)
class FaultOutcome:
    """The results (rungs) of one fault, beginning with the worst magnitude.

    A harmless change should cause no alarm. If no claim can catch the fault, ``limit`` is the reason, which
    is written before the fault is tried.
    """

    fault: str
    part: str
    hazard: str
    circumstance: str
    harmless: str
    rungs: tuple[Rung, ...]
    slightest: str  # the smallest magnitude of the ladder, in words
    limit: str = ""
    applies: bool = True

    @property
    def state(self) -> FaultState:
        """The state of the fault, which is caught if at least its worst magnitude is caught."""
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
        """The rung of the smallest magnitude that a claim caught; all worse magnitudes were also caught."""
        caught = [rung for rung in self.rungs if rung.caught]
        return caught[-1] if caught else None

    @property
    def survivor(self) -> Rung | None:
        """The rung of the first magnitude that no claim caught, or None if all were caught."""
        return next((rung for rung in self.rungs if not rung.caught), None)

    @property
    def alarm(self) -> Alarm | None:
        """The first alarm at the smallest caught magnitude."""
        smallest = self.smallest
        return smallest.alarms[0] if smallest else None

    @property
    def confirmed(self) -> bool | None:
        """Whether a reference confirms the smallest caught magnitude; None if no reference ran."""
        smallest = self.smallest
        return smallest.confirmed if smallest else None

    @property
    def confirmed_in(self) -> list[str] | None:
        """The references that confirm the smallest caught magnitude, or None if no reference ran."""
        if (smallest := self.smallest) is None or smallest.confirmed is None:
            return None
        return [smallest.confirming] * smallest.confirmed


def outcome_of(fault: SeededFault, rungs: Sequence[Rung], *, applies: bool = True) -> FaultOutcome:
    """Return the outcome of ``fault`` with the results ``rungs``."""
    return FaultOutcome(
        fault=fault.name,
        part=fault.part.value,
        hazard=fault.hazard,
        circumstance=fault.circumstance.name,
        harmless=fault.harmless,
        limit=fault.limit,
        rungs=tuple(rungs),
        slightest=fault.ladder.label(fault.ladder.values[-1]),
        applies=applies,
    )


@dataclass(frozen=True, kw_only=True)
class SelfTestTally:
    """The figures of a whole self-test.

    For runs with harmless changes, PyBullet also computes the hand distance; there are ``geometry_runs`` such
    runs. In ``geometry_contradicted`` of them, its result contradicts the harness's verdict on the hand
    distance.
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
        """The number of caught faults divided by the number of applicable faults."""
        return self.caught / self.faults if self.faults else 0.0


def tally_of(outcomes: Sequence[FaultOutcome]) -> SelfTestTally:
    """Return the figures of the whole self-test from ``outcomes``."""
    states = [outcome.state for outcome in outcomes]
    tried = [rung for outcome in outcomes if not outcome.harmless for rung in outcome.rungs]
    geometries = [rung.geometry for outcome in outcomes for rung in outcome.rungs if rung.geometry]
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
        unconfirmed=sum(outcome.confirmed is False for outcome in outcomes),
        geometry_runs=sum(outcome.runs for outcome in geometries),
        geometry_contradicted=sum(len(outcome.contradicted) for outcome in geometries),
    )


def row(outcome: FaultOutcome) -> tuple[str, ...]:
    """Return the table row of a fault, for the heading HEAD."""
    smallest, alarm, survivor = outcome.smallest, outcome.alarm, outcome.survivor
    first = outcome.rungs[0] if outcome.rungs else None
    if smallest is None or alarm is None or first is None:
        tried = str(first.episodes) if first else "0"
        text = f"{outcome.state.value}: {outcome.limit}" if outcome.limit else outcome.state.value
        return (outcome.part, outcome.fault, text, NONE, tried, NONE, first.words if first else NONE, NONE)
    return (
        outcome.part,
        outcome.fault,
        alarm.claim,
        alarm.scenario,
        str(smallest.episodes),
        smallest.words,
        survivor.words if survivor else NONE,
        {
            True: f"{smallest.confirming} too",
            False: f"not in {smallest.confirming}",
            None: "not asked",
        }[smallest.confirmed],
    )


def harmless_row(change: FaultOutcome) -> tuple[str, ...]:
    """Return the table row of a harmless change, for the heading HARMLESS_HEAD."""
    alarms = [str(alarm) for rung in change.rungs for alarm in rung.alarms]
    episodes = sum(rung.episodes for rung in change.rungs)
    geometry = "; ".join(geometry_words(rung.geometry) for rung in change.rungs if rung.geometry) or NONE
    return (change.part, change.fault, change.harmless, str(episodes), "; ".join(alarms) or "none", geometry)


def geometry_words(geometry: Geometry) -> str:
    """Return a text about the runs in which the hand distance was kept or broken.

    The text states the numbers of these runs, and lists the runs that contradict the harness.
    """
    text = f"kept in {geometry.kept} of {geometry.runs}, broken in {geometry.broken}"
    return f"{text}, to the contrary in {', '.join(geometry.contradicted)}" if geometry.contradicted else text


def summary(tally: SelfTestTally) -> str:
    """Return the figures of a self-test in one line."""
    text = f"{tally.caught} of {count_words(tally.faults, 'fault', 'faults')} caught ({tally.kill_rate:.0%})"
    text += f", {tally.rungs_caught} of {tally.rungs} magnitudes tried"
    if tally.limits:
        text += f"; {count_words(tally.limits, 'survivor', 'survivors')} by a stated limit"
    if tally.survivors:
        text += f"; {count_words(tally.survivors, 'survivor', 'survivors')}"
    text += f"; {count_words(tally.false_alarms, 'false alarm', 'false alarms')} on "
    text += count_words(tally.harmless, "harmless change", "harmless changes")
    if tally.true_alarms:
        text += f", {count_words(tally.true_alarms, 'true alarm', 'true alarms')}"
    if tally.geometry_runs:
        contradicted = tally.geometry_contradicted or "none"
        text += f"; PyBullet's geometry contradicts {contradicted} of {tally.geometry_runs} hand distances"
    if tally.unconfirmed:
        text += f"; {tally.unconfirmed} not seen in the reference"
    return text


def markdown(head: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    """Return the lines of a table in Markdown, for the docs."""
    written = ["| " + " | ".join(head) + " |", "|" + "---|" * len(head)]
    return written + ["| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |" for cells in rows]


def in_table(outcomes: Sequence[FaultOutcome]) -> tuple[list[FaultOutcome], list[FaultOutcome]]:
    """Return the faults and the harmless changes as two lists."""
    faults = [outcome for outcome in outcomes if not outcome.harmless]
    return faults, [outcome for outcome in outcomes if outcome.harmless]


def bad(outcomes: Sequence[FaultOutcome]) -> list[FaultOutcome]:
    """Return the outcomes that are failures of the harness: unexplained survivors and false alarms."""
    return [outcome for outcome in outcomes if outcome.state in (FaultState.SURVIVES, FaultState.FALSE_ALARM)]
