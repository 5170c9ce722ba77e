"""Rare violations of a plan: the share of admitted draws, and no share where a run says nothing."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from safety_harness.base.exceptions import StatisticsError
from safety_harness.extensions.assurance.campaign import rare
from safety_harness.extensions.assurance.campaign.episodes import EpisodeRunner
from safety_harness.extensions.assurance.campaign.plan import Plan
from safety_harness.extensions.assurance.campaign.rare import RareViolation, rare_violations
from safety_harness.extensions.assurance.campaign.watch import AvoiderWatch
from safety_harness.extensions.assurance.statistics import importance
from safety_harness.extensions.assurance.statistics.importance import Importance
from safety_harness.extensions.assurance.statistics.rare import Splitting
from safety_harness.extensions.assurance.statistics.sample import EpisodeOutcome, Floats
from tests.assurance.campaign.plans import PLAN, plan_in
from tests.assurance.campaign.test_pilot import AVOIDERS

HOW = Splitting(particles=20, steps=2, replications=6)
ONE = PLAN.replace("  - stratum: nearer\n    space: short.yaml\n    runs: 20\n", "")
ONE = ONE.replace("  - claim: joint speeds within limits\n", "").replace("runs: 30", "runs: 200")


@pytest.fixture(autouse=True)
def fewer_draws(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(rare, "ADMITTED_OF", 100)
    monkeypatch.setattr(importance, "_MOST_RESTARTS", 2)  # whose regions are another test's


@pytest.fixture
def plan(tmp_path: Path) -> Plan:
    return plan_in(tmp_path, ONE)


def only(plan: Plan, how: Importance | Splitting = HOW) -> RareViolation:
    (found,) = rare_violations(plan, how)
    return found


@pytest.mark.parametrize("how", [HOW, Importance(pilot=40, runs=240, replications=6)])
def test_it_says_of_the_system_what_as_many_draws_say(plan: Plan, how: Importance | Splitting) -> None:
    found = only(plan, how)
    rows = EpisodeRunner(plan).run(0, range(200))
    violated = sum(row.judgements[0].outcome is EpisodeOutcome.VIOLATED for row in rows)
    assert 0 < violated < 200
    assert found.low < violated / 200 < found.high
    assert found.estimate.reached == how.replications
    assert found.estimate.model_only


def test_of_draws_that_are_refused_the_share_is_none(plan: Plan, monkeypatch: pytest.MonkeyPatch) -> None:
    """A violation in a thousandth of the half that is admitted."""

    def margins(_: object, points: Floats) -> Floats:
        return np.where(points[:, 0] < 0.5, rare._REFUSED, points[:, 1] - 0.001)

    monkeypatch.setattr(rare._Draws, "__call__", margins)
    monkeypatch.setattr(rare._Draws, "admitted", lambda *_: rare.ADMITTED_OF // 2)
    found = only(plan, Splitting(particles=200, steps=5, replications=20))
    assert found.low < 0.001 < found.high
    assert found.share == pytest.approx(2 * found.estimate.value)
    assert found.low < found.estimate.low * 2
    assert found.estimate.as_many_draws > found.estimate.evaluations  # it is the cheaper way


def test_a_run_that_fails_leaves_nothing_to_be_said(plan: Plan, monkeypatch: pytest.MonkeyPatch) -> None:
    broken = OSError("the disk is full")
    monkeypatch.setattr(rare, "run_all", lambda admitted, _: iter([broken] * len(admitted)))
    with pytest.raises(StatisticsError, match="the disk is full"):
        only(plan)


def test_a_run_that_is_none_leaves_nothing_to_be_said(plan: Plan, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(rare, "why_broken", lambda _: "a hand jumped")
    with pytest.raises(StatisticsError, match="a hand jumped"):
        only(plan)


def test_a_run_that_does_not_test_the_claim_is_farther_than_any_that_does(tmp_path: Path) -> None:
    far = plan_in(tmp_path, ONE.replace("never below 150 mm", "never below 1 mm"))
    draws = rare._Draws(far, far.strata[0], far.claims[0], 1)
    margins = draws(np.random.default_rng(1).random((16, far.strata[0].space.dimension)))
    assert not np.isnan(margins).any()
    tested, others = margins[margins < rare._UNTESTED / 2], margins[margins >= rare._UNTESTED / 2]
    assert len(tested) + len(others) == 16
    assert len(tested) == 0 or tested.max() < others.min(initial=np.inf)


def test_nothing_is_said_where_no_draw_can_be_run(plan: Plan, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(rare._Draws, "_admit", lambda *_: None)
    with pytest.raises(StatisticsError, match="none of 100"):
        only(plan)


def test_what_the_fallback_did_is_not_told_as_the_avoiders(tmp_path: Path) -> None:
    (tmp_path / "mine.py").write_text(AVOIDERS)
    plan = plan_in(tmp_path, ONE.replace("avoider: opposite pose", "avoider: mine.py:Raises"))
    watch = AvoiderWatch()
    assert list(rare_violations(plan, HOW, watch=watch))
    assert watch.unanswered == watch.decisions > 0
    (remark,) = watch.remarks(plan)
    assert "with the fallback in its place" in remark
