"""Compute bounds on the distance of a body or joint from the straight line between two samples.

The page docs/explanation/verdicts.md derives these bounds. The functions process the samples of one body or
of the arm's joints. The times of the samples are on the clock of the trace. The bound at a tick applies from
the previous tick to the next tick.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from safety_harness.claims.properties.base import runs_of
from safety_harness.trace.known import Gap

Floats = NDArray[np.float64]
FloatOrFloats = TypeVar("FloatOrFloats", float, Floats)
ROUNDING_M = 1e-5  # the rounding of stored paths, whose units are micrometres and nanoseconds


@dataclass(frozen=True, eq=False)
class Reach:
    """The bound ``within`` (n,) at each tick.

    A bound applies from the previous tick to the next tick. In the ``gaps`` the bound is unknown, and
    ``within`` is 0.
    """

    within: Floats
    gaps: tuple[tuple[int, int], ...]

    def known_gaps(self, hand: int | None = None) -> tuple[Gap, ...]:
        """Return the gaps in the form that a trace uses.

        The gaps concern the hand with index ``hand``, or all hands if ``hand`` is None.
        """
        return tuple(Gap(first=first, after=end, hand=hand) for first, end in self.gaps)


def body_off_m(way_m: Floats, step_s: Floats, *, most_mps: float, sample_m: Floats | float) -> Floats:
    """Return the largest possible distance of a body from each line between two samples, shape (m,).

    For each pair of successive samples, ``way_m`` (m,) is the distance, and ``step_s`` (m,) is the time
    between them.

    Let x and y be the true places at two samples, T the time between them, and v the largest speed, so |x -
    y| <= v T. After the fraction w of T, the body is within v w T of x and within v (1 - w) T of y. So the
    body's distance from the point at w on the line from x to y is at most (w (1 - w) (v^2 T^2 - |x -
    y|^2))^(1/2). This is largest for w = 1/2. A sample has an error of at most ``sample_m`` (m,). So the line
    from x to y deviates by at most this error from the line between the samples, and |x - y| is at least
    ``way_m`` - 2 ``sample_m``.
    """
    true_m = np.maximum(way_m - 2.0 * sample_m, 0.0)
    slack2 = np.maximum((most_mps * step_s) ** 2 - true_m**2, 0.0)
    return np.asarray(0.5 * np.sqrt(slack2) + sample_m)


def joint_off_rad(
    slope: Floats, step_s: Floats | float, *, most: Floats, hardest: float | None, sample_rad: float
) -> Floats:
    """Return the largest possible deviation of any joint from the line between two samples, shape (m,).

    Let s be the mean speeds ``slope`` (m, j), T the times ``step_s`` (m,), and v the largest speeds ``most``
    (j,).

    If a = ``hardest`` bounds the acceleration, the distance is at most a T^2/8. Otherwise it is at most T
    (v^2 - s^2)/(2 v), which is reached if the joint turns at full speed in one direction and then back. The
    function adds the error of a sample, ``sample_rad``, to the bound.
    """
    if hardest is not None:
        return np.asarray(hardest * step_s**2 / 8.0 + sample_rad)
    even, step_s = np.minimum(np.abs(slope), most), np.asarray(step_s)
    return np.asarray((step_s[:, None] * (most**2 - even**2) / (2.0 * most)).max(axis=1) + sample_rad)


def rate_off(
    slope: Floats, step_s: Floats | float, *, most: Floats, hardest: float | None, sample: float
) -> Floats:
    """Return by how much a joint's speed may differ from its mean between samples, shape (m,).

    The result is the largest value of all joints. Let s be the mean speeds ``slope`` (m, j), T the times
    ``step_s`` (m,), and v the largest speeds ``most`` (j,).

    If a = ``hardest`` bounds the acceleration, the difference is at most a T/2; it is largest if the speed
    changes uniformly. Otherwise it is at most |s| + v. Each sample may be off by ``sample``, which adds 2
    ``sample`` / T.
    """
    off_by = 2.0 * sample / step_s
    if hardest is not None:
        return np.asarray(off_by + hardest * step_s / 2.0)
    return np.asarray(np.maximum(off_by, 0.0) + (np.abs(slope) + most).max(axis=1))


def over_ticks(
    time_ns: NDArray[np.int64],
    off_by: Floats,
    *,
    longest_ns: int,
    period_ns: int,
    count: int,
    frozen: NDArray[np.bool_] | None = None,
) -> Reach:
    """Convert bounds for the intervals between samples to bounds at ticks.

    The bound at a tick is the largest bound of all intervals that overlap the period before or after it. An
    interval is lost, that is, without a bound, if it is longer than ``longest_ns`` or ends at a ``frozen``
    sample. The ticks within a lost interval are lost, because the motion from a lost tick to the next one is
    unknown too. If a lost interval contains no tick, the tick before the interval is lost. A tick is also
    lost if it coincides with a sample between two lost intervals.

    Args:
        time_ns: The times (m + 1,) of the samples since tick 0.
        off_by: The bounds (m,) for the intervals between samples.
        longest_ns: The longest allowed gap.
        period_ns: The period of the ticks.
        count: The number of ticks.
        frozen: (m + 1,) true for each sample that is frozen and repeats the previous sample. None if there is
            no such sample.

    """
    reached, bounded, lost = np.zeros(count), np.zeros(count, np.bool_), np.zeros(count, np.bool_)
    begin, end = time_ns[:-1], time_ns[1:]
    known = end - begin <= longest_ns
    if frozen is not None:
        known &= ~frozen[1:]
    first = np.maximum(begin // period_ns, 0)  # the tick at or before its beginning
    last = np.minimum(-(-end // period_ns), count - 1)  # and at or after its end
    # Most intervals overlap few ticks, so a loop over the ticks of an interval handles all intervals at once.
    spread = last - first
    for step in range(int(spread[known].max(initial=-1)) + 1):
        some = known & (spread >= step)
        np.maximum.at(reached, first[some] + step, off_by[some])
        bounded[first[some] + step] = True
    last_before, first_after = begin[~known] // period_ns, -(-end[~known] // period_ns)
    for left, right in zip(last_before.tolist(), first_after.tolist(), strict=True):
        lost[max(left + (right - left > 1), 0) : max(right, 0)] = True
    # A tick that coincides with a sample is known from the sample, unless both intervals beside it are lost.
    ends, rest = np.divmod(np.concatenate([begin[~known], end[~known]]), period_ns)
    ends = ends[(rest == 0) & (ends >= 0) & (ends < count)]
    lost[ends[~bounded[ends]]] = True
    reached[lost] = 0.0
    return Reach(reached, tuple((int(a), int(b)) for a, b in zip(*runs_of(lost), strict=True)))


def known_beyond_ns(longest_ns: int) -> int:
    """Return how long a body's position is known before its first sample and after its last sample."""
    return longest_ns // 2


def beyond_end(away_ns: FloatOrFloats, *, most: float, sample: float, period_ns: int) -> FloatOrFloats:
    """Return the largest possible distance of a body from its first or last sample.

    ``away_ns`` is the time between this sample and the tick. The bound also covers one more ``period_ns``,
    because it must apply up to the next tick.
    """
    return most * (away_ns + period_ns) / 1e9 + sample


def from_ends(
    reach: Reach, first_ns: int, last_ns: int, *, most: float, sample: float, longest_ns: int, period_ns: int
) -> Reach:
    """Return ``reach`` extended beyond the first and the last sample, by half the longest gap on each side.

    Ticks farther away become gaps.
    """
    count, reached, gaps = len(reach.within), reach.within.copy(), list(reach.gaps)
    ticks = np.arange(count) * period_ns
    away_ns = np.maximum(first_ns - ticks, ticks - last_ns)
    outside = away_ns > 0
    too_far = away_ns > known_beyond_ns(longest_ns)
    reachable = beyond_end(away_ns.astype(np.float64), most=most, sample=sample, period_ns=period_ns)
    in_time = (away_ns > -period_ns) & ~too_far
    reached = np.where(in_time, np.maximum(reached, reachable), reached)
    for side in (outside & (ticks < first_ns) & too_far, outside & (ticks > last_ns) & too_far):
        where = np.flatnonzero(side)
        if len(where):
            gaps.append((int(where[0]), int(where[-1]) + 1))
            reached[where] = 0.0
    return Reach(reached, tuple(sorted(gaps)))
