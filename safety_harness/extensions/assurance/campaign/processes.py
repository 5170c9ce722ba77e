"""The interface of a worker pool that runs episodes, and a pool of processes on this machine.

The pool replaces each process that crashes, hangs or leaks memory. Each worker has its own pipe. Therefore a
worker that dies while it sends a message does not affect other workers. A process that has imported
everything forks the workers (forkserver), so that a new worker starts at once.
"""

from __future__ import annotations

import gc
import multiprocessing
import os
import resource
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from multiprocessing.connection import Connection, wait
from multiprocessing.context import ForkServerProcess
from pathlib import Path
from typing import Protocol

from safety_harness.base.exceptions import CampaignError, InputError
from safety_harness.base.interrupts import deaf_children
from safety_harness.base.pool import one_thread_each
from safety_harness.extensions.assurance.campaign.episodes import EpisodeRunner
from safety_harness.extensions.assurance.campaign.identity import Identity
from safety_harness.extensions.assurance.campaign.plan import read_plan
from safety_harness.extensions.assurance.campaign.rows import Row

_MOST_FALSE_STARTS = 10  # after so many in a row, no worker can start at all
_LOOK_S = 1.0  # between looks at clocks and memory


@dataclass(frozen=True)
class Chunk:
    """Episodes of one stratum that one worker runs.

    If ``keep_violations`` is true, the rows keep the traces of violations.
    """

    stratum: int
    episodes: tuple[int, ...]
    keep_violations: bool


@dataclass(frozen=True)
class Arrived:
    """Finished rows of a chunk.

    A chunk may arrive in several parts, and ``last`` marks the last part.
    """

    chunk: Chunk
    rows: tuple[Row, ...]
    last: bool


@dataclass(frozen=True)
class Lost:
    """A chunk that will yield no more rows.

    ``why`` states the reason: its worker crashed, hung or used too much memory. ``times`` is the number of
    workers that certainly began the chunk and were then lost. If the number is 0, no episode is blamed.
    """

    chunk: Chunk
    why: str
    times: int = 1


Event = Arrived | Lost


class WorkerPool(Protocol):
    """A pool of workers. Call ``give`` as long as ``free`` is positive, and then call ``take``."""

    size: int  # workers that can work at the same time now
    replaced: int  # workers replaced so far

    @property
    def free(self) -> int:
        """The number of chunks that the pool accepts now."""

    def give(self, chunk: Chunk) -> None:
        """Let a worker run ``chunk``."""

    def take(self, timeout_s: float) -> Sequence[Event]:
        """Return the events since the last call.

        If there are no events, wait for at most ``timeout_s``. Raise InputError if the plan caused an error.
        Raise CampaignError if the pool can run no more chunks.
        """

    def close(self) -> None:
        """Stop all workers at once, and drop the unfinished chunks."""


class RunsEpisodes(Protocol):
    """The interface of an ``EpisodeRunner`` that a worker uses."""

    def run(self, stratum: int, episodes: Sequence[int], *, keep_violations: bool = True) -> Iterator[Row]:
        """Yield a row for each of ``episodes``, in their order."""


def bench_of_file(file: Path, identity: Identity) -> EpisodeRunner:
    """Return a runner of the plan in ``file``.

    Raise LedgerError if the plan no longer has the declared ``identity``.
    """
    plan = read_plan(file)
    identity.refuse_other(plan.identity, file, where=", on every machine")
    return EpisodeRunner(plan, worker=f"{os.uname().nodename}:{os.getpid()}")


@dataclass(frozen=True)
class _Free:
    """A message from a worker that is ready for a chunk.

    ``resident_bytes`` is the memory that the worker uses.
    """

    resident_bytes: int


def work(connection: Connection, lifeline: Connection, make: Callable[[], RunsEpisodes]) -> None:
    """Send a row for each episode of each received chunk, and then ``_Free``.

    Return when the pipe closes.
    """
    gc.freeze()  # or each collection looks at all that was imported before the fork, and copies its pages
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the first process answers Ctrl-C
    threading.Thread(target=_end_with, args=(lifeline,), daemon=True).start()
    try:
        bench = make()
        while True:
            connection.send(_Free(resident_bytes(os.getpid())))
            chunk: Chunk | None = connection.recv()
            if chunk is None:
                return
            for row in bench.run(chunk.stratum, chunk.episodes, keep_violations=chunk.keep_violations):
                connection.send(row)
    except InputError as error:
        connection.send(error)
    except (EOFError, BrokenPipeError):
        return


def _end_with(lifeline: Connection) -> None:
    """End this process as soon as its parent has ended, even if the parent was killed."""
    try:
        lifeline.recv()
    except (EOFError, OSError):
        os._exit(0)


def resident_bytes(process: int) -> int:
    """Return the memory that ``process`` uses now, or 0 if the process has ended."""
    try:
        pages = int(Path(f"/proc/{process}/statm").read_text().split()[1])
    except (OSError, IndexError, ValueError):
        if process == os.getpid() and sys.platform == "darwin":
            return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        return 0
    return pages * os.sysconf("SC_PAGE_SIZE")


@dataclass(frozen=True, kw_only=True)
class Limits:
    """The limits beyond which the pool replaces a worker.

    A worker sends at least one message per row. ``silence_s`` is the longest time between two messages, on a
    monotonic clock. Until its first chunk is finished, a worker has ``first_s`` more time, because it may
    compile machine code. If a worker exceeds ``resident_bytes`` or ``episodes``, the pool replaces the worker
    after its chunk. If the worker uses more than twice ``resident_bytes``, the pool replaces it at once.
    """

    silence_s: float = 300.0
    first_s: float = 900.0
    resident_bytes: int = 2 * 2**30
    episodes: int = 20_000


LIMITS = Limits()


@dataclass(eq=False)
class _Worker:
    process: ForkServerProcess
    connection: Connection
    lifeline: Connection
    heard_s: float
    ready: bool = False
    chunk: Chunk | None = None
    rows: int = 0
    chunks: int = 0

    def end(self) -> None:
        """Kill the process and close its pipes."""
        self.process.kill()
        self.process.join()
        self.connection.close()
        self.lifeline.close()


@dataclass(eq=False)
class Processes:
    """A WorkerPool of ``size`` processes, each with a runner that ``make`` returns."""

    make: Callable[[], RunsEpisodes]
    size: int
    limits: Limits = LIMITS
    replaced: int = 0
    workers: list[_Worker] = field(default_factory=list)
    _false_starts: int = 0
    _looked_s: float = 0.0
    _mistake: InputError | None = None

    def __post_init__(self) -> None:
        one_thread_each()
        self._context = multiprocessing.get_context("forkserver")
        # All workers fork from a process that has imported this module already.
        self._context.set_forkserver_preload(["safety_harness.extensions.assurance.campaign.processes"])
        self.workers += [self._started() for _ in range(self.size)]

    @property
    def free(self) -> int:
        """The number of workers without a chunk."""
        return sum(worker.chunk is None for worker in self.workers)

    def give(self, chunk: Chunk) -> None:
        """Give ``chunk`` to a worker without a chunk, preferably to a worker that is ready."""
        worker = max((w for w in self.workers if w.chunk is None), key=lambda w: w.ready)
        worker.chunk = chunk
        worker.heard_s = time.monotonic()
        if worker.ready:
            self._send(worker, chunk)

    def take(self, timeout_s: float) -> Sequence[Event]:
        """Return new rows and lost chunks.

        If the plan caused an error, raise the error only after all earlier events have been returned.
        """
        if self._mistake is not None:
            raise self._mistake
        by_connection = {worker.connection: worker for worker in self.workers}
        events: list[Event] = []
        for connection in wait(list(by_connection), timeout=min(timeout_s, _LOOK_S)):
            assert isinstance(connection, Connection)
            self._hear(by_connection[connection], events)
        if time.monotonic() - self._looked_s > _LOOK_S:
            self._looked_s = time.monotonic()
            for worker in list(self.workers):
                self._look_at(worker, events)
        return events

    def close(self) -> None:
        """Kill all workers."""
        for worker in self.workers:
            worker.end()
        self.workers.clear()

    def _started(self) -> _Worker:
        ours, theirs = self._context.Pipe()
        lifeline, other_end = self._context.Pipe()
        process = self._context.Process(target=work, args=(theirs, other_end, self.make), daemon=True)
        with deaf_children():  # the process that forks them starts here, and must be deaf too
            process.start()
        theirs.close()
        other_end.close()
        return _Worker(process, ours, lifeline, time.monotonic())

    def _send(self, worker: _Worker, message: Chunk | None) -> None:
        with suppress(OSError):  # the worker has ended, as ``_hear`` will notice
            worker.connection.send(message)

    def _hear(self, worker: _Worker, events: list[Event]) -> None:
        """Add all messages of ``worker`` to ``events``.

        Replace the worker if its process has ended.
        """
        rows: list[Row] = []
        done: _Free | None = None  # the worker's last message, which ends its chunk
        ended = False
        try:
            while done is None and worker.connection.poll():
                message = worker.connection.recv()
                worker.heard_s = time.monotonic()
                if isinstance(message, InputError):
                    self._mistake = message
                elif isinstance(message, Row):
                    rows.append(message)
                elif worker.ready:
                    done = message
                else:
                    # The first ``_Free`` comes before any chunk: the worker is ready.
                    worker.ready, self._false_starts = True, 0
                    if worker.chunk is not None:
                        self._send(worker, worker.chunk)
        except (EOFError, OSError):
            ended = True
        if worker.chunk is not None and (rows or done):
            events.append(Arrived(worker.chunk, tuple(rows), last=done is not None))
        if ended:
            self._replace(worker, _how_it_ended(worker.process), events)
        elif done is not None:
            self._finish_chunk(worker, done)

    def _finish_chunk(self, worker: _Worker, done: _Free) -> None:
        assert worker.chunk is not None
        worker.rows += len(worker.chunk.episodes)
        worker.chunks += 1
        worker.chunk = None
        if worker.rows >= self.limits.episodes or done.resident_bytes > self.limits.resident_bytes:
            self._send(worker, None)
            worker.process.join(timeout=1.0)
            self._renew(worker)

    def _look_at(self, worker: _Worker, events: list[Event]) -> None:
        """Replace ``worker`` if it has been silent for too long or uses too much memory."""
        limits = self.limits
        allowed_s = limits.silence_s + (0.0 if worker.chunks else limits.first_s)
        if (worker.chunk is not None or not worker.ready) and time.monotonic() - worker.heard_s > allowed_s:
            self._replace(worker, f"no result within {limits.silence_s:g} s", events)
        elif resident_bytes(worker.process.pid or 0) > 2 * limits.resident_bytes:
            self._replace(worker, f"more than {2 * limits.resident_bytes / 2**30:.3g} GiB of memory", events)

    def _replace(self, worker: _Worker, why: str, events: list[Event]) -> None:
        if not worker.ready:
            self._false_starts += 1
            if self._false_starts >= _MOST_FALSE_STARTS:
                often = f"{_MOST_FALSE_STARTS} workers in a row"
                raise CampaignError(f"{often} ended before they were ready: {why}")
        if worker.chunk is not None:
            # A worker that was not ready has not begun its chunk.
            events.append(Lost(worker.chunk, why, times=int(worker.ready)))
        self.replaced += 1
        self._renew(worker)

    def _renew(self, worker: _Worker) -> None:
        worker.end()
        self.workers[self.workers.index(worker)] = self._started()


def _how_it_ended(process: ForkServerProcess) -> str:
    process.join(timeout=5.0)
    code = process.exitcode
    if code is None:
        return "its process said no more"
    if code < 0:
        return f"its process was ended by {signal.Signals(-code).name}"
    return f"its process ended with exit code {code}"
