"""Bounds on how far a body or joint is from the line between its samples (docs/explanation/verdicts.md).

The functions take the samples of one body, or of the arm's joints, on the trace's clock. The bound at a tick
holds from the tick before it to the tick after it.
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
    """The bound ``within`` (n,) at each tick, which holds up to both neighbours; 0 in unknown ``gaps``."""

    within: Floats
    gaps: tuple[tuple[int, int], ...]

    def known_gaps(self, hand: int | None = None) -> tuple[Gap, ...]:
        """Return the gaps as a trace states them, for ``hand`` or for all."""
        return tuple(Gap(first=first, after=end, hand=hand) for first, end in self.gaps)


def body_off_m(way_m: Floats, step_s: Floats, *, most_mps: float, sample_m: Floats | float) -> Floats:
    """Return how far (m,) a body may be from the lines between its samples.

    Successive samples are ``way_m`` (m,) and ``step_s`` (m,) apart.

    Let x and y be the true places at two samples, T the time between them, and v the largest speed, so
    |x - y| <= v T. After the fraction w of T, the body is within v w T of x and within v (1 - w) T of y. So
    it is off the point at w on the line from x to y by at most (w (1 - w) (v^2 T^2 - |x - y|^2))^(1/2).
    This is largest for w = 1/2. The line from x to y is within ``sample_m`` (m,) of the line between the
    samples. |x - y| is at least ``way_m`` - 2 ``sample_m``.
    """
    true_m = np.maximum(way_m - 2.0 * sample_m, 0.0)
    slack2 = np.maximum((most_mps * step_s) ** 2 - true_m**2, 0.0)
    return np.asarray(0.5 * np.sqrt(slack2) + sample_m)


def joint_off_rad(
    slope: Floats, step_s: Floats | float, *, most: Floats, hardest: float | None, sample_rad: float
) -> Floats:
    """Return how far (m,) joints may be from the lines between samples, as the largest value of all joints.

    ``slope`` (m, j) are the mean speeds s, ``step_s`` (m,) the times T, ``most`` (j,) the largest speeds v.

    If a = ``hardest`` bounds the acceleration, the distance is at most a T^2/8. Otherwise it is at most
    T (v^2 - s^2)/(2 v), if the joint turns as fast as possible in one direction, then back. Both bounds grow
    by ``sample_rad``.
    """
    if hardest is not None:
        return np.asarray(hardest * step_s**2 / 8.0 + sample_rad)
    even, step_s = np.minimum(np.abs(slope), most), np.asarray(step_s)
    return np.asarray((step_s[:, None] * (most**2 - even**2) / (2.0 * most)).max(axis=1) + sample_rad)


def rate_off(
    slope: Floats, step_s: Floats | float, *, most: Floats, hardest: float | None, sample: float
) -> Floats:
    """Return how far (m,) a joint's speed may be from its mean between samples; largest value of all joints.

    ``slope`` (m, j) are the mean speeds s, ``step_s`` (m,) the times T, ``most`` (j,) the largest speeds v.

    If a = ``hardest`` bounds the acceleration, the difference is at most a T/2, since at worst the speed
    changes evenly about its mean. Otherwise it is at most |s| + v. Both samples may be off by ``sample``,
    which adds 2 ``sample`` / T.
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
    """Return the bounds at ticks from bounds between samples.

    A tick has the largest bound of all intervals that touch the period before or after it. An interval is
    lost if it is longer than ``longest_ns`` or ends at a ``frozen`` sample. The ticks within a lost interval
    are lost, since a lost tick also means that the motion to the next tick is unknown. If a lost interval
    contains no tick, the tick before it is lost. So is a tick with a sample between two lost intervals.

    Args:
        time_ns: The times (m + 1,) of the samples since tick 0.
        off_by: The bounds (m,) between samples.
        longest_ns: The longest allowed gap.
        period_ns: The period of the ticks.
        count: The number of ticks.
        frozen: (m + 1,) true for a sample that repeats the previous one, or None if no sample does.

    """
    reached, bounded, lost = np.zeros(count), np.zeros(count, np.bool_), np.zeros(count, np.bool_)
    begin, end = time_ns[:-1], time_ns[1:]
    known = end - begin <= longest_ns
    if frozen is not None:
        known &= ~frozen[1:]
    first = np.maximum(begin // period_ns, 0)  # the tick at or before its beginning
    last = np.minimum(-(-end // period_ns), count - 1)  # and at or after its end
    spread = last - first
    for step in range(int(spread[known].max(initial=-1)) + 1):
        some = known & (spread >= step)
        np.maximum.at(reached, first[some] + step, off_by[some])
        bounded[first[some] + step] = True
    last_before, first_after = begin[~known] // period_ns, -(-end[~known] // period_ns)
    for left, right in zip(last_before.tolist(), first_after.tolist(), strict=True):
        lost[max(left + (right - left > 1), 0) : max(right, 0)] = True
    ends, rest = np.divmod(np.concatenate([begin[~known], end[~known]]), period_ns)
    ends = ends[(rest == 0) & (ends >= 0) & (ends < count)]
    lost[ends[~bounded[ends]]] = True
    reached[lost] = 0.0
    return Reach(reached, tuple((int(a), int(b)) for a, b in zip(*runs_of(lost), strict=True)))


def known_beyond_ns(longest_ns: int) -> int:
    """Return the time before the first and after the last sample for which a body is still known."""
    return longest_ns // 2


def beyond_end(away_ns: FloatOrFloats, *, most: float, sample: float, period_ns: int) -> FloatOrFloats:
    """Return how far a body may be from its first or last sample at ticks that are ``away_ns`` from it.

    The bound at a tick also covers one more ``period_ns``, since it holds up to the next tick.
    """
    return most * (away_ns + period_ns) / 1e9 + sample


def from_ends(
    reach: Reach, first_ns: int, last_ns: int, *, most: float, sample: float, longest_ns: int, period_ns: int
) -> Reach:
    """Return ``reach`` with bounds up to half the longest gap before the first and after the last sample.

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
