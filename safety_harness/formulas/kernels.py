"""Least margins over the future: (n,) arrays in, (n,) arrays out, in one pass each.

What comes after the last sample of a window that runs on is ``beyond``: -inf for a lower bound of a
margin, +inf for an upper one.  No array may hold a NaN.  The largest margin is minus the least of
the negated ones.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from safety_harness.compiled import compiled


@compiled
def least_from_here(x: NDArray[np.float64]) -> NDArray[np.float64]:
    """out[k] = min of x[k:]."""
    out = np.empty(x.shape[0])
    least = np.inf
    for k in range(x.shape[0] - 1, -1, -1):
        least = min(least, x[k])
        out[k] = least
    return out


@compiled
def least_in_window(x: NDArray[np.float64], begin: int, end: int, beyond: float) -> NDArray[np.float64]:
    """out[k] = min of x[k + begin] to x[k + end], ends included, with ``beyond`` where they leave x.

    0 <= begin <= end.  A queue keeps the positions at which a smaller value than all before it
    stands, seen from the window's begin: each is put in and taken out once.
    """
    n = x.shape[0]
    out = np.empty(n)
    queue = np.empty(n, np.int64)
    first, last = 0, 0  # the queue is queue[first:last], its values falling from last to first
    for k in range(n - 1, -1, -1):
        entering = k + begin
        if entering < n:
            value = x[entering]
            while last > first and x[queue[last - 1]] >= value:
                last -= 1
            queue[last] = entering
            last += 1
            while queue[first] > k + end:
                first += 1
        least = x[queue[first]] if last > first else np.inf
        out[k] = min(least, beyond) if k + end >= n else least
    return out


@compiled
def until_from_here(
    lasts: NDArray[np.float64], ends: NDArray[np.float64], beyond: float
) -> NDArray[np.float64]:
    """out[k] = max over j >= k of min(ends[j], min of lasts[k:j]); ``beyond`` follows the last sample."""
    n = lasts.shape[0]
    out = np.empty(n)
    after = beyond
    for k in range(n - 1, -1, -1):
        after = max(ends[k], min(lasts[k], after))
        out[k] = after
    return out
