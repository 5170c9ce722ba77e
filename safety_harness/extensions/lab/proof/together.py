"""Proof and sample in one bound, where it is known how questions are distributed.

A question of the region is drawn at random; P is the chance that the claim is about it (its hand and TCP are
as far apart as the region says) and the network answers it wrongly.  With R and U the probabilities of the
refuted and of the undecided boxes, and b an upper bound (Clopper and Pearson 1934) of the share of wrong
answers among questions drawn from the undecided boxes alone,

    R <= P <= R + U b        with the confidence of b; what is proven adds nothing.

Boxes first, questions then: the sample knows nothing of how the boxes came about, so that b holds whatever
they are.  Axes are independent of each other, each uniform over the region or normal and cut to it.
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
Wrong = Callable[[Floats], NDArray[np.bool_]]
UP = 1.0 + 1e-9  # above the rounding of sums and differences of probabilities
DOUBTFUL = 1e-8  # m or m2: what keeps a claim by less counts as wrong


@dataclass(frozen=True, kw_only=True)
class JointBound:
    """P is from ``low`` to ``high`` with ``confidence``; ``wrong`` of ``samples`` were answered so."""

    low: float
    high: float
    undecided: float
    samples: int
    wrong: int
    confidence: float

    @property
    def cells(self) -> tuple[str, str, str, str, str]:
        """Of a table: wrong at most, at least, undecided, of it asked, wrong."""
        chances = (f"{one:.2g}" for one in (self.high, self.low, self.undecided))
        high, low, undecided = chances
        return high, low, undecided, f"{self.samples:,}", f"{self.wrong:,}"


def chances(questions: QuestionLaw, region: ProofRegion, low: Floats, high: Floats) -> Floats:
    """(n,) the probabilities of boxes from ``low`` to ``high`` (n, 6) within the region."""
    whole, found = region.corners(), np.ones(len(low))
    for axis, normal in enumerate(questions.normals_m):
        start, end = (side[:, axis] for side in whole)
        found *= _chance(normal, low[:, axis], high[:, axis]) / _chance(normal, start, end)
    return found


def drawn(questions: QuestionLaw, low: Floats, high: Floats, rng: np.random.Generator) -> Floats:
    """(n, 6) one question of each box from ``low`` to ``high`` (n, 6)."""
    asked = low + rng.random(low.shape) * (high - low)
    for axis, normal in enumerate(questions.normals_m):
        if normal is not None:
            first, last, above = _ends(normal, low[:, axis], high[:, axis])
            z = ndtri(first + rng.random(len(low)) * (last - first))
            asked[:, axis] = normal[0] + normal[1] * np.where(above, -z, z)
    return np.clip(asked, low, high)


def _chance(normal: Normal | None, low: Floats, high: Floats) -> Floats:
    """(n,) of intervals (n,): of a normal variable, or else proportional to it."""
    if normal is None:
        return high - low
    first, last, _ = _ends(normal, low, high)
    return last - first


def _ends(normal: Normal, low: Floats, high: Floats) -> tuple[Floats, Floats, NDArray[np.bool_]]:
    """(n,) the distribution function at both ends of intervals (n,), those above the mean seen from above."""
    start, end = (low - normal[0]) / normal[1], (high - normal[0]) / normal[1]
    above = start + end > 0.0  # where 1 - F would lose digits
    return ndtr(np.where(above, -end, start)), ndtr(np.where(above, -start, end)), above


def joint_bound(
    tree: BoxTree,
    region: ProofRegion,
    questions: QuestionLaw,
    wrong: Wrong,
    *,
    confidence: float,
    rng: np.random.Generator,
) -> JointBound:
    """From a tree that is finished and questions (n, 6) asked now; ``wrong`` says which are answered so."""
    refuted = sum(float(chances(questions, region, *box).sum()) for box in tree.leaves(region, REFUTED))
    low, high = (np.concatenate(side) for side in zip(*tree.leaves(region, UNDECIDED), strict=True))
    each = chances(questions, region, low, high)
    undecided, count, against, most = min(1.0, float(each.sum()) * UP), 0, 0, 0.0
    if len(each):
        ends = np.cumsum(each)
        count = questions.samples
        rows = np.searchsorted(ends, rng.random(count) * ends[-1], side="right").clip(max=len(each) - 1)
        against = int(np.count_nonzero(wrong(drawn(questions, low[rows], high[rows], rng))))
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
    """One for each claim, all of which hold together with the plan's confidence; none without questions."""
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


def answered_wrongly(avoider: Answering, planned: PlannedProof, asked: Floats) -> NDArray[np.bool_]:
    """(n,) which of ``asked`` (n, 6) the claim is about and the network answers otherwise, or nearly so."""
    apart_m, (near_m, far_m) = np.linalg.norm(asked[:, :3] - asked[:, 3:], axis=1), planned.region.apart_m
    found: NDArray[np.bool_] = (apart_m >= near_m) & (apart_m <= far_m)
    return found & ~(margins_of(avoider, planned.claim, asked) >= DOUBTFUL)
