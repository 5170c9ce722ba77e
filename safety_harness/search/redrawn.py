"""Differences from a reference, drawn again: which are the avoider's doing, and which flip near a limit.

A search chooses its runs, so that of two avoiders that are equally good it finds the runs in which chance was
against the one on trial.  Every run that it found is made again with seeds that nobody chose.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from safety_harness.admission.admit import Admitted, Admitter
from safety_harness.base.exceptions import InputError
from safety_harness.base.proportions import sign_test
from safety_harness.claims.properties.against import ClaimDifference, RunDifference, VerdictChange
from safety_harness.claims.properties.base import Evaluation, Unit
from safety_harness.scenario.model import Verdict
from safety_harness.search.against import difference_of
from safety_harness.search.confirm import OtherDraws
from safety_harness.search.findings import Findings, Group
from safety_harness.search.trials import Trials
from safety_harness.trace.trace import Trace

CHANCE = 0.05  # of all claims together that an avoider as good as the reference is found worse
SELDOM = 0.01  # the chance of the test on overruling: at 0.05 it named int8 weights, which are harmless
OFTEN = 0.03  # of all runs: int8 weights or another training alone violate a claim in 2 % of them
PAIRS = 72  # of runs for each claim, shared evenly among its groups
MOST_GROUPS = 6
_FIRST = 1_000_000_000  # above the number of every point that is searched
_OF_DECISIONS = (Unit.FRACTION, Unit.COUNT)  # few that fall the other way are much of a run
_Pairs = NDArray[np.float64]  # (n, 2) by how much the avoider alone, and the reference alone, violates [SI]


def keep_differences(trials: Trials, findings: Findings, draw: Callable[[], Trials]) -> list[str]:
    """Take the groups that are no differences out of ``findings``; what they are comes back in words.

    Two avoiders that merely differ are each worse than the other somewhere, and a search finds where.  So a
    claim's groups count if of pairs that no search chose significantly more differ to the avoider's harm than
    to the reference's (exact sign test), by much or often.  By much: of those alone that differ by more than
    the scale of the unit, drawn again at the groups' worst points or run by ``draw`` anywhere in the space; a
    share or a count of decisions has no such pairs.  Often: of all that are run anywhere, and in more than
    ``OFTEN`` of them, the others subtracted.  A group counts only if its own pairs are worse, or no group's.
    """
    if trials.reference is None:
        return []
    admitter, lines, drawn = Admitter(), list[str](), None
    chance = CHANCE / len(findings.goals)  # two tests, of either of which one side counts
    for claim, goal in enumerate(findings.goals):
        near = sum(_is_near(run.claims[claim]) for run in trials.differences)
        if near:
            lines.append(f"{goal.sentence}: {near} runs, in which {goal.against} hardly keeps it")
        groups = findings.of_claim(claim)
        if not groups:
            continue
        drawn = drawn or draw()
        anywhere = _lost((one.claims[claim].mine, one.claims[claim].reference) for one in drawn.differences)
        draws = PAIRS // len(groups[:MOST_GROUPS])
        own = [_redrawn(trials, admitter, one, claim, draws) for one in groups[:MOST_GROUPS]]
        again = np.concatenate(own)
        by = np.inf if goal.unit in _OF_DECISIONS else goal.scale
        often, much = _alone(anywhere), _alone(np.concatenate([again, anywhere]), by)
        certain = sign_test(*much) < chance and much[0] > much[1]
        certain |= sign_test(*often) < chance and often[0] - often[1] > OFTEN * len(anywhere)
        mere = [one for one, pairs in zip(groups, own, strict=False) if not np.subtract(*_alone(pairs)) > 0]
        flips = groups if not certain else mere if len(mere) < len(groups) else []
        findings.groups = [one for one in findings.groups if all(one is not flip for flip in flips)]
        if flips:
            (worse, better), (more, fewer) = _alone(again), often
            lines.append(
                f"{goal.sentence}: {sum(one.count for one in flips)} runs; drawn again, {goal.against} alone "
                f"keeps it in {worse} of {len(again)} pairs, and alone violates it in {better}; of "
                f"{len(anywhere)} pairs anywhere in the space, in {more} and in {fewer}"
            )
    return lines


def more_overruled(trials: Trials, draw: Callable[[], Trials]) -> str:
    """Say that the gate overrules the avoider in more runs than the reference; empty if it does not.

    Runs anywhere decide, by ``SELDOM`` and ``OFTEN``; where those of the search give no hint, none are drawn.
    """
    if trials.reference is None or not np.greater(*_overruled(trials.differences)):
        return ""
    drawn = draw().differences
    more, less = _overruled(drawn)
    if more - less <= OFTEN * len(drawn) or sign_test(more, less) >= SELDOM:
        return ""
    return (
        f"the gate overruled a greater share of its proposals than of {trials.reference.name}'s in {more} of "
        f"{len(drawn)} runs anywhere in the space, and a lesser share in {less}"
    )


def _overruled(runs: Sequence[RunDifference]) -> tuple[int, int]:
    """In how many runs is a greater share overruled, and in how many a lesser?"""
    shares = np.array([run.more_overruled for run in runs])
    return int((shares > 0.0).sum()), int((shares < 0.0).sum())


def _lost(pairs: Iterable[tuple[Evaluation, Evaluation]]) -> _Pairs:
    return -np.array([(difference_of(*one), difference_of(*one[::-1])) for one in pairs]).reshape(-1, 2)


def _alone(pairs: _Pairs, by: float = 0.0) -> tuple[int, int]:
    """In how many pairs does the avoider alone violate by more than that, and in how many the reference?"""
    worse, better = (pairs > by).sum(axis=0).tolist()
    return worse, better


def _is_near(one: ClaimDifference) -> bool:
    """Is the claim violated by the avoider alone, and kept by less than the tolerance by the reference?"""
    differs = difference_of(one.mine, one.reference) < 0.0
    return one.change is VerdictChange.NEW and one.reference.verdict is Verdict.HOLDS and not differs


def _redrawn(trials: Trials, admitter: Admitter, group: Group, claim: int, draws: int) -> _Pairs:
    """Run ``draws`` pairs at the group's worst point, with other seeds of the scenario and both avoiders."""
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
    prop = trials.properties[claim]
    return _lost(
        (prop.evaluate(mine), prop.evaluate(other))
        for mine, other in zip(runs[::2], runs[1::2], strict=True)
        if isinstance(mine, Trace) and isinstance(other, Trace)
    )
