"""The fewest rows that turn a verdict, and the chance to miss them, against counting every case."""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations, product

import pytest

from safety_harness.base.proportions import lower_bound, upper_bound
from safety_harness.cell.simulation.worlds import PYBULLET
from safety_harness.extensions.assurance.certification.altered import (
    chance_to_miss,
    rows_to_turn,
    runs_to_see,
)
from safety_harness.extensions.assurance.certification.evidence import ClaimResult, ClaimStatus
from safety_harness.extensions.assurance.certification.verdicts import standing_of
from safety_harness.extensions.assurance.statistics.sequential import anytime_lower, anytime_upper
from tests.assurance.certification.made_up_evidence import bound

MET = (ClaimStatus.SHOWN, ClaimStatus.DOUBTED)


def outcome(counts: tuple[int, ...], target: float | None, chance: float, early: bool) -> ClaimResult:
    """Holds, violated, without a verdict, untested; with the standing that the report gives it."""
    holds, violated, without, untested = counts
    tested, runs = holds + violated + without, sum(counts)
    lower, upper = (anytime_lower, anytime_upper) if early else (lower_bound, upper_bound)
    ends = (lower(violated, tested, chance), upper(violated + without, tested, chance)) if tested else None
    bounded = ends and replace(bound(*ends), confidence=1.0 - 2.0 * chance)
    standing, why = standing_of(
        target=target,
        bound=bounded,
        runs=runs,
        planned=runs,
        tested=tested,
        violated=violated,
        without_verdict=without,
        may_stop_early=early,
        world=PYBULLET,
    )
    return ClaimResult(
        stratum="all",
        planned=runs,
        runs=runs,
        holds=holds,
        violated=violated,
        inconclusive=without,
        failed=0,
        untested=untested,
        bound=bounded,
        standing=standing,
        why=why,
        least_margin_si=None,
    )


@pytest.mark.parametrize("early", [False, True])
@pytest.mark.parametrize("target", [0.4, 0.25, None])
def test_no_fewer_rows_turn_a_verdict_and_so_many_do(early: bool, target: float | None) -> None:
    runs, chance = 9, 0.1
    every = [c for c in product(range(runs + 1), repeat=4) if sum(c) == runs]
    words = {}
    for counts in every:
        standing = outcome(counts, target, chance, early).standing
        words[counts] = "met" if standing in MET else standing.value
    for counts in every:
        away = [
            sum(max(b - a, 0) for a, b in zip(counts, other, strict=True))
            for other in every
            if words[other] != words[counts]
        ]
        assert rows_to_turn(outcome(counts, target, chance, early), target, early=early) == min(away)


def test_eight_rows_of_six_hundred_are_missed_by_twenty_runs_with_76_per_cent() -> None:
    assert chance_to_miss(600, 8, 20) == pytest.approx(0.76, abs=0.005)
    assert runs_to_see(600, 8, 0.01) == 262


@pytest.mark.parametrize("runs", [1, 2, 7])
def test_the_chance_to_miss_is_that_of_all_draws_counted(runs: int) -> None:
    for altered, again in product(range(1, runs + 1), range(runs + 1)):
        draws = list(combinations(range(runs), again))
        missed = sum(min(draw, default=altered) >= altered for draw in draws)
        assert chance_to_miss(runs, altered, again) == pytest.approx(missed / len(draws))


@pytest.mark.parametrize("altered", [1, 3, 40, 600])
@pytest.mark.parametrize("miss", [0.5, 0.01, 1e-9])
def test_the_runs_made_again_are_as_many_as_the_chance_takes_and_no_more(altered: int, miss: float) -> None:
    again = runs_to_see(600, altered, miss)
    assert chance_to_miss(600, altered, again) <= miss
    assert chance_to_miss(600, altered, again - 1) > miss


def test_a_verdict_that_no_row_can_turn_to_another_side_is_turned_by_leaving_it_untested() -> None:
    """One run that violates is no proof, and there is no run that could be one more."""
    assert rows_to_turn(outcome((0, 1, 0, 0), 0.5, 0.05, early=False), 0.5, early=False) == 1


def test_verdicts_on_runs_that_are_missing_are_none() -> None:
    whole = outcome((5, 0, 0, 0), 0.5, 0.05, early=False)
    incomplete = replace(whole, bound=None, standing=ClaimStatus.INCOMPLETE)
    assert rows_to_turn(incomplete, 0.5, early=False) is None
