"""Work on the claims of a plan of proofs, one after another, within a time limit."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import chain

import numpy as np

from safety_harness.extensions.lab.proof.box_kernel import REFUTED, UNDECIDED
from safety_harness.extensions.lab.proof.certificate import Proof, WrongQuestion
from safety_harness.extensions.lab.proof.claims import ClaimKind, margins_of, optimum_constants
from safety_harness.extensions.lab.proof.plan import ProofPlan
from safety_harness.extensions.lab.proof.tree import BoxTree, MapBatches, examined, work

MOST_ASKED = 200_000  # questions at the centres of leaves
WRONG_BY = 1e-8  # m or m2: a violation that is larger than all rounding

OnStep = Callable[[str, float], None]


@dataclass(frozen=True, kw_only=True)
class Effort:
    """Limits and settings of a session of proofs.

    The session takes at most ``seconds`` for all claims, and it halves a box at most ``halvings`` times.

    The time begins after the processes have started and compiled their code. ``over`` maps a function over
    ``at_once`` batches of boxes, for example in other processes. The session ends when ``stopped`` returns
    True. The session calls ``show`` with two arguments: a text about the current claim, and the finished
    fraction of the work.
    """

    seconds: float
    halvings: int
    over: MapBatches = map
    at_once: int = 1
    stopped: Callable[[], bool] = field(default=lambda: False)
    show: OnStep = field(default=lambda text, share: None)


def continue_proofs(plan: ProofPlan, proofs: list[Proof], effort: Effort) -> Iterator[Proof]:
    """Continue the proofs one after another, and yield each of them.

    The function divides the remaining time equally among the remaining proofs.

    Args:
        plan: The plan.
        proofs: The proofs in their current state.
        effort: The limits and settings.

    """
    # Let every process compile its code before the time begins.
    for planned in [proof.planned for proof in proofs[:1]]:
        judge = partial(examined, plan.network, optimum_constants(), planned.claim, planned.region)
        list(effort.over(judge, [planned.region.corners()] * effort.at_once))
    end_s = time.monotonic() + effort.seconds
    for number, proof in enumerate(proofs):
        now_s = time.monotonic()
        share_s = (end_s - now_s) / (len(proofs) - number)

        def report(tree: BoxTree, number: int = number, proof: Proof = proof) -> None:
            decided = 1.0 - tree.shares()["undecided"]
            effort.show(f"{proof.planned.sentence}: {decided:.2%} decided", (number + decided) / len(proofs))

        work(
            proof.tree,
            plan.network,
            proof.planned.claim,
            proof.planned.region,
            halvings=effort.halvings,
            doubt_m=plan.doubt_m,
            until_s=now_s + share_s,
            map_batches=effort.over,
            at_once=effort.at_once,
            on_level=report,
            stopped=effort.stopped,
        )
        yield replace(proof, question=proof.question or wrong_question(plan, proof))


def fresh(plan: ProofPlan) -> list[Proof]:
    """Return a new proof for each claim of a plan; its whole region is undecided."""
    return [Proof(planned, BoxTree()) for planned in plan.proofs]


def wrong_question(plan: ProofPlan, proof: Proof) -> WrongQuestion | None:
    """Return the input with the worst answer among the centres of unproven leaves.

    The result is None if no such answer is wrong, or if the bounds do not confirm it.

    The kernel's bounds at this input must refute even a claim whose limit is looser by half of the violation.
    Because of this margin, a checker with other bounds will also find that the input refutes the original
    claim.

    Args:
        plan: The plan.
        proof: The proof with its tree.

    """
    planned, tree = proof.planned, proof.tree
    leaves = chain(*(tree.leaves(planned.region, code) for code in (REFUTED, UNDECIDED)))
    middles = [(low + high) / 2.0 for low, high in leaves if len(low)]
    points = np.concatenate([np.empty((0, 6)), *middles])[:MOST_ASKED]
    near_m, far_m = planned.region.apart_m
    apart_m = np.linalg.norm(points[:, :3] - points[:, 3:], axis=1)
    points = points[(apart_m > near_m + WRONG_BY) & (apart_m < far_m - WRONG_BY)]
    if not len(points):
        return None
    margins = margins_of(plan.asked, planned.claim, points)
    if not margins.min() < -WRONG_BY:
        return None
    half_m = (
        margins.min() / 2.0 * (1.0 if planned.claim.kind in (ClaimKind.AT_LEAST, ClaimKind.AWAY) else -1.0)
    )
    harder = replace(planned.claim, limit_m=planned.claim.limit_m + half_m)
    worst = points[margins.argmin() :][:1]
    point = worst.copy(), worst.copy()
    (code,) = examined(plan.network, optimum_constants(), harder, planned.region, point, plan.doubt_m)
    x = worst[0].tolist()
    return WrongQuestion((x[0], x[1], x[2]), (x[3], x[4], x[5])) if code == REFUTED else None
