"""Bounds of a probability that hold simultaneously after every trial.

Thus a stream of trials may stop at any time. For each value p of the probability, a martingale compares p
with a mixture of alternatives q. After n trials, of which k are successes, it is

    M_n(p) = E_q[ q^k (1 - q)^(n - k) ] / ( p^k (1 - p)^(n - k) )

If p is the truth, M stays below 1/a for ever with a probability of at least 1 - a (Ville, 1939). Thus the set
of values p with M below 1/a contains the true probability at all times simultaneously (Robbins, 1970).

- Upper bound: q = u p with u ~ Beta(1/2, 1). All alternatives are below p, so that M is a supermartingale
  under all larger probabilities too. M grows with p, and the bound is the value of p at which M reaches 1/a.
  The mixture has no parameter that depends on a guess of p. If no violation occurs, 3,787 trials give the
  bound 1e-3 at 95 %. If the number of trials is fixed beforehand, 2,995 trials give this bound.
- Lower bound: q ~ Beta(1/2, 1/2). The function log M is convex in p. The bound is the value of p below k/n at
  which M reaches 1/a.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike

from safety_harness.base.elementary import log, log1p
from safety_harness.base.special import beta_share, log_beta, settled
from safety_harness.extensions.assurance.statistics.sample import Floats

_SCALE = 0.5  # for the upper bound: q / p has the distribution Beta(_SCALE, 1)
_JEFFREYS = 0.5  # for the lower bound: q has the distribution Beta(_JEFFREYS, _JEFFREYS)


@lru_cache(maxsize=4096)
def anytime_upper(count: int, trials: int, chance: float) -> float:
    """Return an upper bound of the true probability, which holds simultaneously at all times of the stream.

    Args:
        count: The number of successes so far.
        trials: The number of trials so far.
        chance: The largest probability that the true probability ever exceeds the bound.

    """
    if count >= trials:
        return 1.0
    limit = -log(chance)
    return settled(lambda p: evidence_below(p, count, trials) >= limit, count / trials, 1.0, 0.0)[1]


@lru_cache(maxsize=4096)
def anytime_lower(count: int, trials: int, chance: float) -> float:
    """Return a lower bound of the true probability, which holds simultaneously at all times of the stream.

    Args:
        count: The number of successes so far.
        trials: The number of trials so far.
        chance: The largest probability that the true probability is ever below the bound.

    """
    if count <= 0:
        return 0.0
    limit = -log(chance)
    return settled(lambda p: evidence_apart(p, count, trials) < limit, 0.0, count / trials, 0.0)[0]


def evidence_below(share: ArrayLike, count: ArrayLike, trials: ArrayLike) -> Floats:
    """Return log M_n of the upper bound, elementwise.

    The result is the evidence that the true probability is below ``share``.

    Args:
        share: The probabilities p, between 0 and 1.
        count: The numbers k of successes.
        trials: The numbers n of trials. The three arrays broadcast.

    """
    p, k, n = (np.asarray(values, np.float64) for values in (share, count, trials))
    below = log(beta_share(k + _SCALE, n - k + 1.0, p))
    # E[q^k (1 - q)^(n-k)] for q = u p is an incomplete beta integral times p^(-1/2) / 2. The power joins the
    # likelihood.
    mixture = log_beta(k + _SCALE, n - k + 1.0) + below + log(_SCALE)
    return np.asarray(mixture - _likelihood(p, k + _SCALE, n - k))


def evidence_apart(share: ArrayLike, count: ArrayLike, trials: ArrayLike) -> Floats:
    """Return log M_n of the lower bound, elementwise.

    The result is the evidence that the true probability is not ``share``.

    Args:
        share: The probabilities p, between 0 and 1.
        count: The numbers k of successes.
        trials: The numbers n of trials. The three arrays broadcast.

    """
    p, k, n = (np.asarray(values, np.float64) for values in (share, count, trials))
    mixture = log_beta(k + _JEFFREYS, n - k + _JEFFREYS) - log_beta(_JEFFREYS, _JEFFREYS)
    return np.asarray(mixture - _likelihood(p, k, n - k))


def _likelihood(share: Floats, successes: Floats, failures: Floats) -> Floats:
    """Return the logarithm of p^k (1 - p)^m, where the product of 0 and an infinite logarithm is 0."""
    with np.errstate(invalid="ignore"):
        each = successes * log(share), failures * log1p(-share)
    return np.where(successes > 0.0, each[0], 0.0) + np.where(failures > 0.0, each[1], 0.0)
