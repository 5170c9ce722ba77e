"""A worker pool on a Dask cluster, for the extra "cluster" of this package.

Each chunk of episodes is one Dask task, which carries the plan's files. A worker refuses tasks if its version
of this package or of a library differs from the client's.

Each worker should have one thread and a nanny. A deadline can interrupt a user's avoider only on a main
thread. The nanny restarts a worker that hangs.

If a worker dies, Dask runs its tasks again on another worker. After several such deaths, Dask abandons each
task that was on those workers, even if another task caused the deaths. Therefore the pool runs an abandoned
task once more, with no other task beside it, before it blames the task.
"""

from __future__ import annotations

import asyncio
import json
import logging
import math
import os
import tempfile
import threading
import time
from collections.abc import Sequence
from concurrent.futures import CancelledError
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import Any

from safety_harness.base.exceptions import CampaignError, InputError, ScenarioError, described
from safety_harness.base.extras import CLUSTER
from safety_harness.extensions.assurance.campaign.episodes import EpisodeRunner
from safety_harness.extensions.assurance.campaign.identity import Identity, PlanFile, unpacked
from safety_harness.extensions.assurance.campaign.plan import Plan
from safety_harness.extensions.assurance.campaign.processes import (
    LIMITS,
    Arrived,
    Chunk,
    Event,
    Limits,
    Lost,
    bench_of_file,
)
from safety_harness.extensions.assurance.campaign.rows import Row

_AHEAD = 2  # chunks per thread, so that a thread need not wait for the network
_ANSWER_S = 30.0  # for an answer of the scheduler
_LOOK_S = 2.0  # between looks at the cluster as a whole
_MOST_REFUSED = 10  # chunks in a row that no worker could begin
_OF_THREAD = threading.local()  # two threads must not call one avoider at the same time


def run_chunk(
    files: Sequence[PlanFile], identity: Identity, chunk: Chunk
) -> Sequence[Row] | InputError | Lost:
    """Run ``chunk`` on a Dask worker and return its rows.

    The worker's machine needs no file of the plan, because ``files`` has the contents of all files. The
    function returns errors as values, because Dask never reports an exception whose traceback cannot be
    pickled.
    """
    try:
        bench = _bench(files, identity)
        return list(bench.run(chunk.stratum, chunk.episodes, keep_violations=chunk.keep_violations))
    except InputError as error:
        got = f"{error.got} (the worker {os.uname().nodename}:{os.getpid()})"
        return type(error)(place=error.place, expected=error.expected, got=got, hint=error.hint)
    except MemoryError:
        return Lost(chunk, "its worker had no memory left")
    except Exception as error:
        return Lost(chunk, described(error), times=0)


def _bench(files: Sequence[PlanFile], identity: Identity) -> EpisodeRunner:
    """Return this thread's runner of the plan.

    The function creates the runner on the first call for a plan. The plan's files stay on the disk until the
    thread ends or receives another plan.
    """
    if getattr(_OF_THREAD, "plan", "") != identity.sha256:
        _OF_THREAD.folder = tempfile.TemporaryDirectory(prefix="safety-harness-", ignore_cleanup_errors=True)
        file = unpacked(files, Path(_OF_THREAD.folder.name))
        _OF_THREAD.bench = bench_of_file(file, identity)
        _OF_THREAD.plan = identity.sha256
    bench: EpisodeRunner = _OF_THREAD.bench
    return bench


@dataclass(eq=False)
class _Task:
    """A chunk that the scheduler has accepted but has not returned yet.

    ``since_s`` is the time when the pool submitted the chunk. If ``begun`` is true, ``since_s`` is instead
    the time when the pool first saw the chunk on a worker.
    """

    chunk: Chunk
    alone: bool  # while the pool has no other unfinished task
    since_s: float
    begun: bool = False


@dataclass(eq=False)
class DaskCrew:
    """A WorkerPool that uses the workers of a Dask scheduler.

    ``address`` is the scheduler's address (tcp://...) or the path of a scheduler file. If a chunk takes too
    long, the pool reports the chunk as lost and restarts its worker. The constructor raises InputError if no
    scheduler answers at ``address``.
    """

    plan: Plan
    address: str
    limits: Limits = LIMITS
    replaced: int = 0
    size: int = 0  # threads of all workers when they were counted last; workers may come later
    _under_way: dict[Any, _Task] = field(default_factory=dict)  # by future, in the order of submission
    _suspects: set[Chunk] = field(default_factory=set)
    _waiting: Chunk | None = None  # a suspect that waits until no other task is unfinished
    _finished: SimpleQueue[Any] = field(default_factory=SimpleQueue)
    _refused: int = 0
    _mistake: InputError | None = None

    def __post_init__(self) -> None:
        self._client = connected(self.address, _ANSWER_S)
        logging.getLogger("distributed").setLevel(logging.CRITICAL)  # this module reports what matters
        self._looked_s = -math.inf
        self._look_around([])

    @property
    def free(self) -> int:
        """The number of chunks that the pool accepts now.

        The number is 0 while a suspected chunk runs alone, or waits to run alone.
        """
        if self._waiting is not None or any(task.alone for task in self._under_way.values()):
            return 0
        return max(max(self.size, 1) * _AHEAD - len(self._under_way), 0)

    def give(self, chunk: Chunk) -> None:
        """Submit ``chunk`` as a separate task.

        A suspected chunk waits until it can run alone.
        """
        if chunk in self._suspects:
            self._waiting = chunk
        else:
            self._submit(chunk, alone=False)

    def _submit(self, chunk: Chunk, alone: bool) -> None:
        # ``pure=False``: Dask must run the chunk again, and not return an earlier result of it.
        future = self._client.submit(run_chunk, self.plan.files, self.plan.identity, chunk, pure=False)
        self._under_way[future] = _Task(chunk, alone, time.monotonic())
        future.add_done_callback(self._finished.put)

    def take(self, timeout_s: float) -> Sequence[Event]:
        """Return finished and lost chunks.

        If the plan caused an error, raise the error only after all earlier events have been returned.
        """
        if self._mistake is not None:
            raise self._mistake
        if self._waiting is not None and not self._under_way:
            self._submit(self._waiting, alone=True)
            self._waiting = None
        events: list[Event] = []
        try:
            future = self._finished.get(timeout=timeout_s)
            while True:
                events += self._event_of(future)
                future = self._finished.get_nowait()
        except Empty:
            pass
        if not events and self._client.status != "running":
            raise self._gone()
        self._look_around(events)
        return events

    def close(self) -> None:
        """Close the client, so that the scheduler drops its unfinished tasks.

        The cluster continues to run.
        """
        with suppress(OSError, TimeoutError):
            self._client.close(timeout=_ANSWER_S)

    def _event_of(self, future: Any) -> list[Event]:
        if future not in self._under_way:
            return []
        if future.status == "cancelled":  # not by this pool: the scheduler has forgotten the task
            raise self._gone()
        task = self._under_way.pop(future)
        try:
            if future.status == "error":
                return [self._lost(task, future.exception(_ANSWER_S))]
            answer = future.result(_ANSWER_S)
        except (OSError, TimeoutError, CancelledError, asyncio.CancelledError) as error:
            return [Lost(task.chunk, f"its result could not be fetched: {type(error).__name__}", times=0)]
        if isinstance(answer, InputError):
            self._mistake = answer
            return []
        if isinstance(answer, Lost):
            return [answer if answer.times else self._refusal(task, answer.why)]
        self._refused = 0
        return [Arrived(task.chunk, tuple(answer), last=True)]

    def _lost(self, task: _Task, error: BaseException) -> Lost:
        """Return the ``Lost`` event for a ``task`` that Dask has abandoned."""
        from distributed import KilledWorker

        if not isinstance(error, KilledWorker):
            return self._refusal(
                task, " because of ".join(described(e) for e in (error, error.__cause__) if e)
            )
        # A worker that dies takes all of its tasks with it, so only an episode that ran alone is blamed.
        if len(task.chunk.episodes) == 1:
            self._suspects.add(task.chunk)
        return Lost(task.chunk, "its worker died", times=error.allowed_failures + 1 if task.alone else 0)

    def _refusal(self, task: _Task, why: str) -> Lost:
        """Return a ``Lost`` event in which no episode of the task is blamed.

        Raise CampaignError if this is the ``_MOST_REFUSED``-th consecutive event of this kind.
        """
        self._refused += 1
        if self._refused >= _MOST_REFUSED:
            raise CampaignError(
                f"the cluster could not run {_MOST_REFUSED} tasks in a row: {why}; "
                "is this package on its scheduler and on all of its workers?"
            )
        return Lost(task.chunk, why, times=0)

    def _gone(self) -> CampaignError:
        return CampaignError(f"the scheduler {self.address} is gone; the ledger has its earlier results")

    def _look_around(self, events: list[Event]) -> None:
        """Count the workers and look for hung tasks, at most once in ``_LOOK_S`` seconds."""
        if time.monotonic() - self._looked_s < _LOOK_S:
            return
        self._looked_s = time.monotonic()
        try:
            threads: dict[str, int] = self._client.nthreads()
            self.size = sum(threads.values())
            self._look_for_hung(threads, events)
        except (OSError, TimeoutError) as error:
            if not events:  # deliver events before an error
                raise self._gone() from error

    def _look_for_hung(self, threads: dict[str, int], events: list[Event]) -> None:
        """Drop each task that has run for too long, or that no worker has started in time.

        Tasks that have not started are dropped only if there are workers. A worker with n threads works on
        the first n of its tasks, in the order in which the pool submitted them.
        """
        allowed_s, now_s = self.limits.first_s + self.limits.silence_s, time.monotonic()
        place = {future.key: k for k, future in enumerate(self._under_way)}
        at: dict[str, str] = {}
        for worker, keys in self._client.processing().items():
            ours = sorted((key for key in keys if key in place), key=place.__getitem__)
            at |= dict.fromkeys(ours[: threads.get(worker, 1)], worker)
        hung: dict[Any, str | None] = {}
        for future, task in self._under_way.items():
            begun = task.begun or future.key in at
            if begun > task.begun or not threads:
                task.begun, task.since_s = begun, now_s
            elif now_s - task.since_s > allowed_s:
                hung[future] = at.get(future.key)
        if not hung:
            return
        for future in hung:
            task = self._under_way.pop(future)
            events.append(Lost(task.chunk, f"no result within {allowed_s:g} s", times=int(task.begun)))
        workers = sorted({worker for worker in hung.values() if worker})
        self.replaced += len(workers)
        # Cancelling does not end a task that runs already; only a restart of its worker does.
        self._client.cancel(list(hung), force=True)
        if workers:
            self._client.restart_workers(workers, timeout=_ANSWER_S, raise_for_error=False)


def connected(where: str, timeout_s: float) -> Any:
    """Return a ``distributed.Client`` of the scheduler whose address (tcp://...) or file is ``where``.

    Raise InputError if the scheduler does not answer within ``timeout_s``. Raise MissingPackageError if Dask
    is not installed.
    """
    with CLUSTER.needed("--cluster"):
        from distributed import Client
    make: Any = Client  # some of its methods have no types
    try:
        address = where if "://" in where else _address_in(Path(where))
        asyncio.run(_refuse_no_scheduler(address, timeout_s))
        return make(address=address, timeout=timeout_s, set_as_default=False)
    except Exception as error:  # another program may listen there and answer anything
        expected = "the address (tcp://...) or the file of a Dask scheduler that answers"
        got = f"{where}: {str(error) or type(error).__name__}"
        raise ScenarioError.of_option("--cluster", expected, got) from error


def _address_in(file: Path) -> str:
    """Return the address in a scheduler file.

    Raise an error if the file does not exist, because Dask itself would wait for it.
    """
    try:
        address = json.loads(file.read_text(encoding="utf-8"))["address"]
    except FileNotFoundError:
        raise FileNotFoundError("no such file") from None
    except (KeyError, TypeError, UnicodeDecodeError, json.JSONDecodeError):
        raise ValueError("a file of another program") from None
    return str(address)


async def _refuse_no_scheduler(address: str, timeout_s: float) -> None:
    """Check that a scheduler answers.

    A Client waits for ever if another program accepts the connection.
    """
    from distributed.comm.core import connect

    shake_hands: Any = connect  # which has no types
    try:
        comm = await asyncio.wait_for(shake_hands(address, timeout=timeout_s / 2.0), timeout_s)
    except TimeoutError:
        raise TimeoutError(f"no answer within {timeout_s:g} s") from None
    comm.abort()
