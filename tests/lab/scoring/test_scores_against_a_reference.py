"""An avoider beside a reference: what the reference does too is no finding, and more errors are one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import score_cards

from safety_harness.base.settings import DEFAULTS
from safety_harness.extensions.lab.scoring.against import findings_against
from safety_harness.extensions.lab.scoring.scorecard import Kind, Scorecard, ScoreFinding

OFF = ScoreFinding(Kind.FAR_OFF, "seen", "far")
JUMPS = ScoreFinding(Kind.JUMPS, "seen", "jumps")
SETTINGS = (DEFAULTS, DEFAULTS)
SOUND, WRONG = score_cards.scorecard(), score_cards.scorecard("wrong", shift_m=0.07)


def test_findings_that_the_reference_has_in_that_region_do_not_count() -> None:
    assert findings_against(SOUND, [OFF, JUMPS], SOUND, [OFF], SETTINGS) == (JUMPS,)
    elsewhere = replace(OFF, region="far")
    assert findings_against(SOUND, [OFF], SOUND, [elsewhere], SETTINGS) == (OFF,)


def test_more_errors_on_the_same_questions_are_a_finding_with_counts() -> None:
    (found,) = findings_against(WRONG, [], SOUND, [], SETTINGS)
    assert (found.kind, found.region) == (Kind.FAR_OFF, "seen")
    wrong = int(np.count_nonzero(WRONG.regions[0].questions.hands_in_base_m[:, 1] < -0.35))
    assert f"on {wrong} questions where mc-dropout does not" in found.words
    assert "and the reverse on 0, of 200" in found.words
    assert len(found.questions) == 3


def test_fewer_errors_than_the_reference_are_none() -> None:
    assert findings_against(SOUND, [], WRONG, [], SETTINGS) == ()


def test_a_difference_that_chance_may_make_is_none() -> None:
    region = SOUND.regions[0]
    positions = region.answers.positions_in_base_m.copy()
    positions[:5] += 1.0
    few = replace(
        SOUND, regions=(replace(region, answers=replace(region.answers, positions_in_base_m=positions)),)
    )
    assert findings_against(few, [], SOUND, [], SETTINGS) == ()
    positions[:12] += 1.0
    assert len(findings_against(few, [], SOUND, [], SETTINGS)) >= 1


def with_answers(**changed: object) -> Scorecard:
    region = SOUND.regions[0]
    return replace(SOUND, regions=(replace(region, answers=replace(region.answers, **changed)),))


def moved(rows: int, by_m: float) -> Scorecard:
    """The first answers moved along x."""
    positions = SOUND.regions[0].answers.positions_in_base_m.copy()
    positions[:rows, 0] += by_m
    return with_answers(positions_in_base_m=positions)


@pytest.mark.parametrize(("rows", "named"), [(15, False), (40, True)])
def test_a_little_worse_counts_on_more_than_a_share_of_the_questions(rows: int, named: bool) -> None:
    reference, positions = moved(200, 0.055), moved(200, 0.055).regions[0].answers.positions_in_base_m.copy()
    positions[:rows, 0] += 0.010
    found = findings_against(with_answers(positions_in_base_m=positions), [], reference, [], SETTINGS)
    assert [one.kind for one in found] == [Kind.FAR_OFF] * named


@pytest.mark.parametrize(("by_m", "named"), [(-0.015, False), (-0.025, True), (0.025, False)])
def test_answers_over_20_mm_farther_off_than_the_references_are_a_finding(by_m: float, named: bool) -> None:
    reference, far = moved(200, -0.030), moved(200, -0.030).regions[0].answers.positions_in_base_m.copy()
    far[:, 0] += by_m
    found = findings_against(with_answers(positions_in_base_m=far), [], reference, [], SETTINGS)
    assert [one.words.split(" on ")[0] for one in found] == (
        ["answers over 20 mm farther off the optimum than the other"] * named
    )


def test_sure_where_the_reference_doubts_is_a_finding() -> None:
    thresholds = np.full(200, 0.010)
    doubts = with_answers(spreads_m=np.full((200, 3), 0.02), thresholds_m=thresholds)
    sure = with_answers(spreads_m=np.full((200, 3), 0.001), thresholds_m=thresholds)
    (found,) = findings_against(sure, [], doubts, [], SETTINGS)
    assert found.kind is Kind.SPREAD_MISSES
    assert "no spread above its threshold" in found.words
    assert "on 200 questions" in found.words
    assert findings_against(doubts, [], sure, [], SETTINGS) == ()


@pytest.mark.parametrize(("declared_s", "named"), [(0.096, True), (0.008, False), (0.0, False)])
def test_a_declared_time_of_more_than_a_tick_above_the_reference_is_a_finding(
    declared_s: float, named: bool
) -> None:
    assert SOUND.times is not None
    late = replace(SOUND, times=replace(SOUND.times, declared_s=declared_s))
    found = findings_against(late, [], SOUND, [], SETTINGS)
    assert [one.words for one in found] == (
        ["declares 96 ms for a decision, over a tick more than 0 ms of mc-dropout"] if named else []
    )


def test_no_answer_is_an_error() -> None:
    region = SOUND.regions[0]
    silent = replace(region.answers, positions_in_base_m=np.full((200, 3), np.nan))
    card = replace(SOUND, regions=(replace(region, answers=silent),))
    kinds = {one.kind for one in findings_against(card, [], SOUND, [], SETTINGS)}
    assert kinds == {Kind.FAR_OFF, Kind.LEADS_TOWARDS}


def test_cards_of_other_questions_are_refused() -> None:
    region = SOUND.regions[0]
    others = replace(region.questions, seeds=region.questions.seeds + np.uint64(1))
    card = replace(SOUND, regions=(replace(region, questions=others),))
    with pytest.raises(ValueError, match="same questions"):
        findings_against(card, [], SOUND, [], SETTINGS)
