"""An avoider beside a reference: what the reference does too is no finding, and more errors are one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import score_cards

from safety_harness.scoring.against import findings_against
from safety_harness.scoring.scorecard import Kind, ScoreFinding
from safety_harness.settings import DEFAULTS

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
    assert f"on {wrong} questions on which mc-dropout does neither" in found.words
    assert "way round on 0, of 200" in found.words
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
