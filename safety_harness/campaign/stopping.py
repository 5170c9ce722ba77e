"""When a stratum of a plan that may stop early is decided: by its first n episodes."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from safety_harness.campaign.ledger import Ledger
from safety_harness.campaign.plan import Plan
from safety_harness.campaign.rows import Row
from safety_harness.statistics.binomial import chance_of_each, ends_of
from safety_harness.statistics.sample import EpisodeOutcome
from safety_harness.statistics.sequential import anytime_lower, anytime_upper

EVERY = 50  # episodes between looks

_Outcomes = tuple[EpisodeOutcome, ...]  # of an episode, by claim


class Stopping:
    """Looks at the outcomes in the order of the episodes, so that the moment does not hang on who is quicker.

    A claim with a target is decided once its upper bound meets the target, or its lower bound is above it;
    a stratum is when all of its claims are.  Bounds hold at every look (``statistics.sequential``).
    """

    def __init__(self, plan: Plan, ledger: Ledger) -> None:
        self._targets = [one.target for one in plan.claims]
        self._active = plan.stop_early and None not in self._targets
        self._chance = chance_of_each(plan.confidence, ends_of(len(plan.claims), len(plan.strata)))
        count = len(plan.strata)
        self._counts = np.zeros((count, len(plan.claims), len(EpisodeOutcome)), np.int64)
        self._reached = [0] * count
        self._ahead: list[dict[int, _Outcomes]] = [{} for _ in range(count)]
        self._decided: dict[int, int] = {}
        if self._active:
            for stratum in range(count):
                self._read(ledger, stratum)

    def add(self, rows: Iterable[Row]) -> None:
        """Take new episodes in."""
        if self._active:
            for row in rows:
                outcomes = tuple(judgement.outcome for judgement in row.judgements)
                self._ahead[row.stratum][row.episode] = outcomes
            for stratum in range(len(self._ahead)):
                self._advance(stratum)

    @property
    def decided(self) -> dict[int, int]:
        """Strata that are decided, and after how many episodes."""
        return self._decided

    def _read(self, ledger: Ledger, stratum: int) -> None:
        columns = [ledger.outcomes(stratum, claim) for claim in range(len(self._targets))]
        for k, episode in enumerate(columns[0][0].tolist()):
            self._ahead[stratum][episode] = tuple(EpisodeOutcome(int(codes[k])) for _, codes, _ in columns)
        self._advance(stratum)

    def _advance(self, stratum: int) -> None:
        ahead = self._ahead[stratum]
        while stratum not in self._decided and self._reached[stratum] in ahead:
            for claim, outcome in enumerate(ahead.pop(self._reached[stratum])):
                self._counts[stratum, claim, outcome] += 1
            self._reached[stratum] += 1
            if self._reached[stratum] % EVERY == 0 and self._is_decided(stratum):
                self._decided[stratum] = self._reached[stratum]

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
