"""The status of a claim, derived from its bounds and from gaps in its evidence.  Only one status is green.

In each stratum, a claim is *refuted* if even the lower bound exceeds the target. A claim is *shown* if the
upper bound is at most the target. The upper bound treats unfinished runs, and runs without a verdict, as
violations. If one of these conditions applies, the best possible status is *shown with doubt*:

- A run has no verdict.
- The runs are from the kinematic world only.
- The fallback answered instead of the avoider, either always, or sometimes although no claim of the plan
  covers the fallback.
- The gate overruled every proposal, so the avoider never acted.
- Most answers took longer than the runs allow, so the runs assume faster answers than the system gives.

The status of a claim as a whole is the most severe status over its strata.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from math import floor, log10

from safety_harness.cell.simulation.worlds import WorldEntry
from safety_harness.extensions.assurance.campaign.summary import FallbackTally
from safety_harness.extensions.assurance.certification.evidence import (
    SEVERITY,
    Bound,
    ClaimResult,
    ClaimStatus,
    OverrulingResult,
)
from safety_harness.extensions.assurance.statistics.rounding import rounded_down, rounded_up
from safety_harness.trace.answer_times import AnswersTook
from safety_harness.trace.overruling import Overruling


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
    doubt: str = "",
    dependent: str = "",
) -> tuple[ClaimStatus, str]:
    """Return the status of a claim in a stratum, with the reason in a sentence.

    Args:
        target: The allowed violation probability, or None if the plan sets no target.
        bound: The interval of the violation probability, or None if there is no bound.
        runs: The number of runs in the ledger.
        planned: The number of declared runs.
        tested: The number of runs that test the claim.
        violated: The number of runs that violate the claim.
        without_verdict: The number of inconclusive and failed runs.
        may_stop_early: True if a stratum may end before its planned runs.
        world: The world of the runs.
        problem: The reason why there is no bound.
        fallback: A text that states how often the avoider did not answer, or an empty string if it always
            answered.
        doubt: The reason that ``doubt_of`` returned, or an empty string if there is no reason.
        dependent: The reason why the runs are not independent, or an empty string if they are independent.

    """
    # The order matters: without independent or complete runs, no bound has a meaning, and a refutation comes
    # before each doubt.
    if dependent:
        return ClaimStatus.NOT_SHOWN, dependent
    if runs < planned and not may_stop_early:
        made = f"{runs} of {planned} declared runs exist"
        return ClaimStatus.INCOMPLETE, f"{made}, so there is no bound yet"
    if tested == 0:
        return ClaimStatus.UNTESTED, f"not one of {runs} runs put it to the test"
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
    if doubt:
        return ClaimStatus.DOUBTED, f"{counted}: {doubt}"
    return ClaimStatus.SHOWN, f"{counted}: at most {most} of them do, and {limit} was the target"


def doubt_of(fallback: FallbackTally, overruled: Overruling, times: AnswersTook, *, claimed: bool) -> str:
    """Return the reason why the runs of a stratum show little about the avoider, or "" if they show enough.

    Args:
        fallback: The counts that state how often the avoider did not answer.
        overruled: The counts that state how often the gate overruled the avoider's proposals.
        times: The times that the avoider's answers took.
        claimed: Whether the plan has a claim about the fallback.

    """
    if fallback.unanswered and (fallback.unanswered == fallback.decisions or not claimed):
        return "the target is met by the fallback"
    if 0 < overruled.proposals == overruled.overruled:
        every = f"the gate overruled all {overruled.proposals:,} proposals"
        return f"the target is met without the avoider: {every}"
    if 2 * times.slow > times.answers:
        return f"the target is met with answers in time, but {times.summary}"
    return ""


def worst_status(standings: Iterable[ClaimStatus]) -> ClaimStatus:
    """Return the most severe of ``standings``, or UNTESTED if there is no status."""
    return max(standings, key=SEVERITY.index, default=ClaimStatus.UNTESTED)


def overall(outcomes: Sequence[ClaimResult]) -> tuple[ClaimStatus, str]:
    """Return the status of a claim over all ``outcomes``, with the reason from the most severe stratum."""
    standing = worst_status(outcome.standing for outcome in outcomes)
    if not outcomes:
        return standing, "the plan has no stratum"
    worst = [outcome for outcome in outcomes if outcome.standing is standing]
    worst.sort(key=lambda outcome: -outcome.bound.upper if outcome.bound else 0.0)
    where = "" if len(outcomes) == 1 else f"{worst[0].stratum}: "
    extra = len(worst) - 1
    more = f" ({extra} more {'stratum' if extra == 1 else 'strata'} likewise)" if extra else ""
    return standing, f"{where}{worst[0].why}{more}"


def percent(share: float) -> str:
    """Return ``share`` as a percentage with two or three significant digits.

    A positive probability never becomes 0 %, and a probability below 1 never becomes 100 %.
    """
    shown = 100.0 * share
    if 99.995 <= shown < 100.0:  # two digits of the difference to 100 %
        return f"{shown:.{1 - floor(log10(100.0 - shown))}f}".rstrip("0") + " %"
    if shown == 0.0 or shown >= 99.95:
        return f"{shown:.4g} %"
    return f"{shown:.3g} %" if shown >= 0.01 else f"{shown:.2g} %"


def at_most(share: float) -> str:
    """Return the upper bound ``share`` as a percentage, rounded up."""
    return f"{100.0 * float(rounded_up(share)):.3g} %"


def beside_target(bound: Bound, target: float) -> tuple[str, str]:
    """Return a target and an upper bound as percentages, with enough digits to show which is larger."""
    limit, most = percent(target), at_most(bound.upper)
    shown, ends = float(limit[:-2]), (100.0 * bound.lower, float(most[:-2]))
    if (ends[0] > shown, ends[1] > shown) == (bound.lower > target, bound.upper > target):
        return limit, most
    return f"{100.0 * target:.9g} %", f"{100.0 * bound.upper:.9g} %"


def hourly(rate: float) -> str:
    """Return the upper bound ``rate`` per hour, rounded up."""
    return f"{float(rounded_up(rate)):.3g}"


def at_least(share: float) -> str:
    """Return the lower bound ``share`` as a percentage, rounded down."""
    return f"{100.0 * float(rounded_down(share)):.3g} %"


def overruling_line(row: OverrulingResult) -> str:
    """Return a line that states how often the gate overruled proposals in a stratum, and in how many runs.

    ``row`` has the counts of this stratum.
    """
    bound = row.bound
    ends = "" if bound is None else f" ({at_least(bound.lower)} to {at_most(bound.upper)}, 95 % alone)"
    return f"{row.stratum}: {row.words}; in {row.runs_overruled} of {row.runs} runs with a proposal{ends}"


def confidence_words(confidence: float) -> str:
    """Return a confidence in per cent.

    The confidence is rounded down, because the complementary error must be rounded up.
    """
    return f"{100.0 * (1.0 - float(rounded_up(1.0 - confidence))):.9g} %"
