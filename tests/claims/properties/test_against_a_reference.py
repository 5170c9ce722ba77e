"""What the avoider on trial does and a reference does not, of one claim, of a run, of many."""

from __future__ import annotations

import math

import pytest

from safety_harness.claims.properties.against import (
    SCALES,
    TOLERANCE,
    Against,
    ClaimDifference,
    RunDifference,
    VerdictChange,
)
from safety_harness.claims.properties.base import Evaluation, Unit
from safety_harness.scenario.model import Verdict
from safety_harness.trace.overruling import Overruling

HOLDS, VIOLATED, INCONCLUSIVE = Verdict.HOLDS, Verdict.VIOLATED, Verdict.INCONCLUSIVE


def said(verdict: Verdict, margin: float | None, sentence: str = "a distance") -> Evaluation:
    return Evaluation(
        sentence=sentence, verdict=verdict, unit=Unit.LENGTH, margin=margin, reason="", exercised=1
    )


def one(mine: float | None, reference: float | None, sentence: str = "a distance") -> ClaimDifference:
    def of(margin: float | None) -> Evaluation:
        verdict = INCONCLUSIVE if margin is None else VIOLATED if margin < 0.0 else HOLDS
        return said(verdict, margin, sentence)

    return ClaimDifference(mine=of(mine), reference=of(reference))


def run(*claims: ClaimDifference, name: str = "a", mine: int = 0, reference: int = 0) -> RunDifference:
    return RunDifference(
        run=name, claims=claims, mine=Overruling(4, mine, 0), reference=Overruling(4, 0, reference)
    )


def against(*runs: RunDifference, drawn: bool = True) -> Against:
    return Against(mine="mine", reference="ref", runs=runs, drawn=drawn)


@pytest.mark.parametrize(
    ("mine", "reference", "change"),
    [
        (-0.001, 0.001, VerdictChange.NEW),
        (-0.001, None, VerdictChange.NEW),
        (-0.030, -0.010, VerdictChange.DEEPER),
        (-0.0199, -0.010, VerdictChange.NONE),
        (0.001, -0.001, VerdictChange.GONE),
        (0.100, 0.120, VerdictChange.LOST),
        (0.100, 0.109, VerdictChange.NONE),
        (0.120, 0.100, VerdictChange.NONE),
        (None, 0.100, VerdictChange.SILENT),
        (None, -0.100, VerdictChange.NONE),
        (None, None, VerdictChange.NONE),
    ],
)
def test_a_claim_changes_as_its_two_verdicts_and_margins_say(
    mine: float | None, reference: float | None, change: VerdictChange
) -> None:
    assert one(mine, reference).change is change


def test_the_tolerance_of_a_length_is_10_mm_and_every_unit_has_one() -> None:
    assert math.isclose(TOLERANCE * SCALES[Unit.LENGTH], 0.01)
    assert set(SCALES) == set(Unit)


def test_only_what_the_reference_does_not_do_is_told_of_a_run() -> None:
    lines = list(run(one(-0.1, -0.1), one(0.1, -0.1), one(-0.1, 0.02), mine=3, reference=1).lines("ref"))
    assert lines == [
        "new violation: a: a distance: -100.0 mm against +20.0 mm with ref",
        "overruled more: a: 3 of 4 proposals against 1 of 4 with ref",
    ]
    assert not list(run(one(0.3, 0.1), mine=1, reference=2).lines("ref"))


def test_the_sentence_counts_runs_in_pairs_with_mcnemars_exact_p() -> None:
    new, gone, same = run(one(-0.1, 0.1)), run(one(0.1, -0.1)), run(one(-0.1, -0.1))
    found = against(*[new] * 12, gone, *[same] * 55)
    assert found.sentence == (
        "mine violates a claim that ref keeps in 12 of 68 runs; the other way round in 1 (p = 0.0034)"
    )
    by_hand = 2.0 * sum(math.comb(13, k) for k in (0, 1)) / 2**13
    assert f"(p = {by_hand:.2g})" in found.sentence
    assert "(p" not in against(*[new] * 12, gone, drawn=False).sentence


def test_a_run_in_which_each_violates_what_the_other_keeps_speaks_for_neither() -> None:
    both = run(one(-0.1, 0.1, "first"), one(0.1, -0.1, "second"))
    assert against(both, run(one(-0.1, 0.1))).sentence == (
        "mine violates a claim that ref keeps in 1 of 2 runs; the other way round in 0; in 1 each violates "
        "one that the other keeps (p = 1)"
    )


def test_a_violation_without_a_verdict_of_the_reference_is_told_and_not_tested() -> None:
    found = against(run(one(-0.1, None)))
    assert found.worse
    assert "in 0 of 1 runs" in found.sentence
    assert found.sentence.endswith("; in 1 more, where ref has no verdict")


@pytest.mark.parametrize(
    ("pair", "worse"),
    [((-0.1, 0.1), True), ((-0.2, -0.1), True), ((None, 0.1), True), ((0.1, 0.2), False)],
)
def test_worse_are_violations_and_lost_verdicts_but_not_lost_margins(
    pair: tuple[float | None, float | None], worse: bool
) -> None:
    assert against(run(one(*pair))).worse is worse


def test_two_that_do_the_same_say_that_there_is_nothing_new() -> None:
    assert list(against(run(one(-0.1, -0.1), mine=2, reference=2)).lines()) == [
        "mine: no violation that ref does not have, in 1 runs",
        "mine violates a claim that ref keeps in 0 of 1 runs; the other way round in 0 (p = 1)",
        "overruled were of mine 2 of 4 proposals (50%), of ref 2 of 4 proposals (50%): a greater share in 0 "
        "runs, a lesser in 0 (p = 1)",
    ]


def test_lost_margins_are_counted_with_the_worst_of_them() -> None:
    found = list(against(run(one(0.1, 0.12)), run(one(0.1, 0.2), name="b"), run(one(0.5, 0.5))).lines())
    assert found[0] == (
        "a distance: margin lost in 2; the most lost in b: +100.0 mm against +200.0 mm with ref"
    )


def test_a_margin_that_is_not_finite_is_null_for_programs() -> None:
    (claim,) = against(run(one(math.inf, 0.1))).as_json()["runs"][0]["claims"]
    assert claim["margins_si"] == [None, 0.1]
