"""Multilevel splitting on problems with known answers."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np
import pytest
import scipy.stats
from acceptance import misses_are_no_more_than
from known_problems import normal, outside_a_sphere, tail, two_tails
from scipy.special import ndtri

from safety_harness.base.exceptions import StatisticsError
from safety_harness.extensions.assurance.statistics.rare import Margins, Splitting, split
from safety_harness.extensions.assurance.statistics.sample import Floats

USUAL = Splitting()
QUICK = Splitting(particles=150, steps=6, replications=12)
CRUDE = Splitting(particles=60, steps=3, replications=10)  # in many repetitions; right however few there are


KNOWN: list[tuple[Margins, int, float, Splitting]] = [
    (tail(2.0), 2, float(scipy.stats.norm.sf(2.0)), USUAL),
    (tail(3.0), 5, float(scipy.stats.norm.sf(3.0)), USUAL),
    (two_tails(4.0), 2, 2.0 * float(scipy.stats.norm.sf(4.0)), USUAL),
    (outside_a_sphere(9.0), 30, float(scipy.stats.chi2.sf(81.0, 30)), Splitting(particles=200, steps=6)),
]


@pytest.mark.parametrize(("margins", "dimensions", "truth", "how"), KNOWN)
def test_the_known_answer_lies_in_the_interval(
    margins: Margins, dimensions: int, truth: float, how: Splitting
) -> None:
    found = split(margins, dimensions, seed=3, how=how, confidence=0.999)
    assert found.low <= truth <= found.high
    assert found.value == pytest.approx(truth, rel=0.25)
    assert found.reached == 20
    assert found.model_only


def test_it_takes_far_fewer_runs_than_brute_force() -> None:
    """The same relative error from independent draws takes 1 / (error^2 p) of them."""
    truth = float(scipy.stats.norm.sf(4.0))
    found = split(tail(4.0), 2, seed=4)
    error = float(np.std(found.replicates, ddof=1)) / np.sqrt(20) / truth
    assert found.evaluations * 5 < 1.0 / (error**2 * truth)


def test_estimates_are_right_on_average_and_intervals_hold_as_often_as_they_say() -> None:
    truth, runs, missed, values = float(scipy.stats.norm.sf(3.0)), 40, 0, []
    for seed in range(runs):
        found = split(tail(3.0), 2, seed=seed, how=CRUDE, confidence=0.9)
        missed += not found.low <= truth <= found.high
        values.append(found.value)
    assert misses_are_no_more_than(missed, runs, 0.1)
    error = np.std(values, ddof=1) / np.sqrt(runs)
    assert abs(np.mean(values) - truth) < 4.0 * error


def test_the_upper_end_is_that_of_the_plain_draws_alone() -> None:
    """Pilot and replications begin with plain draws: it is Clopper and Pearson's end for their number."""
    found = split(tail(2.0), 2, seed=1, how=QUICK)
    assert found.plain_draws == 13 * 150
    exact = scipy.stats.binomtest(found.plain_violations, found.plain_draws, alternative="less")
    assert found.high == pytest.approx(exact.proportion_ci(0.975).high, rel=1e-9)


def test_brute_force_agrees_where_it_can() -> None:
    """A margin with a corner, a plateau and a jump, of a thousandth or so."""

    def margins(points: Floats) -> Floats:
        z = normal(points)
        first = np.where(points[:, 2] < 0.3, 2.4, 3.4) - z[:, 0]
        return np.minimum(np.maximum(first, z[:, 1] - 2.0), 2.0)

    drawn = margins(np.random.default_rng(5).random((500_000, 3))) < 0.0
    brute = scipy.stats.binomtest(int(drawn.sum()), len(drawn)).proportion_ci(0.999)
    found = split(margins, 3, seed=6, confidence=0.999)
    assert found.low < brute.high
    assert brute.low < found.high


def test_what_is_not_rare_is_estimated_too() -> None:
    found = split(lambda points: points[:, 0] - 0.7, 1, seed=7, how=QUICK)
    assert found.levels == (0.0,)
    assert found.low <= 0.7 <= found.high


def test_replications_that_all_say_the_same_tell_nothing_of_their_spread() -> None:
    """Everything violates: twelve times a probability of 1, and the interval is not of width 0."""
    found = split(lambda points: -1.0 - points[:, 0], 1, seed=7, how=QUICK)
    assert set(found.replicates) == {1.0}
    assert (found.value, found.low, found.high) == (1.0, 0.0, 1.0)


@pytest.mark.parametrize("margins", [lambda p: np.ones(len(p)), lambda p: 1.0 + p[:, 0]])
def test_what_is_never_found_is_not_said_to_be_impossible(margins: Callable[[Floats], Floats]) -> None:
    found = split(margins, 2, seed=8, how=QUICK)
    assert (found.value, found.reached, found.low) == (0.0, 0, 0.0)
    assert found.no_estimate == "0 of 12 replications found a violation"
    assert found.high == pytest.approx(1.0 - 0.025 ** (1 / found.plain_draws))


@pytest.mark.parametrize("share", [2e-4, pytest.param(1e-3, marks=pytest.mark.long)])
def test_a_region_aside_of_the_way_does_not_make_the_upper_end_wrong(share: float) -> None:
    """Margins lead to a tail of 1e-5, and few replications meet the needle."""

    def margins(points: Floats) -> Floats:
        return np.where(points[:, 1] < share, -1.0, ndtri(1.0 - 1e-5) - normal(points)[:, 0])

    found = [split(margins, 2, seed=seed, how=CRUDE) for seed in range(20)]
    assert misses_are_no_more_than(sum(one.high < share for one in found), 20, 0.025)
    assert sum(one.value < share / 2 for one in found) > 2  # which is why there is no other upper end


def test_few_values_are_levels_enough() -> None:
    """Margins 3, 2, 1 and -1 with a tenth each of the one before: 1e-3."""

    def margins(points: Floats) -> Floats:
        steps = (points < 0.1).astype(float)
        return np.asarray(3.0 - steps[:, 0] - steps[:, :2].prod(axis=1) - 2.0 * steps.prod(axis=1))

    found = split(margins, 3, seed=9)
    assert found.low <= 1e-3 <= found.high
    assert found.reached >= 18


def test_the_same_seed_gives_the_same_and_another_does_not() -> None:
    one, again, other = (split(tail(3.0), 2, seed=seed, how=QUICK) for seed in (1, 1, 2))
    assert one == again
    assert one.replicates != other.replicates


def test_evaluations_are_counted_and_points_are_of_the_cube() -> None:
    seen: list[Floats] = []

    def margins(points: Floats) -> Floats:
        seen.append(points)
        return tail(3.0)(points)

    found = split(margins, 2, seed=1, how=QUICK)
    assert found.evaluations == sum(len(points) for points in seen)
    every = np.concatenate(seen)
    assert every.min() >= 0.0
    assert every.max() < 1.0


def test_margins_that_are_no_numbers_are_refused() -> None:
    with pytest.raises(StatisticsError, match="150 that are no number"):
        split(lambda points: np.full(len(points), np.nan), 2, seed=1, how=QUICK)
    with pytest.raises(StatisticsError, match="150 margins"):
        split(lambda points: np.ones(3), 2, seed=1, how=QUICK)
    with pytest.raises(StatisticsError, match="two replications"):
        dataclasses.replace(QUICK, replications=1)
