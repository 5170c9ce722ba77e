"""A bound for the reference world from kinematic runs: what it adds, and that it holds."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from acceptance import misses_are_no_more_than
from streams import sample_of, violations

from safety_harness.base.exceptions import StatisticsError
from safety_harness.base.proportions import lower_bound, upper_bound
from safety_harness.cell.simulation.worlds import KINEMATIC
from safety_harness.extensions.assurance.statistics.model_gap import bridged_bound
from safety_harness.extensions.assurance.statistics.sample import EpisodeOutcome

H, V, U, I, F = (int(outcome) for outcome in EpisodeOutcome)  # noqa: E741


def kinematic(codes: Any, **changes: Any) -> Any:
    return sample_of(codes, world=KINEMATIC, **changes)


def test_three_bounds_by_hand() -> None:
    here, there = [H] * 200, [V] * 2 + [H] * 148 + [U] * 50
    found = bridged_bound(kinematic([V] * 3 + [H] * 997, seed=9), kinematic(here), sample_of(there))
    third = 0.05 / 3
    assert found.kinematic == pytest.approx(upper_bound(3, 1000, third))
    assert found.optimistic == pytest.approx(upper_bound(2, 200, third))
    assert found.tested == pytest.approx(lower_bound(150, 200, third))
    assert found.high == pytest.approx((found.kinematic + found.optimistic) / found.tested)
    assert (found.episodes, found.in_both, found.optimistic_seen) == (1000, 200, 2)


def test_what_the_kinematic_world_shows_too_is_counted_once() -> None:
    both = bridged_bound(kinematic([H] * 500), kinematic([V] * 5 + [H] * 95), sample_of([V] * 5 + [H] * 95))
    assert both.optimistic_seen == 0
    missed = bridged_bound(kinematic([H] * 500), kinematic([H] * 100), sample_of([V] * 5 + [H] * 95))
    assert missed.optimistic_seen == 5
    assert missed.high > both.high


@pytest.mark.parametrize("outcome", [F, I])
def test_what_may_have_been_a_violation_there_counts_as_one(outcome: int) -> None:
    found = bridged_bound(kinematic([H] * 500), kinematic([H] * 100), sample_of([outcome] + [H] * 99))
    assert found.optimistic_seen == 1


def test_a_claim_never_tested_there_is_not_bounded() -> None:
    assert bridged_bound(kinematic([H] * 500), kinematic([H] * 100), sample_of([U] * 100)).high == 1.0


def test_the_bound_holds_as_often_as_it_says() -> None:
    """Worlds that disagree: of tested runs 6 % violate in the reference world, half of them unseen here."""
    rng, missed = np.random.default_rng(14), 0

    def worlds(n: int) -> tuple[np.ndarray, np.ndarray]:
        u = rng.random(n)
        there = np.where(u < 0.048, V, np.where(u < 0.8, H, U))  # 0.06 of the 0.8 that are tested
        here = np.where((u < 0.024) | ((u > 0.1) & (u < 0.11)), V, H)
        return here, there

    for _ in range(500):
        here, there = worlds(150)
        found = bridged_bound(kinematic(worlds(600)[0]), kinematic(here), sample_of(there), 0.9)
        missed += found.high < 0.06
    assert misses_are_no_more_than(missed, 500, 0.1)
    alone = [upper_bound(int(np.sum(worlds(600)[0] == V)), 600, 0.1) < 0.06 for _ in range(500)]
    assert not misses_are_no_more_than(sum(alone), 500, 0.1), "the kinematic bound alone would be wrong"


def test_samples_of_other_worlds_claims_or_episodes_are_refused() -> None:
    fine = (kinematic([H] * 500), kinematic([H] * 100), sample_of([H] * 100))
    bridged_bound(*fine)
    with pytest.raises(StatisticsError, match="world"):
        bridged_bound(fine[0], fine[2], fine[1])
    with pytest.raises(StatisticsError, match="world"):
        bridged_bound(sample_of([H] * 500), *fine[1:])
    with pytest.raises(StatisticsError, match="episodes in both worlds"):
        bridged_bound(fine[0], fine[1], sample_of([H] * 100, seed=4))
    with pytest.raises(StatisticsError, match="stratum"):
        bridged_bound(kinematic([H] * 500, stratum="unseen"), *fine[1:])
    with pytest.raises(StatisticsError, match="stop at any time"):
        bridged_bound(violations(0, 500, stop_early=True, world=KINEMATIC), *fine[1:])
