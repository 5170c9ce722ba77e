"""What models are evaluated on: independent decisions, drawn where and as the name of each set says.

No TCP occurs in two rows of a set, so that rows are independent trials and shares of them have exact
intervals: two samples of one TCP would share the noise of its label.

The draws never coincide with those of a training or a calibration.  A data set's streams are leaves of
its own seed; a training's is the number that its user gave, a calibration's come from that with the spawn
key (7, k), and those here from the evaluation's own seed with (8, k): 64 bits that no other path gives.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from safety_harness.learning.dataset import CompactDataset, LabelFloor, generate, label_floor
from safety_harness.learning.manifest import data_hash
from safety_harness.learning.spaces import SPACES, seen
from safety_harness.learning.splits import split_by_sample, split_by_tcp
from safety_harness.settings import Settings

Floats = NDArray[np.float64]

BRANCH = 8
_DECISIONS, _CHOICE = 0, 1  # below the branch and a set's number: seeds of its decisions, its choice of rows
FLOOR_TCPS = 10_000  # the first ones, at most: 7 s
SEEN_NAME, TEST_NAME = "seen, new TCPs", "seen, test part"
MOST_VIEWS = 20_000_000  # of a data set that is made again: TCPs times candidates; the paper's has a million
SPLITS = {"by TCP": split_by_tcp, "by sample": split_by_sample}


@dataclass(frozen=True, eq=False, kw_only=True)
class EvaluationSet:
    """Questions with their labels: rows (n, 3), base frame [m].

    ``labels_in_base`` are eq. 13's, ``noise_free_in_base`` those with the continuous optimum in place of
    the selected candidate; ``floor`` is what the noise of the labels leaves of any regressor's error on this
    set, by 1,000 redraws for each TCP; only of seen sets, for elsewhere errors have other reasons.
    """

    name: str
    about: str
    seen: bool
    hands_in_base: Floats
    tcps_in_base: Floats
    labels_in_base: Floats
    noise_free_in_base: Floats
    decision_seeds: NDArray[np.uint64]  # (n,)
    floor: LabelFloor | None

    def __len__(self) -> int:
        """How many rows there are."""
        return len(self.hands_in_base)


@dataclass(frozen=True)
class DataCard:
    """How a model's card says that its training data were made."""

    seed: int
    tcps: int
    candidates: int
    hands: int
    split: str
    sha256: str

    @classmethod
    def of(cls, card: Mapping[str, Any]) -> DataCard | None:
        """From the card of a model file; None if it does not say, or is no card of ours."""
        data = card.get("data")
        if not isinstance(data, dict) or data.get("space") != "seen":
            return None
        kind, digest = data.get("split"), data.get("sha256")
        numbers = [data.get(name) for name in ("seed", "tcps", "candidates", "hands")]
        seed, tcps, candidates, hands = (n if type(n) is int and n >= 0 else None for n in numbers)
        if seed is None or tcps is None or candidates is None or hands is None:
            return None
        if not (isinstance(kind, str) and kind in SPLITS and isinstance(digest, str)):
            return None
        return cls(seed, tcps, candidates, hands, kind, digest)


def leaf(seed: int, *path: int) -> int:
    """A 64-bit seed on the evaluation's own branch."""
    words = np.random.SeedSequence(seed, spawn_key=(BRANCH, *path)).generate_state(1, np.uint64)
    return int(words[0])


def fresh_sets(
    settings: Settings,
    *,
    samples: int,
    seed: int,
    candidates: int,
    on_set: Callable[[str], object] = lambda name: None,
) -> list[EvaluationSet]:
    """New TCPs and hands of the seen space and of the three unseen ones, ``samples`` rows each.

    ``on_set`` is told the name of each before it is drawn.
    """
    sets = []
    for number, (name, space_of) in enumerate(SPACES.items(), start=1):
        on_set(name)
        drawn = generate(
            settings,
            space_of(settings),
            seed=leaf(seed, number),
            tcps=samples,
            candidates=candidates,
            hands=samples,
        )
        pairs = np.arange(samples) * (samples + 1)  # TCP k with hand k
        is_seen = name == "seen"
        called = SEEN_NAME if is_seen else name
        about = f"{samples} TCPs and as many hands, drawn afresh in the space {name!r}"
        sets.append(_set(called, about, drawn, pairs, is_seen=is_seen, seed=seed, number=number))
    return sets


def test_part(
    settings: Settings, card: DataCard, *, samples: int, seed: int
) -> tuple[EvaluationSet | None, str]:
    """The part that a model's own training held out for testing, made again; or None, and why.

    At most one row a TCP.  Of a random split over the samples every TCP was trained on as well: its
    label's noise may be remembered, and errors look smaller than on new TCPs.
    """
    if not (card.tcps >= 10 and 0 < card.tcps * card.candidates <= MOST_VIEWS and card.hands > 0):
        return None, f"its data set has {card.tcps} TCPs with {card.candidates} candidates each"
    dataset = generate(
        settings,
        seen(settings),
        seed=card.seed,
        tcps=card.tcps,
        candidates=card.candidates,
        hands=card.hands,
    )
    if data_hash(dataset) != card.sha256:
        return None, "its training data cannot be made again from the card's numbers (another hash)"
    test = SPLITS[card.split](dataset, seed=card.seed).test
    rng = np.random.default_rng(leaf(seed, 0, _CHOICE))
    shuffled = rng.permutation(test)
    _, first = np.unique(shuffled // card.hands, return_index=True)
    rows = rng.permutation(shuffled[first])[:samples]
    about = (
        f"{len(rows)} samples of different TCPs from the test part of the training data, split {card.split}"
    )
    return _set(f"{TEST_NAME} {card.split}", about, dataset, rows, is_seen=True, seed=seed, number=0), ""


def _set(
    name: str,
    about: str,
    dataset: CompactDataset,
    rows: NDArray[np.int64],
    *,
    is_seen: bool,
    seed: int,
    number: int,
) -> EvaluationSet:
    inputs = dataset.inputs(rows)
    rng = np.random.default_rng(leaf(seed, number, _DECISIONS))
    return EvaluationSet(
        name=name,
        about=about,
        seen=is_seen,
        hands_in_base=inputs[:, :3],
        tcps_in_base=inputs[:, 3:],
        labels_in_base=dataset.targets(rows),
        noise_free_in_base=dataset.without_noise().targets(rows),
        decision_seeds=rng.integers(0, 2**64, len(rows), dtype=np.uint64),
        floor=label_floor(dataset.settings, inputs[:FLOOR_TCPS, 3:], seed=leaf(seed, number))
        if is_seen
        else None,
    )
