"""Importance sampling on problems with known answers."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import scipy.stats
from acceptance import misses_are_no_more_than
from known_problems import normal, outside_a_sphere, tail, two_tails

from safety_harness.base.exceptions import StatisticsError
from safety_harness.extensions.assurance.statistics import importance
from safety_harness.extensions.assurance.statistics.importance import Importance, pareto_shape, weigh
from safety_harness.extensions.assurance.statistics.rare import LARGEST_SHAPE, Margins, split

QUICK = Importance(pilot=200, runs=1000, replications=10)
CRUDE = Importance(pilot=100, runs=500, replications=10)


def diagonal(sigma: float) -> Margins:
    """Along a direction in which all coordinates take part alike."""
    return lambda points: sigma - normal(points).sum(axis=1) / np.sqrt(points.shape[1])


KNOWN: list[tuple[Margins, int, float]] = [
    (tail(2.0), 2, float(scipy.stats.norm.sf(2.0))),
    (tail(4.0), 5, float(scipy.stats.norm.sf(4.0))),
    (diagonal(4.5), 15, float(scipy.stats.norm.sf(4.5))),
    (two_tails(4.0), 2, 2.0 * float(scipy.stats.norm.sf(4.0))),
]


@pytest.mark.parametrize(("margins", "dimensions", "truth"), KNOWN)
def test_the_known_answer_lies_in_the_interval(margins: Margins, dimensions: int, truth: float) -> None:
    found = weigh(margins, dimensions, seed=3, confidence=0.999)
    assert found.low <= truth <= found.high
    assert not found.no_estimate
    assert found.value == pytest.approx(truth, rel=0.2)
    assert found.reached == 20
    assert found.pareto_shape is not None
    assert found.pareto_shape < LARGEST_SHAPE


def test_it_takes_far_fewer_runs_than_splitting() -> None:
    truth = float(scipy.stats.norm.sf(4.0))
    weighed, gone_there = weigh(tail(4.0), 2, seed=4), split(tail(4.0), 2, seed=4)
    for one in (weighed, gone_there):
        assert one.value == pytest.approx(truth, rel=0.25)
    assert weighed.evaluations * 10 < gone_there.evaluations
    assert np.std(weighed.replicates) < 1.5 * np.std(gone_there.replicates)


@pytest.mark.parametrize(
    ("margins", "dimensions", "truth"), [KNOWN[1], pytest.param(*KNOWN[2], marks=pytest.mark.long)]
)
def test_estimates_are_right_on_average_and_intervals_hold_as_often_as_they_say(
    margins: Margins, dimensions: int, truth: float
) -> None:
    runs, missed, too_low, values = 40, 0, 0, []
    for seed in range(runs):
        found = weigh(margins, dimensions, seed=seed, how=QUICK, confidence=0.9)
        missed += not found.low <= truth <= found.high
        too_low += found.high < truth
        values.append(found.value)
    assert misses_are_no_more_than(missed, runs, 0.1)
    assert misses_are_no_more_than(too_low, runs, 0.05)
    error = np.std(values, ddof=1) / np.sqrt(runs)
    assert abs(np.mean(values) - truth) < 4.0 * error


@pytest.mark.parametrize("seed", [3, 4])
def test_where_a_few_draws_carry_the_weight_there_is_no_estimate(seed: int) -> None:
    """All around in thirty dimensions: the replications agree on far too little."""
    found = weigh(outside_a_sphere(9.0), 30, seed=seed)
    assert found.pareto_shape is not None
    assert found.pareto_shape > LARGEST_SHAPE or found.reached < 20
    assert found.no_estimate


def test_of_what_never_happens_only_the_plain_draws_say_anything() -> None:
    found = weigh(lambda points: np.ones(len(points)), 3, seed=1)
    assert (found.value, found.low, found.reached) == (0.0, 0.0, 0)
    assert found.no_estimate
    assert found.high == pytest.approx(1.0 - 0.025 ** (1 / found.plain_draws))
    assert 900 < found.plain_draws < 1100  # the pilot's first 500, and a tenth of 5,000


def test_what_always_happens_is_sure() -> None:
    found = weigh(lambda points: -np.ones(len(points)), 3, seed=1)
    assert found.value == pytest.approx(1.0, abs=0.05)
    assert found.low <= 1.0 <= found.high


def aside(share: float) -> Margins:
    """Margins lead to a tail of 3e-7, and nearly all violations are a needle where they do not lead."""
    return lambda points: np.where(points[:, 1] < share, -1.0, 5.0 - normal(points)[:, 0])


def test_a_region_that_no_restart_can_see_does_not_make_the_upper_end_wrong() -> None:
    share = 1e-3
    found = [weigh(aside(share), 2, seed=seed, how=CRUDE) for seed in range(20)]
    assert misses_are_no_more_than(sum(one.high < share for one in found), 20, 0.025)
    assert any(one.value < share / 2 for one in found)  # which is why there is no other upper end


def half_spaces(count: int, probability: float) -> Margins:
    """Any of ``count`` half spaces, equally likely, and ``probability`` together."""
    beyond = float(scipy.stats.norm.isf(1.0 - (1.0 - probability) ** (1.0 / count)))
    return lambda points: np.asarray((beyond - normal(points)[:, :count]).min(axis=1))


def faces(count: int, beyond: float) -> Margins:
    """Outside a box of so many faces."""
    return lambda points: np.asarray((beyond - np.abs(normal(points)[:, : count // 2])).min(axis=1))


MANY_REGIONS = [
    (half_spaces(6, 1e-4), 6, 1e-4),
    pytest.param(half_spaces(10, 1e-4), 10, 1e-4, marks=pytest.mark.long),
    (faces(6, 4.2), 3, 6.0 * float(scipy.stats.norm.sf(4.2))),
    pytest.param(faces(12, 4.3), 6, 12.0 * float(scipy.stats.norm.sf(4.3)), marks=pytest.mark.long),
]


@pytest.mark.parametrize(("margins", "dimensions", "truth"), MANY_REGIONS)
def test_restarts_find_the_regions_that_a_pilot_misses(
    margins: Margins, dimensions: int, truth: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With the pilot alone most estimates that are stated lack regions; with restarts few are far too low."""
    found = [weigh(margins, dimensions, seed=seed) for seed in range(8)]
    assert all(one.low <= truth <= one.high for one in found)
    stated = [one.value / truth for one in found if not one.no_estimate]
    assert not stated or np.median(stated) > 0.6
    monkeypatch.setattr(importance, "_MOST_RESTARTS", 0)
    alone = [weigh(margins, dimensions, seed=seed) for seed in range(8)]
    less = 1.1 if dimensions == 3 else 1.0  # three components may be enough for six faces
    assert np.median([one.value for one in alone]) < less * np.median([one.value for one in found])


def test_margins_that_are_no_numbers_are_refused() -> None:
    with pytest.raises(StatisticsError, match="no number"):
        weigh(lambda points: np.full(len(points), np.nan), 2, seed=1)


@pytest.mark.parametrize(
    "change", [{"pilot": 0}, {"runs": 1}, {"replications": 1}, {"best": 1.0}, {"plain": 0.0}]
)
def test_settings_that_make_no_sense_are_refused(change: dict[str, float]) -> None:
    with pytest.raises(StatisticsError):
        dataclasses.replace(QUICK, **change)  # type: ignore[arg-type]


def test_the_same_seed_says_the_same() -> None:
    assert weigh(tail(3.0), 3, seed=5, how=QUICK) == weigh(tail(3.0), 3, seed=5, how=QUICK)
    assert weigh(tail(3.0), 3, seed=5, how=QUICK) != weigh(tail(3.0), 3, seed=6, how=QUICK)


@pytest.mark.parametrize("shape", [0.1, 0.5, 1.0, 2.0])
def test_the_shape_of_a_tail_is_that_of_the_distribution_it_is_drawn_from(shape: float) -> None:
    found = [
        pareto_shape(scipy.stats.genpareto(shape).rvs(4000, random_state=np.random.default_rng(seed)))
        for seed in range(20)
    ]
    assert np.mean(found) == pytest.approx(shape, abs=0.12)


def test_of_a_handful_of_weights_the_tail_may_be_any() -> None:
    assert pareto_shape(np.arange(1.0, 20.0)) == np.inf
    assert pareto_shape(np.ones(100)) == 0.0
