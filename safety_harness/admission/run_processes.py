"""Execution of runs in several processes.

Only shipped avoiders run in other processes, because they store no data between runs.
"""

from __future__ import annotations

import os
import pickle
from collections import deque
from collections.abc import Iterable, Iterator
from concurrent.futures import Future, ProcessPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, field, replace

from safety_harness.admission.admit import Admitted, admit
from safety_harness.admission.avoiders import executes
from safety_harness.admission.trial import run_trial
from safety_harness.base.exceptions import described
from safety_harness.cell.simulation.worlds import WorldEntry, world_named
from safety_harness.scenario.model import Scenario
from safety_harness.trace.trace import Trace

FEWEST_RUNS = 8  # for fewer, the start of a process takes longer than it saves
_AHEAD = 16  # finished runs for each process that may await judgement; a trace has a megabyte


@dataclass
class RunProcesses:
    """The runs that other processes execute.

    The caller must request the runs in the order of their submission.
    """

    world: WorldEntry
    executor: ProcessPoolExecutor | None = None
    jobs: int = 1
    _waiting: deque[Admitted] = field(default_factory=deque)
    _begun: dict[int, Future[Trace | Exception]] = field(default_factory=dict)

    def trace(self, admitted: Admitted) -> Trace | None:
        """Wait for the run in another process and return its trace.

        Return None if this process has to execute the run itself.  If that run raised an exception, the
        exception is raised here again.
        """
        if self.executor is None or executes(admitted.scenario):
            return None
        while self._waiting and (len(self._begun) < _AHEAD * self.jobs or id(admitted) not in self._begun):
            self._begin(self.executor, self._waiting.popleft())
        ended = self._begun[id(admitted)].result()
        del self._begun[id(admitted)]
        if isinstance(ended, Exception):
            raise ended
        return replace(ended)  # whose arrays are read-only again

    def is_done(self, admitted: Admitted) -> bool:
        """Return whether a run in another process has ended."""
        return id(admitted) in self._begun and self._begun[id(admitted)].done()

    def _begin(self, executor: ProcessPoolExecutor, admitted: Admitted) -> None:
        """Start a run in another process."""
        self._begun[id(admitted)] = executor.submit(_run, admitted.scenario, self.world.label)


class _EnoughError(Exception):
    """The exception that skips the runs that the caller no longer needs.

    It is raised at the end of the block.
    """


@contextmanager
def run_processes(
    admitted: Iterable[Admitted], world: WorldEntry, jobs: int | None
) -> Iterator[RunProcesses]:
    """Yield the runs that ``jobs`` processes execute.

    None means one process for each core.  If there are fewer than FEWEST_RUNS runs, no process is started.
    At the end of the block, unfinished runs are cancelled.
    """
    movable = deque(run for run in admitted if not executes(run.scenario))
    jobs = jobs or len(os.sched_getaffinity(0))
    if jobs < 2 or len(movable) < FEWEST_RUNS:
        yield RunProcesses(world)
        return
    from safety_harness.base.pool import pool

    try:
        with pool(jobs) as executor:
            yield RunProcesses(world, executor, jobs, movable)
            raise _EnoughError
    except _EnoughError:
        pass


def _run(scenario: Scenario, label: str) -> Trace | Exception:
    """Return the trace of a run, or its exception in a form that can be pickled."""
    try:
        return run_trial(admit(scenario), world=world_named(label, "world"))
    except Exception as error:
        try:
            pickle.loads(pickle.dumps(error))
        except Exception:
            return RuntimeError(described(error))
        return error
