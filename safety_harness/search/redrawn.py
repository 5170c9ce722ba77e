"""Use new seeds to repeat the runs that differ from a reference.

The repetitions show which differences the avoider causes, and which occur by chance near a limit. A search
chooses its runs. Even if two avoiders are equally good, a search finds the runs in which the avoider under
test was worse by chance. This module therefore repeats every difference with seeds that no search chose.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from safety_harness.admission.admit import Admitted, Admitter
from safety_harness.base.exceptions import InputError
from safety_harness.base.proportions import sign_test
from safety_harness.base.settings import Settings
from safety_harness.cell.avoidance.measures import optimum_in_base_m
from safety_harness.cell.avoidance.paired import PosedAnswers, WrongAnswer, more_often_wrong, slower_words
from safety_harness.claims.properties.against import ClaimDifference, RunDifference, VerdictChange
from safety_harness.claims.properties.base import Evaluation, Unit
from safety_harness.scenario.model import Verdict
from safety_harness.search.against import difference_of
from safety_harness.search.confirm import OtherDraws
from safety_harness.search.findings import Findings, Group
from safety_harness.search.trials import PartingAnswers, Trials
from safety_harness.trace.trace import Trace

CHANCE = 0.05  # of any finding, over all claims, on an avoider that is as good as the reference
SELDOM = 0.01  # significance of the test on overruling: at 0.05 it reported int8 weights, which are harmless
OFTEN = 0.03  # of all runs: int8 weights, or another training, already violate a claim in 2 % of them
PAIRS = 72  # of runs for each claim, shared evenly among its groups
MOST_GROUPS = 6
_FIRST = 1_000_000_000  # above the number of every point that is searched
_OF_DECISIONS = (Unit.FRACTION, Unit.COUNT)  # a few decisions are a large part of a run: never "by much"
_Pairs = NDArray[np.float64]  # (n, 2) by how much only the avoider, and only the reference, violates [SI]


def keep_differences(trials: Trials, findings: Findings, draw: Callable[[], Trials]) -> list[str]:
    """Remove from ``findings`` each group that shows no real difference, and return lines on these groups.

    Even if two avoiders are equally good, each is worse in some runs, and a search finds such runs. Therefore
    the groups of a claim stay only if the avoider is significantly worse in pairs that no search chose. A
    pair consists of a run with the avoider and a run with the reference. The test is an exact sign test. An
    avoider can be worse in two ways:

    - Much worse: the test counts only pairs whose difference is greater than the scale of the unit. These
      pairs come from new draws of the groups' worst points, and from ``draw``, which draws points anywhere in
      the space. An avoider cannot be much worse in claims about fractions or counts of decisions.
    - Often worse: the test counts only the pairs from ``draw``. The avoider is worse in one fraction of the
      pairs and better in another fraction. The first fraction must exceed the second fraction by more than
      ``OFTEN``.

    If the avoider is significantly worse, a group stays only if the avoider is worse in the group's own
    pairs. If no group meets this condition, all groups stay.

    Args:
        trials: The trials of the search. If they have no reference, the findings stay unchanged.
        findings: The findings, from which the function removes groups.
        draw: The function that runs trials anywhere in the space. If there is no group, this function is not
            called.

    """
    if trials.reference is None:
        return []
    admitter, lines, drawn = Admitter(), list[str](), None
    chance = CHANCE / len(findings.goals)  # two tests for each claim, of which one side counts
    for claim, goal in enumerate(findings.goals):
        near_count = sum(_is_near(run.claims[claim]) for run in trials.differences)
        if near_count:
            lines.append(f"{goal.sentence}: {near_count} runs, in which {goal.against} hardly keeps it")
        groups = findings.of_claim(claim)
        if not groups:
            continue
        drawn = drawn or draw()
        anywhere = _lost(
            (difference.claims[claim].mine, difference.claims[claim].reference)
            for difference in drawn.differences
        )
        draws = PAIRS // len(groups[:MOST_GROUPS])
        own = [_redrawn(trials, admitter, group, claim, draws) for group in groups[:MOST_GROUPS]]
        again = np.concatenate(own)
        much_by = np.inf if goal.unit in _OF_DECISIONS else goal.scale
        often, much = _alone(anywhere), _alone(np.concatenate([again, anywhere]), much_by)
        certain = sign_test(*much) < chance and much[0] > much[1]
        certain |= sign_test(*often) < chance and often[0] - often[1] > OFTEN * len(anywhere)
        mere = [
            group for group, pairs in zip(groups, own, strict=False) if not np.subtract(*_alone(pairs)) > 0
        ]
        flips = groups if not certain else mere if len(mere) < len(groups) else []
        findings.groups = [group for group in findings.groups if all(group is not flip for flip in flips)]
        if flips:
            pairs_of_flips = [
                pairs
                for group, pairs in zip(groups, own, strict=False)
                if any(group is flip for flip in flips)
            ]
            flipped = np.concatenate([np.empty((0, 2)), *pairs_of_flips])
            (worse, better), (more, fewer) = _alone(flipped), often
            lines.append(
                f"{goal.sentence}: {sum(group.count for group in flips)} runs; "
                f"drawn again, {goal.against} alone keeps it in {worse} "
                f"of {len(flipped)} pairs, and alone violates it in {better}; "
                f"of {len(anywhere)} pairs anywhere in the space, in {more} and in {fewer}"
            )
    return lines


def more_overruled(trials: Trials, draw: Callable[[], Trials]) -> list[str]:
    """Return a sentence if the gate refuses more proposals of the avoider than of the reference.

    If the gate refuses a proposal only because of its spread, the refusal is ignored, because a larger spread
    is cautious. The test uses runs anywhere in the space and the limits ``SELDOM`` and ``OFTEN``. These runs
    are drawn only if the gate refuses more proposals of the avoider in the runs of the search.

    Args:
        trials: The trials of the search.
        draw: The function that runs trials anywhere in the space.

    """
    if trials.reference is None or not np.greater(*_refused(trials.differences)):
        return []
    drawn = draw().differences
    more, less = _refused(drawn)
    if more - less <= OFTEN * len(drawn) or sign_test(more, less) >= SELDOM:
        return []
    return [
        f"the gate refused a greater share of its proposals, for more than their spread, than of "
        f"{trials.reference.name}'s in {more} of {len(drawn)} runs anywhere in the space, and a lesser share "
        f"in {less}"
    ]


def worse_answers(trials: Trials, draw: Callable[[], Trials]) -> list[str]:
    """Return sentences on errors and slow answers of the avoider, compared with the reference.

    There is a sentence if the avoider makes an error more often than the reference, or if it answers later.
    The function compares the answers to the last query that both runs of a pair share. Errors are counted in
    runs anywhere in the space. Such runs are drawn only if the runs of the search show an error.

    Args:
        trials: The trials of the search.
        draw: The function that runs trials anywhere in the space.

    """
    pairs = trials.parting_answers
    if trials.reference is None or not pairs:
        return []
    name = trials.reference.name
    own_s, other_s = (
        max(float(made["decision_time_s"][0]) for made in side)
        for side in ([pair.mine for pair in pairs], [pair.theirs for pair in pairs])
    )
    slower = slower_words(own_s, other_s, pairs[0].settings.clock.control_period_s, name)
    worse = list[str]()
    if _more_errors(pairs, name, 0.5):
        worse = _more_errors(draw().parting_answers, name, CHANCE / (2 * len(WrongAnswer)))
    return [*(f"it {text}" for text in worse), *filter(None, [slower])]


def _more_errors(pairs: Sequence[PartingAnswers], reference: str, chance: float) -> list[str]:
    """Return the sentences of ``more_often_wrong`` about the last shared query of each pair."""
    if not pairs:
        return []
    settings = [pair.settings for pair in pairs]
    mine = _posed(np.concatenate([pair.mine for pair in pairs]), settings)
    theirs = _posed(np.concatenate([pair.theirs for pair in pairs]), settings)
    return [sentence for _, sentence, _ in more_often_wrong(mine, theirs, reference, chance)]


def _posed(decisions: NDArray[np.void], settings: Sequence[Settings]) -> PosedAnswers:
    """Return the queries and answers of ``decisions`` (n,).

    The optimum of each decision is computed with the settings of that decision.
    """
    hands, tcps = decisions["hand_position_in_base_m"], decisions["tcp_position_in_base_m"]
    optima = [optimum_in_base_m(own, hands[k : k + 1], tcps[k : k + 1]) for k, own in enumerate(settings)]
    proposed, spreads = decisions["proposed_position_in_base_m"], decisions["proposed_spread_m"]
    return PosedAnswers(
        hands, tcps, np.concatenate(optima), proposed, spreads, decisions["spread_threshold_m"]
    )


def _refused(runs: Sequence[RunDifference]) -> tuple[int, int]:
    """Return two numbers of runs.

    The first number counts the runs in which more checks fail per proposal than with the reference. The
    second number counts the runs in which fewer checks fail. Checks of the spread are ignored.
    """
    shares = np.array([run.more_refused for run in runs])
    return int((shares > 0.0).sum()), int((shares < 0.0).sum())


def _lost(pairs: Iterable[tuple[Evaluation, Evaluation]]) -> _Pairs:
    """Return by how much one avoider violates the claim in each pair, while the other avoider keeps it.

    The shape is (n, 2). The first column is for violations of the avoider, and the second column is for
    violations of the reference.
    """
    return -np.array([(difference_of(*pair), difference_of(*pair[::-1])) for pair in pairs]).reshape(-1, 2)


def _alone(pairs: _Pairs, least: float = 0.0) -> tuple[int, int]:
    """Return two numbers of pairs.

    The first number counts the ``pairs`` in which only the avoider violates the claim by more than ``least``.
    The second number counts the ``pairs`` in which only the reference does so.
    """
    worse, better = (pairs > least).sum(axis=0).tolist()
    return worse, better


def _is_near(claim: ClaimDifference) -> bool:
    """Return whether the avoider violates ``claim`` and the reference keeps it only by a small margin.

    A margin is small if it is less than the tolerance.
    """
    differs = difference_of(claim.mine, claim.reference) < 0.0
    return claim.change is VerdictChange.NEW and claim.reference.verdict is Verdict.HOLDS and not differs


def _redrawn(trials: Trials, admitter: Admitter, group: Group, claim: int, draws: int) -> _Pairs:
    """Return the result of ``_lost`` for ``draws`` new pairs of runs at the worst point of ``group``.

    Each pair has its own seed.
    """
    assert trials.reference is not None
    admitted: list[Admitted] = []
    for draw in range(draws):
        try:
            scenario = trials.scenario(group.worst.point, _FIRST + group.worst.number * PAIRS + draw)
            both = [admitter.admit(pair) for pair in (scenario, trials.reference.in_place(scenario))]
        except InputError:  # with this seed, the run may not be able to begin
            continue
        admitted += [replace(pair, avoider=OtherDraws(pair.avoider, draw)) for pair in both]
    runs: Sequence[Trace | Exception] = trials.world(admitted)
    prop = trials.properties[claim]
    return _lost(
        (prop.evaluate(mine), prop.evaluate(reference))
        for mine, reference in zip(runs[::2], runs[1::2], strict=True)
        if isinstance(mine, Trace) and isinstance(reference, Trace)
    )
