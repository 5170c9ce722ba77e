"""Differences from a reference, drawn again: which are the avoider's doing, and which flip near a limit.

A search chooses its runs, so that of two avoiders that are equally good it finds the runs in which chance was
against the one on trial.  Every run that it found is made again with seeds that nobody chose.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from safety_harness.admission.admit import Admitted, Admitter
from safety_harness.base.exceptions import InputError
from safety_harness.base.proportions import sign_test
from safety_harness.claims.properties.against import TOLERANCE, ClaimDifference, VerdictChange
from safety_harness.scenario.model import Verdict
from safety_harness.search.against import difference_of
from safety_harness.search.confirm import OtherDraws
from safety_harness.search.coverage import Coverage
from safety_harness.search.findings import Findings, Group
from safety_harness.search.trials import Trials
from safety_harness.trace.trace import Trace

CHANCE = 0.05  # of all claims together that an avoider as good as the reference is found worse
BEYOND = 2.0  # times the largest difference the other way
PAIRS = 36  # of runs for each claim, shared evenly among its groups
MOST_GROUPS = 6
_FIRST = 1_000_000_000  # above the number of every point that is searched


def keep_differences(trials: Trials, findings: Findings, search: Callable[[Trials], Findings]) -> list[str]:
    """Take the groups that are no differences out of ``findings``; what they are comes back in words.

    A claim's groups count if, drawn again, significantly more pairs differ to the avoider's harm than to the
    reference's (exact sign test), and a group only if its own do.  Two avoiders that merely differ are each
    worse than the other somewhere, and a search finds where.  So ``search`` then looks for the reverse: a
    claim counts if significantly more runs of the first search differ, or if they differ by more than
    ``BEYOND`` times what any run differs the other way, the tolerance added.
    """
    if trials.reference is None:
        return []
    admitter, lines, other = Admitter(), list[str](), None
    chance = CHANCE / len(findings.goals)
    of_reference = replace(trials, coverage=Coverage(), violations=Coverage(), reverse=True)
    for claim, goal in enumerate(findings.goals):
        groups, reverse = findings.of_claim(claim), ""
        draws = PAIRS // max(len(groups[:MOST_GROUPS]), 1)
        own = [_redrawn(trials, admitter, one, claim, draws) for one in groups[:MOST_GROUPS]]
        worse, better = sum(len(more) for more, _ in own), sum(fewer for _, fewer in own)
        certain = worse > better and sign_test(worse, better) < chance
        if certain:
            other = other or search(of_reference)
            if other.interrupted:
                raise KeyboardInterrupt
            mine, theirs = int(findings.violated[claim]), int(other.violated[claim])
            runs = (*trials.differences, *of_reference.differences)
            most = float(np.nanmax([0.0, *(-run.claims[claim].lost for run in runs)]))
            typical = max(float(np.median(more)) for more, _ in own if more)
            certain = typical > BEYOND * (most + TOLERANCE * goal.scale)
            certain = certain or (mine > theirs and sign_test(mine, theirs) < chance)
            reverse = f"; the other way round the same search finds {theirs} runs, and at most "
            reverse += goal.unit.margin_text(most)
        mere = (one for one, (more, fewer) in zip(groups, own, strict=False) if len(more) <= fewer)
        flips = [*mere] if certain else groups
        findings.groups = [one for one in findings.groups if all(one is not flip for flip in flips)]
        near = sum(_is_near(run.claims[claim]) for run in trials.differences)
        if near:
            lines.append(f"{goal.sentence}: {near} runs, in which {goal.against} hardly keeps it")
        if flips:
            lines.append(
                f"{goal.sentence}: {sum(one.count for one in flips)} runs; drawn again, "
                f"{goal.against} alone keeps it in {worse} of {draws * len(own)} pairs, and alone violates "
                f"it in {better}{reverse}"
            )
    return lines


def _is_near(one: ClaimDifference) -> bool:
    """Is the claim violated by the avoider alone, and kept by less than the tolerance by the reference?"""
    differs = difference_of(one.mine, one.reference) < 0.0
    return one.change is VerdictChange.NEW and one.reference.verdict is Verdict.HOLDS and not differs


def _redrawn(
    trials: Trials, admitter: Admitter, group: Group, claim: int, draws: int
) -> tuple[list[float], int]:
    """Return by how much the avoider is worse in which of ``draws`` pairs [SI], and in how many better."""
    assert trials.reference is not None
    admitted: list[Admitted] = []
    for draw in range(draws):
        try:
            scenario = trials.scenario(group.worst.point, _FIRST + group.worst.number * PAIRS + draw)
            both = [admitter.admit(one) for one in (scenario, trials.reference.in_place(scenario))]
        except InputError:  # the seed decides whether a run can begin
            continue
        admitted += [replace(one, avoider=OtherDraws(one.avoider, draw)) for one in both]
    runs: Sequence[Trace | Exception] = trials.world(admitted)
    prop, worse, better = trials.properties[claim], list[float](), 0
    for mine, other in zip(runs[::2], runs[1::2], strict=True):
        if isinstance(mine, Trace) and isinstance(other, Trace):
            one, two = prop.evaluate(mine), prop.evaluate(other)
            worse += [-lost] if (lost := difference_of(one, two)) < 0.0 else []
            better += difference_of(two, one) < 0.0
    return worse, better
