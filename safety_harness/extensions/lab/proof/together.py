"""Combine a proof and random samples to bound the probability of wrong answers.

The distribution of the inputs must be known.

Let an input be drawn at random from the boxes of the region.  The claim concerns this input if the distance
between hand and TCP lies in the region's range.  P is the probability that the claim concerns the input and
that the network's answer is wrong.  R and U are the probabilities of the refuted and of the undecided boxes.
The program draws a sample of inputs in the undecided boxes.  The sample gives an upper bound b of the
probability of a wrong answer to such an input (Clopper and Pearson 1934).  Then

    R <= P <= R + U b        with the confidence of b; proven boxes add 0.

It draws the sample after the proof has ended.  The sample is therefore independent of how the proof chose the
boxes, and the bound b is valid for any boxes.  The six coordinates of an input are independent.  Each
coordinate has either a uniform distribution over the region or a normal distribution that is truncated to the
region.
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
    """Bounds of the probability P of a wrong answer.

    P lies between ``low`` and ``high`` with ``confidence``.

    In the sample, ``wrong`` of ``samples`` answers were wrong.  ``undecided`` is the probability U of the
    undecided boxes.
    """

    low: float
    high: float
    undecided: float
    samples: int
    wrong: int
    confidence: float

    @property
    def cells(self) -> tuple[str, str, str, str, str]:
        """The cells of a table row: upper bound, lower bound, U, samples, and wrong answers."""
        chances = (f"{chance:.2g}" for chance in (self.high, self.low, self.undecided))
        high, low, undecided = chances
        return high, low, undecided, f"{self.samples:,}", f"{self.wrong:,}"


def chances(questions: QuestionLaw, region: ProofRegion, low: Floats, high: Floats) -> Floats:
    """Return the probability that an input of the region lies in each of n boxes, shape (n,).

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
    """Return a random input from each of n boxes, shape (n, 6).

    Args:
        questions: The distribution.
        low: (n, 6) the low corners.
        high: (n, 6) the high corners.
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
    """Return the probabilities of n intervals for a normal coordinate, shape (n,).

    For a uniform coordinate, return the lengths of the intervals.
    """
    if normal is None:
        return high - low
    first, last, _ = _ends(normal, low, high)
    return last - first


def _ends(normal: Normal, low: Floats, high: Floats) -> tuple[Floats, Floats, NDArray[np.bool_]]:
    """Return the tail probabilities at both ends of n intervals, shape (n,) each.

    The third result is True for upper tails.

    The first result is the smaller probability.  For an interval above the mean, the function uses upper
    tails, because lower tails would lose digits there.
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
    """Return the bound that follows from a finished tree and from a new sample in its undecided boxes.

    Args:
        tree: The tree.
        region: The region.
        questions: The distribution.
        is_wrong: A function that receives n inputs, shape (n, 6), and returns whether each answer is wrong,
            shape (n,).
        confidence: The confidence of the bound.
        rng: The random generator for the sample.

    """
    refuted = sum(float(chances(questions, region, *box).sum()) for box in tree.leaves(region, REFUTED))
    low, high = (np.concatenate(side) for side in zip(*tree.leaves(region, UNDECIDED), strict=True))
    each = chances(questions, region, low, high)
    undecided, count, against, most = min(1.0, float(each.sum()) * UP), 0, 0, 0.0
    if len(each):
        # Draw boxes with probabilities proportional to their chances, then one input in each drawn box.
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
    """Return a bound for each claim; with the plan's confidence, all bounds are true simultaneously.

    The list is empty if the plan has no distribution of inputs.
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
            # Bonferroni: the claims share the error equally, so all bounds hold simultaneously.
            confidence=1.0 - (1.0 - questions.confidence) / len(proofs),
            rng=generator(questions.seed, Branch.PROOF, number),
        )
        for number, proof in enumerate(proofs)
    ]


def answered_wrongly(avoider: Answering, planned: PlannedProof, points: Floats) -> NDArray[np.bool_]:
    """Return True for each input that the claim concerns and that the network answers wrongly, shape (n,).

    The function treats an answer that is nearly wrong as wrong.

    Args:
        avoider: The network.
        planned: The claim with its region.
        points: (n, 6) the inputs, that is, hands and TCPs.

    """
    apart_m, (near_m, far_m) = np.linalg.norm(points[:, :3] - points[:, 3:], axis=1), planned.region.apart_m
    claimed: NDArray[np.bool_] = (apart_m >= near_m) & (apart_m <= far_m)
    return claimed & ~(margins_of(avoider, planned.claim, points) >= DOUBTFUL)
