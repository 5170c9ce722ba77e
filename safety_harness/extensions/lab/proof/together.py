"""One bound on wrong answers from a proof and a sample, for a known distribution of questions.

A question of the region is drawn at random.  The claim concerns it if its hand and TCP are as far apart as
the region requires.  P is the probability that the claim concerns the question and that the network answers
it wrongly.  R and U are the probabilities of the refuted and undecided boxes.  For questions from only the
undecided boxes, b is an upper bound (Clopper and Pearson 1934) of the share of wrong answers.  Then

    R <= P <= R + U b        with the confidence of b; proven boxes add 0.

The program draws the questions after the boxes are final.  The sample does not depend on the way in which the
boxes arose, so b holds for any boxes.  The six axes are independent.  Each of them is uniform over the
region, or normal and cut to it.
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
    """The bound on wrong answers: P lies from ``low`` to ``high`` with ``confidence``.

    Of ``samples`` answers, ``wrong`` were wrong.  ``undecided`` is the probability U of the undecided boxes.
    """

    low: float
    high: float
    undecided: float
    samples: int
    wrong: int
    confidence: float

    @property
    def cells(self) -> tuple[str, str, str, str, str]:
        """The cells of a table: the upper bound, the lower bound, undecided, samples, wrong answers."""
        chances = (f"{chance:.2g}" for chance in (self.high, self.low, self.undecided))
        high, low, undecided = chances
        return high, low, undecided, f"{self.samples:,}", f"{self.wrong:,}"


def chances(questions: QuestionLaw, region: ProofRegion, low: Floats, high: Floats) -> Floats:
    """Return the probability (n,) of each box from ``low`` to ``high`` (n, 6) within the region.

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
    """Return one random question (n, 6) from each box ``low`` to ``high`` (n, 6).

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
    """Return the probability (n,) of intervals (n,) for a normal variable, or their lengths for a uniform."""
    if normal is None:
        return high - low
    first, last, _ = _ends(normal, low, high)
    return last - first


def _ends(normal: Normal, low: Floats, high: Floats) -> tuple[Floats, Floats, NDArray[np.bool_]]:
    """Return two tail probabilities (n,) at the ends of intervals (n,), and whether they are upper tails.

    The smaller probability comes first.  An interval above the mean has upper tails, because lower tails
    would lose digits there.
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
    """Return the bound from a finished tree and from new questions in its undecided boxes.

    Args:
        tree: The tree.
        region: The region.
        questions: The distribution.
        is_wrong: Returns whether (n,) each of n questions (n, 6) has a wrong answer.
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
    """Return a bound for each claim; all bounds together hold with the plan's confidence.

    The list is empty if the plan has no distribution of questions.
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
    """Return whether (n,) the claim concerns each of ``points`` (n, 6) and the network answers it wrongly.

    An answer that is nearly wrong counts as wrong.

    Args:
        avoider: The network.
        planned: The claim with its region.
        points: Hands and TCPs.

    """
    apart_m, (near_m, far_m) = np.linalg.norm(points[:, :3] - points[:, 3:], axis=1), planned.region.apart_m
    claimed: NDArray[np.bool_] = (apart_m >= near_m) & (apart_m <= far_m)
    return claimed & ~(margins_of(avoider, planned.claim, points) >= DOUBTFUL)
