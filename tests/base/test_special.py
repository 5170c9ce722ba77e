from __future__ import annotations

from fractions import Fraction
from math import comb, log
from statistics import NormalDist

import mpmath
import numpy as np
import pytest
import scipy.special

from safety_harness.base.proportions import lower_bound, upper_bound
from safety_harness.base.special import (
    beta_share,
    binomial_at_most,
    log_beta,
    log_gamma,
    lower_tail,
    normal_quantile,
    settled,
    upper_gamma,
)

RNG = np.random.default_rng(54)


def test_the_normal_quantile_is_python_s() -> None:
    chances = np.concatenate([RNG.random(500), 10.0 ** RNG.uniform(-300.0, 0.0, 500)])
    expected = [NormalDist().inv_cdf(chance) for chance in chances.tolist()]
    assert normal_quantile(chances) == pytest.approx(expected, rel=1e-15)


def test_tails_of_the_normal_distribution_keep_their_digits() -> None:
    z = RNG.uniform(-37.0, 8.0, 300)
    assert lower_tail(z) == pytest.approx([float(mpmath.ncdf(x)) for x in z.tolist()], rel=1e-12)


def test_gamma_and_beta_functions() -> None:
    x = np.concatenate([RNG.uniform(0.01, 30.0, 100), 10.0 ** RNG.uniform(0.0, 9.0, 100)])
    assert log_gamma(x) == pytest.approx(scipy.special.gammaln(x), rel=1e-13, abs=1e-14)
    betas = [float(mpmath.log(mpmath.beta(a, mpmath.mpf(0.5)))) for a in x.tolist()]
    assert log_beta(x, 0.5) == pytest.approx(betas, rel=1e-12)
    shapes = np.array([0.5, 1.0, 3.0, 40.0, 1000.0])
    for times in (0.2, 0.9, 1.0, 1.3, 3.0):
        exact = [float(mpmath.gammainc(a, a * times, regularized=True)) for a in shapes.tolist()]
        assert upper_gamma(shapes, shapes * times) == pytest.approx(exact, rel=1e-11)


@pytest.mark.parametrize("trials", [1, 2, 13, 200, 1000])
def test_binomial_tails_are_those_of_whole_numbers(trials: int) -> None:
    share = Fraction(1, 7)
    chances = [comb(trials, k) * share**k * (1 - share) ** (trials - k) for k in range(trials + 1)]
    counts = np.unique([0, trials // 9, trials // 7, trials // 3, trials - 1])
    exact = [float(sum(chances[: k + 1])) for k in counts.tolist()]
    above = [float(sum(chances[k + 1 :])) for k in counts.tolist()]
    assert binomial_at_most(counts, trials, 1 / 7) == pytest.approx(exact, rel=1e-12)
    assert beta_share(counts + 1.0, trials - counts, 1 / 7) == pytest.approx(above, rel=1e-12)


@pytest.mark.parametrize(
    ("count", "trials"), [(0, 1), (0, 59), (3, 59), (58, 59), (7, 10_000), (5000, 10_000)]
)
def test_a_bound_is_rounded_away_from_the_truth_by_a_little(count: int, trials: int) -> None:
    high, low = upper_bound(count, trials, 0.025), lower_bound(count + 1, trials, 0.025)
    for bound, exact in (
        (high, scipy.special.betainccinv(count + 1.0, trials - count, 0.025)),
        (-low, -scipy.special.betaincinv(count + 1.0, trials - count, 0.025)),
    ):
        assert -1e-13 * abs(exact) < bound - exact < 2.0**-41 * abs(exact)


def test_a_bound_does_not_depend_on_its_guide() -> None:
    """A library on another machine, or none: the same float."""

    def bounds(guide: float) -> tuple[float, float]:
        return settled(lambda p: binomial_at_most(2, 300, p) <= 0.05, 0.0, 1.0, guide)

    exact = float(scipy.special.betainccinv(3.0, 298.0, 0.05))
    assert {bounds(guide) for guide in (exact, exact * (1.0 + 1e-15), exact * 1.001, 0.9, 0.0, 1.0)} == {
        bounds(exact)
    }
    before, after = bounds(exact)
    assert before < exact <= after
    assert log(after / before) < 2.0**-43
