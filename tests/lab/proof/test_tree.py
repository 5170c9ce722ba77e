"""Leaves fill their region at any time, and work that was ended goes on to the same end."""

from __future__ import annotations

import time

import numpy as np
import pytest

from safety_harness.cell.avoidance.model_file import load_model
from safety_harness.cell.avoidance.shipped import shipped_model
from safety_harness.extensions.lab.proof import tree as module
from safety_harness.extensions.lab.proof.box_kernel import PROVEN, UNDECIDED
from safety_harness.extensions.lab.proof.claims import ClaimKind, DecisionClaim
from safety_harness.extensions.lab.proof.network import ReluNetwork, network_of
from safety_harness.extensions.lab.proof.tree import LEAVES, BoxTree, work
from tests.lab.proof.regions import SEEN_REGION

CLAIM = DecisionClaim(ClaimKind.AT_MOST, 0.15)


@pytest.fixture(scope="module")
def network() -> ReluNetwork:
    return network_of(load_model(shipped_model("student")))


def worked(network: ReluNetwork, tree: BoxTree, halvings: int, **more: object) -> BoxTree:
    until_s = time.monotonic() + 60.0
    work(tree, network, CLAIM, SEEN_REGION, halvings=halvings, **({"until_s": until_s} | more))  # type: ignore[arg-type]
    return tree


def test_a_step_is_proven_in_all_of_the_seen_space(network: ReluNetwork) -> None:
    shares = worked(network, BoxTree(), 40).shares()
    assert shares == {"proven": 1.0, "refuted": 0.0, "undecided": 0.0, "outside": 0.0}


def test_leaves_fill_the_region_and_do_not_overlap(network: ReluNetwork) -> None:
    tree = worked(network, BoxTree(), 12)
    leaves = [box for code in LEAVES for box in tree.leaves(SEEN_REGION, code)]
    low, high = (np.concatenate([leaf[side] for leaf in leaves]) for side in (0, 1))
    whole = SEEN_REGION.corners()
    assert np.prod(high - low, axis=1).sum() == pytest.approx(np.prod(whole[1] - whole[0]))
    asked = np.random.default_rng(0).uniform(*whole, (500, 6))
    inside = ((asked[:, None] >= low) & (asked[:, None] < high)).all(axis=2)
    assert (inside.sum(axis=1) == 1).all()
    assert sum(tree.shares().values()) == 1.0


def test_without_time_nothing_is_decided(network: ReluNetwork) -> None:
    assert worked(network, BoxTree(), 40, until_s=0.0).shares()["undecided"] == 1.0
    assert worked(network, BoxTree(), 40, stopped=lambda: True).shares()["undecided"] == 1.0


def test_work_that_was_ended_anywhere_comes_to_the_same_end(
    network: ReluNetwork, monkeypatch: pytest.MonkeyPatch
) -> None:
    at_once = worked(network, BoxTree(), 16)
    monkeypatch.setattr(module, "AT_ONCE", 7)
    tree, rng = BoxTree(), np.random.default_rng(1)
    for halvings in (3, 9, 14, 16, 16, 16, 16):
        answers = iter([False] * int(rng.integers(1, 60)))
        worked(network, tree, halvings, stopped=lambda answers=answers: next(answers, True))
        assert sum(tree.shares().values()) == 1.0
    worked(network, tree, 16)
    assert all(np.array_equal(a, b) for a, b in zip(tree.levels, at_once.levels, strict=True))


def test_how_many_batches_go_at_once_changes_nothing(
    network: ReluNetwork, monkeypatch: pytest.MonkeyPatch
) -> None:
    alone = worked(network, BoxTree(), 14)
    monkeypatch.setattr(module, "AT_ONCE", 64)
    together = worked(network, BoxTree(), 14, at_once=3)
    assert all(np.array_equal(a, b) for a, b in zip(alone.levels, together.levels, strict=True))
    assert (alone.levels[-1] >= PROVEN).all()
    assert (alone.levels[14] == UNDECIDED).any()
