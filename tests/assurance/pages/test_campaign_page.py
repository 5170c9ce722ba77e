"""A campaign's page: what its ledger holds, and nothing shown before all of it has run."""

from __future__ import annotations

import re
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

import pytest

from safety_harness.admission.admit import admit
from safety_harness.admission.trial import run_kinematic
from safety_harness.cell.simulation.worlds import PYBULLET
from safety_harness.extensions.assurance.campaign.episodes import EpisodeRunner, trace_bytes
from safety_harness.extensions.assurance.campaign.identity import PlanFile
from safety_harness.extensions.assurance.campaign.ledger import Ledger
from safety_harness.extensions.assurance.campaign.plan import read_plan
from safety_harness.extensions.assurance.campaign.rows import ClaimJudgement, Row
from safety_harness.extensions.assurance.campaign.summary import state_of
from safety_harness.extensions.assurance.pages import campaign_page
from safety_harness.extensions.assurance.pages.campaign_page import NOT_SHOWN, REFUTED, SHOWN, write_page
from safety_harness.extensions.assurance.statistics.sample import EpisodeOutcome
from tests.assurance.campaign.plans import ledger_in, plan_in

WHEN = datetime(2026, 11, 24, tzinfo=UTC)


def row(episode: int, stratum: int, margin: float) -> Row:
    outcome = EpisodeOutcome.VIOLATED if margin < 0.0 else EpisodeOutcome.HOLDS
    judgements = (ClaimJudgement(outcome, margin, 0.25, 3), ClaimJudgement(EpisodeOutcome.UNTESTED))
    return Row(
        stratum=stratum,
        episode=episode,
        seed=100 * stratum + episode,
        judgements=judgements,
        draws=1,
        cell="a",
    )


def page_of(ledger: Ledger, folder: Path) -> str:
    write_page(folder / "campaign.html", ledger, state_of(ledger), command="again", generated_at=WHEN)
    return (folder / "campaign.html").read_text()


def words_of(page: str) -> str:
    return re.sub(r"\s+", " ", re.sub("<[^>]+>", " ", page))


@pytest.fixture
def ledger(tmp_path: Path) -> Ledger:
    """Near: 30 episodes of which 25 violate; nearer: none of 20 yet."""
    made = ledger_in(tmp_path, plan_in(tmp_path))
    made.record(row(k, 0, -0.001 * (k + 1) if k < 25 else 0.2) for k in range(30))
    made.declared = replace(made.declared, world=PYBULLET)  # a reference, whose bounds show something
    return made


def test_what_has_run_is_there_and_no_bound_before_the_end(ledger: Ledger, tmp_path: Path) -> None:
    words = words_of(page_of(ledger, tmp_path))
    assert "a hand nearby: not complete: 30 of 50 episodes" in words
    assert "near hand distance never below 150 mm not shown 30 25 0 – – 0.5 −25.0 mm 24" in words
    assert "near 24 hand distance never below 150 mm −25.0 mm 0.250 s repeatable from its seed" in words
    assert words.index("near 24 hand") < words.index("near 23 hand")


def test_targets_are_refuted_or_shown_by_their_bounds_alone(ledger: Ledger, tmp_path: Path) -> None:
    ledger.record(row(k, 1, 0.2) for k in range(20))
    words = words_of(page_of(ledger, tmp_path))
    assert "1 of 2 targets shown, 1 refuted" in words
    assert f"near hand distance never below 150 mm {REFUTED} 30 25" in words
    assert f"nearer hand distance never below 150 mm {SHOWN} 20 0" in words


def test_a_world_that_shows_nothing_shows_no_target(ledger: Ledger, tmp_path: Path) -> None:
    ledger.record(row(k, 1, 0.2) for k in range(20))
    ledger.declared = replace(ledger.declared, world=plan_in(tmp_path).world)
    words = words_of(page_of(ledger, tmp_path))
    assert f"nearer hand distance never below 150 mm {NOT_SHOWN} 20 0" in words
    assert "0 of 2 targets shown" in words


def test_a_claim_that_no_run_tests_is_not_shown(tmp_path: Path) -> None:
    ledger = ledger_in(tmp_path, plan_in(tmp_path))
    untested = (ClaimJudgement(EpisodeOutcome.UNTESTED),) * 2
    for stratum, runs in enumerate((30, 20)):
        ledger.record(replace(row(k, stratum, 0.2), judgements=untested) for k in range(runs))
    ledger.declared = replace(ledger.declared, world=PYBULLET)
    assert "0 of 2 targets shown" in words_of(page_of(ledger, tmp_path))


def test_of_very_many_violations_the_worst_are_listed(
    ledger: Ledger, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    few = campaign_page._WORST.replace(f"LIMIT {campaign_page.MOST_EPISODES}", "LIMIT 4")
    monkeypatch.setattr(campaign_page, "_WORST", few)
    words = words_of(page_of(ledger, tmp_path))
    assert "The worst of each claim first, 4 of 25." in words
    assert "near 20 hand" not in words


def test_the_worst_that_are_kept_are_replayed(ledger: Ledger, tmp_path: Path) -> None:
    run = run_kinematic(admit(EpisodeRunner(plan_in(tmp_path)).scenario(1, 0, 0)))
    worst = replace(row(0, 1, -0.9), trace=trace_bytes(run))
    assert page_of(ledger, tmp_path).count("data-packed=") == 0
    ledger.record([worst])
    page = page_of(ledger, tmp_path)
    assert page.count('data-packed="') == 1
    assert "nearer, episode 0" in words_of(page)


def test_margins_of_different_units_are_not_put_in_one_order(ledger: Ledger, tmp_path: Path) -> None:
    """A metre beyond a distance is not worse than half a degree beyond an angle: each claim has its worst."""
    small = ClaimJudgement(EpisodeOutcome.VIOLATED, -1e-6, 0.25, 1)
    second = replace(row(0, 1, 0.2), judgements=(ClaimJudgement(EpisodeOutcome.UNTESTED), small))
    ledger.record([second])
    listed = [(claim, margin) for _, _, claim, margin, *_ in ledger.all(campaign_page._WORST)]
    assert listed[:3] == [(0, -0.025), (1, -1e-6), (0, -0.024)]
    assert len(listed) == 26


@pytest.mark.parametrize(("space", "told"), [("recorded-variations", True), ("reaching-hands", False)])
def test_a_campaign_of_recorded_hands_says_that_they_are_wrists(
    space: str, told: bool, tmp_path: Path
) -> None:
    file = tmp_path / "plan.yaml"
    file.write_text(
        "plan: hands\nworld: kinematic\nstrata:\n"
        f"  - {{stratum: all, space: 'shipped:{space}', runs: 2}}\n"
        "claims:\n  - claim: joint speeds within limits\n"
    )
    with Ledger.create(tmp_path / "ledger.sqlite", read_plan(file)) as made:
        assert ("recorded hands are wrists" in words_of(page_of(made, tmp_path))) is told
        assert bool(made.wrists) is told  # what the evidence excludes


@pytest.mark.parametrize(
    ("name", "table", "told"),
    [
        ("hands.txt", "time_s,right_hand_x_m,right_hand_y_m,right_hand_z_m\n0,0,0,0\n1,0,0,0\n", True),
        ("speeds.csv", "speed,times\n1,2\n", False),
    ],
)
def test_a_recording_is_told_by_its_content(tmp_path: Path, name: str, table: str, told: bool) -> None:
    plan = plan_in(tmp_path)
    with Ledger.create(
        tmp_path / "other.sqlite",
        replace(plan, files=(*plan.files, PlanFile(name, table.encode()))),
    ) as made:
        assert bool(made.wrists) is told
