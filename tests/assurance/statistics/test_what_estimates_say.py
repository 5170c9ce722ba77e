"""Estimates say whose they are, and agree with sums that are written out."""

from __future__ import annotations

from math import sqrt

import numpy as np
import pytest
from scipy.stats import binom
from scipy.stats import t as student
from streams import violations, with_margins

from safety_harness.base.exceptions import StatisticsError
from safety_harness.extensions.assurance.statistics.binomial import bounds_of, chance_of_each
from safety_harness.extensions.assurance.statistics.distances import tolerance_bound
from safety_harness.extensions.assurance.statistics.paired import compare
from safety_harness.extensions.assurance.statistics.planning import (
    Aim,
    allowed_violations,
    power,
    runs_needed,
)
from safety_harness.extensions.assurance.statistics.rare import Splitting, split

AIM = Aim(target=0.2, confidence=0.9)


def test_estimates_name_the_claim_and_the_stratum_that_they_are_of() -> None:
    sample, other = violations(2, 30, stratum="unseen"), violations(3, 30, stratum="unseen")
    (bounds,) = bounds_of([sample], 0.95)
    found = compare(sample, other)
    assert (bounds.stratum, bounds.claim) == (found.stratum, found.claim) == ("unseen", "a claim")
    margins = with_margins(np.linspace(-1.0, 1.0, 100))
    assert tolerance_bound(margins, 0.9).content == 0.9


@pytest.mark.parametrize(("confidence", "family", "field"), [(1.0, 1, "confidence"), (0.9, 0, "claims")])
def test_a_confidence_or_a_family_that_is_none_is_named(confidence: float, family: int, field: str) -> None:
    with pytest.raises(StatisticsError) as caught:
        chance_of_each(confidence, family)
    assert caught.value.place.field == field


@pytest.mark.parametrize(
    ("probability", "tested"), [(-0.1, 0.5), (1.1, 0.5), (float("nan"), 0.5), (0.1, 0.0), (0.1, 1.1)]
)
def test_a_power_of_no_shares_is_refused(probability: float, tested: float) -> None:
    with pytest.raises(StatisticsError) as caught:
        power(AIM, 40, probability=probability, tested=tested)
    assert caught.value.place.field == "power"


def test_the_power_is_the_sum_over_how_many_runs_test_the_claim() -> None:
    runs, probability, tested = 60, 0.03, 0.4
    by_hand = 0.0
    for n in range(runs + 1):
        allowed = allowed_violations(AIM, n)
        shows = 0.0 if allowed is None else binom.cdf(allowed, n, probability)
        by_hand += binom.pmf(n, runs, tested) * shows
    assert power(AIM, runs, probability=probability, tested=tested) == pytest.approx(by_hand, abs=1e-9)


@pytest.mark.parametrize("target", [0.2, 0.7, 0.97])
def test_no_more_runs_are_needed_and_no_more_violations_allowed_than_that(target: float) -> None:
    aim = Aim(target=target, confidence=0.9)
    for allowed in range(4):
        needed = runs_needed(aim, allowed=allowed)
        assert needed > allowed
        assert aim.shown_by(allowed, needed)
        assert not any(aim.shown_by(allowed, n) for n in range(allowed + 1, needed))
    for trials in range(1, 90):
        shown = [k for k in range(trials + 1) if aim.shown_by(k, trials)]
        assert allowed_violations(aim, trials) == max(shown, default=None)


def test_a_rare_event_s_lower_end_is_student_s_over_the_replications_and_its_upper_end_higher() -> None:
    how = Splitting(particles=60, steps=2, replications=8)
    found = split(lambda points: points[:, 0] - 0.03, 2, seed=3, how=how, confidence=0.9)
    replicates = np.array(found.replicates)
    half = student.ppf(0.95, 7) * replicates.std(ddof=1) / sqrt(8)
    assert found.reached == 8
    assert found.low == pytest.approx(max(replicates.mean() - half, 0.0))
    assert found.high > replicates.mean() + half


@pytest.mark.parametrize(
    "wrong", [{"particles": 0}, {"steps": 0}, {"replications": 1}, {"survivors": 0.0}, {"survivors": 1.0}]
)
def test_a_splitting_without_particles_steps_replications_or_survivors_is_refused(
    wrong: dict[str, float],
) -> None:
    with pytest.raises(StatisticsError) as caught:
        Splitting(**wrong)  # type: ignore[arg-type]
    assert caught.value.place.field == "splitting"


def test_where_one_replication_is_half_of_the_sum_there_is_no_estimate() -> None:
    """A region of two parts of which few replications find the larger one."""

    def margins(points: np.ndarray) -> np.ndarray:
        hidden = (points[:, 0] > 0.99) & (points[:, 1] > 0.99)
        return np.where(hidden, -1.0, points[:, 0] - 1e-5)

    founds = [
        split(margins, 2, seed=seed, how=Splitting(particles=40, steps=2, replications=6))
        for seed in range(8)
    ]
    dominated = [max(one.replicates) >= 0.5 * sum(one.replicates) for one in founds]
    assert any(dominated)
    for one, alone in zip(founds, dominated, strict=True):
        assert one.no_estimate or not alone
