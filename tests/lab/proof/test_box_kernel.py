"""What is proven of a box is so of every question in it, as the network itself answers."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from cell.avoidance.random_models import random_perceptron

from safety_harness.cell.avoidance.learned import LearnedAvoider
from safety_harness.cell.avoidance.model_file import Model, load_model
from safety_harness.cell.avoidance.shipped import shipped_model
from safety_harness.extensions.lab.proof.box_kernel import MARGIN, OUTSIDE, PROVEN, REFUTED
from safety_harness.extensions.lab.proof.claims import (
    ClaimKind,
    DecisionClaim,
    margins_of,
    optimum_constants,
    threshold_m,
)
from safety_harness.extensions.lab.proof.network import network_of
from safety_harness.extensions.lab.proof.plan import ProofRegion
from safety_harness.extensions.lab.proof.tree import Boxes, Codes, examined
from tests.lab.proof.regions import SEEN_REGION, random_boxes

CLAIMS = [
    DecisionClaim(ClaimKind.AT_MOST, 0.11),
    DecisionClaim(ClaimKind.AT_LEAST, 0.11),
    DecisionClaim(ClaimKind.OPTIMUM, 0.004),
    DecisionClaim(ClaimKind.OPTIMUM, 0.05),
    DecisionClaim(ClaimKind.AWAY, 0.0),
]
OF_ENSEMBLES = [
    DecisionClaim(ClaimKind.AT_MOST, 0.11),
    DecisionClaim(ClaimKind.UNSURE, 0.003),
    DecisionClaim(ClaimKind.UNSURE, 0.02),
    DecisionClaim(ClaimKind.AWAY, 0.0),
]
NEAR = replace(SEEN_REGION, apart_m=(0.1, 0.4))


def random_ensemble(seed: int) -> Model:
    """Three members, with a threshold that about half of their spreads are above."""
    found = load_model(shipped_model("student-ensemble")).calibration
    assert found is not None
    calibration = replace(found, spread_threshold_m=0.02)
    return replace(random_perceptron(members=3, seed=seed), calibration=calibration)


def codes_of(model: Model, claim: DecisionClaim, region: ProofRegion, boxes: Boxes) -> Codes:
    return examined(network_of(model), optimum_constants(), claim, region, boxes, threshold_m(model))


def contradicted(
    model: Model, claim: DecisionClaim, boxes: Boxes, codes: Codes, region: ProofRegion, n: int
) -> int:
    """How many of n random questions of each decided box, its corners among them, are not as was said."""
    avoider, rng, wrong = LearnedAvoider.from_model(model), np.random.default_rng(0), 0
    for code in (PROVEN, REFUTED, OUTSIDE):
        low, high = (side[codes == code][:, None] for side in boxes)
        place = rng.random((len(low), n, 6))
        place[:, : n // 4] = np.round(place[:, : n // 4])
        asked = (low + (high - low) * place).reshape(-1, 6)
        margins = margins_of(avoider, claim, asked)
        apart_m = np.linalg.norm(asked[:, :3] - asked[:, 3:], axis=1)
        inside = (apart_m >= region.apart_m[0]) & (apart_m <= region.apart_m[1])
        if code == OUTSIDE:
            wrong += int(inside.sum())
        else:
            wrong += int((~(margins >= 0.0) if code == PROVEN else ~(margins < 0.0) | ~inside).sum())
    return wrong


def sizes_and_examples(claim: DecisionClaim, model: Model, count: int, n: int, least: int) -> None:
    decided = 0
    for size in (1.0, 0.2, 0.03, 0.001):
        for region in (SEEN_REGION, NEAR):
            boxes = random_boxes(region, count, size, seed=int(1e3 * size))
            codes = codes_of(model, claim, region, boxes)
            decided += int((codes >= PROVEN).sum())
            assert contradicted(model, claim, boxes, codes, region, n) == 0
    assert decided > least


@pytest.mark.parametrize("claim", CLAIMS, ids=lambda claim: claim.sentence)
def test_no_question_contradicts_a_decided_box_of_the_student(claim: DecisionClaim) -> None:
    sizes_and_examples(claim, load_model(shipped_model("student")), 100, 40, 200)


@pytest.mark.parametrize("claim", CLAIMS, ids=lambda claim: claim.sentence)
def test_nor_of_random_networks(claim: DecisionClaim) -> None:
    sizes_and_examples(claim, random_perceptron(seed=5), 60, 40, 50)


@pytest.mark.parametrize("claim", OF_ENSEMBLES, ids=lambda claim: claim.sentence)
def test_nor_of_ensembles_whose_spread_counts_too(claim: DecisionClaim) -> None:
    sizes_and_examples(claim, load_model(shipped_model("student-ensemble")), 40, 40, 60)
    sizes_and_examples(claim, random_ensemble(seed=6), 20, 40, 20)


def test_the_spread_alone_can_prove_and_keep_from_refuting() -> None:
    wild = random_ensemble(seed=6)  # far from the optimum, and its members far from each other
    claim, boxes = DecisionClaim(ClaimKind.UNSURE, 0.001), random_boxes(SEEN_REGION, 50, 0.001, seed=7)
    assert wild.calibration is not None
    sure = replace(wild, calibration=replace(wild.calibration, spread_threshold_m=9.0))
    assert (codes_of(wild, claim, SEEN_REGION, boxes) == PROVEN).mean() > 0.9
    assert (codes_of(sure, claim, SEEN_REGION, boxes) == REFUTED).mean() > 0.9
    nobody = replace(wild, calibration=None)
    assert (codes_of(nobody, claim, SEEN_REGION, boxes) < PROVEN).all()


@pytest.mark.long
@pytest.mark.parametrize("seed", range(10))
@pytest.mark.parametrize("claim", CLAIMS, ids=lambda claim: claim.sentence)
def test_nor_of_many_random_networks(claim: DecisionClaim, seed: int) -> None:
    sizes_and_examples(claim, random_perceptron(seed=seed), 2_000, 200, 50)


@pytest.mark.parametrize("claim", CLAIMS, ids=lambda claim: claim.sentence)
def test_a_single_question_is_decided_as_the_network_answers_it(claim: DecisionClaim) -> None:
    model = load_model(shipped_model("student"))
    asked, _ = random_boxes(SEEN_REGION, 500, 0.5, seed=9)
    codes = codes_of(model, claim, SEEN_REGION, (asked, asked.copy()))
    margins = margins_of(LearnedAvoider.from_model(model), claim, asked)
    clear = np.abs(margins) > 10.0 * MARGIN
    assert clear.sum() > 490
    assert np.array_equal(codes[clear] == PROVEN, margins[clear] > 0.0)
    assert np.array_equal(codes[clear] == REFUTED, margins[clear] < 0.0)


@pytest.mark.parametrize("scale", [np.nan, 1e30, 1e300])
def test_answers_that_may_be_anything_decide_nothing(scale: float) -> None:
    network = network_of(load_model(shipped_model("student")))
    broken = network._replace(weight=network.weight * scale)
    boxes = random_boxes(SEEN_REGION, 50, 0.01, seed=3)
    for claim in CLAIMS:
        assert (examined(broken, optimum_constants(), claim, SEEN_REGION, boxes) < PROVEN).all()


def test_where_the_optimum_has_no_direction_nothing_is_decided() -> None:
    low, high = random_boxes(SEEN_REGION, 20, 0.1, seed=4)
    low[:, 3:], high[:, 3:] = [0.6999, -0.0001, 0.3499], [0.7001, 0.0001, 0.3501]
    model = load_model(shipped_model("student"))
    for limit_m in (1e-4, 0.5):
        codes = codes_of(model, DecisionClaim(ClaimKind.OPTIMUM, limit_m), SEEN_REGION, (low, high))
        assert (codes < PROVEN).all()
