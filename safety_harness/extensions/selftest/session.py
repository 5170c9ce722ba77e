"""Run one complete self-test in several processes: choose the faults, try them, and write the files.

The session stores each finished fault at once, so that a later failure loses no result.
"""

from __future__ import annotations

import platform
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import as_completed
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass, field
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import Any

from safety_harness.admission.admit import Admitted
from safety_harness.admission.trial import slower_because
from safety_harness.base.compiled import source_hash
from safety_harness.base.distribution import installed_version
from safety_harness.base.exceptions import SettingsError, near_miss
from safety_harness.base.pool import pool
from safety_harness.cell.simulation.worlds import KINEMATIC, REFERENCE, WorldEntry
from safety_harness.extensions.selftest.catalogue import EVERY
from safety_harness.extensions.selftest.document import SelfTestRun, document, write_document, write_page
from safety_harness.extensions.selftest.fault import SeededFault
from safety_harness.extensions.selftest.outcome import FaultOutcome, outcome_of
from safety_harness.extensions.selftest.replayed import caught_runs
from safety_harness.extensions.selftest.suite import SelfTestPlan
from safety_harness.extensions.selftest.system import ChangedSystem
from safety_harness.extensions.selftest.trial import SAME_TWICE, FaultTrials, Rung, evaluations_of
from safety_harness.scenario.model import Verdict

PAGE, DATA = "selftest.html", "selftest.json"


@dataclass(eq=False)
class SelfTestSession:
    """A self-test in progress, with its outcomes so far. It tries the faults with these ``numbers`` in EVERY.

    ``remarks`` are about the sound system, which the constructor tries out. ``broken`` is the reason why the
    self-test ended early. The constructor raises InputError if scenarios cannot be used.
    """

    plan: SelfTestPlan
    numbers: list[int]
    out: Path
    command: str
    done: dict[str, FaultOutcome] = field(default_factory=dict)
    interrupted: bool = False
    broken: str = ""

    def __post_init__(self) -> None:
        self._episodes = self.plan.episodes()
        self.remarks = tuple(sound_remarks(self._episodes, self.plan.world))
        self._begun_s = time.monotonic()

    @property
    def tried(self) -> list[FaultOutcome]:
        """The outcomes so far, in the order of the catalogue."""
        return [self.done[EVERY[n].name] for n in self.numbers if EVERY[n].name in self.done]

    def run(self, jobs: int, on_fault: Callable[[FaultOutcome], None]) -> None:
        """Try all faults, unless Ctrl-C or a defect ends the test earlier.

        Raise OSError if a file cannot be written.
        """
        results = outcomes(self.plan, self.numbers, jobs)
        try:
            while (outcome := next(results, None)) is not None:
                self.done[outcome.fault] = outcome
                on_fault(outcome)
                self.write()
        except KeyboardInterrupt:
            self.interrupted = True
        except BrokenProcessPool:
            self.broken = "a process ended before its time (for its memory, or by hand)"
        except OSError:
            raise
        except Exception as error:  # keep the outcomes so far
            self.broken = f"{type(error).__name__}: {error}, a defect of safety-harness"

    @property
    def document(self) -> dict[str, Any]:
        """The outcomes so far, in the form of the JSON file."""
        return document(self.tried, self._facts())

    def write(self) -> None:
        """Write the outcomes so far as JSON; raise OSError if that fails."""
        write_document(self.out / DATA, self.tried, self._facts())

    def write_page(self) -> None:
        """Write the page, with runs in 3-D after a complete self-test; raise OSError if that fails."""
        whole = not (self.interrupted or self.broken)
        runs = caught_runs(self.tried, self._episodes, self.plan.world) if whole else []
        write_page(self.out / PAGE, self.tried, self._facts(), runs)

    def _facts(self) -> SelfTestRun:
        return SelfTestRun(
            profile=self.plan.profile.name,
            avoider=self.plan.avoider,
            safety_filter=self.plan.safety_filter,
            predictor=self.plan.predictor,
            world=self.plan.world.label,
            scenarios=str(self.plan.folder),
            episodes=len(self._episodes),
            planned=len(self.numbers),
            seconds=round(time.monotonic() - self._begun_s, 1),
            command=self.command,
            package_version=installed_version(),
            source_hash=source_hash(),
            platform=f"Python {platform.python_version()}, {platform.system()} {platform.machine()}",
            generated_at=datetime.now(UTC),
            remarks=self.remarks,
            interrupted=len(self.done) < len(self.numbers),
        )


def numbers_of(text: str | None) -> list[int]:
    """Return the indices in EVERY of the faults whose name contains ``text``.

    Raise SettingsError if there is no such fault.
    """
    numbers = [n for n, fault in enumerate(EVERY) if text is None or text.lower() in fault.name.lower()]
    if not numbers:
        every, page = [fault.name for fault in EVERY], "safety-harness docs results/self-test#what-was-caught"
        hint = near_miss(text or "", every, most=3, all_of_them=page)
        raise SettingsError.of_option("--fault", f"words of one of {len(EVERY)} faults", repr(text), hint)
    return numbers


def try_out(trials: FaultTrials, fault: SeededFault) -> FaultOutcome:
    """Try a ``fault``, and return its outcome.

    The function tries the magnitudes in order, beginning with the worst, until no claim catches one of them.
    It then repeats the run with the smallest caught magnitude in a reference world. A harmless change runs on
    the whole suite instead, and all of its alarms are recorded.
    """
    if not trials.applies(fault):
        return outcome_of(fault, (), applies=False)
    if fault.harmless:
        return outcome_of(fault, (trials.everywhere(fault),))
    rungs: list[Rung] = []
    for magnitude in fault.ladder.values:
        rungs.append(trials.rung(fault, magnitude))
        if not rungs[-1].caught:
            break
    caught = [rung for rung in rungs if rung.caught]
    if caught:
        # The caught magnitudes come first, so this is the smallest of them.
        rungs[len(caught) - 1] = trials.confirmed(fault, caught[-1])
    return outcome_of(fault, rungs)


_TRIALS: list[FaultTrials] = []  # of this process


def _begin(plan: SelfTestPlan) -> None:
    _TRIALS[:] = [FaultTrials(plan.episodes(), plan.world)]


def _try(number: int) -> FaultOutcome:
    return try_out(_TRIALS[0], EVERY[number])


def outcomes(plan: SelfTestPlan, numbers: list[int], jobs: int) -> Iterator[FaultOutcome]:
    """Yield the outcome of each fault in ``numbers`` when it is finished.

    A single job runs in this process.
    """
    if jobs == 1:
        trials = FaultTrials(plan.episodes(), plan.world)
        yield from (try_out(trials, EVERY[number]) for number in numbers)
        return
    with pool(jobs, partial(_begin, plan)) as processes:
        for future in as_completed([processes.submit(_try, number) for number in numbers]):
            yield future.result()


def sound_remarks(episodes: Sequence[Admitted], world: WorldEntry = KINEMATIC) -> list[str]:
    """Return remarks on the sound system: a slow or unrepeatable avoider, or parts that are missing."""
    with_avoider = [(n, episode) for n, episode in enumerate(episodes) if episode.driver is None]
    avoiders = {episode.avoider.name: number for number, episode in reversed(with_avoider)}
    notes = [why for number in avoiders.values() if (why := slower_because(episodes[number].avoider))]
    if len(with_avoider) < len(episodes):
        notes.append("no avoider and no gate: faults of theirs, and of the visual servo itself, do not apply")
    if not REFERENCE.is_installed:
        notes.append(f"{REFERENCE} is not installed: no check by its geometry")
    for name, number in avoiders.items():
        system = ChangedSystem(episodes[number])
        repeated = evaluations_of(system.admitted, system.run(world))[SAME_TWICE]
        if repeated.verdict is not Verdict.HOLDS:
            notes.append(f"{name} is not repeatable even without a fault: {repeated.reason}")
    return notes
