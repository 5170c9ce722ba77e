"""A region that is halved until its parts are decided: one code for each node, level by level.

A node is halved along an axis (codes 0 to 5: hand, then TCP), or it is a leaf (codes of ``box_kernel``).  The
next level consists of the two halves of each halved node, the lower half first.  So the leaves always fill
the region.  A leaf at level k has the share 2^-k of the region.  Work can continue at an undecided leaf at
any time.
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
    """The codes of each level; a fresh tree is one undecided leaf."""

    levels: list[Codes] = field(default_factory=lambda: [np.array([UNDECIDED], np.uint8)])

    def shares(self) -> dict[str, float]:
        """Return the exact shares of the region: proven, refuted, undecided, and outside of the claim."""
        return {
            name: sum(float((codes == code).sum()) * 2.0**-k for k, codes in enumerate(self.levels))
            for code, name in LEAVES.items()
        }

    def leaves(self, region: ProofRegion, code: int) -> Iterator[Boxes]:
        """Yield the boxes of the leaves with ``code`` in ``region``, level by level, largest first."""
        low, high = region.corners()
        for codes in self.levels:
            yield low[codes == code], high[codes == code]
            low, high = halves(low, high, codes)


def halves(low: Floats, high: Floats, codes: Codes) -> Boxes:
    """Return the halves (2 m, 6) of the m boxes that ``codes`` halves, of n from ``low`` to ``high`` (n, 6).

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
    """Return the codes (n,) of boxes, with the ``constants`` (10,) of the optimum.

    The function belongs to the module, so that other processes can call it.

    Args:
        network: The network.
        constants: The result of ``optimum_constants``.
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
    """Return the codes (n,) of boxes and bounds (n, 2) of the spread [m]; ``constants`` has the shape (10,).

    The arguments are the same as in ``examined``.
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
    """Decide or halve the undecided leaves of ``tree``, the largest first, down to ``halvings`` halvings.

    The work ends early at ``until_s``, or when ``stopped`` returns True; the tree is complete at any time.

    Args:
        tree: The tree, changed in place.
        network: The network.
        claim: The claim.
        region: The region.
        halvings: The greatest depth of the tree.
        until_s: The time at which to end, by ``time.monotonic``.
        doubt_m: The network's threshold of the spread; NaN means no threshold.
        map_batches: Maps a function over batches of boxes, for example in other processes.
        at_once: The number of batches to map at a time; the result does not depend on it.
        on_level: Receives the tree after each level.
        stopped: Ends the work when it returns True.

    """
    judge = partial(examined, network, optimum_constants(), claim, region, doubt_m=doubt_m)
    low, high = region.corners()
    level = 0
    while level < len(tree.levels):
        codes = tree.levels[level]
        waiting = np.flatnonzero(codes == UNDECIDED)
        old_codes = codes.copy()
        last = level >= halvings or 2 * len(waiting) > MOST_BOXES
        batches = ((low[part], high[part]) for part in _parts(waiting))
        rows = _parts(waiting)
        while (group := list(islice(rows, at_once))) and not stopped() and time.monotonic() < until_s:
            for part, judged in zip(group, map_batches(judge, list(islice(batches, at_once))), strict=True):
                codes[part] = np.where(judged < PROVEN, UNDECIDED, judged) if last else judged
        low, high = halves(low, high, codes)
        _put_next(tree, level, old_codes, len(low))
        on_level(tree)
        level += 1


def _parts(rows: NDArray[np.int64]) -> Iterator[NDArray[np.int64]]:
    """Return ``rows`` in batches of ``AT_ONCE``."""
    return (rows[start : start + AT_ONCE] for start in range(0, len(rows), AT_ONCE))


def _put_next(tree: BoxTree, level: int, old_codes: Codes, count: int) -> None:
    """Give ``count`` nodes to the level after ``level``, which had ``old_codes`` (n,); undecided if new."""
    halved = tree.levels[level] < PROVEN
    fresh = np.full(count, UNDECIDED, np.uint8)
    old = np.repeat(old_codes[halved] < PROVEN, 2)
    if level + 1 < len(tree.levels):
        fresh[old] = tree.levels[level + 1]
        tree.levels[level + 1] = fresh
    elif count:
        tree.levels.append(fresh)
