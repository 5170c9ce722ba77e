"""Vacuity accounting: a suite in which a claim was never put to the test says so."""

from __future__ import annotations

from dataclasses import replace
from math import inf, nan

import pytest
from hypothesis import given
from hypothesis import strategies as st

from safety_harness.claims.properties.base import Evaluation, Unit
from safety_harness.claims.properties.tally import Judged, table, table_lines, tally_claims, untested_lines
from safety_harness.scenario.model import Verdict

SENTENCE = "hand distance never below 50 mm"
H, V, U = Verdict.HOLDS, Verdict.VIOLATED, Verdict.INCONCLUSIVE


def judged(
    verdict: Verdict,
    *,
    exercised: int,
    margin: float | None = None,
    expected: Verdict = H,
    run: str = "a run",
    sentence: str = SENTENCE,
) -> Judged:
    evaluation = Evaluation(
        sentence=sentence,
        verdict=verdict,
        unit=Unit.LENGTH,
        margin=margin,
        worst_time_s=None if margin is None else 1.5,
        reason="",
        exercised=exercised,
    )
    return Judged(run=run, evaluation=evaluation, expected=expected)


def test_runs_occasions_and_verdicts_are_counted_by_sentence() -> None:
    other = "TCP speed never above 250 mm/s"
    first, second = tally_claims(
        [
            judged(H, exercised=3, margin=0.2, run="slow"),
            judged(H, exercised=9, margin=0.1, sentence=other),
            judged(V, exercised=1, margin=-0.01, run="fast"),
            judged(U, exercised=0, run="nobody"),
        ]
    )
    assert (first.sentence, second.sentence) == (SENTENCE, other)
    assert (first.runs, first.exercised, first.occasions) == (3, 2, 4)
    assert (first.holds, first.violated, first.inconclusive) == (1, 1, 1)
    assert first.worst is not None
    assert first.worst.run == "fast"
    assert first.worst_words == "-10.0 mm at 1.500 s, fast"
    assert not first.untested


@pytest.mark.parametrize(
    ("outcomes", "untested"),
    [
        ([(U, 0, H)], True),
        ([(U, 0, V)], True),
        ([(U, 0, U)], False),  # its author knows that it says nothing
        ([(U, 0, H), (U, 0, U)], True),
        ([(U, 0, H), (H, 1, U)], True),  # tested only where nobody expected anything
        ([(U, 0, H), (H, 1, H)], False),
        ([(U, 2, H)], False),  # exercised, but cut short
        ([(V, 0, H)], False),  # a violation is a test
    ],
)
def test_a_claim_is_untested_if_no_run_that_was_expected_to_tell_put_it_to_the_test(
    outcomes: list[tuple[Verdict, int, Verdict]], untested: bool
) -> None:
    (found,) = tally_claims(judged(v, exercised=n, expected=e) for v, n, e in outcomes)
    assert found.untested is untested
    assert bool(untested_lines([found])) is untested
    assert ("NEVER PUT TO THE TEST" in table_lines([found])[1]) is untested


def test_what_was_never_exercised_is_counted_with_what_the_nearest_run_lacked() -> None:
    every = [judged(U, exercised=0, margin=m, sentence="a") for m in (0.3, 0.1, nan)]
    tallies = tally_claims([*every, judged(H, exercised=1, sentence="b")])
    first, *lines = untested_lines(tallies)
    assert first == "1 of 2 claims were never exercised, and nothing is shown of:"
    assert tallies[0].nearest == every[1]
    assert lines == ["  a", f"    {every[1].run}: {every[1].evaluation.reason}"]


def unmeasured(run: str = "a log", sentence: str = SENTENCE) -> Judged:
    one = judged(U, exercised=7, run=run, sentence=sentence)
    return replace(one, evaluation=replace(one.evaluation, reason="not measured: mode", unmeasured=("mode",)))


def test_what_was_not_measured_is_no_test_and_is_told_apart_from_what_was_never_exercised() -> None:
    every = [unmeasured(sentence="a"), judged(U, exercised=0, sentence="b"), judged(H, exercised=1)]
    tallies = tally_claims(every)
    assert [(t.untested, t.exercised, t.occasions, t.unmeasured) for t in tallies] == [
        (True, 0, 0, 1),
        (True, 0, 0, 0),
        (False, 1, 1, 0),
    ]
    assert untested_lines(tallies) == [
        "1 of 3 claims were never exercised, and nothing is shown of:",
        "  b",
        "    a run: ",
        "1 of 3 claims were not measured, and nothing is shown of:",
        "  a",
        "    a log: not measured: mode",
    ]
    lacking, idle, _ = table_lines(tallies)[1:]
    assert lacking.endswith("1 (1 not measured)  NOT MEASURED")
    assert idle.endswith("NEVER PUT TO THE TEST")


def test_one_run_that_was_measured_is_a_test() -> None:
    (found,) = tally_claims([unmeasured(), judged(H, exercised=2, margin=0.1)])
    assert (found.untested, found.runs, found.exercised, found.occasions) == (False, 2, 1, 2)
    assert "1 (1 not measured)  +100.0 mm" in table_lines([found])[1]


def test_a_margin_that_is_not_finite_is_never_the_worst() -> None:
    (found,) = tally_claims([judged(U, exercised=1, margin=m) for m in (nan, inf, -inf)])
    assert found.worst is None
    assert found.worst_words == "-"
    zero, *_ = tally_claims([judged(H, exercised=1, margin=m) for m in (0.1, 0.0, nan)])
    assert zero.worst is not None
    assert zero.worst.evaluation.margin == 0.0


def test_no_claim_at_all_gives_no_table() -> None:
    assert tally_claims([]) == ()
    assert table_lines([]) == []


@given(
    st.lists(
        st.tuples(
            st.sampled_from(Verdict), st.integers(0, 5), st.sampled_from(Verdict), st.sampled_from("abc")
        )
    )
)
def test_nothing_is_lost_and_order_of_runs_does_not_matter(
    outcomes: list[tuple[Verdict, int, Verdict, str]],
) -> None:
    every = [judged(v, exercised=n, expected=e, sentence=s) for v, n, e, s in outcomes]
    tallies = tally_claims(every)
    assert sum(t.runs for t in tallies) == len(every)
    assert sum(t.occasions for t in tallies) == sum(one.evaluation.exercised for one in every)
    for t in tallies:
        assert t.holds + t.violated + t.inconclusive == t.runs
        assert t.exercised <= t.runs
    assert set(tally_claims(reversed(every))) == set(tallies)


def test_columns_of_the_table_stand_below_each_other() -> None:
    tallies = tally_claims(
        [judged(H, exercised=12345, margin=0.2), judged(V, exercised=1, margin=-1.0, sentence="short")]
    )
    head, first, second = table_lines(tallies)
    end = head.index("occasions") + len("occasions")
    assert (first[:end].split()[-1], second[:end].split()[-1]) == ("12345", "1")


def test_a_table_that_does_not_fit_is_a_block_for_each_row() -> None:
    head, rows = ("region", "avoider", "mean", "worst"), [("seen", "mine", "1.5", "10.25")]
    assert table(head, rows, 80, right=range(2, 4)) == [
        "region  avoider  mean  worst",
        "seen    mine      1.5  10.25",
    ]
    assert table(head, rows, 27) == ["seen, mine", "  mean 1.5; worst 10.25"]
    assert table(head, []) == []
    assert table(head, rows, 28) == table(head, rows)
