"""Benches that misbehave at chosen episodes: what a worker may meet."""

from __future__ import annotations

import os
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from safety_harness.base.exceptions import InadmissibleError, Place
from safety_harness.extensions.assurance.campaign.processes import Chunk
from safety_harness.extensions.assurance.campaign.rows import ClaimJudgement, Row
from safety_harness.extensions.assurance.statistics.sample import EpisodeOutcome


def row_of(stratum: int, episode: int, *, claims: int = 2, trace: bytes | None = None) -> Row:
    """Margins that hang on the episode alone: every seventh violates."""
    margin = (episode % 7) - 0.5
    outcome = EpisodeOutcome.VIOLATED if margin < 0.0 else EpisodeOutcome.HOLDS
    return Row(
        stratum=stratum,
        episode=episode,
        seed=episode,
        judgements=(ClaimJudgement(outcome, margin, 0.1, 1),) * claims,
        draws=1,
        seconds=0.2,
        worker=str(os.getpid()),
        trace=trace if outcome is EpisodeOutcome.VIOLATED else None,
    )


@dataclass(frozen=True)
class Plain:
    """Takes ``seconds`` for each episode."""

    seconds: float = 0.0

    def __call__(self) -> Plain:
        return self

    def run(self, stratum: int, episodes: Sequence[int], *, keep_violations: bool = True) -> Iterator[Row]:
        for episode in episodes:
            self.meet(stratum, episode)
            time.sleep(self.seconds)
            yield row_of(stratum, episode, trace=b"t" if keep_violations else None)

    def meet(self, stratum: int, episode: int) -> None:
        """What happens at an episode."""


def done_by(bench: Plain, files: object, identity: object, chunk: Chunk) -> list[Row]:
    """What such a bench does on a cluster."""
    return list(bench.run(chunk.stratum, chunk.episodes, keep_violations=chunk.keep_violations))


@dataclass(frozen=True)
class Crashes(Plain):
    """At episode ``at`` of the first stratum the process ends; only ``times``, as files count them."""

    at: int = 5
    times: int = 1_000
    folder: Path = Path()

    def meet(self, stratum: int, episode: int) -> None:
        if (stratum, episode) == (0, self.at) and len(list(self.folder.glob("crash-*"))) < self.times:
            (self.folder / f"crash-{time.monotonic_ns()}").touch()
            self.misbehave()

    def misbehave(self) -> None:
        os._exit(3)


@dataclass(frozen=True)
class Hangs(Crashes):
    def misbehave(self) -> None:
        time.sleep(600.0)


@dataclass(frozen=True)
class CrashesAndHangs(Crashes):
    """Crashes at one episode, hangs at another, once each."""

    hangs_at: int = 12

    def meet(self, stratum: int, episode: int) -> None:
        for kind, at in ((Crashes, self.at), (Hangs, self.hangs_at)):
            folder = self.folder / kind.__name__
            folder.mkdir(exist_ok=True)
            kind(at=at, times=1, folder=folder).meet(stratum, episode)


@dataclass(frozen=True)
class Grows(Crashes):
    def misbehave(self) -> None:
        held = bytearray(700 * 2**20)
        held[::4096] = b"x" * len(held[::4096])
        time.sleep(600.0)


@dataclass(frozen=True)
class IsMistaken(Crashes):
    def misbehave(self) -> None:
        raise InadmissibleError(place=Place(field="avoider"), expected="one that is there", got="none")


@dataclass(frozen=True)
class NeverReady(Plain):
    def __call__(self) -> Plain:
        os._exit(9)
