from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest

from safety_harness.base.seeds import Branch, generator, seed

LEAVES: list[tuple[int, Branch, tuple[int, ...]]] = [
    (root, branch, path)
    for root in (0, 1, 2**40)
    for branch in Branch
    for path in [(), (0,), (1,), (0, 0), (0, 1), (1, 0), (12345,)]
]


def test_a_leaf_is_the_same_whatever_was_made_before_it() -> None:
    alone = generator(5, Branch.DECISION, 3).standard_normal(8)
    generator(5, Branch.HAND_SENSOR_NOISE).standard_normal(1000)
    for k in (7, 0, 3):
        seed(5, Branch.DECISION, k)
    assert np.array_equal(generator(5, Branch.DECISION, 3).standard_normal(8), alone)
    forwards = [seed(5, Branch.DECISION, k) for k in range(20)]
    backwards = [seed(5, Branch.DECISION, k) for k in reversed(range(20))]
    assert forwards == backwards[::-1]


def test_all_leaves_differ() -> None:
    seeds = [seed(root, branch, *path) for root, branch, path in LEAVES]
    assert len(set(seeds)) == len(LEAVES)
    first = [generator(root, branch, *path).integers(2**62) for root, branch, path in LEAVES]
    assert len(set(first)) == len(LEAVES)


def test_neighbouring_leaves_are_uncorrelated() -> None:
    count = 4000
    streams = np.array([generator(1, Branch.DECISION, k).standard_normal(count) for k in range(12)])
    correlation = np.corrcoef(streams)
    largest = max(abs(correlation[i, j]) for i, j in combinations(range(len(streams)), 2))
    assert largest < 4.5 / np.sqrt(count)


@pytest.mark.parametrize("root", [0, 1, 2**63])
def test_a_seed_fits_a_signed_integer_of_the_trace(root: int) -> None:
    for k in range(200):
        value = seed(root, Branch.DECISION, k)
        assert 0 <= value < 2**63
        assert int(np.int64(value)) == value


def test_branches_keep_their_numbers() -> None:
    """Traces hold these numbers' consequences: a renumbering would make old seeds mean new runs."""
    assert {branch.name: branch.value for branch in Branch} == {
        "HAND_SENSOR_NOISE": 1,
        "DECISION": 2,
        "SPACE_DRAW": 3,
        "HAND_MOTION": 4,
        "SEARCH": 5,
        "CAMPAIGN": 6,
        "STATISTICS": 7,
        "SELFTEST": 8,
        "DECISION_TIME": 9,
        "SCORING": 10,
        "CONTROLLER": 11,
        "ENVIRONMENT": 12,
        "PROOF": 13,
        "SAFETY_FILTER": 14,
        "PREDICTOR": 15,
        "PREDICTED_INSTANT": 16,
    }
