"""Certify that a decision in a run would be the same for any hand position in a box around the hand.

Two of the gate's checks depend only on the network's answer and on the hand.  The first check is whether the
spread is at most the threshold on every axis.  The second check is whether the path leads away from the hand.
For the seed of a decision, a network with dropout is an ensemble of its passes, so the same proofs apply.
The certificate assumes that the position of the TCP is exact.

First the network answers for the centre and the corners of the box.  If a check gives different results for
these answers, a proof is impossible.  Otherwise a single coarse bound over the box (``CHEAP``) is sufficient
for most decisions.  The remaining decisions need tighter bounds and halvings of the box.
"""

from __future__ import annotations

from functools import lru_cache
from itertools import product

import numpy as np

from safety_harness.cell.avoidance.asking import Question, ask
from safety_harness.cell.avoidance.flaky import asked_in, difference
from safety_harness.cell.avoidance.learned import LearnedAvoider
from safety_harness.cell.avoidance.model_file import Dropout, Model
from safety_harness.extensions.lab.proof.box_kernel import MARGIN, PROVEN, REFUTED, UNDECIDED
from safety_harness.extensions.lab.proof.claims import ClaimKind, DecisionClaim, optimum_constants
from safety_harness.extensions.lab.proof.network import ReluNetwork, network_of
from safety_harness.extensions.lab.proof.plan import ProofRegion
from safety_harness.extensions.lab.proof.tree import BoxTree, examined_with_spreads, work
from safety_harness.trace.certified import CertifiedDecision, CertifiedDecisions, Sameness
from safety_harness.trace.trace import Trace

HALVINGS, HALVED_CHEAPLY = 4, 2  # a choice: halvings of a box with the tight and with the cheap bound
CHEAP = 3  # layers of a deep network over which slack grows before it becomes symbols
PLACES = np.array([(0.0, 0.0, 0.0), *product((-1.0, 1.0), repeat=3)])
AWAY = DecisionClaim(ClaimKind.AWAY, 0.0)
NO_ANSWER = CertifiedDecision(certain=Sameness.NONE, away=Sameness.NONE)


def certified_decisions(trace: Trace, model: Model, sha256: str, half_m: float) -> CertifiedDecisions:
    """Return certificates of all decisions in a run, for hands within +- ``half_m`` along each axis.

    A decision has no certificate if its answer was late or if a fault altered the answer.  It also has no
    certificate if its answer is not bit-identical to the model's answer.

    Args:
        trace: The run.
        model: The network.
        sha256: The hash of the network's file.
        half_m: Half the size of a box of hands [m].

    """
    avoider, decisions = LearnedAvoider.from_model(model), [NO_ANSWER] * len(trace.decisions)
    for entry in asked_in(trace):
        if not difference(entry.answer, ask(avoider, entry.question)):
            decisions[entry.number - 1] = certified(avoider, entry.question, half_m)
    return CertifiedDecisions(half_m=half_m, network_sha256=sha256, decisions=tuple(decisions))


def certified(avoider: LearnedAvoider, question: Question, half_m: float) -> CertifiedDecision:
    """Return the certificate of the decision for one input and its seed.

    Args:
        avoider: The network.
        question: The input.
        half_m: Half the size of the box of hands [m].

    """
    hands = question.hand_position_in_base_m + half_m * PLACES
    tcps = np.broadcast_to(question.tcp_position_in_base_m, hands.shape)
    answers, spreads = avoider.propose_many(hands, tcps, np.full(len(hands), question.seed, np.uint64))
    threshold_m, away = avoider.spread_threshold_m, AWAY.margins(hands, tcps, answers) >= 0.0
    # Without dropout the seed has no effect, so a constant seed lets all decisions use the cached network.
    network = _network_of(avoider.model, 0 if avoider.model.dropout is Dropout.NONE else question.seed)
    region = ProofRegion.around(question.tcp_position_in_base_m, hands.min(axis=0), hands.max(axis=0))
    cheap = network._replace(gathers=network.gathers * CHEAP)
    (code,), ((least_m, most_m),) = examined_with_spreads(
        cheap, optimum_constants(), AWAY, region, region.corners()
    )
    certain = Sameness.SAME  # without a threshold, or for a single pass, which has no spread
    if threshold_m is not None and len(network.weight) > 1:
        sure = spreads.max(axis=1) <= threshold_m
        known = most_m <= threshold_m - MARGIN or least_m >= threshold_m + MARGIN
        certain = _same(
            sure, known, code, cheap, network, DecisionClaim(ClaimKind.CERTAIN, threshold_m), region
        )
    away_known = code in (PROVEN, REFUTED)
    return CertifiedDecision(
        certain=certain, away=_same(away, away_known, code, cheap, network, AWAY, region)
    )


_network_of = lru_cache(maxsize=1)(network_of)  # the same for every decision without dropout


def _same(
    answers: np.ndarray[tuple[int], np.dtype[np.bool_]],
    known: bool | np.bool_,
    code: int,
    cheap: ReluNetwork,
    network: ReluNetwork,
    claim: DecisionClaim,
    region: ProofRegion,
) -> Sameness:
    """Return whether ``claim`` has the same truth value for all inputs in ``region``.

    If this remains unknown, the result is UNDECIDED.

    ``answers`` contains the truth value of the claim for n of these inputs.  ``known`` is True if a bound
    over the whole region has already proven or refuted the claim.  If ``known`` is False, ``code`` may be the
    axis along which to halve the region.
    """
    if answers.min() != answers.max():
        return Sameness.OTHER
    if known:
        return Sameness.SAME
    tree = BoxTree()
    if code < PROVEN:
        tree = BoxTree([np.array([code], np.uint8), np.full(2, UNDECIDED, np.uint8)])
    # The cheap bound may decide some halves, so that only the others need the tight bound.
    for bounded, halvings in ((cheap, HALVED_CHEAPLY), (network, HALVINGS)):
        work(tree, bounded, claim, region, halvings=halvings, until_s=np.inf)
    shares = tree.shares()
    if shares["proven"] > 0.0 and shares["refuted"] > 0.0:
        return Sameness.OTHER
    return Sameness.UNDECIDED if shares["undecided"] > 0.0 else Sameness.SAME
