"""A crew on a Dask cluster: the extra "cluster" of this package.

Each chunk is a task, with which the plan's files travel.  Workers have to have the same version of this
package and of its libraries, and refuse otherwise.  They should have one thread and a nanny: a user's
avoider is interrupted at its deadline on a main thread only, and a worker that hangs is restarted by its
nanny.
"""

from __future__ import annotations

import asyncio
import logging
import math
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

from safety_harness.campaign.crew import Arrived, Chunk, Event, Lost
from safety_harness.campaign.episodes import Bench
from safety_harness.campaign.files import PlanFile, unpacked
from safety_harness.campaign.identity import Identity
from safety_harness.campaign.plan import Plan
from safety_harness.campaign.processes import LIMITS, Limits
from safety_harness.campaign.rows import Row
from safety_harness.campaign.worker import Mistake, PlanFromFile
from safety_harness.exceptions import CampaignError, InputError, Place, ScenarioError

_AHEAD = 2  # chunks for each thread, so that none waits for the network
_ANSWER_S = 30.0
_LOOK_S = 2.0  # between looks at the cluster as a whole
_OF_THREAD = threading.local()  # avoiders are not made to be asked by two at once


@dataclass(frozen=True)
class Shipment:
    """A plan on its way to a machine that has none of its files."""

    files: tuple[PlanFile, ...]
    identity: Identity


def run_chunk(shipment: Shipment, chunk: Chunk) -> list[Row] | Mistake:
    """What a Dask worker does with a chunk."""
    try:
        bench = _bench(shipment)
        return list(bench.run(chunk.stratum, chunk.episodes, keep_violations=chunk.keep_violations))
    except InputError as error:
        return Mistake.of(error)


def _bench(shipment: Shipment) -> Bench:
    """Made once for a plan; its files stay until the thread ends or takes up another plan."""
    if getattr(_OF_THREAD, "plan", "") != shipment.identity.sha256:
        _OF_THREAD.folder = tempfile.TemporaryDirectory(prefix="safety-harness-", ignore_cleanup_errors=True)
        file = unpacked(shipment.files, Path(_OF_THREAD.folder.name))
        _OF_THREAD.bench = PlanFromFile(file, shipment.identity)()
        _OF_THREAD.plan = shipment.identity.sha256
    bench: Bench = _OF_THREAD.bench
    return bench


@dataclass(eq=False)
class DaskCrew:
    """A Crew of the workers of a Dask scheduler; ``address`` is tcp://... or the path of a scheduler file.

    A chunk that takes too long is lost, and the worker that has it is restarted.  InputError if there is no
    such scheduler.
    """

    plan: Plan
    address: str
    limits: Limits = LIMITS
    replaced: int = 0
    _under_way: dict[Any, tuple[Chunk, float]] = field(default_factory=dict)  # by future
    _finished: SimpleQueue[Any] = field(default_factory=SimpleQueue)
    _mistake: InputError | None = None

    def __post_init__(self) -> None:
        try:
            from distributed import Client
        except ImportError:
            raise ScenarioError(
                place=Place(field="--cluster"),
                expected="the library distributed",
                got="none",
                hint="pip install 'safety-harness[cluster]'",
            ) from None
        is_address = "://" in self.address
        where = {"address": self.address} if is_address else {"scheduler_file": self.address}
        try:
            if not is_address and not Path(self.address).is_file():  # which would be waited for
                raise FileNotFoundError("no such file")
            make: Any = Client  # of whose methods some have no types
            self._client = make(**where, timeout=_ANSWER_S, set_as_default=False)
        except (OSError, ValueError, TimeoutError) as error:
            raise ScenarioError(
                place=Place(field="--cluster"),
                expected="the address (tcp://...) or the file of a Dask scheduler that answers",
                got=f"{self.address}: {error or type(error).__name__}",
            ) from error
        logging.getLogger("distributed").setLevel(logging.CRITICAL)  # what matters of it is said here
        self._shipment = Shipment(self.plan.files, self.plan.identity)
        self._looked_s = -math.inf
        self._look_around([])

    @property
    def size(self) -> int:
        """Threads of all workers when they were counted last, 1 at least: workers may come later."""
        return self._threads

    @property
    def free(self) -> int:
        """Chunks that are welcome."""
        return max(self.size * _AHEAD - len(self._under_way), 0)

    def give(self, chunk: Chunk) -> None:
        """As a task of its own."""
        future = self._client.submit(run_chunk, self._shipment, chunk, pure=False)
        self._under_way[future] = chunk, time.monotonic()
        future.add_done_callback(self._finished.put)

    def take(self, timeout_s: float) -> Sequence[Event]:
        """Chunks as they come, whole; a mistake in the plan once all before it was told."""
        if self._mistake is not None:
            raise self._mistake
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
        """Drop what is under way, which the scheduler does with its client; the cluster stays."""
        with suppress(OSError, TimeoutError):
            self._client.close(timeout=_ANSWER_S)

    def _event_of(self, future: Any) -> list[Event]:
        if future not in self._under_way:
            return []
        if future.status == "cancelled":  # by nobody here: the scheduler has forgotten it
            raise self._gone()
        chunk, _ = self._under_way.pop(future)
        try:
            if future.status == "error":
                return [Lost(chunk, f"{type(future.exception(_ANSWER_S)).__name__} on the cluster")]
            found = future.result(_ANSWER_S)
        except (OSError, TimeoutError, CancelledError, asyncio.CancelledError) as error:
            return [Lost(chunk, f"its result could not be fetched: {type(error).__name__}")]
        if isinstance(found, Mistake):
            self._mistake = found.error
            return []
        return [Arrived(chunk, tuple(found), last=True)]

    def _gone(self) -> CampaignError:
        return CampaignError(
            f"the scheduler {self.address} is gone; what came from it before is in the ledger"
        )

    def _look_around(self, events: list[Event]) -> None:
        """Count the workers and look for hung ones, now and then."""
        if time.monotonic() - self._looked_s < _LOOK_S:
            return
        self._looked_s = time.monotonic()
        try:
            self._threads = max(int(sum(self._client.nthreads().values())), 1)
            self._look_for_hung(events)
        except (OSError, TimeoutError) as error:
            if not events:  # they come first
                raise self._gone() from error

    def _look_for_hung(self, events: list[Event]) -> None:
        allowed_s = self.limits.first_s + _AHEAD * self.limits.silence_s
        now_s = time.monotonic()
        hung = [future for future, (_, since_s) in self._under_way.items() if now_s - since_s > allowed_s]
        if not hung:
            return
        keys = {future.key for future in hung}
        workers = [worker for worker, tasks in self._client.processing().items() if keys & set(tasks)]
        for future in hung:
            chunk, _ = self._under_way.pop(future)
            events.append(Lost(chunk, f"no result within {allowed_s:g} s"))
        self._client.cancel(hung, force=True)
        if workers:
            self.replaced += len(workers)
            self._client.restart_workers(workers, timeout=_ANSWER_S, raise_for_error=False)
