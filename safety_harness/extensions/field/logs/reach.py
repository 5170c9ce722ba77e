"""Bounds on the distance between a thing and the line between its samples (docs/explanation/verdicts.md).

Every function takes the samples of one thing on the trace's clock. It gives the bound at each tick, for the
time from the tick before to the tick after.
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
ROUNDING_M = 1e-5  # of stored paths, in micrometres and nanoseconds


@dataclass(frozen=True, eq=False)
class Reach:
    """The bound ``within`` (n,) at each tick, up to its neighbours; 0 in the unknown ``gaps``."""

    within: Floats
    gaps: tuple[tuple[int, int], ...]

    def known_gaps(self, hand: int | None = None) -> tuple[Gap, ...]:
        """Return the gaps in the form of a trace."""
        return tuple(Gap(first=first, after=end, hand=hand) for first, end in self.gaps)


def body_off_m(way_m: Floats, step_s: Floats, *, most_mps: float, sample_m: Floats | float) -> Floats:
    """Return (m,) how far a body may be from the line between samples, ``way_m`` and ``step_s`` (m,) apart.

    Let x and y be the true places, T the time between them, and v the largest speed, so |x - y| <= v T. At
    the fraction w of the time the body is within v w T of x and within v (1 - w) T of y. So it is within (w
    (1 - w) (v^2 T^2 - |x - y|^2))^(1/2) of the point at w of the straight line, which is largest in the
    middle. That line is within ``sample_m`` (m,) of the line between the samples, and |x - y| is at least
    their distance less 2 ``sample_m``.
    """
    true_m = np.maximum(way_m - 2.0 * sample_m, 0.0)
    slack2 = np.maximum((most_mps * step_s) ** 2 - true_m**2, 0.0)
    return np.asarray(0.5 * np.sqrt(slack2) + sample_m)


def joint_off_rad(
    slope: Floats, step_s: Floats | float, *, most: Floats, hardest: float | None, sample_rad: float
) -> Floats:
    """Return (m,) the same for joints that turn evenly from sample to sample, the largest of all joints.

    ``slope`` (m, j), ``step_s`` (m,), ``most`` (j,).

    A bound a on the acceleration gives a T^2/8. A bound v on the speed gives T (v^2 - s^2)/(2 v), with the
    mean speed s: as fast as possible in one direction, then back.
    """
    if hardest is not None:
        return np.asarray(hardest * step_s**2 / 8.0 + sample_rad)
    even, step_s = np.minimum(np.abs(slope), most), np.asarray(step_s)
    return np.asarray((step_s[:, None] * (most**2 - even**2) / (2.0 * most)).max(axis=1) + sample_rad)


def rate_off(
    slope: Floats, step_s: Floats | float, *, most: Floats, hardest: float | None, sample: float
) -> Floats:
    """Return (m,) how far a joint's speed may be from its mean between samples, the largest of all joints.

    ``slope`` (m, j), ``step_s`` (m,), ``most`` (j,).

    At the ends of T it is a T/2, since at worst the speed is a line about its mean. Both samples may be off
    too.
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
    are lost. If a lost interval contains no tick, the tick before it is lost, as the way from a lost tick is
    lost too. A tick with a sample between two lost intervals is lost as well.

    Args:
        time_ns: The times (m + 1,) of the samples since tick 0.
        off_by: The bounds (m,) between samples.
        longest_ns: The longest allowed gap.
        period_ns: The period of the ticks.
        count: The number of ticks.
        frozen: (m + 1,) true for a sample that repeats the previous one. None: all false.

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
    """Return how long before its first and after its last sample a thing is known."""
    return longest_ns // 2


def beyond_end(away_ns: FloatOrFloats, *, most: float, sample: float, period_ns: int) -> FloatOrFloats:
    """Return how far a thing may be at ticks ``away_ns`` from its first or last sample.

    The tick beside the end is as far off as the sample can be from it, and so is its neighbour.
    """
    return most * (away_ns + period_ns) / 1e9 + sample


def from_ends(
    reach: Reach, first_ns: int, last_ns: int, *, most: float, sample: float, longest_ns: int, period_ns: int
) -> Reach:
    """Return the bounds with ticks before the first and after the last sample, up to half the longest gap."""
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
