"""The word on a claim, from what is bounded and what is not.  Green is for one case only.

For each stratum: *refuted* if even the lower bound is above the target; *shown* if the upper bound is at or
below it.  Runs without a verdict, or that could not be carried on, count as violations in the upper bound,
and a claim that has any is *shown with doubt* at best; so is one whose runs were made in the kinematic world
only, and one in whose runs the fallback stood in for the avoider: throughout, or without a claim of the plan
about that.  The claim gets the gravest of its strata.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from math import floor, log10

from safety_harness.cell.simulation.worlds import WorldEntry
from safety_harness.extensions.assurance.certification.evidence import (
    SEVERITY,
    Bound,
    ClaimResult,
    ClaimStatus,
    OverrulingResult,
)
from safety_harness.extensions.assurance.statistics.rounding import rounded_down, rounded_up


def standing_of(
    *,
    target: float | None,
    bound: Bound | None,
    runs: int,
    planned: int,
    tested: int,
    violated: int,
    without_verdict: int,
    may_stop_early: bool,
    world: WorldEntry,
    problem: str = "",
    fallback: str = "",
    stood_in: bool = False,
    dependent: str = "",
) -> tuple[ClaimStatus, str]:
    """The standing of one claim in one stratum, and why in a sentence.

    ``problem`` says why there is no bound.  ``fallback`` says how often the avoider did not answer, if it did
    not always; ``stood_in``: so often that nothing was shown of the avoider, or more often than the plan says
    anything of.  ``dependent`` says why the runs are not independent, if they are not.
    """
    if dependent:
        return ClaimStatus.NOT_SHOWN, dependent
    if runs < planned and not may_stop_early:
        made = f"{runs} of {planned} declared runs were made"
        return ClaimStatus.INCOMPLETE, f"{made}, so there is no bound yet"
    if tested == 0:
        return ClaimStatus.UNTESTED, f"none of {runs} runs put it to the test"
    if bound is None:
        return ClaimStatus.INCOMPLETE, f"there is no bound: {problem}"
    counted = f"{violated} of {tested} tested runs violate it"
    if without_verdict:
        counted += f", {without_verdict} had no verdict"
    if fallback:
        counted += f" ({fallback})"
    if target is None:
        return ClaimStatus.ESTIMATED, f"{counted}; the plan sets no target"
    limit, most = beside_target(bound, target)
    if bound.lower > target:
        sure = confidence_words(bound.of_one_end)
        return ClaimStatus.REFUTED, f"{counted}: with {sure} confidence more than {limit} of them do"
    if bound.upper > target:
        return ClaimStatus.NOT_SHOWN, f"{counted}: it may be up to {most} of them, and {limit} was the target"
    if without_verdict:
        return ClaimStatus.DOUBTED, f"{counted}; they count as violations, and the target is still met"
    if world.model_only:
        return ClaimStatus.DOUBTED, f"{counted}: model only, {world}"
    if stood_in:
        return ClaimStatus.DOUBTED, f"{counted}: the target is met by the fallback"
    return ClaimStatus.SHOWN, f"{counted}: at most {most} of them do, and {limit} was the target"


def gravest(standings: Iterable[ClaimStatus]) -> ClaimStatus:
    """The one that a reader has to know first; UNTESTED of nothing at all."""
    return max(standings, key=SEVERITY.index, default=ClaimStatus.UNTESTED)


def overall(outcomes: Sequence[ClaimResult]) -> tuple[ClaimStatus, str]:
    """A claim's standing over its strata, and why: the gravest stratum's own reason."""
    standing = gravest(outcome.standing for outcome in outcomes)
    if not outcomes:
        return standing, "the plan has no stratum"
    worst = [outcome for outcome in outcomes if outcome.standing is standing]
    worst.sort(key=lambda outcome: -outcome.bound.upper if outcome.bound else 0.0)
    where = "" if len(outcomes) == 1 else f"{worst[0].stratum}: "
    others = len(worst) - 1
    more = f" ({others} more {'stratum' if others == 1 else 'strata'} likewise)" if others else ""
    return standing, f"{where}{worst[0].why}{more}"


def percent(share: float) -> str:
    """A probability in per cent with two or three significant digits.

    Never 0 % of something, nor 100 % of less.
    """
    shown = 100.0 * share
    if 99.995 <= shown < 100.0:  # two digits of what it lacks
        return f"{shown:.{1 - floor(log10(100.0 - shown))}f}".rstrip("0") + " %"
    if shown == 0.0 or shown >= 99.95:
        return f"{shown:.4g} %"
    return f"{shown:.3g} %" if shown >= 0.01 else f"{shown:.2g} %"


def at_most(share: float) -> str:
    """An upper bound in per cent: its digits are never below it."""
    return f"{100.0 * float(rounded_up(share)):.3g} %"


def beside_target(bound: Bound, target: float) -> tuple[str, str]:
    """A target and an upper bound in per cent, with so many digits that they say which is the larger one."""
    limit, most = percent(target), at_most(bound.upper)
    shown, ends = float(limit[:-2]), (100.0 * bound.lower, float(most[:-2]))
    if (ends[0] > shown, ends[1] > shown) == (bound.lower > target, bound.upper > target):
        return limit, most
    return f"{100.0 * target:.9g} %", f"{100.0 * bound.upper:.9g} %"


def hourly(rate: float) -> str:
    """An upper bound an hour: its digits are never below it."""
    return f"{float(rounded_up(rate)):.3g}"


def at_least(share: float) -> str:
    """A lower bound in per cent: its digits are never above it."""
    return f"{100.0 * float(rounded_down(share)):.3g} %"


def overruling_line(one: OverrulingResult) -> str:
    """How often the gate overruled the avoider in a stratum, and in how many of its runs it may."""
    bound = one.bound
    ends = "" if bound is None else f" ({at_least(bound.lower)} to {at_most(bound.upper)}, 95 % alone)"
    return f"{one.stratum}: {one.words}; in {one.runs_overruled} of {one.runs} runs with a proposal{ends}"


def confidence_words(confidence: float) -> str:
    """A confidence in per cent, never more of it than there is: what may fail is rounded up."""
    return f"{100.0 * (1.0 - float(rounded_up(1.0 - confidence))):.9g} %"
