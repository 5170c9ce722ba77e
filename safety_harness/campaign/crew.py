"""Who runs episodes: chunks in, rows out; and what can be lost on the way."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Protocol

from safety_harness.campaign.rows import Row


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
        ...

    @property
    def free(self) -> int:
        """How many chunks may be given now."""
        ...

    @property
    def replaced(self) -> int:
        """How many workers were replaced so far."""
        ...

    def give(self, chunk: Chunk) -> None:
        """Have it run."""
        ...

    def take(self, timeout_s: float) -> Sequence[Event]:
        """What has come since; waits for something until the timeout is over.

        InputError where the plan is to blame, CampaignError where nothing can be run any more.
        """
        ...

    def close(self) -> None:
        """Stop at once; what is under way is dropped."""
        ...


class RunsEpisodes(Protocol):
    """What a worker has: ``EpisodeRunner``, or another in its place."""

    def run(self, stratum: int, episodes: Sequence[int], *, keep_violations: bool = True) -> Iterator[Row]:
        """A row for each, in their order."""
        ...


class MakesBench(Protocol):
    """Made anew in each worker; has to be pickled on the way."""

    def __call__(self) -> RunsEpisodes:
        """InputError where the plan is to blame."""
        ...
