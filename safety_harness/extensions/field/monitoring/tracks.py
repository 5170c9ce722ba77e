"""Track bodies and joints with straight lines between samples, and bound the errors of these lines.

Each sample updates the bounds. The bounds are the same as the bounds that ``extensions.field.logs.certain``
computes for a log that ends at this sample. ``extensions.field.logs.reach`` computes the bounds between two
samples. After the last sample, the bounds follow from the greatest speed. They are valid for at most half of
the longest gap. Times are in nanoseconds since the first sample of the joints.
"""

from __future__ import annotations

from collections import deque

import numpy as np
from numpy.typing import NDArray

from safety_harness.base.elementary import length
from safety_harness.cell.robot.description import ArmModel
from safety_harness.extensions.field.logs.checked import wrapped_rad
from safety_harness.extensions.field.logs.frozen import Repeats
from safety_harness.extensions.field.logs.model import HandFacts, JointFacts
from safety_harness.extensions.field.logs.reach import (
    ROUNDING_M,
    beyond_end,
    body_off_m,
    joint_off_rad,
    known_beyond_ns,
    rate_off,
)
from safety_harness.extensions.field.logs.streams import NS, SHORTEST_STEP_NS
from safety_harness.extensions.field.monitoring.earlier import EarlierSamples, least_accelerations

Values = NDArray[np.float64]


class Jump(ValueError):
    """The error for a sample that earlier samples contradict, or that is frozen."""


class WithinByTick:
    """The error at each tick, and the ticks at which it is unknown.

    The results are the same as from ``reach.over_ticks``, but are updated with each sample.
    """

    def __init__(self, longest_ns: int, period_ns: int) -> None:
        self._longest_ns, self._period_ns = longest_ns, period_ns
        self._off: dict[int, float] = {}
        self._lost: dict[int, None] = {}
        self._alone: dict[int, None] = {}  # ticks with a sample at the end of a gap
        self.oldest = 0

    def add(self, begin_ns: int, end_ns: int, error: float, *, lost: bool = False) -> None:
        """Add the ``error`` between two samples.

        If ``lost`` is true, or if the gap is too long, the ticks between the samples become unknown.
        """
        first, last = begin_ns // self._period_ns, -(-end_ns // self._period_ns)
        if lost or end_ns - begin_ns > self._longest_ns:
            self._lost |= dict.fromkeys(range(max(first + (last - first > 1), self.oldest), last))
            ends = (divmod(time_ns, self._period_ns) for time_ns in (begin_ns, end_ns))
            self._alone |= {tick: None for tick, beside_ns in ends if not beside_ns}
            return
        for tick in range(max(first, self.oldest), last + 1):
            self._off[tick] = max(self._off.get(tick, 0.0), error)

    def at(self, tick: int) -> float | None:
        """Return the error at ``tick``, or None if it is unknown."""
        if tick in self._lost or (tick in self._alone and tick not in self._off):
            return None
        return self._off.get(tick, 0.0)

    def forget(self, first_kept: int) -> None:
        """Forget all ticks before ``first_kept``."""
        self.oldest = first_kept
        for kept in (self._off, self._lost, self._alone):
            while kept and (tick := next(iter(kept))) < first_kept:
                del kept[tick]


class JointTrack:
    """The track of the joints: their positions and speeds at each tick up to the last sample, with errors."""

    def __init__(self, facts: JointFacts, period_ns: int, arm: ArmModel) -> None:
        self._facts, self._period_ns, self._arm = facts, period_ns, arm
        self._turned_rad = np.zeros(len(arm.joint_names))  # the whole turns by which encoders wrapped
        longest_ns = round(facts.longest_gap_s * NS)
        self._within, self._rate_within = (WithinByTick(longest_ns, period_ns) for _ in range(2))
        self._bends: dict[int, float] = {}
        self.last: tuple[int, Values, Values | None] | None = None
        self._before: tuple[int, Values, Values | None] | None = None
        self.slope: Values | None = None  # the mean speed between the last two samples
        self._repeats = [Repeats() for _ in facts.move_at_most_radps]
        self._earlier = EarlierSamples(len(arm.joint_names))

    def unwrapped(self, time_ns: int, position_rad: Values) -> Values:
        """Return the next joint positions ``position_rad`` (n,) without wraps; raise Jump after a jump."""
        turned_rad = self._turned_rad
        if self.last is not None:
            step_s = (time_ns - self.last[0]) / NS
            step_rad = position_rad - turned_rad - self.last[1]
            turned_rad = turned_rad + wrapped_rad(step_rad, step_s, self._facts, self._arm)
        self._refuse_jump(time_ns, position_rad - turned_rad)
        self._turned_rad = turned_rad
        return position_rad - turned_rad

    def _refuse_jump(self, time_ns: int, position_rad: Values) -> None:
        """Raise Jump if a joint exceeded its speed or acceleration to reach ``position_rad`` (n,)."""
        times_ns, earlier_rad = self._earlier.kept_samples()
        steps_s, known_rad = (time_ns - times_ns)[..., None] / NS, self._facts.known_to_rad
        moved, most = np.abs(position_rad - earlier_rad), self._facts.move_at_most_radps
        fast = moved - (steps_s * most + 2.0 * known_rad) * (1.0 + 1e-9)  # the rounding over long steps
        if fast.size and fast.max() > 0.0:
            *sample, joint = np.unravel_index(fast.argmax(), fast.shape)
            raise Jump(
                f"a turn of joint {joint + 1} by {np.degrees(moved[*sample, joint]):.4g} deg in "
                f"{steps_s[*sample, 0] * 1e3:.4g} ms, and its limit is {np.degrees(most[joint]):.4g} deg/s"
            )
        if (hard := self._facts.accelerate_at_most_radps2) is None:
            return
        least, spans_ns = least_accelerations(time_ns, position_rad, self._earlier, known_rad)
        if least.size and least.max() > hard * (1.0 + 1e-6):
            level, joint = np.unravel_index(least.argmax(), least.shape)
            raise Jump(
                f"at least {least[level, joint]:.4g} rad/s2 of joint {joint + 1} in "
                f"{spans_ns[level] / 1e6:.4g} ms, and its limit is {hard:.4g} rad/s2"
            )

    def add(self, time_ns: int, position_rad: Values, rates_radps: Values | None) -> int | None:
        """Add a new sample with ``position_rad`` (n,) and ``rates_radps`` (n,).

        Its time must be later than the time of the last sample. Return the time since which a joint is
        frozen, or None if no joint is frozen.
        """
        sample, previous = (time_ns, position_rad, rates_radps), self.last
        self._before, self.last = previous, sample
        self._earlier.add(time_ns, position_rad)
        joints = zip(self._repeats, position_rad.tolist(), strict=True)
        since = [at_ns for joint, value in joints if (at_ns := joint.since(time_ns, (value,))) is not None]
        if previous is None:
            self._within.add(0, 0, self._facts.known_to_rad)
            return None
        frozen = bool(since) and not self._facts.at_rest
        begin_ns = min(previous[0], *since) if frozen else previous[0]
        step_s, facts = (time_ns - previous[0]) / NS, self._facts
        most, hard = facts.move_at_most_radps, facts.accelerate_at_most_radps2
        slope = (position_rad - previous[1])[None] / step_s
        # a single step is a plain number, since that is quicker
        steps = np.array([step_s]) if hard is None else step_s
        error = joint_off_rad(slope, steps, most=most, hardest=hard, sample_rad=facts.known_to_rad)
        self._within.add(begin_ns, time_ns, error.item(), lost=frozen)
        if facts.speeds_known_to_radps is None:
            error = rate_off(slope, steps, most=most, hardest=hard, sample=facts.known_to_rad)
        else:
            assert rates_radps is not None
            assert previous[2] is not None
            fastest = np.maximum(np.abs(rates_radps), np.abs(previous[2])) + most
            more = float(fastest.max()) if hard is None else hard * step_s / 2.0
            error = np.array(facts.speeds_known_to_radps + more)
        self._rate_within.add(begin_ns, time_ns, error.item(), lost=frozen)
        if self.slope is not None and previous[0] % self._period_ns:
            cell = previous[0] // self._period_ns
            bend = float(np.abs(slope[0] - self.slope).max()) * self._period_ns / NS / 4.0
            self._bends[cell] = self._bends.get(cell, 0.0) + bend
        self.slope = slope[0]
        return begin_ns if frozen else None

    def at(self, tick_ns: int) -> tuple[Values, Values]:
        """Return the positions and speeds at ``tick_ns``, a time between the last two samples."""
        assert self.last is not None
        time_ns, position_rad, rates_radps = self.last
        if self._before is None or self.slope is None:
            return position_rad, rates_radps if rates_radps is not None else np.zeros_like(position_rad)
        before_ns, before_rad, _ = self._before
        share = (tick_ns - before_ns) / (time_ns - before_ns)
        position = position_rad if share == 1.0 else before_rad + share * (position_rad - before_rad)
        if self._facts.speeds_known_to_radps is None:
            return position, self.slope
        assert rates_radps is not None
        assert self._before[2] is not None
        return position, self._before[2] + share * (rates_radps - self._before[2])

    def errors_at(self, tick: int) -> tuple[float, float] | None:
        """Return the errors of position and speed at ``tick``, or None if they are unknown."""
        position_error, rate = self._within.at(tick), self._rate_within.at(tick)
        if position_error is None or rate is None:
            return None
        if self.slope is None:  # one sample alone
            rate = float(self._facts.move_at_most_radps.max())
        return position_error + max(self._bends.get(tick, 0.0), self._bends.get(tick - 1, 0.0)), rate

    def forget(self, first_kept: int) -> None:
        """Forget all ticks before ``first_kept``."""
        self._within.forget(first_kept)
        self._rate_within.forget(first_kept)
        while self._bends and (cell := next(iter(self._bends))) < first_kept - 1:
            del self._bends[cell]


class BodyTrack:
    """The track of a hand or of an elbow."""

    def __init__(self, facts: HandFacts, clock_known_to_s: float, period_ns: int) -> None:
        self._facts, self._clock_s, self._period_ns = facts, clock_known_to_s, period_ns
        self._longest_ns = round(facts.longest_gap_s * NS)
        self.reaches_ns = known_beyond_ns(self._longest_ns)
        self._sample_m = facts.known_to_m + facts.moves_at_most_mps * clock_known_to_s + ROUNDING_M
        self._within = WithinByTick(self._longest_ns, period_ns)
        self.samples: deque[tuple[int, Values]] = deque()
        self._first_ns: int | None = None
        self.lost = False  # whether the body is lost since the last sample
        self._repeats = Repeats()
        self._earlier = EarlierSamples(3)

    def takes(self, time_ns: int) -> bool:
        """Return whether ``time_ns`` is later than the last sample."""
        return not self.samples or time_ns - self.samples[-1][0] >= SHORTEST_STEP_NS

    def refuse_jump(self, time_ns: int, position_m: Values) -> None:
        """Raise Jump if the body is too slow to have reached ``position_m`` (3,) since an earlier sample."""
        times_ns, earlier_m = self._earlier.kept_samples()
        steps_s, way_m = (time_ns - times_ns) / NS, np.sqrt(((position_m - earlier_m) ** 2).sum(axis=-1))
        most = self._facts.moves_at_most_mps
        fast = way_m - most * (steps_s + 2.0 * self._clock_s) - 2.0 * self._facts.known_to_m - ROUNDING_M
        if fast.size and fast.max() > 0.0:
            sample = np.unravel_index(fast.argmax(), fast.shape)
            path = f"a way of {way_m[sample] * 1e3:.4g} mm in {steps_s[sample] * 1e3:.4g} ms"
            raise Jump(f"{path}, and its limit is {most:g} m/s")

    def add(self, time_ns: int, position_m: Values) -> int | None:
        """Add a sample at ``position_m`` (3,) that is later than the last sample.

        Return the time since which the body is frozen and therefore lost, or None if it is not frozen.
        """
        since_ns = self._repeats.since(time_ns, tuple(position_m.tolist()))
        self.lost = since_ns is not None and not self._facts.at_rest
        if self.samples:
            before_ns, before_m = self.samples[-1]
            way_m = np.array([length(position_m - before_m)])
            steps, most = np.array([(time_ns - before_ns) / NS]), self._facts.moves_at_most_mps
            error_m = body_off_m(way_m, steps, most_mps=most, sample_m=self._sample_m)
            begin_ns = before_ns if since_ns is None else min(since_ns, before_ns)
            self._within.add(begin_ns if self.lost else before_ns, time_ns, float(error_m[0]), lost=self.lost)
        else:
            self._first_ns = time_ns
        self.samples.append((time_ns, position_m))
        self._earlier.add(time_ns, position_m)
        return since_ns if self.lost else None

    def at(self, tick: int) -> tuple[Values, float] | None:
        """Return the body's position at ``tick`` and its error, or None if the position is unknown."""
        if not self.samples or self._first_ns is None:
            return None
        time_ns, last_ns = tick * self._period_ns, self.samples[-1][0]
        error_m = self._within.at(tick)
        away_ns = max(self._first_ns - time_ns, time_ns - last_ns)
        if error_m is None or away_ns > self.reaches_ns or (self.lost and time_ns > last_ns):
            return None
        if away_ns > -self._period_ns:
            most = self._facts.moves_at_most_mps
            own_m = beyond_end(away_ns, most=most, sample=self._sample_m, period_ns=self._period_ns)
            error_m = max(error_m, own_m)
        return self.place_at(time_ns), error_m

    def place_at(self, time_ns: int) -> Values:
        """Return the body's place at ``time_ns``, on the line between the samples around it."""
        later = self.samples[-1]
        if time_ns >= later[0]:
            return later[1]
        for earlier in reversed(self.samples):
            if earlier[0] <= time_ns:
                share = (time_ns - earlier[0]) / (later[0] - earlier[0])
                return earlier[1] + share * (later[1] - earlier[1])
            later = earlier
        return later[1]

    def corners(self, begin_ns: int, end_ns: int) -> list[int]:
        """Return the times of the samples between ``begin_ns`` and ``end_ns``."""
        places = []
        for time_ns, _ in reversed(self.samples):
            if time_ns <= begin_ns:
                break
            if time_ns < end_ns:
                places.append(time_ns)
        return places

    def forget(self, first_kept: int) -> None:
        """Forget all ticks before ``first_kept``."""
        self._within.forget(first_kept)
        while len(self.samples) > 1 and self.samples[1][0] <= first_kept * self._period_ns:
            self.samples.popleft()
