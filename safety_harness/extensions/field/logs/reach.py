"""How far from a straight line between samples a thing can have been: the bounds of docs/logs.md.

Every function takes the samples of one thing on the trace's clock, and gives what is straight between them at
the ticks, and within how much of that the true one was, at a tick and up to those beside it.
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
    """``within`` (n,) of each tick, up to those beside it; 0 in ``gaps``, where nothing is known."""

    within: Floats
    gaps: tuple[tuple[int, int], ...]

    def known_gaps(self, hand: int | None = None) -> tuple[Gap, ...]:
        """As a trace has them."""
        return tuple(Gap(first=first, after=after, hand=hand) for first, after in self.gaps)


def body_off_m(way_m: Floats, step_s: Floats, *, most_mps: float, sample_m: Floats | float) -> Floats:
    """(m,) how far a body may be from the line between two samples, ``way_m`` (m,), ``step_s`` (m,) apart.

    From the true places x and y, T apart in time, at most v T apart: at the fraction w of the time the body
    is within v w T of x and within v (1 - w) T of y, so within (w (1 - w) (v^2 T^2 - |x - y|^2))^(1/2) of the
    point at w of the straight line, which is largest in the middle.  That line is within ``sample_m`` (m,) of
    the one between the samples, and |x - y| at least 2 ``sample_m`` less than what they are apart.
    """
    true_m = np.maximum(way_m - 2.0 * sample_m, 0.0)
    slack2 = np.maximum((most_mps * step_s) ** 2 - true_m**2, 0.0)
    return np.asarray(0.5 * np.sqrt(slack2) + sample_m)


def joint_off_rad(
    slope: Floats, step_s: Floats | float, *, most: Floats, hardest: float | None, sample_rad: float
) -> Floats:
    """(m,) the same of joints that turn evenly from sample to sample, the largest of all.

    ``slope`` (m, j), ``step_s`` (m,), ``most`` (j,).

    By a bound a on the acceleration at most a T^2/8; by one v on the speed at most T (v^2 - s^2)/(2 v), with
    the mean speed s: up as fast as may be, and down again.
    """
    if hardest is not None:
        return np.asarray(hardest * step_s**2 / 8.0 + sample_rad)
    even, step_s = np.minimum(np.abs(slope), most), np.asarray(step_s)
    return np.asarray((step_s[:, None] * (most**2 - even**2) / (2.0 * most)).max(axis=1) + sample_rad)


def rate_off(
    slope: Floats, step_s: Floats | float, *, most: Floats, hardest: float | None, sample: float
) -> Floats:
    """(m,) how far a joint's speed may be from its mean from sample to sample, the largest of all.

    ``slope`` (m, j), ``step_s`` (m,), ``most`` (j,).

    At the ends of T by a T/2, as the mean is that of a line at worst; and both samples may be off.
    """
    off = 2.0 * sample / step_s
    if hardest is not None:
        return np.asarray(off + hardest * step_s / 2.0)
    return np.asarray(np.maximum(off, 0.0) + (np.abs(slope) + most).max(axis=1))


def over_ticks(
    time_ns: NDArray[np.int64],
    off: Floats,
    *,
    longest_ns: int,
    period_ns: int,
    count: int,
    frozen: NDArray[np.bool_] | None = None,
) -> Reach:
    """From bounds ``off`` (m,) between samples at ``time_ns`` (m + 1,) to the ``count`` ticks.

    A tick has the largest bound of what touches the period before or after it.  Between samples farther apart
    than ``longest_ns``, and up to one that is ``frozen`` (m + 1,), nothing is known: at the ticks between
    them, at that before them if there are none, as the way from a lost tick is lost too, and at one with a
    sample that has such gaps on both sides.
    """
    within, told, lost = np.zeros(count), np.zeros(count, np.bool_), np.zeros(count, np.bool_)
    begin, end = time_ns[:-1], time_ns[1:]
    known = end - begin <= longest_ns
    if frozen is not None:
        known &= ~frozen[1:]
    first = np.maximum(begin // period_ns, 0)  # the tick at or before its beginning
    last = np.minimum(-(-end // period_ns), count - 1)  # and at or after its end
    spread = last - first
    for step in range(int(spread[known].max(initial=-1)) + 1):
        some = known & (spread >= step)
        np.maximum.at(within, first[some] + step, off[some])
        told[first[some] + step] = True
    before, after = begin[~known] // period_ns, -(-end[~known] // period_ns)
    for one, other in zip(before.tolist(), after.tolist(), strict=True):
        lost[max(one + (other - one > 1), 0) : max(other, 0)] = True
    ends, which = np.divmod(np.concatenate([begin[~known], end[~known]]), period_ns)
    ends = ends[(which == 0) & (ends >= 0) & (ends < count)]
    lost[ends[~told[ends]]] = True
    within[lost] = 0.0
    return Reach(within, tuple((int(a), int(b)) for a, b in zip(*runs_of(lost), strict=True)))


def known_beyond_ns(longest_ns: int) -> int:
    """Return how long before its first sample and after its last one a thing is known."""
    return longest_ns // 2


def beyond_end(away_ns: FloatOrFloats, *, most: float, sample: float, period_ns: int) -> FloatOrFloats:
    """Return how far a thing may be at ticks ``away_ns`` from its first or last sample.

    The tick beside the end is as far off as the sample can be from it, and so is the one before or after.
    """
    return most * (away_ns + period_ns) / 1e9 + sample


def from_ends(
    reach: Reach, first_ns: int, last_ns: int, *, most: float, sample: float, longest_ns: int, period_ns: int
) -> Reach:
    """And of the ticks before the first sample and after the last, as far as half the longest gap."""
    count, within, gaps = len(reach.within), reach.within.copy(), list(reach.gaps)
    ticks = np.arange(count) * period_ns
    away_ns = np.maximum(first_ns - ticks, ticks - last_ns)
    outside = away_ns > 0
    beyond = away_ns > known_beyond_ns(longest_ns)
    reachable = beyond_end(away_ns.astype(np.float64), most=most, sample=sample, period_ns=period_ns)
    near = (away_ns > -period_ns) & ~beyond
    within = np.where(near, np.maximum(within, reachable), within)
    for side in (outside & (ticks < first_ns) & beyond, outside & (ticks > last_ns) & beyond):
        where = np.flatnonzero(side)
        if len(where):
            gaps.append((int(where[0]), int(where[-1]) + 1))
            within[where] = 0.0
    return Reach(within, tuple(sorted(gaps)))
