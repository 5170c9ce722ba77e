"""Compute maps of the undecided and refuted parts of a region, as seen from above and from the side.

A map is a grid of cells in two coordinates of the hand or of the TCP.  A cell contains all inputs with these
two coordinates, for any values of the other four.  Each cell has a digit, which is the class of the undecided
or refuted fraction of the claimed volume in the cell.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from safety_harness.extensions.lab.proof.box_kernel import PROVEN, REFUTED, UNDECIDED
from safety_harness.extensions.lab.proof.certificate import Proof

Floats = NDArray[np.float64]
# Cells of a side; leaves at a time, whose overlaps with the cells take 16 MB for each axis.
CELLS, AT_ONCE = 20, 100_000
VIEWS = ((0, 1, "from above"), (0, 2, "from the side"))  # across, up
EDGES = (1e-9, 0.01, 0.1, 0.5)  # the least shares in the classes 1 to 4
NOTHING = "-"  # for a cell outside the claim


@dataclass(frozen=True, kw_only=True)
class BoxMap:
    """A map of the undecided or refuted part of a region.

    ``rows`` begins with the lowest row, and a row has a digit for each cell from left to right.  A digit is
    the class of the fraction that ``what`` specifies (undecided or refuted).  ``low_m`` and ``high_m`` are
    the lower left and the upper right corner of the map, in the base frame.
    """

    who: str
    seen: str
    axes: str
    what: str
    low_m: tuple[float, float]
    high_m: tuple[float, float]
    rows: tuple[str, ...]

    @property
    def classes(self) -> NDArray[np.int64]:
        """The class of each cell, or -1 for a cell that the claim does not concern, shape (CELLS, CELLS).

        The first index is horizontal, and the second index is vertical.
        """
        digits = [[-1 if digit == NOTHING else int(digit) for digit in row] for row in self.rows]
        return np.array(digits, np.int64).T


def maps_of(proof: Proof) -> Iterator[BoxMap]:
    """Yield eight maps: the undecided and refuted parts for hand and TCP, from above and from the side."""
    low, high = (side[0] for side in proof.planned.region.corners())
    for who, first in (("hand", 0), ("TCP", 3)):
        for across, upward, seen in VIEWS:
            axes = first + across, first + upward
            volumes = {code: _volumes(proof, code, axes) for code in (PROVEN, REFUTED, UNDECIDED)}
            whole = sum(volumes.values())
            for part, code in (("undecided", UNDECIDED), ("refuted", REFUTED)):
                shares = np.round(volumes[code] / np.where(whole > 0.0, whole, 1.0), 12)
                # Class 0 means none: a fraction below 1e-9 is a rounding error.
                classes = np.searchsorted(EDGES, shares, side="right")
                texts = np.where(whole > 0.0, classes.astype(str), NOTHING)
                yield BoxMap(
                    who=who,
                    seen=seen,
                    axes="xyz"[across] + "xyz"[upward],
                    what=part,
                    low_m=(float(low[axes[0]]), float(low[axes[1]])),
                    high_m=(float(high[axes[0]]), float(high[axes[1]])),
                    rows=tuple("".join(row) for row in texts.T),
                )


def _volumes(proof: Proof, code: int, axes: tuple[int, int]) -> Floats:
    """Return the volume of the leaves with ``code`` in each cell, shape (CELLS, CELLS).

    The volumes are relative to the volume of the region.
    """
    region = proof.planned.region
    whole, volumes = region.corners(), np.zeros((CELLS, CELLS))
    for level, (low, high) in enumerate(proof.tree.leaves(region, code)):
        for start in range(0, len(low), AT_ONCE):
            part = slice(start, start + AT_ONCE)
            first, second = (
                _overlaps(low[part, axis], high[part, axis], whole[0][0, axis], whole[1][0, axis])
                for axis in axes
            )
            volumes += 2.0**-level * (first.T @ second)
    return volumes


def _overlaps(low: Floats, high: Floats, start: float, end: float) -> Floats:
    """Return the fraction of each interval that lies in each cell, shape (n, CELLS).

    There are n intervals from ``low`` to ``high``.  The cells divide the range from ``start`` to ``end``.
    """
    edges = np.linspace(start, end, CELLS + 1)
    inside = np.minimum(high[:, None], edges[1:]) - np.maximum(low[:, None], edges[:-1])
    shares: Floats = np.maximum(inside, 0.0) / (high - low)[:, None]
    return shares
