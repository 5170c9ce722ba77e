"""The loop that gives episodes to a worker pool and commits their rows to the ledger.

If a chunk is lost, the runner runs its episodes again, one at a time, to find the episode that caused the
loss. After ATTEMPTS losses, the outcome of that episode is FAILED. The results do not depend on the order in
which rows arrive, or on the time of day.
"""

from __future__ import annotations

import time
from collections import Counter, deque
from collections.abc import Callable, Iterable
from dataclasses import KW_ONLY, dataclass, field
from functools import partial
from itertools import chain, islice

import numpy as np

from safety_harness.admission.repeatability import Repeatability
from safety_harness.base.compiling import Pace
from safety_harness.extensions.assurance.campaign.episodes import EpisodeRunner, failed_row, random_episodes
from safety_harness.extensions.assurance.campaign.ledger import Ledger
from safety_harness.extensions.assurance.campaign.plan import Plan
from safety_harness.extensions.assurance.campaign.processes import Arrived, Chunk, Lost, WorkerPool
from safety_harness.extensions.assurance.campaign.rows import Row
from safety_harness.extensions.assurance.campaign.summary import tally_of
from safety_harness.extensions.assurance.statistics.binomial import chance_of_each, ends_of
from safety_harness.extensions.assurance.statistics.sample import EpisodeOutcome
from safety_harness.extensions.assurance.statistics.sequential import anytime_lower, anytime_upper

ATTEMPTS = 3  # losses of an episode before its outcome is FAILED; a choice
CHUNK_S = 1.0  # of work per chunk, so that handing over and committing cost little
MOST_IN_CHUNK = 1000  # a choice
MOST_TOGETHER = 64  # episodes of a chunk in a world with batches, which holds all their traces in memory
_WAIT_S = 0.5  # to wait for events before ``enough`` is called again
_COMMIT_S = 0.2  # between commits, so that a transaction has many rows


@dataclass(eq=False)
class CampaignRunner:
    """A runner of the missing episodes of a ledger, which also reports its progress.

    ``tally`` has the counts of the committed episodes. ``done_now`` is the number of episodes of this
    session, and ``retried`` is the number of lost episodes that ran again. The runner calls ``enough`` before
    it gives chunks to workers. Once ``enough`` returns True, the workers finish their chunks and receive no
    new chunks.

    ``part`` is a pair (k, n) that selects every n-th episode, beginning with episode k. Machines that have
    only the plan in common can thus divide the work. ``repeatability`` collects the queries that all workers
    sent to their avoiders.
    """

    plan: Plan
    ledger: Ledger
    crew: WorkerPool
    _: KW_ONLY
    on_progress: Callable[[CampaignRunner], None] = lambda runner: None
    enough: Callable[[], bool] = lambda: False
    part: tuple[int, int] = (0, 1)
    done_now: int = 0
    retried: int = 0
    _out: dict[Chunk, set[int]] = field(default_factory=dict)  # episodes whose rows are still to come
    _again: deque[Chunk] = field(default_factory=deque)
    _tried: Counter[tuple[int, int]] = field(default_factory=Counter)
    _rows: list[Row] = field(default_factory=list)
    _committed_s: float = 0.0
    _spent_s: float = 0.0

    def __post_init__(self) -> None:
        self.repeatability = Repeatability()
        self._bench = EpisodeRunner(self.plan)  # draws scenarios here; workers run them
        self.tally = tally_of(self.ledger)
        self.pace = Pace()
        # The ledger of an earlier session may already have traces of violations.
        self._kept = [sorted(self.ledger.violations_kept(s)) for s in range(len(self.plan.strata))]
        self._stopping = Stopping(self.plan, self.ledger)
        missing = [self._missing(s) for s in range(len(self.plan.strata))]
        self._left = [sum(map(len, ranges)) for ranges in missing]
        self._episodes = [chain.from_iterable(ranges) for ranges in missing]
        self._stratum = 0

    @property
    def left(self) -> int:
        """The number of episodes that have not finished yet."""
        strata = zip(self.tally.strata, self._left, strict=True)
        return sum(left for stratum, left in strata if not stratum.complete)

    @property
    def standing(self) -> tuple[int, int]:
        """The numbers of finished and of planned episodes.

        If the runner runs only a part, the numbers are those of the part.
        """
        first, parts = self.part
        if parts == 1:
            return self.tally.done, self.tally.planned
        planned = sum(len(range(first, stratum.planned, parts)) for stratum in self.tally.strata)
        return planned - sum(self._left), planned

    def run(self) -> bool:
        """Run until the campaign ends or ``enough`` returns True. Return True if the campaign is complete.

        InputError and CampaignError are passed on from ``WorkerPool.take``. Raise OutputError if the ledger
        cannot be written. After any error, the ledger has all episodes that finished before the error.
        """
        try:
            self._run()
        finally:
            self.commit()
        return self.tally.complete

    def _run(self) -> None:
        while True:
            stopped = self.enough()
            while not stopped and self.crew.free and (chunk := self._next_chunk()) is not None:
                self._out[chunk] = set(chunk.episodes)
                self.crew.give(chunk)
            if not self._out:
                break
            for event in self.crew.take(_WAIT_S):
                if isinstance(event, Arrived):
                    self._arrived(event)
                else:
                    self._lost(event)
            now_s = time.monotonic()
            if now_s - self._committed_s > _COMMIT_S or not self._out:
                self.commit()
                self._committed_s = now_s
                self.on_progress(self)
        self._drop_surplus()
        self.on_progress(self)

    def commit(self) -> None:
        """Write the rows that have arrived.

        After an error, the runner keeps the rows for the next commit.
        """
        # Rows may still arrive for episodes after the end of a stratum.
        ends = [stratum.stopped_after for stratum in self.tally.strata]  # later episodes do not count
        rows = [row for row in self._rows if (end := ends[row.stratum]) is None or row.episode < end]
        if rows:
            self.ledger.record(rows)
        self._rows = []
        for row in rows:
            self.tally.strata[row.stratum].add(row)
            if row.trace is not None and row.violates:
                self._kept[row.stratum].append(row.episode)
        self._stopping.add(rows)
        for stratum, stop in self._stopping.decided.items():
            if self.tally.strata[stratum].stopped_after is None:
                self.ledger.stop(stratum, stop)
                # Count again, because ``stop`` has removed rows.
                self.tally = tally_of(self.ledger)

    def _arrived(self, event: Arrived) -> None:
        waiting = self._out[event.chunk]
        for row in event.rows:
            waiting.discard(row.episode)
            drawn = partial(self._bench.scenario, row.stratum, row.episode, max(row.draws - 1, 0))
            self.repeatability.take(row.asked, drawn)
            if row.driven is not None:
                self.repeatability.take_run(row.driven, drawn)
            self._rows.append(row)
            self.done_now += 1
            self._left[row.stratum] -= 1
            self._spent_s += row.seconds
        if event.last:
            del self._out[event.chunk]

    def _lost(self, event: Lost) -> None:
        """Try lost episodes again, one at a time.

        An episode that is lost too often becomes a failed episode.
        """
        waiting = sorted(self._out.pop(event.chunk))
        # A chunk of several episodes does not show which of them ended the worker.
        blamed = event.times if len(event.chunk.episodes) == 1 else 0
        self.retried += len(waiting)
        for episode in waiting:
            key = (event.chunk.stratum, episode)
            self._tried[key] += blamed
            if self._tried[key] >= ATTEMPTS:
                why = f"failed to run, {self._tried[key]} times: {event.why}"
                self._rows.append(failed_row(self.plan, *key, why))
                self.done_now += 1
                self._left[event.chunk.stratum] -= 1
            else:
                self._again.append(Chunk(event.chunk.stratum, (episode,), event.chunk.keep_violations))

    def _next_chunk(self) -> Chunk | None:
        if self._again:
            return self._again.popleft()
        while self._stratum < len(self.plan.strata):
            stratum = self._stratum
            if self.tally.strata[stratum].stopped_after is None:
                episodes = tuple(islice(self._episodes[stratum], self._length))
                if episodes:  # keep the first violations by their numbers, in any order of arrival
                    earlier = sum(episode < episodes[0] for episode in self._kept[stratum])
                    return Chunk(stratum, episodes, earlier < self.plan.violations_kept)
            self._stratum += 1
        return None

    @property
    def _length(self) -> int:
        """The number of episodes in the next chunk.

        The number is 1 until the time of an episode is known.
        """
        if not self.done_now:
            return 1
        each_s = self._spent_s / self.done_now
        most = MOST_TOGETHER if self.plan.world.batch else MOST_IN_CHUNK
        return max(1, min(int(CHUNK_S / max(each_s, 1e-6)), most))

    def _missing(self, stratum: int) -> list[range]:
        first, parts = self.part
        missing = self.ledger.missing(stratum)
        return [range(gap.start + (first - gap.start) % parts, gap.stop, parts) for gap in missing]

    def _drop_surplus(self) -> None:
        """Drop the traces of violations, except those of the first ``violations_kept`` violating episodes."""
        for stratum, tally in enumerate(self.tally.strata):
            surplus = self.ledger.violations_kept(stratum)[self.plan.violations_kept :]
            if tally.complete and surplus:
                random = random_episodes(self.plan, stratum)
                self.ledger.drop_traces(stratum, [episode for episode in surplus if episode not in random])


EVERY = 50  # episodes between two looks at the bounds

_Outcomes = tuple[EpisodeOutcome, ...]  # of an episode, by claim


class Stopping:
    """The rule that ends strata early.

    The rule receives the episodes in order, so that the workers' speed has no effect. A claim is decided once
    its upper bound meets the target, or its lower bound exceeds the target. A stratum ends once all its
    claims are decided. The bounds from ``extensions.assurance.statistics.sequential`` hold simultaneously at
    all times, so the rule may be evaluated repeatedly.
    """

    def __init__(self, plan: Plan, ledger: Ledger) -> None:
        self._targets = [planned.target for planned in plan.claims]
        self._active = plan.stop_early and None not in self._targets
        self._chance = chance_of_each(plan.confidence, ends_of(len(plan.claims), len(plan.strata)))
        count = len(plan.strata)
        self._counts = np.zeros((count, len(plan.claims), len(EpisodeOutcome)), np.int64)
        self._reached = [0] * count
        self._ahead: list[dict[int, _Outcomes]] = [{} for _ in range(count)]
        self.decided: dict[int, int] = {}  # stratum -> the number of episodes that decided it
        for stratum in range(count if self._active else 0):
            columns = [ledger.outcomes(stratum, claim) for claim in range(len(plan.claims))]
            for k, episode in enumerate(columns[0][0].tolist()):
                self._ahead[stratum][episode] = tuple(
                    EpisodeOutcome(int(codes[k])) for _, codes, _ in columns
                )
            self._advance(stratum)

    def add(self, rows: Iterable[Row]) -> None:
        """Receive the episodes of ``rows``, and decide for each stratum whether it ends."""
        if self._active:
            for row in rows:
                outcomes = tuple(judgement.outcome for judgement in row.judgements)
                self._ahead[row.stratum][row.episode] = outcomes
            for stratum in range(len(self._ahead)):
                self._advance(stratum)

    def _advance(self, stratum: int) -> None:
        ahead = self._ahead[stratum]
        while stratum not in self.decided and self._reached[stratum] in ahead:
            for claim, outcome in enumerate(ahead.pop(self._reached[stratum])):
                self._counts[stratum, claim, outcome] += 1
            self._reached[stratum] += 1
            if self._reached[stratum] % EVERY == 0 and self._is_decided(stratum):
                self.decided[stratum] = self._reached[stratum]

    def _is_decided(self, stratum: int) -> bool:
        for target, counts in zip(self._targets, self._counts[stratum], strict=True):
            assert target is not None
            trials = int(counts.sum() - counts[EpisodeOutcome.UNTESTED])
            surely = int(counts[EpisodeOutcome.VIOLATED])
            perhaps = surely + int(counts[EpisodeOutcome.INCONCLUSIVE] + counts[EpisodeOutcome.FAILED])
            shown = anytime_upper(perhaps, trials, self._chance) <= target
            if not trials or not (shown or anytime_lower(surely, trials, self._chance) > target):
                return False
        return True
