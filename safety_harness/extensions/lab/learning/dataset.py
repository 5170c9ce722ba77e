"""Generate the data set of eq. 13 (section 4.1 of the paper) in a compact form.

A data set of 10,000 TCPs and 500 hands has 5,000,000 samples, one for each pair. The selected candidate
depends only on the TCP, and the hand only shifts the target. Therefore, 10,000 selected candidates and 500
hands are sufficient to compute every sample. Sample k combines TCP k // hands with hand k mod hands. The
program computes the row of a sample on demand.

TCPs and hands lie in the seen space or in one of three unseen spaces (Table 3).  ``space.regions`` defines
these regions and gives the reasons.

Training, validation and test contain 0.8, 0.1 and 0.1 of the samples.  The paper splits the samples at
random.  Each TCP, and the noise of its label, then occurs in all three parts, so a network may memorise
labels of the test part.  A split by TCP avoids this leak.  In both kinds of splits, all three parts contain
the same hands.  This is harmless, because a hand only shifts the target by a known vector.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from safety_harness.base.compiled import compiled
from safety_harness.base.exceptions import DatasetError, Place, near_miss
from safety_harness.base.geometry.regions import Region
from safety_harness.base.settings import Settings
from safety_harness.cell.avoidance.candidates import CandidateCap, continuous_optimum
from safety_harness.extensions.lab.learning.image_error import ImageErrors
from safety_harness.extensions.lab.learning.many_candidates import draw_many
from safety_harness.scenario.robots import Robot
from safety_harness.space.regions import paper_seen, region_named

Vector = NDArray[np.float64]  # (3,)
Vectors = NDArray[np.float64]  # (..., 3)


@dataclass(frozen=True)
class Space:
    """The regions of the TCPs and of the hands in a data set; the hands do not depend on the TCPs."""

    name: str
    tcp: Region
    hand: Region


SPACES = {  # the region of the hands and the region of the TCPs, for each name of a space
    "seen": ("seen hand", "seen tcp"),
    "unseen hand": ("unseen hand", "seen tcp"),
    "unseen tcp": ("seen hand", "unseen tcp"),
    "unseen both": ("unseen hand", "unseen tcp"),
}


def space_named(name: str, settings: Settings) -> Space:
    """Return the space with ``name`` in the cell of ``settings``; raise DatasetError for an unknown name."""
    if name not in SPACES:
        raise DatasetError(
            place=Place(field="space"),
            expected=f"one of {', '.join(map(repr, SPACES))}",
            got=repr(name),
            hint=near_miss(name, SPACES),
        )
    bounds = paper_seen(settings)
    hand, tcp = (region_named(region, bounds, settings) for region in SPACES[name])
    return Space(name, tcp=tcp, hand=hand)


def seen(settings: Settings) -> Space:
    """Return the space for training.

    Its TCPs lie around the desired position, and its hands lie around the nominal hand position.
    """
    return space_named("seen", settings)


Index = NDArray[np.integer]
Numbers = NDArray[np.int64]

VIEWS_AT_A_TIME = 100_000  # bounds the memory; the result does not depend on it
# TCPs that use the same random candidates in the floor, so that fewer candidates are drawn.
TCPS_A_REDRAW = 32
# A choice: far above the paper's 10,000 TCPs, 100 candidates and 500 hands.  A larger number is a mistake.
MOST = {"tcps": 10_000_000, "candidates": 100_000, "hands": 10_000_000}


class Stream(IntEnum):
    """The random streams that derive from a data set's seed.

    The numbers are part of the file format, so never reuse the number of a removed stream.
    """

    TCPS = 1
    HANDS = 2
    CANDIDATES = 3  # a stream for each TCP: its candidates depend only on the seed and the TCP's number
    SPLIT = 4
    REDRAWS = 5


def stream(seed: int, name: Stream, *path: int) -> np.random.Generator:
    """Return a new random generator for a stream that derives from ``seed``.

    Args:
        seed: The root.
        name: The stream.
        path: Further numbers that select a substream of the stream.

    """
    return np.random.Generator(np.random.PCG64(np.random.SeedSequence(seed, spawn_key=(name, *path))))


@dataclass(frozen=True, eq=False)
class CompactDataset:
    """The TCPs of a data set with their selected candidates, and the hands.

    All positions are in the base frame [m], and the arrays are read-only.

    ``selected_in_base`` is t_opt of eq. 13, that is, the candidate with the least image error.
    ``optimum_in_base`` is the noise-free counterpart: the point on the cap of all possible candidates that is
    nearest to the desired position.  ``candidates_in_view`` is the number of candidates of each TCP from
    which the camera sees the whole object.  ``arm`` is the name of the cell's arm.
    """

    settings: Settings
    space: Space
    seed: int
    tcp_in_base: Vectors  # (n, 3)
    selected_in_base: Vectors  # (n, 3)
    optimum_in_base: Vectors  # (n, 3)
    candidates_in_view: NDArray[np.int64]  # (n,)
    hand_in_base: Vectors  # (m, 3)
    arm: str = Robot.UR10.label

    def __post_init__(self) -> None:
        for value in vars(self).values():
            if isinstance(value, np.ndarray):
                value.setflags(write=False)

    def __len__(self) -> int:
        """Return the number of samples: TCPs times hands."""
        return self.tcps * self.hands

    @property
    def tcps(self) -> int:
        """The number of TCPs."""
        return len(self.tcp_in_base)

    @property
    def hands(self) -> int:
        """The number of hands."""
        return len(self.hand_in_base)

    @property
    def candidates(self) -> int:
        """The number of candidates for each TCP."""
        return self.settings.avoidance.candidate_count

    @property
    def views_without_object(self) -> int:
        """The total number of candidates from which the camera does not see the whole object."""
        return self.tcps * self.candidates - int(self.candidates_in_view.sum())

    @property
    def tcps_without_view(self) -> int:
        """The number of TCPs without a candidate from which the camera sees the whole object."""
        return int(np.count_nonzero(self.candidates_in_view == 0))

    def without_noise(self) -> CompactDataset:
        """Return the same data set with the optimum as t_opt, so that its labels have no noise."""
        return replace(self, selected_in_base=self.optimum_in_base)

    def inputs(self, index: Index) -> Vectors:
        """Return the inputs of the samples whose numbers are in ``index``, shape (len, 6).

        A row contains the position of the hand, followed by the position of the TCP.
        """
        tcp, hand = self._pairs(index)
        return np.concatenate([self.hand_in_base[hand], self.tcp_in_base[tcp]], axis=1)

    def targets(self, index: Index) -> Vectors:
        """Return the targets of the samples whose numbers are in ``index``, shape (len, 3).

        The target is gt = 0.05 (t_tcp - t_h) + t_opt (eq. 13).
        """
        tcp, hand = self._pairs(index)
        pull = self.settings.avoidance.hand_pull
        by_tcp: Vectors = self.selected_in_base + pull * self.tcp_in_base
        rows: Vectors = by_tcp[tcp] - pull * self.hand_in_base[hand]
        return rows

    def _pairs(self, index: Index) -> tuple[Index, Index]:
        """Return the TCP's number and the hand's number for each sample.

        Raise IndexError if the number of a sample is out of range.
        """
        if len(index) and not (index.min() >= 0 and index.max() < len(self)):
            raise IndexError(f"samples are numbered 0 to {len(self) - 1}")
        tcp, hand = np.divmod(index, self.hands)
        return tcp, hand


def generate(
    settings: Settings,
    space: Space,
    *,
    seed: int,
    tcps: int = 10_000,
    candidates: int = 100,
    hands: int = 500,
    arm: str = Robot.UR10.label,
    on_progress: Callable[[int], object] | None = None,
) -> CompactDataset:
    """Draw TCPs, candidates and hands, and select each TCP's candidate with the least |f - f*|^2 (eq. 15).

    The features f come from the exact image.  If the camera sees the whole object from some candidates of a
    TCP, the function selects among these candidates.  If there is no such candidate, it selects among all
    candidates of the TCP, and ``candidates_in_view`` is 0.  Even then the image moments exist, because the
    exact image has no border.

    Args:
        settings: The settings of the cell.
        space: The space of the TCPs and hands.
        seed: The root of all random numbers.
        tcps: The number of TCPs.
        candidates: The number of candidates for each TCP.
        hands: The number of hands.
        arm: The arm's name.
        on_progress: A function that receives the number of finished TCPs.

    Returns:
        The data set.

    Raises:
        DatasetError: A number is out of range, or no candidate of some TCP has an image of the object.

    """
    for name, number in (("tcps", tcps), ("candidates", candidates), ("hands", hands)):
        if not 1 <= number <= MOST[name]:
            raise DatasetError(
                place=Place(field=name), expected=f"a number from 1 to {MOST[name]}", got=str(number)
            )
    if seed < 0:
        raise DatasetError(place=Place(field="seed"), expected="a seed of at least 0", got=str(seed))
    settings = replace(settings, avoidance=replace(settings.avoidance, candidate_count=candidates))
    tcp_in_base = space.tcp.draw(stream(seed, Stream.TCPS), tcps)
    errors = ImageErrors.from_settings(settings)
    selected, in_view = np.empty((tcps, 3)), np.empty(tcps, np.int64)
    step = max(1, VIEWS_AT_A_TIME // candidates)
    for start in range(0, tcps, step):
        part = slice(start, min(start + step, tcps))
        positions = candidates_of(settings, tcp_in_base, seed, np.arange(part.start, part.stop))
        best, in_view[part] = errors.select(positions)
        selected[part] = positions[np.arange(len(positions)), best]
        if on_progress is not None:
            on_progress(part.stop)
    return CompactDataset(
        settings=settings,
        space=space,
        seed=seed,
        tcp_in_base=tcp_in_base,
        selected_in_base=selected,
        optimum_in_base=continuous_optimum(settings, tcp_in_base),
        candidates_in_view=in_view,
        hand_in_base=space.hand.draw(stream(seed, Stream.HANDS), hands),
        arm=arm,
    )


def fresh_pairs(
    settings: Settings, space: Space, *, seed: int, samples: int, candidates: int
) -> tuple[CompactDataset, Numbers]:
    """Return a new data set, and the numbers of rows that contain each TCP and each hand only once.

    Args:
        settings: The settings of the cell.
        space: The space of the TCPs and hands.
        seed: The root of all random numbers.
        samples: The number of rows.
        candidates: The number of candidates for each TCP.

    """
    drawn = generate(settings, space, seed=seed, tcps=samples, candidates=candidates, hands=samples)
    return drawn, np.arange(samples) * (samples + 1)  # TCP k with hand k


def seed_below(seed: int, *path: int) -> int:
    """Return a 64-bit seed that derives from ``seed`` and ``path``, for code with its own generators."""
    return int(np.random.SeedSequence(seed, spawn_key=path).generate_state(1, np.uint64)[0])


def candidates_of(settings: Settings, tcp_in_base: Vectors, seed: int, numbers: Index) -> Vectors:
    """Return the candidates of k TCPs, that is, each TCP plus random offsets, shape (k, candidates, 3) [m].

    Args:
        settings: The settings of the cell.
        tcp_in_base: (n, 3) all TCPs.
        seed: The seed of the data set.
        numbers: (k,) the numbers of the TCPs.

    """
    # A stream for each TCP, so that its candidates do not depend on the batches.
    generators = [stream(seed, Stream.CANDIDATES, int(number)) for number in numbers]
    positions: Vectors = draw_many(CandidateCap.from_settings(settings), generators)
    positions += tcp_in_base[numbers, None]
    return positions


@dataclass(frozen=True, eq=False)
class LabelFloor:
    """The least possible errors of a regressor on new TCPs, for each axis [m].

    The errors cannot be zero, because the candidates are random.
    """

    rmse_m: Vector  # (3,)
    mae_m: Vector  # (3,)
    redraws: int


def label_floor(settings: Settings, tcp_in_base: Vectors, *, seed: int, redraws: int = 1000) -> LabelFloor:
    """Return the least RMSE and the least MAE of any regressor against labels with random candidates.

        RMSE = sqrt(mean_TCP Var(label | TCP)),   MAE = mean_TCP E|label - median(label | TCP)|, by axis.

    A regressor knows the TCP but not the drawn candidates.  Its RMSE is least if it predicts the mean label
    of each TCP.  Its MAE is least if it predicts the median label.  The least RMSE is therefore the root of
    the mean variance, and the least MAE is the mean distance from the median.  In general, a single regressor
    cannot reach both.  These limits do not apply to TCPs of the training data, because a network may memorise
    their labels.

    The label is the candidate that is nearest to the desired position.  For upright views, this candidate
    also has the least image error.  The hand shifts a label by a known vector, so the result does not depend
    on the hand.  Each group of 32 TCPs uses the same random candidates.  This does not change the
    distribution of the labels of a single TCP.

    Args:
        settings: The settings of the cell.
        tcp_in_base: (n, 3) the TCPs.
        seed: The root of all random numbers.
        redraws: The number of random labels for each TCP.

    Raises:
        DatasetError: There is no TCP, or ``redraws`` is below 2.

    """
    if redraws < 2 or len(tcp_in_base) == 0:
        raise DatasetError(
            place=Place(field="redraws"),
            expected="at least 2 redraws for at least one TCP",
            got=f"{redraws} for {len(tcp_in_base)}",
        )
    cap = CandidateCap.from_settings(settings)
    wanted = np.array(settings.cell.desired_tcp_position_in_base_m) - tcp_in_base
    rng = stream(seed, Stream.REDRAWS)
    variances, deviations = np.empty_like(tcp_in_base), np.empty_like(tcp_in_base)
    for start in range(0, len(wanted), TCPS_A_REDRAW):
        group = slice(start, start + TCPS_A_REDRAW)
        labels = np.empty((len(wanted[group]), redraws, 3))
        _furthest_along(draw_many(cap, [rng] * redraws), wanted[group], labels)
        # The unbiased variance: the mean of the labels is estimated from the same labels.
        variances[group] = labels.var(axis=1, ddof=1)
        deviations[group] = np.abs(labels - np.median(labels, axis=1, keepdims=True)).mean(axis=1)
    return LabelFloor(np.sqrt(variances.mean(axis=0)), deviations.mean(axis=0), redraws)


@compiled
def _furthest_along(
    offsets: NDArray[np.float64],  # (sets, candidates, 3), all of one length
    wanted: NDArray[np.float64],  # (n, 3)
    best_out: NDArray[np.float64],  # (n, sets, 3)
) -> None:
    """For each vector w in ``wanted``, find the offset o with the largest o . w in each set.

    The function writes the offsets to ``best_out``.

    This is also the offset nearest to w, because |o - w|^2 = |o|^2 + |w|^2 - 2 o . w and all offsets have the
    same length.
    """
    sets, candidates, _ = offsets.shape
    for k in range(wanted.shape[0]):
        x, y, z = wanted[k, 0], wanted[k, 1], wanted[k, 2]
        for s in range(sets):
            best, furthest = 0, -np.inf
            for c in range(candidates):
                along = offsets[s, c, 0] * x + offsets[s, c, 1] * y + offsets[s, c, 2] * z
                if along > furthest:
                    best, furthest = c, along
            for i in range(3):
                best_out[k, s, i] = offsets[s, best, i]


HELD_OUT = 0.1  # the share for validation, and for testing


@dataclass(frozen=True, eq=False)
class Split:
    """The numbers of the samples in each part, as read-only arrays; every sample is in exactly one part."""

    kind: str
    train: Numbers
    validation: Numbers
    test: Numbers

    def __post_init__(self) -> None:
        for part in (self.train, self.validation, self.test):
            part.setflags(write=False)


def split_by_sample(dataset: CompactDataset, *, seed: int) -> Split:
    """Return a random split of the samples, as in the paper; the samples of a part are in random order.

    Args:
        dataset: The data set.
        seed: The root of all random numbers.

    Raises:
        DatasetError: There are fewer than 10 samples.

    """
    return Split("by sample", *_parts(len(dataset), "samples", seed, 0))


def split_by_tcp(dataset: CompactDataset, *, seed: int) -> Split:
    """Return a random split of the TCPs; all samples of a TCP are in the same part.

    Args:
        dataset: The data set.
        seed: The root of all random numbers.

    Raises:
        DatasetError: There are fewer than 10 TCPs.

    """
    train, validation, test = (
        (tcps[:, None] * dataset.hands + np.arange(dataset.hands)).ravel()
        for tcps in _parts(dataset.tcps, "TCPs", seed, 1)
    )
    return Split("by TCP", train, validation, test)


SPLITS = {"by TCP": split_by_tcp, "by sample": split_by_sample}


def _parts(count: int, unit: str, seed: int, kind: int) -> tuple[Numbers, Numbers, Numbers]:
    """Return a random permutation of 0 ... count - 1, cut into train, validation and test."""
    held_out = round(HELD_OUT * count)
    if count < 10:
        raise DatasetError(
            place=Place(field="split"),
            expected=f"at least 10 {unit} to split into 0.8, 0.1 and 0.1",
            got=f"{count} {unit}",
        )
    order = stream(seed, Stream.SPLIT, kind).permutation(count)
    train = count - 2 * held_out
    return order[:train], order[train : train + held_out], order[train + held_out :]
