"""Describe the comparison of a recorded cell with both worlds, in lines of text for people."""

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


def comparison_lines(cell: CellComparison) -> Iterator[str]:
    """Yield the lines of the whole comparison."""
    share = f"{cell.confidence:.0%}"
    yield f"{cell.log}: {cell.title}; {cell.duration_s:g} s, {cell.joint_samples} samples of the joints"
    yield f"simulated minus recorded, with {share} intervals of the mean (approximate, of this recording):"
    for world in cell.worlds:
        yield f"{world.world}:"
        yield from (f"  {line}" for line in world_lines(world, cell.usually))


def world_lines(world: WorldBeside, usually: float) -> Iterator[str]:
    """Yield the lines of one world."""
    for item in (*world.joints, *filter(None, [world.tcp]), *world.distances):
        yield f"{item.what}: {difference_words(item, usually)}"
    yield from map(closest_words, world.closest)
    if world.fit is not None:
        yield from fit_words(world.fit, [item.what for item in world.joints])
    for claim in world.claims:
        mark = "DIFF" if claim.differs else "ok  " if claim.decided else "open"
        yield f"{mark} {claim_words(claim)}"
    yield from (f"not compared: {item}" for item in world.absent)


def difference_words(row: Difference, usually: float) -> str:
    """Return a text about a difference.

    The text contains the mean with its interval, the usual size, the largest size, and the uncertainty of the
    recording.
    """
    return (
        f"mean {estimate(row.mean, row.unit)}; {usually:.0%} of the time within "
        f"{shown(row.usually, row.unit)}, at most {shown(row.largest, row.unit)} at {row.at_s:.3f} s; "
        f"recorded to within {shown(row.recorded_within, row.unit)}"
    )


def closest_words(row: ClosestHand) -> str:
    """Return the text of a hand's least distances in the simulation and in the log."""
    least = "unknown" if row.recorded_least_m is None else shown(row.recorded_least_m, "m")
    return (
        f"least distance of {row.hand}: simulated {shown(row.simulated_m, 'm')}, recorded {least} to "
        f"{shown(row.recorded_most_m, 'm')}"
    )


def fit_words(fit: DelayFit, joints: Sequence[str]) -> Iterator[str]:
    """Yield the delay, the offsets, and the differences before and after the fit."""
    late = f"not estimated: {fit.why}" if fit.late is None else estimate(fit.late, "s")
    yield f"recorded joints later than simulated by: {late}"
    offs = ", ".join(f"{name} {estimate(est, 'rad')}" for name, est in zip(joints, fit.offsets, strict=False))
    yield f"and off by: {offs}"
    yield f"which leaves {shown(fit.left, 'rad')} of {shown(fit.before, 'rad')} (root mean square)"


def claim_words(row: ClaimOfBoth) -> str:
    """Return the text of a claim's verdicts and margins, for the log and for the run."""
    return (
        f"{row.sentence}: recorded {row.recorded.value} {row.recorded_margin}, "
        f"simulated {row.simulated.value} {row.simulated_margin}"
    )


def estimate(of_value: Estimate, unit: str) -> str:
    """Return the text of a value with its interval."""
    if of_value.low is None or of_value.high is None:
        return f"{shown(of_value.value, unit)} (no interval)"
    return f"{shown(of_value.value, unit)} ({shown(of_value.low, unit)} to {shown(of_value.high, unit)})"


def shown(value: float, unit: str) -> str:
    """Return the text of a value in degrees, millimetres or milliseconds."""
    text = f"{degrees(value):.3f}" if unit == "rad" else f"{value * 1e3:.2f}"
    return f"{'0' if float(text) == 0.0 else text} {'deg' if unit == 'rad' else f'm{unit}'}"
