from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from safety_harness.base.exceptions import DatasetError
from safety_harness.base.settings import DEFAULTS
from safety_harness.extensions.lab.learning.dataset import (
    CompactDataset,
    Split,
    generate,
    seen,
    split_by_sample,
    split_by_tcp,
)

DATASET = generate(DEFAULTS, seen(DEFAULTS), seed=1, tcps=100, candidates=5, hands=30)
BOTH = pytest.mark.parametrize("split", [split_by_sample, split_by_tcp])
Splitter = Callable[..., Split]


def tcps_of(index: np.ndarray, dataset: CompactDataset = DATASET) -> set[tuple[float, ...]]:
    """By position, as a network sees them."""
    return set(map(tuple, dataset.inputs(index)[:, 3:]))


@BOTH
def test_every_sample_is_in_one_part(split: Splitter) -> None:
    parts = split(DATASET, seed=1)
    together = np.concatenate([parts.train, parts.validation, parts.test])
    assert np.array_equal(np.sort(together), np.arange(len(DATASET)))


@BOTH
def test_eight_tenths_are_trained_on_and_a_tenth_each_held_out(split: Splitter) -> None:
    parts = split(DATASET, seed=1)
    assert (len(parts.train), len(parts.validation), len(parts.test)) == (2400, 300, 300)


def test_by_tcp_no_tcp_is_shared() -> None:
    parts = split_by_tcp(DATASET, seed=1)
    train, validation, test = map(tcps_of, (parts.train, parts.validation, parts.test))
    assert (len(train), len(validation), len(test)) == (80, 10, 10)
    assert train.isdisjoint(validation | test)
    assert validation.isdisjoint(test)


def test_by_sample_nearly_every_tested_tcp_was_trained_on() -> None:
    parts = split_by_sample(DATASET, seed=1)
    assert len(tcps_of(parts.test) & tcps_of(parts.train)) > 0.9 * len(tcps_of(parts.test))


@BOTH
def test_one_seed_is_one_split_and_another_seed_another(split: Splitter) -> None:
    first, again, other = split(DATASET, seed=1), split(DATASET, seed=1), split(DATASET, seed=2)
    assert np.array_equal(first.train, again.train)
    assert np.array_equal(first.test, again.test)
    assert set(first.test) != set(other.test)


@BOTH
def test_parts_are_random(split: Splitter) -> None:
    """The mean TCP number of the test part is that of all, within its own scatter."""
    means = [np.mean(split(DATASET, seed=seed).test // DATASET.hands) for seed in range(30)]
    scatter = np.std(np.arange(100)) / np.sqrt(10 * 30)  # at most: by TCP ten numbers are drawn
    assert np.mean(means) == pytest.approx(49.5, abs=5.0 * scatter)
    assert len({round(mean, 6) for mean in means}) > 25


def test_too_little_to_split_is_refused() -> None:
    few_tcps = generate(DEFAULTS, seen(DEFAULTS), seed=1, tcps=9, candidates=5, hands=30)
    with pytest.raises(DatasetError, match="9 TCPs"):
        split_by_tcp(few_tcps, seed=1)
    assert len(split_by_sample(few_tcps, seed=1).test) == 27
    tiny = generate(DEFAULTS, seen(DEFAULTS), seed=1, tcps=3, candidates=5, hands=3)
    with pytest.raises(DatasetError, match="9 samples"):
        split_by_sample(tiny, seed=1)
