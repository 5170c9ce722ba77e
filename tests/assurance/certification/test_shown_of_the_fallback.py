"""How often the avoider did not answer, and what may be shown then: read off rows that are made up."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from safety_harness.extensions.assurance.campaign.rows import ClaimJudgement, Row
from safety_harness.extensions.assurance.campaign.summary import FallbackTally, fallback_of
from safety_harness.extensions.assurance.certification.argument import argument_of
from safety_harness.extensions.assurance.certification.evidence import UNANSWERED, ClaimStatus
from safety_harness.extensions.assurance.certification.findings import of_strata
from safety_harness.extensions.assurance.certification.folder import junit_xml
from safety_harness.extensions.assurance.certification.page import render
from safety_harness.extensions.assurance.certification.results import claims_of, strata_of
from safety_harness.extensions.assurance.statistics.sample import EpisodeOutcome
from safety_harness.trace.answer_times import AnswersTook
from safety_harness.trace.overruling import Overruling
from tests.assurance.campaign.plans import PLAN, ledger_in, plan_in
from tests.assurance.certification.made_up_evidence import evidence

IN_PYBULLET = PLAN.replace("world: kinematic", "world: PyBullet")
CLAIMED = "  - claim: The avoider answered\n    violated in at most: 50 %\nkeep:"
WHY = "the avoider gave no answer: ValueError"


def row(
    stratum: int,
    episode: int,
    claims: int,
    *,
    silent: int = 0,
    why: str = WHY,
    overruling: Overruling = Overruling(),  # noqa: B008  # it is frozen
    times: AnswersTook = AnswersTook(),  # noqa: B008
) -> Row:
    return Row(
        stratum=stratum,
        episode=episode,
        seed=episode,
        judgements=(ClaimJudgement(EpisodeOutcome.HOLDS, 0.05, 0.1, 1),) * claims,
        draws=1,
        decisions=2,
        proposed=2 - silent,
        opposite=silent,
        faults=silent,
        run_error=why if silent else "",
        overruling=overruling,
        times=times,
    )


def standings(
    folder: Path, *, silent: Sequence[int], claimed: bool
) -> tuple[list[ClaimStatus], list[str], list[str], list[FallbackTally]]:
    """Of the first claim in both strata: standings, why, findings of the strata, and the counts.

    ``silent`` says to how many of its two questions each run of the second stratum got no answer.
    """
    plan = plan_in(folder, IN_PYBULLET.replace("keep:", CLAIMED) if claimed else IN_PYBULLET)
    with ledger_in(folder, plan) as ledger:
        count = len(plan.claims)
        ledger.record(row(0, k, count) for k in range(30))
        ledger.record(row(1, k, count, silent=silent[k]) for k in range(20))
        outcomes = claims_of(plan, ledger)[0].outcomes
        found = [one.text for one in of_strata(ledger, strata_of(plan, ledger))]
        counts = [fallback_of(ledger), fallback_of(ledger, 0), fallback_of(ledger, 1)]
    return [one.standing for one in outcomes], [one.why for one in outcomes], found, counts


@pytest.mark.parametrize("claimed", [False, True])
def test_an_avoider_that_always_answers_changes_nothing(tmp_path: Path, claimed: bool) -> None:
    found, why, findings, counts = standings(tmp_path, silent=[0] * 20, claimed=claimed)
    assert found == [ClaimStatus.SHOWN, ClaimStatus.SHOWN]
    assert not any("fallback" in text for text in [*why, *findings])
    assert [one.summary for one in counts] == [""] * 3


@pytest.mark.parametrize(("claimed", "expected"), [(False, ClaimStatus.DOUBTED), (True, ClaimStatus.SHOWN)])
def test_one_missing_answer_leaves_doubt_unless_the_plan_says_how_many_there_may_be(
    tmp_path: Path, claimed: bool, expected: ClaimStatus
) -> None:
    found, why, findings, counts = standings(tmp_path, silent=[1] + [0] * 19, claimed=claimed)
    words = "the avoider did not always answer: with the fallback in its place in 1 of 40 decisions"
    assert found == [ClaimStatus.SHOWN, expected]
    assert "fallback" not in why[0]
    assert words in why[1]
    assert findings == [f"nearer: {words}; most often: {WHY}"]
    assert counts == [
        FallbackTally(1, 100, 1, WHY),
        FallbackTally(0, 60, 0, ""),
        FallbackTally(1, 40, 1, WHY),
    ]


@pytest.mark.parametrize("claimed", [False, True])
def test_nothing_is_shown_in_green_of_an_avoider_that_never_answered(tmp_path: Path, claimed: bool) -> None:
    found, why, _, counts = standings(tmp_path, silent=[2] * 20, claimed=claimed)
    assert found == [ClaimStatus.SHOWN, ClaimStatus.DOUBTED]
    assert "the avoider did not answer: with the fallback in its place in 40 of 40 decisions" in why[1]
    assert counts[0].summary.startswith("the avoider did not always answer")


@pytest.mark.parametrize(
    ("row_of_second", "status", "words"),
    [
        ({"overruling": Overruling(2, 1, 1)}, ClaimStatus.DOUBTED, "the gate overruled all 40 proposals"),
        ({"overruling": Overruling(4, 1, 2)}, ClaimStatus.SHOWN, ""),
        (
            {"times": AnswersTook(2, 2, 0.3, 0.008)},
            ClaimStatus.DOUBTED,
            "(100 %) took longer",
        ),
        ({"times": AnswersTook(4, 2, 0.3, 0.008)}, ClaimStatus.SHOWN, ""),
    ],
)
def test_a_target_met_without_the_avoider_or_with_late_answers_is_in_doubt(
    tmp_path: Path, row_of_second: dict[str, Any], status: ClaimStatus, words: str
) -> None:
    plan = plan_in(tmp_path, IN_PYBULLET)
    with ledger_in(tmp_path, plan) as ledger:
        count = len(plan.claims)
        ledger.record(row(0, k, count) for k in range(30))
        ledger.record(row(1, k, count, **row_of_second) for k in range(20))
        first, second = claims_of(plan, ledger)[0].outcomes
        found = [item.text for item in of_strata(ledger, strata_of(plan, ledger))]
    assert (first.standing, second.standing) == (ClaimStatus.SHOWN, status)
    assert words in second.why
    hidden = any("more of the gate and its fallback than of the avoider" in text for text in found)
    assert hidden == ("overruling" in row_of_second)


def test_page_argument_and_junit_say_it_in_their_headlines() -> None:
    plain = evidence()
    assert plain.fallback == ""
    first, *others = plain.strata
    silent = replace(
        plain, strata=(replace(first, decisions=(("opposite poses", 7), (UNANSWERED, 7))), *others)
    )
    words = silent.fallback
    assert words.startswith("the avoider did not always answer: with the fallback in its place in 7 of ")
    page = render(silent, {})
    for begin, end in (("<title>", "</title>"), ("<h1>", "</h1>")):
        assert words in page.split(begin)[1].split(end)[0]
    assert words in argument_of(silent).text
    assert words in junit_xml(silent).split("<testsuite ")[0]
    assert "in its place" not in render(plain, {}) + junit_xml(plain)
