"""Faults tried in several processes; what is finished is there at once, whatever happens to the rest."""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import FIRST_COMPLETED, Future, wait
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

from safety_harness.admission.trial import slower_because
from safety_harness.campaign.pool import pool
from safety_harness.scenario.model import Verdict
from safety_harness.selftest.catalogue import EVERY
from safety_harness.selftest.fault import SeededFault
from safety_harness.selftest.outcome import FaultOutcome, outcome_of
from safety_harness.selftest.profile import SelfTestProfile
from safety_harness.selftest.suite import Suite
from safety_harness.selftest.system import ChangedSystem
from safety_harness.selftest.trial import SAME_TWICE, FaultTrials, Rung, words_on


@dataclass(frozen=True)
class SelfTestPlan:
    """What is tried, on what."""

    profile: SelfTestProfile
    folder: Path
    avoider: str | None

    def suite(self) -> Suite:
        """Read and admitted; InputError for what cannot be."""
        profile = self.profile
        return Suite.read(
            self.folder, first=profile.first, others=profile.others, avoider=self.avoider, draws=profile.draws
        )


def try_out(trials: FaultTrials, fault: SeededFault) -> FaultOutcome:
    """Down the ladder until one survives, what is slighter still is not tried; the last catch in PyBullet.

    A harmless one is tried on the whole suite, and all its alarms are kept.
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
        confirmed = trials.confirmed(fault, caught[-1])
        rungs[len(caught) - 1] = replace(caught[-1], confirmed=confirmed)
    return outcome_of(fault, rungs)


_TRIALS: list[FaultTrials] = []  # of this process


def _begin(plan: SelfTestPlan) -> None:
    _TRIALS[:] = [FaultTrials(plan.suite())]


def _try(number: int) -> FaultOutcome:
    return try_out(_TRIALS[0], EVERY[number])


def outcomes(plan: SelfTestPlan, numbers: list[int], jobs: int) -> Iterator[FaultOutcome]:
    """The faults of these numbers in EVERY, each when it is finished; one job is done here."""
    if jobs == 1:
        trials = FaultTrials(plan.suite())
        yield from (try_out(trials, EVERY[number]) for number in numbers)
        return
    with pool(jobs, partial(_begin, plan)) as processes:
        running: set[Future[FaultOutcome]] = {processes.submit(_try, number) for number in numbers}
        while running:
            finished = wait(running, return_when=FIRST_COMPLETED).done
            running -= finished
            for future in finished:
                yield future.result()


def sound_remarks(suite: Suite) -> list[str]:
    """What a user has to know of the sound system: an avoider that is slow to ask, or not repeatable."""
    avoiders = {one.avoider.name: number for number, one in reversed(list(enumerate(suite.episodes)))}
    said = [why for number in avoiders.values() if (why := slower_because(suite.episodes[number].avoider))]
    for name, number in avoiders.items():
        system = ChangedSystem(suite.episodes[number])
        wrong = words_on(system.admitted, system.run())[SAME_TWICE]
        if wrong.verdict is not Verdict.HOLDS:
            said.append(f"{name} is not repeatable even without a fault: {wrong.reason}")
    return said
