"""Is a decision of a run the same for every hand in a box about the one that was asked about?

Two of the gate's checks follow from the network's answer and that hand: is it certain (its spread at most the
threshold on every axis), and does its way lead away from the hand?  With the decision's own seed a network
with dropout is an ensemble of its passes, so that both are proven as of any other.  The TCP is exact.  The
network is asked at the box's middle and corners first: where its answers differ there, nothing is to prove.
Then one cheap bound of the whole box (``CHEAP``) decides most; the rest is bounded tightly, and halved.
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

HALVINGS, HALVED_CHEAPLY = 4, 2
CHEAP = 3  # layers in which slack of a deep network grows, before it becomes symbols
PLACES = np.array([(0.0, 0.0, 0.0), *product((-1.0, 1.0), repeat=3)])
AWAY = DecisionClaim(ClaimKind.AWAY, 0.0)
NO_ANSWER = CertifiedDecision(certain=Sameness.NONE, away=Sameness.NONE)


def certified_decisions(trace: Trace, model: Model, sha256: str, half_m: float) -> CertifiedDecisions:
    """Of all decisions of ``trace``, whose hands are +- ``half_m`` by axis.

    Answers that came too late, that a fault spoilt, or that are not ``model``'s bit for bit have none.
    """
    avoider, found = LearnedAvoider.from_model(model), [NO_ANSWER] * len(trace.decisions)
    for one in asked_in(trace):
        if not difference(one.answer, ask(avoider, one.question)):
            found[one.number - 1] = certified(avoider, one.question, half_m)
    return CertifiedDecisions(half_m=half_m, network_sha256=sha256, decisions=tuple(found))


def certified(avoider: LearnedAvoider, question: Question, half_m: float) -> CertifiedDecision:
    """Of one question and its seed."""
    hands = question.hand_position_in_base_m + half_m * PLACES
    tcps = np.broadcast_to(question.tcp_position_in_base_m, hands.shape)
    answers, spreads = avoider.propose_many(hands, tcps, np.full(len(hands), question.seed, np.uint64))
    threshold_m, away = avoider.spread_threshold_m, AWAY.margins(hands, tcps, answers) >= 0.0
    network = _network_of(avoider.model, 0 if avoider.model.dropout is Dropout.NONE else question.seed)
    region = ProofRegion.about(question.tcp_position_in_base_m, hands.min(axis=0), hands.max(axis=0))
    cheap = network._replace(gathers=network.gathers * CHEAP)
    (code,), ((least_m, most_m),) = examined_with_spreads(
        cheap, optimum_constants(), AWAY, region, region.corners()
    )
    certain = Sameness.SAME  # without a threshold, or of a single answer, which has no spread
    if threshold_m is not None and len(network.weight) > 1:
        asked = spreads.max(axis=1) <= threshold_m
        known = most_m <= threshold_m - MARGIN or least_m >= threshold_m + MARGIN
        certain = _same(
            asked, known, code, cheap, network, DecisionClaim(ClaimKind.CERTAIN, threshold_m), region
        )
    away_known = code in (PROVEN, REFUTED)
    return CertifiedDecision(
        certain=certain, away=_same(away, away_known, code, cheap, network, AWAY, region)
    )


_network_of = lru_cache(maxsize=1)(network_of)  # without dropout the same for every decision


def _same(
    asked: np.ndarray[tuple[int], np.dtype[np.bool_]],
    known: bool | np.bool_,
    code: int,
    cheap: ReluNetwork,
    network: ReluNetwork,
    claim: DecisionClaim,
    region: ProofRegion,
) -> Sameness:
    """Whether the claim is kept of all questions of the region, or of none; ``asked`` (n,) of some.

    It is ``known`` if one bound has shown so already, whose ``code`` says else along which axis to halve.
    """
    if asked.min() != asked.max():
        return Sameness.OTHER
    if known:
        return Sameness.SAME
    tree = BoxTree()
    if code < PROVEN:
        tree = BoxTree([np.array([code], np.uint8), np.full(2, UNDECIDED, np.uint8)])
    for one, halvings in ((cheap, HALVED_CHEAPLY), (network, HALVINGS)):
        work(tree, one, claim, region, halvings=halvings, until_s=np.inf)
    shares = tree.shares()
    if shares["proven"] > 0.0 and shares["refuted"] > 0.0:
        return Sameness.OTHER
    return Sameness.UNDECIDED if shares["undecided"] > 0.0 else Sameness.SAME
