"""Bounds of a margin's quantiles that assume nothing of its distribution.

A tested run without a margin may have had any: it counts as minus infinity.  Untested runs are left out.
All of it is of samples of fixed length.  "Margin" is of the claim: for "hand distance never below 50 mm"
the minimum hand distance is the margin plus 50 mm.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import scipy

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
    """With ``confidence`` at least ``content`` of all tested runs keep a margin of ``at_least`` or more (SI).

    ``rank`` says which of the ``trials`` margins in ascending order that is; ``at_least`` is -inf, and
    ``rank`` 0, where so few runs can say nothing.  ``seen`` is the sample's own quantile.
    """

    content: float
    at_least: float
    rank: int
    seen: float
    trials: int
    confidence: float
    model_only: bool


def tolerance_bound(sample: IndependentSample, content: float, confidence: float = 0.95) -> QuantileBound:
    """The greatest of the margins that ``content`` of all runs keep, with ``confidence`` (Wilks, 1941).

    It is the r-th smallest of n, with the greatest r for which P(Bin(n, 1 - content) >= r) >= confidence:
    exact for continuous margins, cautious for others.  The same is a lower bound of the quantile
    1 - content.  StatisticsError for a content outside (0, 1) or without a tested run.
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
        seen=float(margins[min(math.floor((1.0 - content) * n + 1e-9), n - 1)]),  # 0.1 n, but for rounding
        trials=n,
        confidence=confidence,
        model_only=sample.declaration.model_only,
    )


def _check_content(content: float) -> None:
    if not 0.0 < content < 1.0:
        raise refusal("content", "a share between 0 and 1", f"{content:g}")


def _rank(n: int, share: float, confidence: float) -> int:
    """The greatest r with P(Bin(n, share) >= r) >= confidence; 0 if there is none."""
    ranks = np.arange(1, n + 1)
    return int(np.count_nonzero(scipy.special.bdtrc(ranks - 1, n, share) >= confidence))  # it falls with r


def _tested(sample: IndependentSample) -> Floats:
    """Margins (n,) of the tested runs, ascending; minus infinity where a verdict or a margin is missing."""
    known = fixed_length(sample)
    tested = known.outcomes != EpisodeOutcome.UNTESTED
    if not tested.any():
        raise refusal("margins", f"a tested run ({known.name})", "none")
    sure = known.judged & np.isfinite(known.margins)
    return np.sort(np.where(sure, known.margins, -np.inf)[tested])
