"""Runs of many files in several processes: of what ships alone, which keeps nothing from run to run."""

from __future__ import annotations

import os
import pickle
from collections import deque
from collections.abc import Iterable, Iterator
from concurrent.futures import Future, ProcessPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, field, replace

from safety_harness.admission.admit import Admitted, admit
from safety_harness.admission.avoiders import is_executed
from safety_harness.admission.trial import run_trial
from safety_harness.base.exceptions import described
from safety_harness.base.pool import pool
from safety_harness.cell.simulation.worlds import WorldEntry, worlds_by_label
from safety_harness.scenario.model import Scenario
from safety_harness.trace.trace import Trace

FEWEST_RUNS = 8  # for which the start of a process pays
_AHEAD = 4  # runs a process that may wait to be judged: a trace has a megabyte


@dataclass
class RunProcesses:
    """Runs that are under way elsewhere, in the order in which they will be asked for."""

    world: WorldEntry
    executor: ProcessPoolExecutor | None = None
    jobs: int = 1
    _waiting: deque[Admitted] = field(default_factory=deque)
    _begun: dict[int, Future[Trace | Exception]] = field(default_factory=dict)

    def trace(self, one: Admitted) -> Trace | None:
        """Of a run that is made elsewhere, when it has come to its end; None of one that is for this process.

        What it raised there is raised here.
        """
        if self.executor is None or is_executed(one.scenario.under_test):
            return None
        while self._waiting and (len(self._begun) < _AHEAD * self.jobs or id(one) not in self._begun):
            self._begin(self.executor, self._waiting.popleft())
        found = self._begun[id(one)].result()
        del self._begun[id(one)]
        if isinstance(found, Exception):
            raise found
        return replace(found)  # whose arrays are read-only again

    def is_done(self, one: Admitted) -> bool:
        """Has it come to its end elsewhere?"""
        return id(one) in self._begun and self._begun[id(one)].done()

    def _begin(self, executor: ProcessPoolExecutor, one: Admitted) -> None:
        self._begun[id(one)] = executor.submit(_run, one.scenario, self.world.label)


class _EnoughError(Exception):
    """Nobody asks for the runs that are left."""


@contextmanager
def run_processes(
    admitted: Iterable[Admitted], world: WorldEntry, jobs: int | None
) -> Iterator[RunProcesses]:
    """So many processes, without a number one for each core; none of their own for few runs.

    What is under way at the end of the block is given up.
    """
    apart = deque(one for one in admitted if not is_executed(one.scenario.under_test))
    jobs = jobs or len(os.sched_getaffinity(0))
    if jobs < 2 or len(apart) < FEWEST_RUNS:
        yield RunProcesses(world)
        return
    try:
        with pool(jobs) as executor:
            yield RunProcesses(world, executor, jobs, apart)
            raise _EnoughError
    except _EnoughError:
        pass


def _run(scenario: Scenario, label: str) -> Trace | Exception:
    try:
        return run_trial(admit(scenario), world=worlds_by_label()[label])
    except Exception as error:
        try:
            pickle.loads(pickle.dumps(error))
        except Exception:
            return RuntimeError(described(error))
        return error
