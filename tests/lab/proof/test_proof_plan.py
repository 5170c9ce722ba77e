"""A plan of proofs: what it may say, and where it is wrong."""

from __future__ import annotations

from pathlib import Path

import pytest
from cell.avoidance.random_models import SEEN, random_perceptron

from safety_harness.base.exceptions import InputError
from safety_harness.cell.avoidance.model_file import save_model
from safety_harness.extensions.lab.proof.claims import ClaimKind, DecisionClaim
from safety_harness.extensions.lab.proof.plan import ProofRegion, read_proof_plan
from tests.lab.proof.regions import PLAN, plan_file


def test_claims_and_regions_are_as_written(tmp_path: Path) -> None:
    plan = read_proof_plan(plan_file(tmp_path))
    steps, near = plan.proofs
    assert steps.claim == DecisionClaim(ClaimKind.AT_MOST, 0.15)
    assert (steps.region.hand_low_m, steps.region.tcp_high_m) == (
        plan.asked.model.seen.hand_low_m,
        plan.asked.model.seen.tcp_high_m,
    )
    assert near.claim == DecisionClaim(ClaimKind.OPTIMUM, 0.04)
    assert near.region.tcp_low_m == (0.65, -0.14, 0.26)
    assert near.sentence == "within 40 mm of the optimum (corner)"


def test_a_network_of_ones_own_is_sought_beside_the_plan(tmp_path: Path) -> None:
    save_model(random_perceptron(), tmp_path / "own.safetensors")
    path = plan_file(tmp_path, PLAN.replace("avoider: student", "avoider: own.safetensors"))
    plan = read_proof_plan(path)
    assert plan.proofs[0].region.hand_low_m == SEEN.hand_low_m


@pytest.mark.parametrize(
    ("was", "now", "place", "told"),
    [
        ("avoider: student", "avoider: optimum", ":2: avoider", "regression resnet"),
        ("avoider: student", "avoider: mine.pt", ":2: avoider", "FILE.safetensors or FILE.onnx"),
        ("avoider: student", "avoider: opposite pose", ":2: avoider", "a network"),
        ("steps at most 150 mm", "steps at most 150", "claims[0].claim", "mm"),
        ("steps at most 150 mm", "steps at most 0 mm", "claims[0].claim", "above 0"),
        ("steps at most 150 mm", "uncertain or within 9 mm of the optimum", "claims[0]", "a spread"),
        ("steps at most 150 mm", "is kind", "claims[0].claim", "leads away"),
        ("in: corner", "in: corners", "claims[1].in", "corner"),
        ("claims:", "  close: {apart: [400 mm, 100 mm]}\nclaims:", "apart[1]", "above"),
        ("claims:", "  close: {apart: [100 mm, 400 mm]}\nclaims:", ":3: regions", "a claim in each region"),
        ("  corner:", "  seen:", "regions.seen", "a name other than"),
        ("to: [700 mm, -400 mm, -100 mm]", "to: [600 mm, -400 mm, -100 mm]", "corner.hand", "below"),
        ("within 40 mm of the optimum\n    in: corner", "steps at most 0.15 m", "claims[1]", "once"),
        ("proof:", "scenario:", "proofs.yaml", "a plan of proofs"),
    ],
)
def test_what_is_wrong_is_told_with_its_place(
    tmp_path: Path, was: str, now: str, place: str, told: str
) -> None:
    assert was in PLAN
    with pytest.raises(InputError) as caught:
        read_proof_plan(plan_file(tmp_path, PLAN.replace(was, now, 1)))
    assert place in str(caught.value)
    assert told in str(caught.value)


def test_a_region_without_a_pair_is_told_from_one_with_few() -> None:
    """Distances of two boxes run from the least to the largest without a gap."""
    boxes: dict[str, tuple[float, float, float]] = {
        "hand_low_m": (0.6, 0.0, 0.0),
        "hand_high_m": (0.7, 0.1, 0.1),
        "tcp_low_m": (0.0, 0.0, 0.0),
        "tcp_high_m": (0.1, 0.1, 0.1),
    }
    apart = {(0.0, 0.49): False, (0.0, 0.51): True, (0.72, 1.0): False, (0.71, 1.0): True, (0.5, 0.7): True}
    for limits, has in apart.items():
        assert ProofRegion(name="a box", apart_m=limits, **boxes).has_pair == has
