"""Check a stream's samples against physical limits and against the statements in LOG.yaml."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from safety_harness.base.elementary import length
from safety_harness.base.exceptions import LogError
from safety_harness.cell.robot.description import ArmModel
from safety_harness.extensions.field.logs.model import JointFacts
from safety_harness.extensions.field.logs.sample_bound import SampleBound, refuse_unbounded
from safety_harness.extensions.field.logs.streams import NS, LogSamples, strides

FARTHEST_M, FARTHEST_RAD = 10.0, 8.0 * np.pi  # a sample beyond these has another unit, or is none
MOST_APART = 0.3  # the largest relative difference of speeds and way that shows another unit
LEAST_INTERVALS = 10  # the fewest intervals for this test: in fewer, noise at rest may look so
HARDEST_TAKEN = 40.0  # rad/s2 or m/s2, the most that is assumed if LOG.yaml states no acceleration


def joints_checked(joints: LogSamples, names: tuple[str, ...]) -> LogSamples:
    """Return the samples in which every joint has an angle; raise LogError if an angle is impossible."""
    values = joints.values[:, : len(names)]
    far = np.abs(values) > FARTHEST_RAD
    if far.any():
        index = int(np.argmax(far.any(axis=1)))
        joint = int(np.argmax(far[index]))
        expected = f"an angle of at most {np.degrees(FARTHEST_RAD):.0f} deg either way"
        got = f"{names[joint]} at {np.degrees(values[index, joint]):.6g} deg"
        raise joints.error(index, expected, got, 'degrees instead of radians? See the key "unit"')
    return _measured(joints, np.asarray(np.isfinite(values).all(axis=1)))


def positions_checked(positions: LogSamples, keep: bool) -> LogSamples:
    """Return the samples that have a position, or all samples if ``keep`` is true.

    Raise LogError if a position is too far away. If several far positions are all equal, they mean only that
    the tracker lost the body.
    """
    far = np.abs(positions.values) > FARTHEST_M
    distant = far.any(axis=1)
    if np.count_nonzero(distant) > 1 and (positions.values[distant] == positions.values[distant][0]).all():
        positions.values[distant] = np.nan  # trackers repeat one far place for a body that they do not see
    elif far.any():
        index = int(np.argmax(far.any(axis=1)))
        got = f"{', '.join(f'{value:.6g}' for value in positions.values[index])} m"
        expected = f"a position within {FARTHEST_M:g} m of the base"
        raise positions.error(index, expected, got, 'millimetres instead of metres? See the key "unit"')
    return positions if keep else _measured(positions, np.asarray(np.isfinite(positions.values).all(axis=1)))


def _measured(samples: LogSamples, there: NDArray[np.bool_]) -> LogSamples:
    """Return the samples for which ``there`` (n,) is true; raise LogError if these are fewer than two."""
    if np.count_nonzero(there) < 2:
        raise LogError(
            place=samples.source.place,
            expected=f"two samples at least of {samples.source.name} with all its numbers",
            got=f"{np.count_nonzero(there)} of {len(there)}",
        )
    if there.all():
        return samples
    first, last = samples.time_ns[~there][[0, -1]] / NS
    return samples.chosen(there).noted(
        f"{np.count_nonzero(~there)} of {len(there)} samples, from {first:.3f} to {last:.3f} s of its clock, "
        "are no measurements (empty, NaN, zeros or one far place)"
    )


def with_bounds(samples: LogSamples, bound: SampleBound | None = None, *, speeds: bool = False) -> LogSamples:
    """Return the samples after moving the uncertainties and the speeds out of the columns with positions.

    ``bound`` computes the uncertainty from its columns. If ``bound`` is None, a single column is the
    uncertainty [m]. ``speeds`` is True if the last three columns are speeds.
    """
    if speeds:
        samples = replace(samples, values=samples.values[:, :-3], speeds_mps=samples.values[:, -3:])
    values, beside = samples.values[:, :3], samples.values[:, 3:]
    if not beside.shape[1]:
        return samples
    known_to_m = beside[:, 0] if bound is None else np.array([bound.reach_m(row) for row in beside])
    split = replace(samples, values=values, known_to_m=known_to_m)
    refuse_unbounded(split)
    return split


def refuse_the_same(streams: list[LogSamples]) -> None:
    """Raise LogError if two streams of hands or elbows have the same samples, even if the files differ."""
    for a, b in combinations(streams, 2):
        if np.array_equal(a.time_ns, b.time_ns) and np.array_equal(a.values, b.values):
            got = f"the samples of {a.source.name} twice"
            place = b.source.place
            raise LogError(place=place, expected="a stream of its own of each hand and elbow", got=got)


def the_short_way(joints: LogSamples, facts: JointFacts, arm: ArmModel) -> LogSamples:
    """Return ``joints`` without wraps of the angles of joints that have no limits.

    If the angle of such a joint jumps, the joint is assumed to have turned the short way.
    """
    count, step_s = len(arm.joint_names), np.diff(joints.time_ns)[:, None] / NS
    turned_rad = wrapped_rad(np.diff(joints.values[:, :count], axis=0), step_s, facts, arm)
    if not (wraps := turned_rad != 0.0).any():
        return joints
    values = joints.values.copy()
    # After a wrap, all later angles are off by the same turn.
    values[1:, :count] -= np.cumsum(turned_rad, axis=0)
    names = ", ".join(np.array(arm.joint_names)[np.any(wraps, axis=0)])
    note = f"{names} wraps at a turn {np.count_nonzero(wraps)} times, and has no ends: taken the short way"
    return replace(joints, values=values).noted(note)


def wrapped_rad(
    steps_rad: NDArray[np.float64], step_s: NDArray[np.float64] | float, facts: JointFacts, arm: ArmModel
) -> NDArray[np.float64]:
    """Return the multiple of 2 pi [rad] that a wrap added to each of the steps ``steps_rad`` (..., n).

    Only joints without limits wrap. ``step_s`` (..., 1) is the duration of each step. A step of more than pi
    is a wrap if its duration exceeds the longest gap. It is also a wrap if the joint is too slow to have
    turned the long way.
    """
    endless = np.isinf(arm.position_lower_rad) & np.isinf(arm.position_upper_rad)
    sure = step_s * facts.move_at_most_radps + 2.0 * facts.known_to_rad < np.pi
    wraps = endless & (np.abs(steps_rad) > np.pi) & (sure | (step_s > facts.longest_gap_s))
    return 2.0 * np.pi * np.where(wraps, np.round(steps_rad / (2.0 * np.pi)), 0.0)


def noted_beyond_ends(joints: LogSamples, arm: ArmModel) -> LogSamples:
    """Return ``joints`` with a note for each joint whose logged angle exceeds the joint's limits."""
    angles = joints.values[:, : len(arm.joint_names)]
    excess = np.fmax(angles - arm.position_upper_rad, arm.position_lower_rad - angles)
    for k in np.flatnonzero((excess > 0.0).any(axis=0)):
        most, count = np.degrees(excess[:, k].max()), np.count_nonzero(excess[:, k] > 0.0)
        note = f"{arm.joint_names[k]} is up to {most:.3g} deg beyond its end, in {count} samples of the log"
        joints = joints.noted(note)
    return joints


def refuse_jumping_joints(joints: LogSamples, facts: JointFacts, names: tuple[str, ...]) -> None:
    """Raise LogError if a joint's speed or acceleration certainly exceeds its limit.

    The check compares neighbours, then every second sample, every fourth and so on, because the samples'
    errors hide an excess over a short step.
    """
    for stride in strides(len(joints.time_ns)):
        _refuse_jumps(joints, facts, names, stride)


def _refuse_jumps(joints: LogSamples, facts: JointFacts, names: tuple[str, ...], stride: int) -> None:
    """Make the check of ``refuse_jumping_joints`` for every sample number that is divisible by ``stride``."""
    angles_rad = joints.values[::stride, : len(names)]
    step_s = np.diff(joints.time_ns[::stride]) / NS
    moved = np.abs(np.diff(angles_rad, axis=0))
    allowed = step_s[:, None] * facts.move_at_most_radps + 2.0 * facts.known_to_rad
    allowed *= 1.0 + 1e-9  # the rounding of differences over long steps
    if (moved > allowed).any():
        index = int(np.argmax((moved > allowed).any(axis=1)))
        joint = int(np.argmax(moved[index] - allowed[index]))
        speed = np.degrees(moved[index, joint] / step_s[index])
        most = np.degrees(facts.move_at_most_radps[joint])
        hint = "another unit from here on? or joints: {move at most: ...} says how fast they can be"
        if abs(moved[index, joint] - 2.0 * np.pi) <= allowed[index, joint]:
            hint = "its angles wrap at a turn, and a joint with ends has to be logged without the wrap: the "
            hint += "angles alone do not say in which turn it is"
        raise joints.error(
            (index + 1) * stride,
            f"{names[joint]} to turn at {most:.4g} deg/s at most, as the file says",
            f"a jump of {np.degrees(moved[index, joint]):.4g} deg in {step_s[index] * 1e3:.4g} ms, "
            f"{speed:.4g} deg/s",
            hint,
        )
    if facts.accelerate_at_most_radps2 is None or len(step_s) < 2:
        return
    # twice the second divided difference is an acceleration somewhere between the three samples
    turned = np.abs(np.diff(np.diff(angles_rad, axis=0) / step_s[:, None], axis=0))
    between_s, error = (step_s[1:] + step_s[:-1]) / 2.0, 2.0 * facts.known_to_rad / step_s
    hard = ((turned - (error[1:] + error[:-1])[:, None]) / between_s[:, None]).max(axis=1)
    if (hard > facts.accelerate_at_most_radps2 * (1.0 + 1e-6)).any():
        index = int(np.argmax(hard > facts.accelerate_at_most_radps2 * (1.0 + 1e-6)))
        raise joints.error(
            (index + 2) * stride,
            f"{names[int(np.argmax(turned[index]))]} to speed up or brake at "
            f"{facts.accelerate_at_most_radps2:.4g} rad/s2 at most, as the file says",
            f"{hard[index]:.4g} rad/s2 at least, by three samples known to {facts.known_to_rad:.4g} rad",
            "joints: {accelerate at most: ..., known to: ...}, which must include the error of their stamps",
        )


def refuse_another_unit(joints: LogSamples, names: Sequence[str]) -> None:
    """Raise LogError if the log seems to confuse radians and degrees.

    This is the case if the speeds of one joint or of all joints match the angles only after a conversion
    between rad and deg.
    """
    angles, speeds = np.split(joints.values, 2, axis=1)
    steps, step_s = np.diff(angles, axis=0), np.diff(joints.time_ns)[:, None] / NS
    both, every = np.stack([steps, (speeds[1:] + speeds[:-1]) / 2.0 * step_s]), [*range(len(names))]
    for label, chosen in (("the angles", every), *((names[k], [k]) for k in every)):
        moved, by_speed = both[:, np.isfinite(both.sum(axis=0)) & np.isin(every, chosen)]
        for times in (np.degrees(1.0), np.radians(1.0)) if len(moved) >= LEAST_INTERVALS else ():
            if length(by_speed - times * moved) < MOST_APART * length(by_speed):
                expected, got = f"joint speeds that lead along {label}", f"{times:.3g} times their way"
                hint = 'degrees and radians are exchanged: the ends of the columns\' names, or the key "unit"'
                raise LogError(place=joints.source.place, expected=expected, got=got, hint=hint)


def refuse_contradicting_speeds(
    samples: LogSamples,
    places: NDArray[np.float64],
    speeds: NDArray[np.float64],
    known: tuple[float, float],
    hard: float | None,
    names: Sequence[str],
    unit: tuple[str, float],
) -> None:
    """Raise LogError if ``speeds`` (n, k) contradict ``places`` (n, k).

    The error refers to the first interval with a contradiction. Let T be the time between two samples, and a
    the largest acceleration. Then the mean speed differs from the mean of the two measured speeds by at most
    a T/4. The check skips samples without speeds.

    Args:
        samples: The samples, for their times and for the places in error messages.
        places: The positions (n, k).
        speeds: The speeds (n, k).
        known: Two uncertainties, first that of the positions, then that of the speeds.
        hard: The largest acceleration a. If it is None, twice the largest acceleration in the speeds is
            assumed, but at most HARDEST_TAKEN.
        names: The names of the columns.
        unit: The name of the unit of positions in error messages, and the factor that converts SI to this
            unit.

    """
    there = np.flatnonzero(np.isfinite(speeds).all(axis=1))
    if len(there) < 2:
        return
    places, speeds, at_s = places[there], speeds[there], (samples.time_ns[there] - samples.time_ns[0]) / NS
    step_s = np.diff(at_s)[:, None]
    by_speed = (speeds[1:] + speeds[:-1]) / 2.0 * step_s
    shown = 2.0 * np.abs(np.diff(speeds, axis=0) / step_s).max(axis=0)
    hardest = np.minimum(shown, HARDEST_TAKEN) if hard is None else hard
    allowed = np.broadcast_to(step_s * (known[1] + hardest * step_s / 4.0), by_speed.shape)
    conflicts: list[tuple[int, int, int]] = []
    for sign in (1.0, -1.0):  # positions ahead of, then behind, the way by the speeds and its tolerance
        more = np.zeros(places.shape)
        more[1:] = np.cumsum(sign * (np.diff(places, axis=0) - by_speed) - allowed, axis=0)
        # The largest conflict over all pairs of samples is the rise above the least value so far.
        since = np.minimum.accumulate(more, axis=0)
        for end, column in np.argwhere(more - since > 2.0 * known[0])[:1].tolist():
            conflicts.append((end, column, int(np.argmax(more[:, column] == since[end, column]))))
    for end, column, begin in sorted(conflicts)[:1]:
        slack = 2.0 * known[0] + allowed[begin:end, column].sum()
        amounts = places[end, column] - places[begin, column], by_speed[begin:end, column].sum(), slack
        moved, by_speeds, limit = (f"{float(x) * unit[1]:.4g} {unit[0]}" for x in amounts)
        times = f"{at_s[begin]:.3f} to {at_s[end]:.3f} s"
        raise samples.error(
            int(there[begin]),
            f"{names[column]} to go by {moved} from {times}, as its positions do, to within {limit}",
            f"{by_speeds} by its speeds",
            'speeds of another unit, sign, axis or joint? or how well they are known: "speeds known to"',
        )
