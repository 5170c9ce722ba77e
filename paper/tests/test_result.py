"""The rule of the three words, by made-up figures that give each of them."""

from __future__ import annotations

import math

import pytest

from safety_harness_paper.intervals import Estimate, Paired, mean_of, share_of
from safety_harness_paper.result import (
    ClaimState,
    FigureComparison,
    PaperClaim,
    PaperVerdict,
    above_zero,
    below_zero,
    estimate_words,
    every,
    fewer,
    judge,
    most,
    number,
    within,
)

HOLDS = PaperClaim("it falls", ClaimState.HOLDS, "")
OTHER_WAY = PaperClaim("it falls", ClaimState.CONTRADICTED, "")
UNDECIDED = PaperClaim("it falls", ClaimState.UNDECIDED, "")
OURS = mean_of([9.9, 10.0, 10.1, 10.0, 10.0])


def figure(paper: float) -> FigureComparison:
    return FigureComparison(label="a figure", ours=OURS, paper=paper)


def test_claims_that_hold_and_figures_that_agree_are_reproduced() -> None:
    word, why = judge([HOLDS, HOLDS], [figure(10.0)] * 9 + [figure(20.0)])
    assert word is PaperVerdict.REPRODUCED
    assert why == "All 2 claims hold, and 9 of 10 figures agree."


def test_claims_that_hold_without_the_figures_are_the_direction_only() -> None:
    word, why = judge([HOLDS], [figure(10.0)] * 8 + [figure(20.0)] * 2)
    assert word is PaperVerdict.DIRECTION_ONLY
    assert why == "The claim holds, but only 8 of 10 figures agree."


@pytest.mark.parametrize("lost", [OTHER_WAY, UNDECIDED])
def test_one_claim_that_does_not_hold_is_enough_against_it(lost: PaperClaim) -> None:
    word, why = judge([HOLDS, lost], [figure(10.0)])
    assert word is PaperVerdict.NOT_REPRODUCED
    assert why.startswith(f"1 of 2 claims does not hold: it falls ({lost.state.value})")
    assert judge([lost], [])[1].startswith("The claim does not hold: it falls")


def test_claims_without_figures_can_be_reproduced() -> None:
    assert judge([HOLDS], [])[0] is PaperVerdict.REPRODUCED


def test_without_a_claim_there_is_no_verdict() -> None:
    with pytest.raises(ValueError, match="claim"):
        judge([], [figure(10.0)])


@pytest.mark.parametrize(
    ("paper", "agrees"), [(10.0, True), (10.9, True), (9.1, True), (11.5, False), (0.0, False)]
)
def test_a_figure_agrees_within_a_tenth(paper: float, agrees: bool) -> None:
    assert figure(paper).agrees is agrees


def test_a_wide_prediction_interval_counts_up_to_a_quarter_and_no_further() -> None:
    wide = mean_of([6.0, 14.0, 10.0, 8.0, 12.0])
    assert wide.next_low < 5.0
    assert FigureComparison(label="", ours=wide, paper=12.4).agrees is True
    assert FigureComparison(label="", ours=wide, paper=12.6).agrees is False
    assert figure(12.4).agrees is False


def test_a_single_training_agrees_only_when_it_is_close() -> None:
    one = mean_of([10.0])
    assert FigureComparison(label="", ours=one, paper=12.0).agrees is True  # anything may be the next one
    assert FigureComparison(label="", ours=one, paper=13.0).agrees is False


def test_a_count_agrees_if_ours_lies_in_its_own_interval() -> None:
    for share, agrees in ((0.05, True), (0.08, False)):
        ours = Estimate(value=share, low=share, high=share)
        none = FigureComparison(label="", ours=ours, paper=0.0, scale=100.0, paper_ends=(0.0, 7.1))
        assert none.agrees is agrees


def test_what_is_not_compared_has_no_say() -> None:
    silent = FigureComparison(label="", ours=OURS, paper=99.0, counts=False)
    assert silent.agrees is None
    assert judge([HOLDS], [silent])[0] is PaperVerdict.REPRODUCED
    assert FigureComparison(label="", ours=OURS).agrees is None


@pytest.mark.parametrize(
    ("values", "below", "above"),
    [
        ([-1.0, -1.1, -0.9], ClaimState.HOLDS, ClaimState.CONTRADICTED),
        ([1.0, 1.1, 0.9], ClaimState.CONTRADICTED, ClaimState.HOLDS),
        ([-1.0, 1.0, 0.5], ClaimState.UNDECIDED, ClaimState.UNDECIDED),
        ([-1.0], ClaimState.UNDECIDED, ClaimState.UNDECIDED),
    ],
)
def test_a_direction_is_decided_by_the_whole_interval(
    values: list[float], below: ClaimState, above: ClaimState
) -> None:
    assert below_zero("", mean_of(values)).state is below
    assert above_zero("", mean_of(values)).state is above


@pytest.mark.parametrize(
    ("middle", "state"),
    [(0.0, ClaimState.HOLDS), (3.0, ClaimState.CONTRADICTED), (1.0, ClaimState.UNDECIDED)],
)
def test_the_same_up_to_a_bound(middle: float, state: ClaimState) -> None:
    difference = mean_of([middle - 0.1, middle, middle + 0.1])
    assert within("", difference, 1.0).state is state


@pytest.mark.parametrize(
    ("pairs", "state"),
    [
        (Paired(0, 22, 50), ClaimState.HOLDS),
        (Paired(22, 0, 50), ClaimState.CONTRADICTED),
        (Paired(0, 0, 50), ClaimState.UNDECIDED),
        (Paired(2, 5, 50), ClaimState.UNDECIDED),
    ],
)
def test_fewer_takes_an_exact_test(pairs: Paired, state: ClaimState) -> None:
    claim = fewer("", "the one", "the other", pairs)
    assert claim.state is state
    assert (
        f"{pairs.second_only} with the other alone, {pairs.first_only} with the one alone" in claim.evidence
    )


def test_one_exception_is_enough_against_every() -> None:
    assert every("", 50, 50).state is ClaimState.HOLDS
    assert every("", 49, 50).state is ClaimState.CONTRADICTED
    with pytest.raises(ValueError, match="0 of 0"):
        every("", 0, 0)


def test_most_is_decided_by_the_exact_interval() -> None:
    for count, state in ((150, ClaimState.HOLDS), (104, ClaimState.UNDECIDED), (50, ClaimState.CONTRADICTED)):
        assert most("", share_of([k < count for k in range(200)])).state is state


def test_numbers_in_words() -> None:
    assert number(-0.001, 2) == "0.00"
    assert number(-1.5, 1) == "\u22121.5"
    assert estimate_words(OURS, unit="mm", digits=1) == "10.0 mm [9.9, 10.1]"
    assert estimate_words(mean_of([2.0])) == "2.00 [no interval]"
    assert math.isnan(share_of([True]).next_low)
