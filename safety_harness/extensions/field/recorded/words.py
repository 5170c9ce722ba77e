"""A recorded cell beside the worlds, in lines for people."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from math import degrees

from safety_harness.extensions.field.recorded.apart import DelayFit, Difference, Estimate
from safety_harness.extensions.field.recorded.compare import (
    CellComparison,
    ClaimOfBoth,
    ClosestHand,
    WorldBeside,
)


def comparison_lines(found: CellComparison) -> Iterator[str]:
    """All of it."""
    share = f"{found.confidence:.0%}"
    yield f"{found.log}: {found.title}; {found.duration_s:g} s, {found.joint_samples} samples of the joints"
    yield f"simulated minus recorded, with {share} intervals of the mean (approximate, of this recording):"
    for world in found.worlds:
        yield f"{world.world}:"
        yield from (f"  {line}" for line in world_lines(world, found.usually))


def world_lines(world: WorldBeside, usually: float) -> Iterator[str]:
    """Of one world."""
    for one in (*world.joints, *filter(None, [world.tcp]), *world.distances):
        yield f"{one.what}: {difference_words(one, usually)}"
    yield from map(closest_words, world.closest)
    if world.fit is not None:
        yield from fit_words(world.fit, [one.what for one in world.joints])
    for claim in world.claims:
        mark = "DIFF" if claim.differs else "ok  " if claim.decided else "open"
        yield f"{mark} {claim_words(claim)}"
    yield from (f"not compared: {one}" for one in world.absent)


def difference_words(one: Difference, usually: float) -> str:
    """Mean with its interval, what it usually is at most, the largest and when, how closely the log knows."""
    return (
        f"mean {estimate(one.mean, one.unit)}; {usually:.0%} of the time within "
        f"{shown(one.usually, one.unit)}, at most {shown(one.largest, one.unit)} at {one.at_s:.3f} s; "
        f"recorded to within {shown(one.recorded_within, one.unit)}"
    )


def closest_words(one: ClosestHand) -> str:
    """The least distance of a hand in both."""
    least = "nobody knows how little" if one.recorded_least_m is None else shown(one.recorded_least_m, "m")
    return (
        f"least distance of {one.hand}: simulated {shown(one.simulated_m, 'm')}, recorded {least} to "
        f"{shown(one.recorded_most_m, 'm')}"
    )


def fit_words(fit: DelayFit, joints: Sequence[str]) -> Iterator[str]:
    """What delay and offsets explain."""
    late = f"not estimated: {fit.why}" if fit.late is None else estimate(fit.late, "s")
    yield f"recorded joints later than simulated by: {late}"
    offs = ", ".join(f"{name} {estimate(one, 'rad')}" for name, one in zip(joints, fit.offsets, strict=False))
    yield f"and off by: {offs}"
    yield f"which leaves {shown(fit.left, 'rad')} of {shown(fit.before, 'rad')} (root mean square)"


def claim_words(one: ClaimOfBoth) -> str:
    """Both verdicts."""
    return (
        f"{one.sentence}: recorded {one.recorded.value} {one.recorded_margin}, "
        f"simulated {one.simulated.value} {one.simulated_margin}"
    )


def estimate(one: Estimate, unit: str) -> str:
    """With its interval."""
    if one.low is None or one.high is None:
        return f"{shown(one.value, unit)} (no interval)"
    return f"{shown(one.value, unit)} ({shown(one.low, unit)} to {shown(one.high, unit)})"


def shown(value: float, unit: str) -> str:
    """In degrees, millimetres or milliseconds."""
    text = f"{degrees(value):.3f}" if unit == "rad" else f"{value * 1e3:.2f}"
    return f"{'0' if float(text) == 0.0 else text} {'deg' if unit == 'rad' else f'm{unit}'}"
