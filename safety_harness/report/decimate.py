"""Fewer points to draw, without losing an extreme."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


def ticks_per_column(count: int, columns: int) -> int:
    """How many consecutive ticks share one of ``columns`` columns (1: every tick is drawn)."""
    return 1 if count <= 2 * columns else -(-count // columns)


def keep_extremes(time_s: Floats, values: Floats, columns: int) -> tuple[Floats, Floats]:
    """The smallest and the largest value of every column, at their own times and in order.

    ``time_s`` and ``values`` are (n,); at most 2 ``columns`` points come back, and every tick when
    there are no more than that.  What is not finite is a gap: a column without any finite value
    becomes one NaN, so that the line breaks there.  The first and last finite samples are kept.
    """
    values = np.where(np.isfinite(values), values, np.nan)
    count = len(values)
    width = ticks_per_column(count, columns)
    if width == 1:
        return time_s, values
    rows = -(-count // width)
    padded = np.full(rows * width, np.nan)
    padded[:count] = values
    table = padded.reshape(rows, width)
    empty = np.isnan(table).all(axis=1)
    starts = np.arange(rows) * width
    least = starts + np.argmin(np.where(np.isnan(table), np.inf, table), axis=1)
    most = starts + np.argmax(np.where(np.isnan(table), -np.inf, table), axis=1)
    least[empty] = most[empty] = starts[empty]
    ends = np.flatnonzero(np.isfinite(values))[[0, -1]] if not empty.all() else np.empty(0, dtype=np.int64)
    keep = np.unique(np.concatenate([least, most, ends]))
    return time_s[keep], values[keep]


def spans(time_s: Floats, mask: NDArray[np.bool_], end_s: float, columns: int) -> list[tuple[float, float]]:
    """Stretches (start, length) [s] in which ``mask`` (n,) is true, each tick lasting to the next.

    Gaps shorter than one of ``columns`` columns are closed, so that a mode which flickers costs no
    more ink than one can see; nothing that is true is ever left out.
    """
    if not mask.any():
        return []
    ends = np.append(time_s[1:], max(end_s, time_s[-1]))
    shortest_s = (ends[-1] - time_s[0]) / columns
    found: list[tuple[float, float]] = []
    for index in np.flatnonzero(mask):
        start, end = float(time_s[index]), float(ends[index])
        if found and start - (found[-1][0] + found[-1][1]) < shortest_s:
            found[-1] = (found[-1][0], end - found[-1][0])
        else:
            found.append((start, end - start))
    return found
