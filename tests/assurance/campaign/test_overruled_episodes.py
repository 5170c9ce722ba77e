"""Episodes in which the gate overruled a proposal, as a sample that bounds and paired tests take."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import pytest

from safety_harness.base.exceptions import StatisticsError
from safety_harness.extensions.assurance.campaign.ledger import Ledger
from safety_harness.extensions.assurance.campaign.overruled import (
    compare_overruling,
    overruled_episodes,
    overruling_in,
)
from safety_harness.extensions.assurance.campaign.rows import ClaimJudgement, Row
from safety_harness.extensions.assurance.campaign.summary import state_of
from safety_harness.extensions.assurance.commands.campaign_lines import ledger_lines
from safety_harness.extensions.assurance.statistics.sample import EpisodeOutcome
from safety_harness.trace.overruling import Overruling
from safety_harness.trace.records import Check
from tests.assurance.campaign.plans import PLAN, ledger_in, plan_in

SMALL = PLAN.replace("runs: 30", "runs: 8").replace("runs: 20", "runs: 2")
NONE_ASKED, LET_THROUGH = Overruling(), Overruling(2)
OVERRULED = Overruling(4, 2, 1, Counter({Check.UNCERTAIN: 3, Check.TABLE: 1}))


def recorded(folder: Path, *overruling: Overruling, failed: int = 0) -> Ledger:
    """The first stratum's episodes, the last ``failed`` of them broken; the second's are let through."""
    ledger = ledger_in(folder, plan_in(folder, SMALL))
    last = len(overruling) - failed
    for stratum, of in enumerate((overruling, (LET_THROUGH, LET_THROUGH))):
        ledger.record(
            Row(
                stratum=stratum,
                episode=k,
                seed=11 + k,
                judgements=(ClaimJudgement(EpisodeOutcome.HOLDS, 0.1, 0.2, 3),) * 2,
                overruling=one,
                failure="cut short" if stratum == 0 and k >= last else "",
            )
            for k, one in enumerate(of)
        )
    return ledger


def test_counts_are_there_again_by_stratum_and_together(tmp_path: Path) -> None:
    with recorded(tmp_path, *(OVERRULED,) * 3, *(LET_THROUGH,) * 5) as ledger:
        assert overruling_in(ledger, 0) == OVERRULED + OVERRULED + OVERRULED + Overruling(10)
        assert overruling_in(ledger, 1) == Overruling(4)
        assert overruling_in(ledger).proposals == 26
        lines = [line.strip() for line in ledger_lines(ledger, state_of(ledger))]
    counts = "9 uncertain, 3 table; 6 replaced by the opposite pose, 3 by a stop"
    assert f"overruled 9 of 26 proposals (34.6 %): {counts}" in lines
    assert "by stratum: near 40.9 %, nearer 0 %" in lines


def test_an_episode_without_a_proposal_is_no_trial_and_a_broken_one_may_have_had_one(tmp_path: Path) -> None:
    told = (OVERRULED, LET_THROUGH, NONE_ASKED, LET_THROUGH, NONE_ASKED, OVERRULED, LET_THROUGH, NONE_ASKED)
    with recorded(tmp_path, *told, failed=3) as ledger:
        sample = overruled_episodes(ledger, 0)
    of = EpisodeOutcome
    expected = [of.VIOLATED, of.HOLDS, of.UNTESTED, of.HOLDS, of.UNTESTED, of.VIOLATED, of.FAILED, of.FAILED]
    assert sample.outcomes.tolist() == expected
    assert (sample.trials, sample.violations, sample.at_worst) == (6, 2, 4)


def test_of_a_stratum_that_misses_episodes_nothing_is_estimated(tmp_path: Path) -> None:
    with recorded(tmp_path, OVERRULED) as ledger, pytest.raises(StatisticsError, match="incomplete"):
        overruled_episodes(ledger, 0)


def test_two_campaigns_are_paired_by_episode(tmp_path: Path) -> None:
    before = (OVERRULED, *(LET_THROUGH,) * 7)
    after = (*(OVERRULED,) * 6, NONE_ASKED, LET_THROUGH)
    with (
        recorded(tmp_path / "a", *before) as first,
        recorded(tmp_path / "b", *after, failed=1) as second,
    ):
        near, nearer = compare_overruling(first, second)
    one = near.episodes
    assert (one.both, one.only_first, one.only_second, one.unclear) == (1, 5, 0, 1)
    assert one.p_value == pytest.approx(2 * 0.5**5)
    assert near.summary == (
        "near: overruled 69.2 % of 26 proposals, before 16.7 % of 18 (+52.6%); of 8 episodes some proposal "
        "was overruled both times in 1, only after in 5, only before in 0, unclear 1; p 0.0625 (McNemar, of "
        "its own line alone)"
    )
    assert (nearer.before, nearer.episodes.p_value) == (Overruling(4), 1.0)
