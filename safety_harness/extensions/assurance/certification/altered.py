"""How few altered rows would turn a verdict, and with what chance runs that are made again miss them all.

Of N runs n are drawn without replacement by who verifies.  If k of the N rows were altered, none of them is
among the n with the chance C(N - k, n) / C(N, n) (hypergeometric); a row with another outcome is seen for
certain once its run is made again.  k is the least number of rows that, with whatever outcomes, give another
word on the target: *met* (shown, with or without doubt), *not shown*, *refuted* or *never put to the test*;
without a target only the last one.  Doubt is no such word: a single run without a verdict makes it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

from safety_harness.base.proportions import lower_bound, upper_bound
from safety_harness.extensions.assurance.certification.evidence import ClaimEvidence, ClaimResult, ClaimStatus
from safety_harness.extensions.assurance.statistics.sequential import anytime_lower, anytime_upper


@dataclass(frozen=True)
class Turn:
    """``rows`` altered, and no fewer, give a claim another verdict in a stratum."""

    claim: str
    stratum: str
    standing: ClaimStatus
    rows: int


def turns_of(claims: Sequence[ClaimEvidence], *, early: bool) -> tuple[Turn, ...]:
    """Of every verdict that there is, the most easily turned first; ``early``: of bounds at every time."""
    turns = [
        Turn(claim.sentence, outcome.stratum, outcome.standing, rows)
        for claim in claims
        for outcome in claim.outcomes
        if (rows := rows_to_turn(outcome, claim.target, early=early)) is not None
    ]
    return tuple(sorted(turns, key=lambda turn: turn.rows))


def rows_to_turn(outcome: ClaimResult, target: float | None, *, early: bool) -> int | None:
    """The least number of rows with other outcomes that turn the verdict; None where runs are missing.

    The quickest way to more violations is from runs that have none, and then from untested ones; the quickest
    to fewer is the way back.
    """
    if outcome.standing is ClaimStatus.UNTESTED:
        return 1
    if outcome.bound is None:
        return None
    return min(_ways(outcome, target, 1.0 - outcome.bound.of_one_end, early))


def _ways(outcome: ClaimResult, target: float | None, chance: float, early: bool) -> Iterator[int]:
    yield outcome.tested  # all of them, never put to the test
    if target is None:
        return
    lower, upper = (anytime_lower, anytime_upper) if early else (lower_bound, upper_bound)
    tested, runs, violated = outcome.tested, outcome.runs, outcome.violated
    bad = violated + outcome.inconclusive + outcome.failed

    def refuted(rows: int) -> bool:
        new = max(rows - (tested - violated), 0)  # that were untested
        return lower(violated + rows, tested + new, chance) > target

    def met(rows: int) -> bool:
        new = max(rows - bad, 0)
        return upper(max(bad - rows, 0), tested + new, chance) <= target

    def unmet(rows: int) -> bool:
        new = max(rows - (tested - bad), 0)
        return upper(bad + rows, tested + new, chance) > target

    if outcome.standing is ClaimStatus.REFUTED:
        yield from _least(lambda rows: lower(violated - rows, tested, chance) <= target, violated)
    elif outcome.standing in (ClaimStatus.SHOWN, ClaimStatus.DOUBTED):
        yield from _least(unmet, runs - bad)
    else:
        yield from _least(refuted, runs - violated)
        yield from _least(met, bad + runs - tested)


def _least(turns: Callable[[int], bool], most: int) -> Iterator[int]:
    """The least number from 1 that does, if ``most`` does: who does stays with every further one."""
    least = 1
    if least <= most and turns(most):
        while least < most:
            middle = (least + most) // 2
            least, most = (least, middle) if turns(middle) else (middle + 1, most)
        yield most


def chance_to_miss(runs: int, altered: int, again: int) -> float:
    """That ``again`` of ``runs`` runs, drawn without replacement, are none of the ``altered`` ones."""
    few, many = sorted((altered, again))
    return math.prod(max(runs - many - k, 0) / (runs - k) for k in range(few))


def runs_to_see(runs: int, altered: int, miss: float) -> int:
    """The least number of runs made again that miss all ``altered`` rows with a chance of ``miss``."""
    (again,) = _least(lambda again: chance_to_miss(runs, altered, again) <= miss, runs - altered + 1)
    return again
