"""What a pilot says of a plan, against counts by hand, and that it looks at none of the plan's own runs."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import scipy.stats

from safety_harness.extensions.assurance.campaign.episodes import EpisodeRunner, root_seed
from safety_harness.extensions.assurance.campaign.pilot import FIRST, aim_of, forecast, pilot, too_few
from safety_harness.extensions.assurance.campaign.plan import Plan
from safety_harness.extensions.assurance.campaign.summary import CampaignTally, ClaimCounts, StratumTally
from safety_harness.extensions.assurance.statistics.planning import runs_for_tested, runs_needed
from safety_harness.extensions.assurance.statistics.sample import EpisodeOutcome
from tests.assurance.campaign.plans import PLAN, plan_in

TARGETED = PLAN.replace("within limits\n", "within limits\n    violated in at most: 2 %\n").replace(
    "runs: 30", "runs: 300"
)


@pytest.fixture
def plan(tmp_path: Path) -> Plan:
    return plan_in(tmp_path, TARGETED)


def test_of_300_runs_for_2_percent_61_test_it_and_it_says_how_many_are_needed(plan: Plan) -> None:
    found = forecast(plan, 0, 1, tried=49, tested=10, bad=0)
    assert found.expected[1] == 61
    assert found.expected[0] < 61 < found.expected[2]
    needed = runs_needed(aim_of(plan, 0.02))
    assert found.needed == needed
    assert found.runs_needed is not None
    assert scipy.stats.binom.sf(needed - 1, found.runs_needed, 10 / 49) >= 0.9
    assert scipy.stats.binom.sf(needed - 1, found.runs_needed - 1, 10 / 49) < 0.9
    assert not found.enough
    assert f"300 runs for 2 %: 61 will test it ({found.expected[0]} to {found.expected[2]}); " in found.line
    assert found.line.endswith(f"{found.runs_needed} runs are needed")


def test_where_all_runs_test_a_claim_the_bound_alone_says_how_many(plan: Plan) -> None:
    found = forecast(plan, 0, 1, tried=30, tested=30, bad=0)
    assert found.runs_needed == runs_needed(aim_of(plan, 0.02))
    assert found.enough
    assert not forecast(plan, 1, 1, tried=30, tested=30, bad=0).enough  # 20 runs


def test_what_the_pilot_violates_takes_more_runs_or_cannot_be_shown(plan: Plan) -> None:
    spotless = forecast(plan, 0, 0, tried=50, tested=50, bad=0)
    some = forecast(plan, 0, 0, tried=50, tested=50, bad=10)
    assert spotless.runs_needed is not None
    assert some.runs_needed is not None
    assert some.runs_needed > spotless.runs_needed
    most = forecast(plan, 0, 0, tried=50, tested=50, bad=45)
    assert most.runs_needed is None
    assert "no number of runs will show it" in most.line
    assert "too near to the target" in forecast(plan, 0, 0, tried=50, tested=50, bad=25).line


def test_a_claim_that_no_run_of_the_pilot_tests_is_not_enough(plan: Plan) -> None:
    found = forecast(plan, 0, 1, tried=30, tested=0, bad=0)
    assert not found.enough
    assert "untested in 30 runs" in found.line


@pytest.mark.parametrize("share", [0.02, 0.5, 0.97, 1.0])
def test_it_is_the_least_number_of_runs_that_gives_so_many_tested_ones(share: float) -> None:
    runs = runs_for_tested(40, share=share, wanted=0.8)
    assert scipy.stats.binom.sf(39, runs, share) >= 0.8
    assert runs == 40 or scipy.stats.binom.sf(39, runs - 1, share) < 0.8


def test_a_campaign_is_warned_by_its_own_first_runs_and_not_by_fewer(plan: Plan) -> None:
    def tally(done: int, untested: int) -> CampaignTally:
        counts = {EpisodeOutcome.HOLDS: done - untested, EpisodeOutcome.UNTESTED: untested}
        claims = [ClaimCounts(dict.fromkeys(EpisodeOutcome, 0) | counts) for _ in plan.claims]
        first = StratumTally(300, claims, done=done)
        return CampaignTally([first, StratumTally(20, [ClaimCounts() for _ in plan.claims])])

    (found,) = too_few(plan, tally(FIRST, 20))
    assert (found.stratum, found.sentence) == ("near", "joint speeds within limits")
    assert list(too_few(plan, tally(FIRST, 0))) == []
    assert list(too_few(plan, tally(FIRST - 1, 20))) == []


def test_a_pilot_runs_other_episodes_than_the_plan(plan: Plan, monkeypatch: pytest.MonkeyPatch) -> None:
    seeds: list[int] = []
    draw = EpisodeRunner.draw

    def noted(self: EpisodeRunner, stratum: int, k: int, *first: Any) -> Any:
        seeds.append(root_seed(self.plan, stratum, k))
        return draw(self, stratum, k, *first)

    monkeypatch.setattr(EpisodeRunner, "draw", noted)
    found = pilot(plan, 4)
    assert len(seeds) == 8
    own = {root_seed(plan, stratum, k) for stratum in (0, 1) for k in range(300)}
    assert own.isdisjoint(seeds)
    assert [one.tried for one in found.forecasts] == [4] * 4
    assert found.failures == ()
    assert found.seconds(plan, 2) == pytest.approx((300 * found.run_s[0] + 20 * found.run_s[1]) / 2)


AVOIDERS = """
from safety_harness import Proposal


class Raises:
    name = "raises"

    def propose(self, *, hand_position_in_base_m, tcp_position_in_base_m, seed):
        raise ValueError("no idea")


class Remembers:
    name = "remembers"
    asked = 0

    def propose(self, *, hand_position_in_base_m, tcp_position_in_base_m, seed):
        self.asked += 1
        return Proposal(tcp_position_in_base_m + [0.0, 0.0, 0.001 * self.asked])
"""


def of(folder: Path, avoider: str) -> Plan:
    folder.mkdir(exist_ok=True)
    (folder / "mine.py").write_text(AVOIDERS)
    return plan_in(folder, PLAN.replace("avoider: opposite pose", f"avoider: mine.py:{avoider}"))


def test_a_pilot_of_an_avoider_that_gives_no_answer_is_not_enough(tmp_path: Path) -> None:
    found = pilot(of(tmp_path, "Raises"), 4)
    (remark,) = found.remarks
    assert "with the fallback in its place" in remark
    assert not found.enough


def test_nor_is_one_of_an_avoider_that_remembers(tmp_path: Path) -> None:
    found = pilot(of(tmp_path, "Remembers"), 8)
    (remark,) = found.remarks
    assert "the avoider remembers" in remark
    assert not found.enough


def test_where_the_plan_claims_that_it_answers_the_claim_says_it(tmp_path: Path) -> None:
    text = PLAN.replace("  - claim: joint speeds", "  - claim: the avoider answered\n  - claim: joint speeds")
    (tmp_path / "mine.py").write_text(AVOIDERS)
    plan = plan_in(tmp_path, text.replace("opposite pose", "mine.py:Raises"))
    assert pilot(plan, 4).remarks == ()
