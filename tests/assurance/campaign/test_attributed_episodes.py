"""A campaign's violated episodes are drawn again from their seeds, and grouped by whose fault they are."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from safety_harness.admission.trial import judge, run_many
from safety_harness.cli.console import AS_EXPECTED
from safety_harness.extensions.assurance.campaign.attributed import ViolatedEpisodes, violated_episodes
from safety_harness.extensions.assurance.campaign.episodes import EpisodeRunner
from safety_harness.extensions.assurance.campaign.ledger import Ledger
from safety_harness.extensions.assurance.campaign.plan import read_plan
from safety_harness.extensions.assurance.commands.campaign import attribute
from tests.assurance.campaign.plans import PLAN, plan_in

BLIND = """\
scenario space: a hand comes, and the sensor does not see it
duration: 4.5 s
avoider: opposite pose
tcp start:
  offset: [0 mm, 0 mm, 0 mm]
hands:
  - hand: right hand
    starts at: [840 mm, from -510 mm to -490 mm, 400 mm]
    elbow towards: [1000 mm, -1200 mm, 500 mm]
    moves:
      - move to: [760 mm, -80 mm, 380 mm]
        speed: 250 mm/s
      - wait: 1 s
faults:
  - hand sensor: sees nothing
claims:
  hand distance never below 50 mm: holds
"""
SMALL = (
    PLAN.replace("runs: 30", "runs: 3").replace("runs: 20", "runs: 2").replace("below 150 mm", "below 50 mm")
)


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A ledger in which all five episodes violate the first claim, and no trace is kept."""
    folder = tmp_path_factory.mktemp("blind")
    plan = plan_in(folder, SMALL, BLIND)
    runner = EpisodeRunner(plan)
    with Ledger.create(folder / "ledger.sqlite", plan) as ledger:
        for stratum, count in enumerate((3, 2)):
            ledger.record(runner.run(stratum, range(count), keep_violations=False))
    return folder / "ledger.sqlite"


def test_the_violated_episodes_of_a_campaign_are_grouped(
    path: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert attribute(path, out=tmp_path) == AS_EXPECTED
    out, err = capsys.readouterr()
    assert "5 of 5 violations, in 5 episodes" in err
    assert "of 5: 5 perception" in out
    assert json.loads((tmp_path / "attribution.json").read_text())["groups"] == {"perception": 5}
    assert "5 violations" in (tmp_path / "attribution.svg").read_text()


def test_the_first_of_each_claim_are_taken_strata_side_by_side(path: Path) -> None:
    with Ledger.open(path) as ledger:
        violated = ViolatedEpisodes.first(ledger, 3)
    assert list(violated.claims) == [(0, 0), (1, 0), (0, 1)]
    assert violated.summary == "3 of 5 violations, in 3 episodes"


def test_an_episode_drawn_again_is_the_one_that_was_run(path: Path) -> None:
    plan = read_plan(path.parent / "plan.yaml")
    with Ledger.open(path) as ledger:
        again = list(violated_episodes(plan, ViolatedEpisodes.first(ledger, 2), programs=False))
        noted = "SELECT margin FROM judgement WHERE episode = 0 AND claim = 0 ORDER BY stratum"
        margins = [margin for (margin,) in ledger.all(noted)]
    runs = run_many([one for one, _ in again])
    assert [judge(run)[0].margin for run in runs] == margins
    assert len({*margins}) == 2
    assert [[claim.sentence for claim in claims] for _, claims in again] == [
        ["hand distance never below 50 mm"]
    ] * 2
