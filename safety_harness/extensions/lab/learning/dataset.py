"""The data set of eq. 13 (section 4.1 of the paper), in a compact form.

10,000 TCPs times 500 hands make 5,000,000 samples.  The selected candidate depends only on the TCP, and the
hand only shifts the target.  So 10,000 selections and 500 hands determine every sample.  Sample k joins TCP
k // hands with hand k mod hands, and the program computes its row on demand.

TCPs and hands lie in the seen space or in one of three unseen spaces (Table 3).  ``space.regions`` defines
these regions and gives the reasons.

Training, validation and test contain 0.8, 0.1 and 0.1 of the samples.  The paper splits the samples at
random.  Then every TCP, with the noise of its label, occurs in all three parts, so a network may remember
labels of the test.  A split by TCP has no such leak.  In both splits, all parts have the same hands, which
only shift the target in a known way.
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
    """The region of the TCPs in a data set and, independent of it, the region of the hands."""

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
    """Return the space of training: TCPs about the desired position, and hands about the nominal position."""
    return space_named("seen", settings)


Index = NDArray[np.integer]
Numbers = NDArray[np.int64]

VIEWS_AT_A_TIME = 100_000  # bounds the memory; the result does not depend on it
TCPS_A_REDRAW = 32
MOST = {"tcps": 10_000_000, "candidates": 100_000, "hands": 10_000_000}


class Stream(IntEnum):
    """The random streams below a data set's seed; never reuse a number, because it is part of the format."""

    TCPS = 1
    HANDS = 2
    CANDIDATES = 3  # a stream for each TCP: its candidates depend only on the seed and the TCP's number
    SPLIT = 4
    REDRAWS = 5


def stream(seed: int, name: Stream, *path: int) -> np.random.Generator:
    """Return a fresh generator for a stream below ``seed``.

    Args:
        seed: The root.
        name: The stream.
        path: Further numbers below the stream.

    """
    return np.random.Generator(np.random.PCG64(np.random.SeedSequence(seed, spawn_key=(name, *path))))


@dataclass(frozen=True, eq=False)
class CompactDataset:
    """TCPs with their selected candidates, and hands: read-only positions in the base frame [m].

    ``selected_in_base`` is t_opt of eq. 13, the candidate with the least image error.  ``optimum_in_base`` is
    the point of the whole cap that is nearest to the desired position; it has no noise.
    ``candidates_in_view`` counts the candidates of each TCP that see the whole object.  ``arm`` is the name
    of the cell's arm.
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
        """The number of candidates, over all TCPs, that do not see the whole object."""
        return self.tcps * self.candidates - int(self.candidates_in_view.sum())

    @property
    def tcps_without_view(self) -> int:
        """The number of TCPs without any candidate that sees the whole object."""
        return int(np.count_nonzero(self.candidates_in_view == 0))

    def without_noise(self) -> CompactDataset:
        """Return the same samples with the optimum as t_opt, so that a network learns exact labels."""
        return replace(self, selected_in_base=self.optimum_in_base)

    def inputs(self, index: Index) -> Vectors:
        """Return the inputs (len, 6), hand and then TCP, of the samples numbered ``index``."""
        tcp, hand = self._pairs(index)
        return np.concatenate([self.hand_in_base[hand], self.tcp_in_base[tcp]], axis=1)

    def targets(self, index: Index) -> Vectors:
        """Return gt = 0.05 (t_tcp - t_h) + t_opt (eq. 13), (len, 3), of the samples numbered ``index``."""
        tcp, hand = self._pairs(index)
        pull = self.settings.avoidance.hand_pull
        by_tcp: Vectors = self.selected_in_base + pull * self.tcp_in_base
        rows: Vectors = by_tcp[tcp] - pull * self.hand_in_base[hand]
        return rows

    def _pairs(self, index: Index) -> tuple[Index, Index]:
        """Return the number of TCP and hand for each sample; raise IndexError for a number out of range."""
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
    """Draw TCPs, candidates and hands, and select each TCP's candidate by the least |f - f*|^2 (eq. 15).

    The features f come from the exact image.  A candidate that does not see the whole object is selected only
    if no candidate of its TCP sees it.  In that case ``candidates_in_view`` is 0.  The exact image has no
    border, so its moments are defined even then.

    Args:
        settings: The settings of the cell.
        space: The space of the TCPs and hands.
        seed: The root of all random numbers.
        tcps: The number of TCPs.
        candidates: The number of candidates for each TCP.
        hands: The number of hands.
        arm: The arm's name.
        on_progress: Receives the number of finished TCPs.

    Returns:
        The data set.

    Raises:
        DatasetError: A number is out of range, or all candidates of a TCP lack an image of the object.

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
    """Return a new data set, and the numbers of ``samples`` rows that share no TCP and no hand.

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
    """Return the 64-bit seed at ``path`` below ``seed``, for a consumer with its own generators."""
    return int(np.random.SeedSequence(seed, spawn_key=path).generate_state(1, np.uint64)[0])


def candidates_of(settings: Settings, tcp_in_base: Vectors, seed: int, numbers: Index) -> Vectors:
    """Return the candidate positions (k, candidates, 3) [m] of k TCPs: each TCP plus random offsets.

    Args:
        settings: The settings of the cell.
        tcp_in_base: (n, 3) all TCPs.
        seed: The seed of the data set.
        numbers: (k,) the numbers of the TCPs.

    """
    generators = [stream(seed, Stream.CANDIDATES, int(number)) for number in numbers]
    positions: Vectors = draw_many(CandidateCap.from_settings(settings), generators)
    positions += tcp_in_base[numbers, None]
    return positions


@dataclass(frozen=True, eq=False)
class LabelFloor:
    """The least error by axis [m] that any regressor has on new TCPs, because the candidates are random."""

    rmse_m: Vector  # (3,)
    mae_m: Vector  # (3,)
    redraws: int


def label_floor(settings: Settings, tcp_in_base: Vectors, *, seed: int, redraws: int = 1000) -> LabelFloor:
    """Return the least RMSE and MAE of any regressor against labels that are selected from fresh candidates.

        RMSE = sqrt(mean_TCP Var(label | TCP)),   MAE = mean_TCP E|label - median(label | TCP)|, by axis.

    A regressor knows the TCP but not the drawn candidates.  Its RMSE is least if it predicts the mean label
    of each TCP.  Its MAE is least if it predicts the median label.  So the floor of the RMSE is the root of
    the mean variance.  The floor of the MAE is the mean distance from the median.  One regressor does not
    reach both floors.  A TCP from the training cannot test them, because the network may remember its label.

    Each label is the candidate nearest to the desired position, which has the least image error for upright
    views.  The hand shifts a label by a known vector, so the floors do not depend on the hand.  Groups of 32
    TCPs share the redrawn candidates, which does not change the distribution of each TCP's labels.

    Args:
        settings: The settings of the cell.
        tcp_in_base: (n, 3) the TCPs.
        seed: The root of all random numbers.
        redraws: The number of labels for each TCP.

    Raises:
        DatasetError: There is no TCP, or fewer than 2 redraws.

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
        variances[group] = labels.var(axis=1, ddof=1)
        deviations[group] = np.abs(labels - np.median(labels, axis=1, keepdims=True)).mean(axis=1)
    return LabelFloor(np.sqrt(variances.mean(axis=0)), deviations.mean(axis=0), redraws)


@compiled
def _furthest_along(
    offsets: NDArray[np.float64],  # (sets, candidates, 3), all of one length
    wanted: NDArray[np.float64],  # (n, 3)
    best_out: NDArray[np.float64],  # (n, sets, 3)
) -> None:
    """Fill ``best_out`` with the offset o of each set that leads furthest along each vector w of ``wanted``.

    All o have the same length, and |o - w|^2 = |o|^2 + |w|^2 - 2 o . w.  So the same o also ends nearest to
    the end of w.
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
    """The numbers of the samples in each part, read-only; every sample is in exactly one part."""

    kind: str
    train: Numbers
    validation: Numbers
    test: Numbers

    def __post_init__(self) -> None:
        for part in (self.train, self.validation, self.test):
            part.setflags(write=False)


def split_by_sample(dataset: CompactDataset, *, seed: int) -> Split:
    """Return the paper's split of the samples at random; each part is in random order.

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
