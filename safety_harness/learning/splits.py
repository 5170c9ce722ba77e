"""Which samples of a data set are trained on, validated on and tested on: 0.8, 0.1 and 0.1 of them.

The paper splits the samples at random, so that every TCP, and with it the noise of its label, is in all
three parts: a network may remember what it is then tested on.  Splitting by TCP has no such leak.  (Hands
are shared in both; they only shift the target, in a known way.)
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from safety_harness.exceptions import DatasetError, Place
from safety_harness.learning.dataset import CompactDataset, Stream, stream

HELD_OUT = 0.1  # for validation, and as much again for testing


@dataclass(frozen=True, eq=False)
class Split:
    """Numbers of the samples in each part, read-only; together they are all samples, each once."""

    kind: str
    train: NDArray[np.int64]
    validation: NDArray[np.int64]
    test: NDArray[np.int64]

    def __post_init__(self) -> None:
        for part in (self.train, self.validation, self.test):
            part.setflags(write=False)


def split_by_sample(dataset: CompactDataset, *, seed: int) -> Split:
    """The paper's split: samples at random, in random order.  DatasetError with fewer than 10 of them."""
    return Split("by sample", *_parts(len(dataset), "samples", seed, 0))


def split_by_tcp(dataset: CompactDataset, *, seed: int) -> Split:
    """TCPs at random, each with all of its samples in one part.  DatasetError with fewer than 10 TCPs."""
    train, validation, test = (
        (tcps[:, None] * dataset.hands + np.arange(dataset.hands)).ravel()
        for tcps in _parts(dataset.tcps, "TCPs", seed, 1)
    )
    return Split("by TCP", train, validation, test)


def _parts(
    count: int, what: str, seed: int, kind: int
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
    """A random permutation of 0 ... count - 1, cut into train, validation and test."""
    held_out = round(HELD_OUT * count)
    if count < 10:
        raise DatasetError(
            place=Place(field="split"),
            expected=f"at least 10 {what} to split into 0.8, 0.1 and 0.1",
            got=f"{count} {what}",
        )
    order = stream(seed, Stream.SPLIT, kind).permutation(count)
    train = count - 2 * held_out
    return order[:train], order[train : train + held_out], order[train + held_out :]
