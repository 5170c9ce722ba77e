"""Compute the least number of altered rows that changes a verdict.

Also compute the probability that a check misses all of these rows. The verifier draws n of N runs without
replacement. Suppose that k of the N rows were altered. The draw misses all k altered rows with the
probability C(N - k, n) / C(N, n), according to the hypergeometric distribution. If an altered row states
another outcome, a repetition of its run always exposes the row.

Here, k is the least number of altered rows that can change a status. An altered row may state any outcome.
The statuses are *met*, *not shown*, *refuted* and *never tested*. A claim is *met* if it is shown, even with
doubt. If there is no target, only the status *never tested* is considered. Doubt is not a separate status,
because a single run without a verdict is enough to cause doubt.
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
    """The least number of altered ``rows`` that changes the verdict of a claim in a stratum."""

    claim: str
    stratum: str
    standing: ClaimStatus
    rows: int


def turns_of(claims: Sequence[ClaimEvidence], *, early: bool) -> tuple[Turn, ...]:
    """Return a ``Turn`` for every verdict of ``claims``.

    The verdict that is changed most easily comes first. ``early`` is true if the bounds hold simultaneously
    at all times, as in a plan that may stop early.
    """
    turns = [
        Turn(claim.sentence, outcome.stratum, outcome.standing, rows)
        for claim in claims
        for outcome in claim.outcomes
        if (rows := rows_to_turn(outcome, claim.target, early=early)) is not None
    ]
    return tuple(sorted(turns, key=lambda turn: turn.rows))


def rows_to_turn(outcome: ClaimResult, target: float | None, *, early: bool) -> int | None:
    """Return the least number of rows whose altered outcomes change the verdict of ``outcome``.

    To add violations with the fewest rows, a forger first alters tested runs that have no violation, and then
    untested runs. To remove violations with the fewest rows, a forger first alters violating runs, and then
    untested runs.

    Args:
        outcome: The results of a claim in a stratum.
        target: The violation probability that the plan allows, or None if the plan sets no target.
        early: True if the bounds hold simultaneously at all times.

    Returns:
        The number of rows, at least 1, or None while runs are missing.

    """
    if outcome.standing is ClaimStatus.UNTESTED:
        return 1
    if outcome.bound is None:
        return None
    return min(_least_rows(outcome, target, 1.0 - outcome.bound.of_one_end, early))


def _least_rows(outcome: ClaimResult, target: float | None, chance: float, early: bool) -> Iterator[int]:
    """Yield the least number of altered rows for each new status.

    A new status is any status except the present status.
    """
    yield outcome.tested  # every tested row must change to leave the claim untested
    if target is None:
        return
    lower, upper = (anytime_lower, anytime_upper) if early else (lower_bound, upper_bound)
    tested, runs, violated = outcome.tested, outcome.runs, outcome.violated
    bad = violated + outcome.inconclusive + outcome.failed

    def refuted(rows: int) -> bool:
        new = max(rows - (tested - violated), 0)  # rows that were untested before
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
    """If ``turns`` is true for a number from 1 to ``most``, yield the least such number.

    ``turns`` must be monotone: if it is true for a number, it is true for every larger number.
    """
    least = 1
    if least <= most and turns(most):
        while least < most:
            middle = (least + most) // 2
            least, most = (least, middle) if turns(middle) else (middle + 1, most)
        yield most


def chance_to_miss(runs: int, altered: int, again: int) -> float:
    """Return the probability that a sample without replacement misses all altered rows.

    The sample has ``again`` of ``runs`` runs, and ``altered`` rows were altered.
    """
    few, many = sorted((altered, again))
    return math.prod(max(runs - many - k, 0) / (runs - k) for k in range(few))


def runs_to_see(runs: int, altered: int, miss: float) -> int:
    """Return how many of ``runs`` runs must be repeated to find an altered row.

    If ``altered`` rows were altered, the probability of missing them all is at most ``miss``.
    """
    (again,) = _least(lambda again: chance_to_miss(runs, altered, again) <= miss, runs - altered + 1)
    return again
