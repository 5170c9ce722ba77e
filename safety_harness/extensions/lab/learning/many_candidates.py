"""Draw the candidates of many TCPs at once, for data sets."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from safety_harness.base.compiled import compiled
from safety_harness.cell.avoidance.candidates import CandidateCap


def draw_many(cap: CandidateCap, generators: Sequence[np.random.Generator]) -> NDArray[np.float64]:
    """Return the same offsets as ``cap.draw``, except for rounding, shape (n, count, 3) [m].

    This function is much faster than ``cap.draw``.

    Args:
        cap: The cap of the candidates.
        generators: A random generator for each of n sets.  If a generator occurs repeatedly, it draws its
            sets one after another.

    """
    frame = cap.frame()
    offsets = np.empty((len(generators), cap.count, 3))
    angles = np.empty((len(generators), 2, 2 * cap.count))
    for k, rng in enumerate(generators):
        rng.standard_normal(out=angles[k])
    kept = np.zeros(len(generators), np.int64)
    while True:
        _keep(cap.sigma_rad * angles, frame, np.cos(cap.cone_rad), cap.radius_m, offsets, kept)
        # Only a set with too few directions draws again, so that each generator draws as many numbers as in
        # ``cap.draw``.
        short = np.flatnonzero(kept < cap.count)
        if not len(short):
            return offsets
        for row in short.tolist():
            generators[row].standard_normal(out=angles[row])


@compiled
def _keep(
    angles_rad: NDArray[np.float64],  # (n, 2, m): azimuths, elevations
    frame: NDArray[np.float64],  # (3, 3) rows: axis, side, up
    least_cosine: float,
    radius_m: float,
    offsets_out: NDArray[np.float64],  # (n, count, 3)
    kept: NDArray[np.int64],  # (n,) the counts so far, updated
) -> None:
    """Append offsets to every set that has fewer than ``count`` offsets.

    The function uses only directions within the cone.
    """
    sets, _, proposals = angles_rad.shape
    count = offsets_out.shape[1]
    for k in range(sets):
        for i in range(proposals):
            if kept[k] == count:
                break
            cos_elevation = np.cos(angles_rad[k, 1, i])
            along = cos_elevation * np.cos(angles_rad[k, 0, i])
            if along >= least_cosine:
                aside = cos_elevation * np.sin(angles_rad[k, 0, i])
                upward = np.sin(angles_rad[k, 1, i])
                for j in range(3):
                    offsets_out[k, kept[k], j] = radius_m * (
                        along * frame[0, j] + aside * frame[1, j] + upward * frame[2, j]
                    )
                kept[k] += 1
