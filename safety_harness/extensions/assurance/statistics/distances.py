"""Bounds of the quantiles of a margin, without an assumption about its distribution.

If a tested run has no margin, its margin is set to minus infinity, because the true margin is unknown.
Untested runs are ignored. The samples must have a fixed length.

Here, a margin is the margin of the claim and not the measured quantity. For "hand distance never below 50
mm", the least hand distance of a run is its margin plus 50 mm.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from safety_harness.base.special import beta_share
from safety_harness.extensions.assurance.statistics.binomial import chance_of_each
from safety_harness.extensions.assurance.statistics.sample import (
    EpisodeOutcome,
    Floats,
    IndependentSample,
    fixed_length,
    refusal,
)


@dataclass(frozen=True, kw_only=True)
class QuantileBound:
    """The margin ``at_least`` (SI) that a fraction ``content`` of all tested runs keeps, with ``confidence``.

    This margin has the position ``rank`` among the margins of the ``trials`` runs, in ascending order. If the
    runs are too few for a statement, ``at_least`` is -inf and ``rank`` is 0. ``seen`` is the quantile of the
    sample itself.
    """

    content: float
    at_least: float
    rank: int
    seen: float
    trials: int
    confidence: float
    model_only: bool


def tolerance_bound(sample: IndependentSample, content: float, confidence: float = 0.95) -> QuantileBound:
    """Return the largest margin that a fraction ``content`` of all runs keeps.

    The method comes from Wilks (1941). The bound is the r-th smallest of n margins. Here r is the largest
    number with P(Bin(n, 1 - content) >= r) >= confidence. The bound is exact for continuous margins, and
    conservative for discrete margins. The bound is also a lower bound of the quantile 1 - content.

    Args:
        sample: A sample of fixed length.
        content: The fraction of tested runs, between 0 and 1.
        confidence: The confidence of this bound by itself, between 0 and 1.

    Raises:
        StatisticsError: The content or the confidence is not between 0 and 1, no run is tested, or the stream
            may stop early.

    """
    _check_content(content)
    chance_of_each(confidence, 1)
    margins = _tested(sample)
    n = len(margins)
    rank = _rank(n, 1.0 - content, confidence)
    return QuantileBound(
        content=content,
        at_least=float(margins[rank - 1]) if rank else -math.inf,
        rank=rank,
        # In floating point, (1 - 0.9) n is a little below 0.1 n; the 1e-9 makes up for that.
        seen=float(margins[min(math.floor((1.0 - content) * n + 1e-9), n - 1)]),
        trials=n,
        confidence=confidence,
        model_only=sample.declaration.model_only,
    )


def _check_content(content: float) -> None:
    if not 0.0 < content < 1.0:
        raise refusal("content", "a share between 0 and 1", f"{content:g}")


def _rank(n: int, share: float, confidence: float) -> int:
    """Return the largest r with P(Bin(n, share) >= r) >= confidence, or 0 if there is no such r."""
    ranks = np.arange(1, n + 1)
    return int(np.count_nonzero(beta_share(ranks, n - ranks + 1.0, share) >= confidence))  # it falls with r


def _tested(sample: IndependentSample) -> Floats:
    """Return the margins of the tested runs in ascending order, shape (n,).

    A margin is -inf if the run has no verdict or no margin.
    """
    known = fixed_length(sample)
    tested = known.outcomes != EpisodeOutcome.UNTESTED
    if not tested.any():
        raise refusal("margins", f"a tested run ({known.name})", "none")
    sure = known.judged & np.isfinite(known.margins)
    return np.sort(np.where(sure, known.margins, -np.inf)[tested])
