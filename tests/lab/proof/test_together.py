"""Proof and sample in one bound: it covers the truth as often as it says, and knows no loop."""

from __future__ import annotations

from math import prod
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import binom, norm

from safety_harness.base.exceptions import InputError
from safety_harness.extensions.lab.proof.box_kernel import PROVEN, REFUTED, UNDECIDED
from safety_harness.extensions.lab.proof.plan import QuestionLaw, read_proof_plan
from safety_harness.extensions.lab.proof.session import Effort, continue_proofs, fresh
from safety_harness.extensions.lab.proof.together import chances, drawn, joint_bound, joint_bounds
from safety_harness.extensions.lab.proof.tree import BoxTree
from tests.lab.proof.regions import PLAN, SEEN_REGION, plan_file

UNIFORM = QuestionLaw(normals_m=(None,) * 6, samples=60, confidence=0.9, seed=0)
NORMALS = ((0.8, 0.2), (-0.3, 0.1), (0.0, 0.3), None, (0.0, 0.05), (0.3, 1.0))
NORMAL = QuestionLaw(normals_m=NORMALS, samples=60, confidence=0.9, seed=0)
LOW, HIGH = (side[0] for side in SEEN_REGION.corners())


def a_tree(x: float, depth: int) -> BoxTree:
    """Halved along the hand's x about the share ``x``: proven above it, refuted below, undecided between."""
    levels, at = [np.array([UNDECIDED], np.uint8)], 0
    for level in range(depth):
        levels[level][at] = 0
        place = int(x * 2.0 ** (level + 1)) & 1
        levels.append(np.array([UNDECIDED, PROVEN] if place == 0 else [REFUTED, UNDECIDED], np.uint8))
        at = place
    return BoxTree(levels)


def share_below(questions: QuestionLaw, share: float) -> float:
    """The chance that the hand's x is below this share of the region."""
    x, (low, high) = LOW[0] + share * (HIGH[0] - LOW[0]), (LOW[0], HIGH[0])
    normal = questions.normals_m[0]
    if normal is None:
        return share
    first, last = norm.cdf([low, high], *normal)
    return float((norm.cdf(x, *normal) - first) / (last - first))


def covered(questions: QuestionLaw, count: int) -> int:
    """In how many of ``count`` simulations with known truth the bound holds."""
    found = 0
    for number in range(count):
        rng = np.random.default_rng(number)
        share = float(rng.uniform(0.02, 0.98))
        edge_m = LOW[0] + share * (HIGH[0] - LOW[0])
        tree = a_tree(share, int(rng.integers(1, 6)))
        truth = share_below(questions, share)
        one = joint_bound(
            tree,
            SEEN_REGION,
            questions,
            lambda asked, edge_m=edge_m: asked[:, 0] < edge_m,  # type: ignore[misc]
            confidence=questions.confidence,
            rng=rng,
        )
        assert one.low <= truth * (1.0 + 1e-9)
        found += truth <= one.high
    return found


@pytest.mark.parametrize(("questions", "count"), [(UNIFORM, 1_000), (NORMAL, 200)], ids=["uniform", "normal"])
def test_of_a_thousand_bounds_with_known_truth_as_many_hold_as_they_say(
    questions: QuestionLaw, count: int
) -> None:
    held = covered(questions, count)
    assert held >= binom.ppf(1e-4, count, questions.confidence)
    assert held < count  # a bound that always held would say nothing


def test_what_is_proven_adds_nothing_and_what_is_refuted_counts_whole() -> None:
    def bound(codes: list[int]) -> tuple[float, float, int]:
        tree = BoxTree([np.array([0], np.uint8), np.array(codes, np.uint8)])
        rng = np.random.default_rng(0)
        one = joint_bound(
            tree, SEEN_REGION, UNIFORM, lambda x: np.zeros(len(x), bool), confidence=0.9, rng=rng
        )
        return one.low, one.high, one.samples

    assert bound([PROVEN, PROVEN]) == (0.0, 0.0, 0)
    assert bound([PROVEN, REFUTED]) == (pytest.approx(0.5), pytest.approx(0.5), 0)
    low, high, samples = bound([PROVEN, UNDECIDED])
    assert (low, samples) == (0.0, 60)
    assert high == pytest.approx(0.5 * (1.0 - 0.1 ** (1.0 / 60.0)))


@pytest.mark.parametrize("questions", [UNIFORM, NORMAL], ids=["uniform", "normal"])
def test_questions_are_drawn_as_their_boxes_chances_say(questions: QuestionLaw) -> None:
    count, rng = 40_000, np.random.default_rng(2)
    asked = drawn(questions, np.tile(LOW, (count, 1)), np.tile(HIGH, (count, 1)), rng)
    assert ((asked >= LOW) & (asked <= HIGH)).all()
    for _ in range(20):
        ends = np.sort(rng.random((2, 6)), axis=0)
        low, high = (
            LOW + ends[0] * (HIGH - LOW),
            LOW + ends[1] * (HIGH - LOW),
        )
        (chance,) = chances(questions, SEEN_REGION, low[None], high[None])
        inside = int(((asked >= low) & (asked <= high)).all(axis=1).sum())
        assert binom.ppf(1e-6, count, chance) <= inside <= binom.ppf(1.0 - 1e-6, count, chance)


def test_the_chance_far_from_the_mean_keeps_its_digits() -> None:
    questions = QuestionLaw(normals_m=((0.0, 0.05), *(None,) * 5), samples=1, confidence=0.9, seed=0)
    low, high = LOW.copy(), HIGH.copy()
    low[0] = 1.1
    (chance,) = chances(questions, SEEN_REGION, low[None], high[None])
    exact = (norm.sf(22.0) - norm.sf(22.8)) / (norm.sf(10.8) - norm.sf(22.8))
    assert chance == pytest.approx(exact, rel=1e-9)
    assert prod(drawn(questions, low[None], high[None], np.random.default_rng(0)).shape) == 6


def with_distribution(folder: Path, more: str, samples: int = 500) -> Path:
    return plan_file(folder, f"{PLAN}distribution: {{samples: {samples}, confidence: 95 %{more}}}\n")


def test_a_plan_says_how_questions_are_distributed(tmp_path: Path) -> None:
    more = ", hand: {mean: [650 mm, -450 mm, -150 mm], std: [50 mm, 100 mm, 80 mm]}"
    plan = read_proof_plan(with_distribution(tmp_path, more))
    assert plan.questions is not None
    assert plan.questions.normals_m[:4] == ((0.65, 0.05), (-0.45, 0.1), (-0.15, 0.08), None)
    proofs = list(continue_proofs(plan, fresh(plan), Effort(seconds=1e6, halvings=8)))
    steps, near = joint_bounds(plan, proofs)
    assert (steps.samples, near.samples, near.high) == (500, 0, 0.0)  # of which all is proven
    assert steps.confidence == pytest.approx(0.975)
    assert steps.high < steps.undecided
    assert joint_bounds(plan, proofs) == [steps, near]


@pytest.mark.parametrize(
    ("more", "told"),
    [
        (", space: nominal.yaml", "questions that a loop makes"),
        (", trace: run.npz", "questions that a loop makes"),
        (", hand: {mean: [5 m, 0 m, 0 m], std: [1 mm, 1 mm, 1 mm]}", "within the region seen"),
        (", tcp: {mean: [700 mm, 0 mm, 300 mm], std: [0 mm, 1 mm, 1 mm]}", "above 0"),
    ],
)
def test_one_that_is_not_known_is_refused(tmp_path: Path, more: str, told: str) -> None:
    with pytest.raises(InputError, match=told):
        read_proof_plan(with_distribution(tmp_path, more))
    with pytest.raises(InputError, match="whole number"):
        read_proof_plan(with_distribution(tmp_path, "", samples=0))
