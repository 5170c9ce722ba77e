"""Differences from a reference, drawn again: which are the avoider's doing, and which flip near a limit.

A search chooses its runs, so that of two avoiders that are equally good it finds the runs in which chance was
against the one on trial.  Every run that it found is made again with seeds that nobody chose.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from safety_harness.admission.admit import Admitted, Admitter
from safety_harness.exceptions import InputError
from safety_harness.properties.against import ClaimDifference, VerdictChange
from safety_harness.proportions import sign_test
from safety_harness.scenario.model import Verdict
from safety_harness.search.against import difference
from safety_harness.search.confirm import OtherDraws
from safety_harness.search.findings import Findings, Group
from safety_harness.search.trials import Trials
from safety_harness.trace.trace import Trace

CHANCE = 0.05  # of all claims together that an avoider as good as the reference is found worse
PAIRS = 36  # of runs for each claim, shared evenly among its groups
MOST_GROUPS = 6
_FIRST = 1_000_000_000  # above the number of every point that is searched


def keep_differences(trials: Trials, findings: Findings) -> list[str]:
    """Take the groups that are no differences out of ``findings``; what they are comes back in words.

    A claim's groups count if, drawn again, significantly more pairs differ to the avoider's harm than to the
    reference's (exact sign test), and a group only if its own do.
    """
    if trials.reference is None:
        return []
    admitter, lines = Admitter(), []
    for claim, goal in enumerate(findings.goals):
        groups = findings.of_claim(claim)[:MOST_GROUPS]
        draws = PAIRS // max(len(groups), 1)
        own = [_redrawn(trials, admitter, group, claim, draws) for group in groups]
        worse, better = (sum(column) for column in zip(*own, strict=True)) if own else (0, 0)
        certain = worse > better and sign_test(worse, better) < CHANCE / len(findings.goals)
        flips = [
            group for group, (more, fewer) in zip(groups, own, strict=True) if not certain or more <= fewer
        ]
        if groups and not certain:
            flips = findings.of_claim(claim)
        findings.groups = [one for one in findings.groups if all(one is not flip for flip in flips)]
        near = sum(_is_near(run.claims[claim], goal.scale) for run in trials.differences)
        if near:
            lines.append(f"{goal.sentence}: {near} runs, in which {goal.against} hardly keeps it")
        if flips:
            lines.append(
                f"{goal.sentence}: {sum(one.count for one in flips)} runs; drawn again, "
                f"{goal.against} alone keeps it in {worse} of {draws * len(groups)} pairs, and alone "
                f"violates it in {better}"
            )
    return lines


def _is_near(one: ClaimDifference, scale: float) -> bool:
    """Is the claim violated by the avoider alone, and kept by less than the tolerance by the reference?"""
    differs = difference(one.mine.margin, one.reference.margin, scale) < 0.0
    return one.change is VerdictChange.NEW and one.reference.verdict is Verdict.HOLDS and not differs


def _redrawn(trials: Trials, admitter: Admitter, group: Group, claim: int, draws: int) -> tuple[int, int]:
    """Return in how many of ``draws`` pairs the avoider is worse than the reference, and better."""
    assert trials.reference is not None
    pairs: list[Admitted] = []
    for draw in range(draws):
        try:
            scenario = trials.scenario(group.worst.point, _FIRST + group.worst.number * PAIRS + draw)
            both = [admitter.admit(one) for one in (scenario, trials.reference.in_place(scenario))]
        except InputError:  # the seed decides whether a run can begin
            continue
        pairs += [replace(one, avoider=OtherDraws(one.avoider, draw)) for one in both]
    runs: Sequence[Trace | Exception] = trials.world(pairs)
    prop, scale = trials.properties[claim], trials.goals[claim].scale
    worse = better = 0
    for mine, other in zip(runs[::2], runs[1::2], strict=True):
        if isinstance(mine, Trace) and isinstance(other, Trace):
            margins = prop.evaluate(mine).margin, prop.evaluate(other).margin
            worse += difference(*margins, scale) < 0.0
            better += difference(*margins[::-1], scale) < 0.0
    return worse, better
