"""Where two segments are nearest to each other."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from safety_harness.compiled import compiled


@compiled
def nearest_shares(
    a_start: NDArray[np.float64],
    a_end: NDArray[np.float64],
    b_start: NDArray[np.float64],
    b_end: NDArray[np.float64],
) -> tuple[float, float]:
    """How far along each of two segments, 0 to 1, its point lies that is nearest to the other.

    Ends (3,); a segment may be a point, whose share is 0.  The four ends are tried beside the two
    inner points whose joining line is perpendicular to both, so that nearly parallel segments are
    no danger; of several nearest pairs one is given.  (NaN, NaN) if anything read is NaN.
    """
    ux, uy, uz = a_end[0] - a_start[0], a_end[1] - a_start[1], a_end[2] - a_start[2]
    vx, vy, vz = b_end[0] - b_start[0], b_end[1] - b_start[1], b_end[2] - b_start[2]
    wx, wy, wz = b_start[0] - a_start[0], b_start[1] - a_start[1], b_start[2] - a_start[2]
    uu = ux * ux + uy * uy + uz * uz
    vv = vx * vx + vy * vy + vz * vz
    uv = ux * vx + uy * vy + uz * vz
    uw = ux * wx + uy * wy + uz * wz
    vw = vx * wx + vy * wy + vz * wz
    if np.isnan(uu + vv + uw + vw):
        return np.nan, np.nan
    nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
    nn = nx * nx + ny * ny + nz * nz
    best, s_best, t_best = np.inf, 0.0, 0.0
    for candidate in range(5):
        s = t = 0.0
        if candidate < 2:  # an end of a against b
            s = float(candidate)
            t = min(max((s * uv - vw) / vv, 0.0), 1.0) if vv > 0.0 else 0.0
        elif candidate < 4:  # an end of b against a
            t = float(candidate - 2)
            s = min(max((uw + t * uv) / uu, 0.0), 1.0) if uu > 0.0 else 0.0
        else:
            if not nn > 0.0:
                break
            s = ((wy * vz - wz * vy) * nx + (wz * vx - wx * vz) * ny + (wx * vy - wy * vx) * nz) / nn
            t = ((wy * uz - wz * uy) * nx + (wz * ux - wx * uz) * ny + (wx * uy - wy * ux) * nz) / nn
            if not (0.0 < s < 1.0 and 0.0 < t < 1.0):
                break
        x, y, z = wx + t * vx - s * ux, wy + t * vy - s * uy, wz + t * vz - s * uz
        squared = x * x + y * y + z * z
        if squared < best:
            best, s_best, t_best = squared, s, t
    return s_best, t_best
