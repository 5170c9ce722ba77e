"""Halve a region until its parts are decided, and store the parts as a tree with a code for each node.

If the code of a node is from 0 to 5, the node is halved along the axis with this number. Axes 0 to 2 are the
axes of the hand, and axes 3 to 5 are the axes of the TCP. A node with a larger code is a leaf, and
``box_kernel`` defines these codes. The next level consists of the two halves of each halved node, beginning
with the lower half. The leaves therefore always fill the region. The volume of a leaf at level k is 2^-k
times the volume of the region. A later session can continue at the undecided leaves.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from functools import partial
from itertools import islice
from typing import Any

import numpy as np
from numpy.typing import NDArray

from safety_harness.extensions.lab.proof.box_kernel import OUTSIDE, PROVEN, REFUTED, UNDECIDED, examine
from safety_harness.extensions.lab.proof.claims import DecisionClaim, optimum_constants
from safety_harness.extensions.lab.proof.network import ReluNetwork
from safety_harness.extensions.lab.proof.plan import ProofRegion

Floats = NDArray[np.float64]
Codes = NDArray[np.uint8]
Boxes = tuple[Floats, Floats]  # low and high corners (n, 6)

AT_ONCE = 8_192  # boxes in a batch, which takes some 50 ms
MOST_BOXES = 1_500_000  # on a level, where they take 0.15 GB
LEAVES = {PROVEN: "proven", REFUTED: "refuted", UNDECIDED: "undecided", OUTSIDE: "outside"}


@dataclass
class BoxTree:
    """The codes of a tree, level by level; a new tree is a single undecided leaf."""

    levels: list[Codes] = field(default_factory=lambda: [np.array([UNDECIDED], np.uint8)])

    def shares(self) -> dict[str, float]:
        """Return the exact fractions of the region that are proven, refuted, undecided and outside."""
        return {
            name: sum(float((codes == code).sum()) * 2.0**-k for k, codes in enumerate(self.levels))
            for code, name in LEAVES.items()
        }

    def leaves(self, region: ProofRegion, code: int) -> Iterator[Boxes]:
        """Yield the boxes of the leaves with ``code`` in ``region``, level by level, beginning at the top."""
        low, high = region.corners()
        for codes in self.levels:
            yield low[codes == code], high[codes == code]
            low, high = halves(low, high, codes)


def halves(low: Floats, high: Floats, codes: Codes) -> Boxes:
    """Return the two halves of each box that ``codes`` halves.

    If ``codes`` halves m of n boxes, the corners of the halves have the shape (2 m, 6).

    Args:
        low: (n, 6) the low corners.
        high: (n, 6) the high corners.
        codes: (n,) the codes.

    """
    rows = np.flatnonzero(codes < PROVEN)
    axes = codes[rows]
    lows, highs = np.repeat(low[rows], 2, axis=0), np.repeat(high[rows], 2, axis=0)
    middle = (low[rows, axes] + high[rows, axes]) / 2.0
    first = 2 * np.arange(len(rows))
    highs[first, axes] = middle
    lows[first + 1, axes] = middle
    return lows, highs


MapBatches = Callable[[Callable[[Boxes], Codes], Iterable[Boxes]], Iterable[Codes]]


def examined(
    network: ReluNetwork,
    constants: Floats,
    claim: DecisionClaim,
    region: ProofRegion,
    boxes: Boxes,
    doubt_m: float = np.nan,
) -> Codes:
    """Decide n boxes, and return a code for each of them, shape (n,).

    It is not a nested function, so that other processes can call it.

    Args:
        network: The network.
        constants: (10,) the result of ``optimum_constants``.
        claim: The claim.
        region: The region.
        boxes: The corners of the boxes.
        doubt_m: The network's threshold of the spread; NaN means no threshold.

    """
    return examined_with_spreads(network, constants, claim, region, boxes, doubt_m)[0]


def examined_with_spreads(
    network: ReluNetwork,
    constants: Floats,
    claim: DecisionClaim,
    region: ProofRegion,
    boxes: Boxes,
    doubt_m: float = np.nan,
) -> tuple[Codes, Floats]:
    """Decide n boxes, and return a code for each box, shape (n,), and bounds of its spread, shape (n, 2) [m].

    ``constants`` has the shape (10,), and all arguments are the same as in ``examined``.
    """
    codes, spreads_m = np.empty(len(boxes[0]), np.uint8), np.empty((len(boxes[0]), 2))
    near_m, far_m = region.apart_m
    examine(
        network, constants, int(claim.kind), claim.limit_m, doubt_m, near_m, far_m, *boxes, codes, spreads_m
    )
    return codes, spreads_m


def work(
    tree: BoxTree,
    network: ReluNetwork,
    claim: DecisionClaim,
    region: ProofRegion,
    *,
    halvings: int,
    until_s: float,
    doubt_m: float = np.nan,
    map_batches: MapBatches = map,
    at_once: int = 1,
    on_level: Callable[[BoxTree], Any] = lambda tree: None,
    stopped: Callable[[], bool] = lambda: False,
) -> None:
    """Decide or halve the undecided leaves of ``tree``, beginning with the largest.

    The function ends early at the time ``until_s``, or when ``stopped`` returns True.  The tree is valid at
    any time.

    Args:
        tree: The tree, changed in place.
        network: The network.
        claim: The claim.
        region: The region.
        halvings: The largest number of times to halve a box, that is, the greatest depth of the tree.
        until_s: The time at which to end, on the clock of ``time.monotonic``.
        doubt_m: The network's threshold of the spread; NaN means no threshold.
        map_batches: A replacement of ``map``, which may process the batches of boxes in other processes.
        at_once: The number of batches to map at a time, which has no effect on the result.
        on_level: A function that receives the tree after each level.
        stopped: A function that returns True if the work must end.

    """
    judge = partial(examined, network, optimum_constants(), claim, region, doubt_m=doubt_m)
    low, high = region.corners()
    level = 0
    while level < len(tree.levels):
        codes = tree.levels[level]
        waiting = np.flatnonzero(codes == UNDECIDED)
        old_codes = codes.copy()
        # On the last level no box is halved, so the other leaves remain undecided for a later session.
        last = level >= halvings or 2 * len(waiting) > MOST_BOXES
        batches = ((low[part], high[part]) for part in _parts(waiting))
        rows = _parts(waiting)
        # Check the time between groups only, so that the codes of a batch are complete.
        while (group := list(islice(rows, at_once))) and not stopped() and time.monotonic() < until_s:
            for part, judged in zip(group, map_batches(judge, list(islice(batches, at_once))), strict=True):
                codes[part] = np.where(judged < PROVEN, UNDECIDED, judged) if last else judged
        low, high = halves(low, high, codes)
        _put_next(tree, level, old_codes, len(low))
        on_level(tree)
        level += 1


def _parts(rows: NDArray[np.int64]) -> Iterator[NDArray[np.int64]]:
    """Yield batches of at most ``AT_ONCE`` elements of ``rows``."""
    return (rows[start : start + AT_ONCE] for start in range(0, len(rows), AT_ONCE))


def _put_next(tree: BoxTree, level: int, old_codes: Codes, count: int) -> None:
    """Adjust the level after ``level``, so that it has ``count`` nodes.

    Existing nodes keep their codes, and new nodes are undecided.  ``old_codes`` contains the previous codes
    of ``level``, shape (n,).
    """
    halved = tree.levels[level] < PROVEN
    fresh = np.full(count, UNDECIDED, np.uint8)
    old = np.repeat(old_codes[halved] < PROVEN, 2)
    if level + 1 < len(tree.levels):
        fresh[old] = tree.levels[level + 1]
        tree.levels[level + 1] = fresh
    elif count:
        tree.levels.append(fresh)
