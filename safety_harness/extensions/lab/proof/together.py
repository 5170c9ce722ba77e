"""Proof and sample in one bound, for a known distribution of questions.

A question of the region is drawn at random.  P is the chance that the claim concerns it (its hand and TCP are
as far apart as the region requires) and that the network answers it wrongly.  R and U are the probabilities
of the refuted and undecided boxes.  b is an upper bound (Clopper and Pearson 1934) of the share of wrong
answers among questions from the undecided boxes alone.  Then

    R <= P <= R + U b        with the confidence of b; proven boxes add 0.

The boxes come first, then the questions.  The sample is independent of the origin of the boxes, so b holds
for any boxes.  Axes are independent, each uniform over the region, or normal and cut to it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr, ndtri

from safety_harness.base.proportions import upper_bound
from safety_harness.base.seeds import Branch, generator
from safety_harness.extensions.lab.proof.box_kernel import REFUTED, UNDECIDED
from safety_harness.extensions.lab.proof.certificate import Proof
from safety_harness.extensions.lab.proof.claims import Answering, margins_of
from safety_harness.extensions.lab.proof.plan import Normal, PlannedProof, ProofPlan, ProofRegion, QuestionLaw
from safety_harness.extensions.lab.proof.tree import BoxTree

Floats = NDArray[np.float64]
IsWrong = Callable[[Floats], NDArray[np.bool_]]
UP = 1.0 + 1e-9  # above the rounding of sums and differences of probabilities
DOUBTFUL = 1e-8  # m or m2: an answer with a smaller margin counts as wrong


@dataclass(frozen=True, kw_only=True)
class JointBound:
    """P is from ``low`` to ``high`` with ``confidence``; ``wrong`` of ``samples`` answers were wrong."""

    low: float
    high: float
    undecided: float
    samples: int
    wrong: int
    confidence: float

    @property
    def cells(self) -> tuple[str, str, str, str, str]:
        """The cells of a table: wrong at most, at least, undecided, samples, wrong."""
        chances = (f"{chance:.2g}" for chance in (self.high, self.low, self.undecided))
        high, low, undecided = chances
        return high, low, undecided, f"{self.samples:,}", f"{self.wrong:,}"


def chances(questions: QuestionLaw, region: ProofRegion, low: Floats, high: Floats) -> Floats:
    """Return the probabilities (n,) of boxes from ``low`` to ``high`` (n, 6) within the region.

    Args:
        questions: The distribution.
        region: The region.
        low: (n, 6) the low corners.
        high: (n, 6) the high corners.

    """
    whole, products = region.corners(), np.ones(len(low))
    for axis, normal in enumerate(questions.normals_m):
        start, end = (side[:, axis] for side in whole)
        products *= _chance(normal, low[:, axis], high[:, axis]) / _chance(normal, start, end)
    return products


def drawn(questions: QuestionLaw, low: Floats, high: Floats, rng: np.random.Generator) -> Floats:
    """Return a question (n, 6) from each box ``low`` to ``high`` (n, 6).

    Args:
        questions: The distribution.
        low: The low corners.
        high: The high corners.
        rng: The generator.

    """
    points = low + rng.random(low.shape) * (high - low)
    for axis, normal in enumerate(questions.normals_m):
        if normal is not None:
            first, last, above = _ends(normal, low[:, axis], high[:, axis])
            z = ndtri(first + rng.random(len(low)) * (last - first))
            points[:, axis] = normal[0] + normal[1] * np.where(above, -z, z)
    return np.clip(points, low, high)


def _chance(normal: Normal | None, low: Floats, high: Floats) -> Floats:
    """Return the chance (n,) of intervals (n,): of a normal variable, or proportional to their length."""
    if normal is None:
        return high - low
    first, last, _ = _ends(normal, low, high)
    return last - first


def _ends(normal: Normal, low: Floats, high: Floats) -> tuple[Floats, Floats, NDArray[np.bool_]]:
    """Return the distribution function (n,) at both ends of intervals (n,), and whether it runs from above.

    Intervals above the mean count from above.
    """
    start, end = (low - normal[0]) / normal[1], (high - normal[0]) / normal[1]
    above = start + end > 0.0  # where 1 - F would lose digits
    return ndtr(np.where(above, -end, start)), ndtr(np.where(above, -start, end)), above


def joint_bound(
    tree: BoxTree,
    region: ProofRegion,
    questions: QuestionLaw,
    is_wrong: IsWrong,
    *,
    confidence: float,
    rng: np.random.Generator,
) -> JointBound:
    """Return the bound from a finished tree and from questions asked now.

    Args:
        tree: The tree.
        region: The region.
        questions: The distribution.
        is_wrong: Returns which of questions (n, 6) have a wrong answer.
        confidence: The confidence of the bound.
        rng: The generator of the questions.

    """
    refuted = sum(float(chances(questions, region, *box).sum()) for box in tree.leaves(region, REFUTED))
    low, high = (np.concatenate(side) for side in zip(*tree.leaves(region, UNDECIDED), strict=True))
    each = chances(questions, region, low, high)
    undecided, count, against, most = min(1.0, float(each.sum()) * UP), 0, 0, 0.0
    if len(each):
        ends = np.cumsum(each)
        count = questions.samples
        rows = np.searchsorted(ends, rng.random(count) * ends[-1], side="right").clip(max=len(each) - 1)
        against = int(np.count_nonzero(is_wrong(drawn(questions, low[rows], high[rows], rng))))
        most = upper_bound(against, count, 1.0 - confidence)
    return JointBound(
        low=max(0.0, refuted / UP),
        high=min(1.0, (refuted + undecided * most) * UP),
        undecided=undecided,
        samples=count,
        wrong=against,
        confidence=confidence,
    )


def joint_bounds(plan: ProofPlan, proofs: list[Proof]) -> list[JointBound]:
    """Return a bound for each claim; all hold together with the plan's confidence.

    The list is empty without a distribution of questions.
    """
    questions, avoider = plan.questions, plan.asked
    if questions is None:
        return []
    return [
        joint_bound(
            proof.tree,
            proof.planned.region,
            questions,
            partial(answered_wrongly, avoider, proof.planned),
            confidence=1.0 - (1.0 - questions.confidence) / len(proofs),
            rng=generator(questions.seed, Branch.PROOF, number),
        )
        for number, proof in enumerate(proofs)
    ]


def answered_wrongly(avoider: Answering, planned: PlannedProof, points: Floats) -> NDArray[np.bool_]:
    """Return which (n,) of ``points`` (n, 6) the claim concerns and the network answers wrongly.

    An answer that is nearly wrong counts too.

    Args:
        avoider: The network.
        planned: The claim with its region.
        points: Hands and TCPs.

    """
    apart_m, (near_m, far_m) = np.linalg.norm(points[:, :3] - points[:, 3:], axis=1), planned.region.apart_m
    claimed: NDArray[np.bool_] = (apart_m >= near_m) & (apart_m <= far_m)
    return claimed & ~(margins_of(avoider, planned.claim, points) >= DOUBTFUL)
