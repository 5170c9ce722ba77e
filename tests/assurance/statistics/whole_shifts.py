"""Whole shifts with a known rate of violations: is the bound an hour above it as often as it says?

A shift is eight hours of approaches with exponential gaps (or bursts of them), each of some stratum, each a
run that puts the claim to the test or not, and violates it or not.  Some shifts are watched, and the
approaches counted; a campaign makes runs of each stratum; the bound is made of both.  What is true of all
shifts is known, and met again in shifts that are only simulated for that.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from streams import sample_of

from safety_harness.extensions.assurance.statistics.rates import SharedError, most_an_hour
from safety_harness.extensions.assurance.statistics.sample import EpisodeOutcome, IndependentSample

SHIFT_H = 8.0
CONFIDENCE = 0.95
Formula = Callable[[int, float, list[IndependentSample]], float]


@dataclass(frozen=True, kw_only=True)
class Shifts:
    """``mixture`` of strata with their ``shares`` of violations; ``bursts`` of approaches at once."""

    name: str
    an_hour: float
    mixture: tuple[float, ...]
    shares: tuple[float, ...]
    tested: float = 1.0
    watched: int = 1
    runs: int = 300
    bursts: int = 1

    @property
    def truth(self) -> float:
        """Violations an hour."""
        return self.an_hour * self.tested * float(np.dot(self.mixture, self.shares))

    def approaches(self, shifts: int, rng: np.random.Generator) -> int:
        """How many there are in so many shifts."""
        count = 0
        for _ in range(shifts):
            many = int(SHIFT_H * self.an_hour / self.bursts * 2 + 50)
            begins = np.cumsum(rng.exponential(self.bursts / self.an_hour, many))
            assert begins[-1] > SHIFT_H
            count += self.bursts * int(np.count_nonzero(begins < SHIFT_H))
        return count

    def met(self, shifts: int, rng: np.random.Generator) -> float:
        """Violations an hour, as they are met in so many shifts."""
        strata = rng.choice(len(self.mixture), self.approaches(shifts, rng), p=self.mixture)
        chances = self.tested * np.array(self.shares)[strata]
        return float((rng.random(len(strata)) < chances).sum()) / (shifts * SHIFT_H)

    def campaign(self, rng: np.random.Generator) -> list[IndependentSample]:
        """Runs of each stratum."""
        samples = []
        for share in self.shares:
            codes = np.where(rng.random(self.runs) < share, EpisodeOutcome.VIOLATED, EpisodeOutcome.HOLDS)
            codes = np.where(rng.random(self.runs) < self.tested, codes, EpisodeOutcome.UNTESTED)
            samples.append(sample_of(codes))
        return samples

    def coverage(self, formula: Formula, times: int, seed: int) -> float:
        """How often the bound is not below the truth."""
        rng = np.random.default_rng(seed)
        hours = self.watched * SHIFT_H
        bounds = [
            formula(self.approaches(self.watched, rng), hours, self.campaign(rng)) for _ in range(times)
        ]
        return float(np.mean(np.array(bounds) >= self.truth))


def ours(count: int, hours: float, samples: list[IndependentSample]) -> float:
    """As an evidence report has it."""
    error = SharedError(CONFIDENCE, 1)
    return most_an_hour(count, hours, error.of_each_rate) * error.worst_run(samples).high


def point_by_point(count: int, hours: float, samples: list[IndependentSample]) -> float:
    """Wrong: neither has an uncertainty."""
    return count / hours * max(one.violations / max(one.trials, 1) for one in samples)


def rate_as_counted(count: int, hours: float, samples: list[IndependentSample]) -> float:
    """Wrong where few approaches were counted: the rate has no uncertainty."""
    return count / hours * SharedError(CONFIDENCE, 1).worst_run(samples).high


FEW = Shifts(name="few approaches, many runs", an_hour=1.0, mixture=(1.0,), shares=(0.1,), runs=2000)
EVERYDAY = Shifts(
    name="seen and unseen", an_hour=30.0, mixture=(0.7, 0.3), shares=(0.01, 0.04), tested=0.4, watched=2
)
WORST = Shifts(name="the worst stratum alone", an_hour=30.0, mixture=(0.0, 1.0), shares=(0.01, 0.04))
RARE = Shifts(name="hardly a violation", an_hour=12.0, mixture=(1.0,), shares=(0.003,), runs=500)
EVERY = (FEW, EVERYDAY, WORST, RARE)
BURSTS = Shifts(
    name="in bursts of six: not a Poisson process",
    an_hour=12.0,
    mixture=(1.0,),
    shares=(0.1,),
    runs=20_000,
    bursts=6,
)
