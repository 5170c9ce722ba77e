"""The row of one episode."""

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
    """The result of one episode for one claim.

    The margin is in SI units, and NaN if there is no margin.
    """

    outcome: EpisodeOutcome
    margin: float = math.nan
    worst_time_s: float = math.nan
    exercised: int = 0


@dataclass(frozen=True, kw_only=True)
class Row:
    """An episode that ran or failed to run.

    ``judgements`` has an entry for each of the plan's claims, in their order. ``seed`` is the seed from which
    all draws of the episode derive. ``draws`` is the number of draws up to the draw that admission accepted.
    ``run`` is a number that identifies the run, or 0 if there is no run. ``theorem`` has the bits of
    ``theorem_bits``. Bit 0 is set if the avoider runs behind a shield, and bit n is set if assumption n did
    not hold.

    ``cell`` is the run's cell in the coverage map. ``run_error`` states how the avoider failed to answer.
    ``failure`` is the reason why the run is missing or incomplete. ``seconds`` and ``worker`` depend on this
    machine, and all other fields are equal on every machine.
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
    run_error: str = ""
    failure: str = ""
    seconds: float = 0.0
    worker: str = ""
    trace: bytes | None = field(default=None, repr=False)
    added: tuple[tuple[str, float], ...] = ()  # columns of packages, by name; the ledger stores NaN as NULL
    # A ledger does not store these fields with the row. ``opened``: (path from the plan's folder, SHA-256).
    asked: tuple[Asked, ...] = field(default=(), repr=False, compare=False)
    driven: DrivenRun | None = field(default=None, repr=False, compare=False)
    times: AnswersTook = field(default_factory=AnswersTook, repr=False, compare=False)  # of this machine
    opened: tuple[tuple[str, str], ...] = field(default=(), repr=False, compare=False)

    @property
    def violates(self) -> bool:
        """Whether the episode violates any claim."""
        return any(judgement.outcome is EpisodeOutcome.VIOLATED for judgement in self.judgements)
