"""Who runs episodes, chunks in and rows out, and a process of a crew: it runs chunks, and says so."""

from __future__ import annotations

import os
import resource
import signal
import sys
import threading
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Protocol

from safety_harness.campaign.episodes import EpisodeRunner
from safety_harness.campaign.identity import Identity
from safety_harness.campaign.plan import read_plan
from safety_harness.campaign.rows import Row
from safety_harness.exceptions import InputError, Place


@dataclass(frozen=True)
class Mistake:
    """An InputError on its way between processes: exceptions with keywords are not pickled."""

    kind: type[InputError]
    place: Place
    expected: str
    got: str
    hint: str

    @classmethod
    def of(cls, error: InputError) -> Mistake:
        """The same, to be sent."""
        return cls(type(error), error.place, error.expected, error.got, error.hint)

    @property
    def error(self) -> InputError:
        """The same, to be raised."""
        return self.kind(place=self.place, expected=self.expected, got=self.got, hint=self.hint)


@dataclass(frozen=True)
class Ready:
    """The worker has read the plan."""


@dataclass(frozen=True)
class ChunkDone:
    """A chunk is finished; ``resident_bytes`` of the worker now."""

    resident_bytes: int


@dataclass(frozen=True)
class PlanFromFile:
    """Makes an EpisodeRunner of the plan in a file; LedgerError if it is no longer the declared one."""

    file: Path
    identity: Identity

    def __call__(self) -> EpisodeRunner:
        """Read the plan."""
        plan = read_plan(self.file)
        self.identity.refuse_other(plan.identity, self.file, where=", on every machine")
        return EpisodeRunner(plan, worker=f"{os.uname().nodename}:{os.getpid()}")


def work(connection: Connection, lifeline: Connection, make: MakesBench) -> None:
    """Answer chunks with their rows one by one, then Done; ends when nobody is there any more."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the first process answers Ctrl-C
    threading.Thread(target=_end_with, args=(lifeline,), daemon=True).start()
    try:
        bench = make()
        connection.send(Ready())
        while True:
            chunk: Chunk | None = connection.recv()
            if chunk is None:
                return
            for row in bench.run(chunk.stratum, chunk.episodes, keep_violations=chunk.keep_violations):
                connection.send(row)
            connection.send(ChunkDone(resident_bytes(os.getpid())))
    except InputError as error:
        connection.send(Mistake.of(error))
    except (EOFError, BrokenPipeError):
        return


def _end_with(lifeline: Connection) -> None:
    """End this process when the one that started it has ended, whatever this one is at."""
    try:
        lifeline.recv()
    except (EOFError, OSError):
        os._exit(0)


def resident_bytes(process: int) -> int:
    """Memory that a process has now; 0 for one that is gone."""
    try:
        pages = int(Path(f"/proc/{process}/statm").read_text().split()[1])
    except (OSError, IndexError, ValueError):
        if process == os.getpid() and sys.platform == "darwin":
            return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        return 0
    return pages * os.sysconf("SC_PAGE_SIZE")


@dataclass(frozen=True)
class Chunk:
    """Episodes of one stratum that one worker runs; ``keep_violations``: are traces of these still wanted?"""

    stratum: int
    episodes: tuple[int, ...]
    keep_violations: bool


@dataclass(frozen=True)
class Arrived:
    """Rows of a chunk, which may come in parts; ``last`` with the last of them."""

    chunk: Chunk
    rows: tuple[Row, ...]
    last: bool


@dataclass(frozen=True)
class Lost:
    """A chunk of which nothing more will come, and why: its worker crashed, hung or grew too large.

    ``times`` is how often it was certainly begun and lost: with 0 none of its episodes can be blamed.
    """

    chunk: Chunk
    why: str
    times: int = 1


Event = Arrived | Lost


class WorkerPool(Protocol):
    """Workers.  ``give`` while ``free``, then ``take``."""

    @property
    def size(self) -> int:
        """How many can work at the same time now."""

    @property
    def free(self) -> int:
        """How many chunks may be given now."""

    @property
    def replaced(self) -> int:
        """How many workers were replaced so far."""

    def give(self, chunk: Chunk) -> None:
        """Have it run."""

    def take(self, timeout_s: float) -> Sequence[Event]:
        """What has come since; waits for something until the timeout is over.

        InputError where the plan is to blame, CampaignError where nothing can be run any more.
        """

    def close(self) -> None:
        """Stop at once; what is under way is dropped."""


class RunsEpisodes(Protocol):
    """What a worker has: ``EpisodeRunner``, or another in its place."""

    def run(self, stratum: int, episodes: Sequence[int], *, keep_violations: bool = True) -> Iterator[Row]:
        """A row for each, in their order."""


class MakesBench(Protocol):
    """Made anew in each worker; has to be pickled on the way."""

    def __call__(self) -> RunsEpisodes:
        """InputError where the plan is to blame."""
