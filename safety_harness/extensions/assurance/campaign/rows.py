"""What is noted down of one episode."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from safety_harness.admission.repeatability import DrivenRun
from safety_harness.cell.avoidance.flaky import Asked
from safety_harness.extensions.assurance.statistics.sample import EpisodeOutcome
from safety_harness.trace.answer_times import AnswersTook
from safety_harness.trace.overruling import Overruling


@dataclass(frozen=True)
class ClaimJudgement:
    """One claim's word on one episode; the margin is SI, NaN where there is none."""

    outcome: EpisodeOutcome
    margin: float = math.nan
    worst_time_s: float = math.nan
    exercised: int = 0


@dataclass(frozen=True, kw_only=True)
class Row:
    """One episode, run or failed to run.  ``judgements`` are in the order of the plan's claims.

    ``seed`` is the root of its draws, ``draws`` how many of them it took until admission let one through.
    ``run`` is the number by which the run is told from others, 0 where there is none.  ``theorem`` are its
    ``theorem_bits``: 0 without a shield, which has bit 0; bit n says that assumption n did not hold.
    ``cell`` is where it falls in the coverage of the domain.  ``mishap`` says what the avoider did instead of
    answering, ``failure`` why there is no run at all.  ``seconds`` and ``worker`` are of this machine:
    everything else is the same wherever it runs.
    """

    stratum: int  # its place in the plan
    episode: int
    seed: int
    judgements: tuple[ClaimJudgement, ...]
    draws: int = 0
    decisions: int = 0
    proposed: int = 0
    opposite: int = 0
    stopped: int = 0
    faults: int = 0
    late: int = 0
    overruling: Overruling = field(default_factory=Overruling)
    run: int = 0
    theorem: int = 0
    cell: str = ""
    mishap: str = ""
    failure: str = ""
    seconds: float = 0.0
    worker: str = ""
    trace: bytes | None = field(default=None, repr=False)
    added: tuple[tuple[str, float], ...] = ()  # columns of packages, by name; a NaN is kept as nothing
    # Of which a ledger keeps nothing with the row; ``opened``: files beside the plan, and their SHA-256.
    asked: tuple[Asked, ...] = field(default=(), repr=False, compare=False)
    driven: DrivenRun | None = field(default=None, repr=False, compare=False)
    times: AnswersTook = field(default_factory=AnswersTook, repr=False, compare=False)  # of this machine
    opened: tuple[tuple[str, str], ...] = field(default=(), repr=False, compare=False)

    @property
    def violates(self) -> bool:
        """Any of the claims?"""
        return any(judgement.outcome is EpisodeOutcome.VIOLATED for judgement in self.judgements)
