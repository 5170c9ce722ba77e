"""Copies of one run are one run: a campaign in which runs repeat others states no bound, and says why."""

from __future__ import annotations

from pathlib import Path

import pytest
from typer.testing import CliRunner, Result

from safety_harness.base.exceptions import StatisticsError
from safety_harness.cli.console import DIFFERS
from safety_harness.cli.main import app
from safety_harness.extensions.assurance.campaign.ledger import Ledger
from safety_harness.extensions.assurance.campaign.session import processes, run_missing
from safety_harness.extensions.assurance.campaign.summary import state_of
from safety_harness.extensions.assurance.certification.evidence import ClaimStatus, read_evidence
from safety_harness.extensions.assurance.certification.folder import JSON
from tests.assurance.campaign.plans import plan_in

VISIT = """\
scenario space: a hand that visits
duration: 1 s
tcp start:
  offset: [{offset}, -120 mm, 60 mm]
hands:
  - hand: right hand
    starts at: [840 mm, {side}, 250 mm]
    elbow towards: [1600 mm, -1200 mm, 300 mm]
    moves:
      - wait: 5 s
      - withdraw: {withdraw}
claims:
  hand distance never below 10 mm: holds
"""
FIXED = {"offset": "40 mm", "side": "-350 mm", "withdraw": "0.5 m/s"}
PLAN = """\
plan: copies
avoider: opposite pose
world: kinematic
strata:
  - stratum: cell
    space: short.yaml
    runs: 12
claims:
  - claim: hand distance never below 10 mm
    violated in at most: 50 %
"""
WANDER = """\
scenario space: a hand wanders beside an arm
duration: 2 s
{seed}tcp start:
  offset: [0 mm, 0 mm, from 39 mm to 41 mm]
hands:
  - hand: right hand
    starts at: [950 mm, -400 mm, 400 mm]
    elbow towards: [1700 mm, -1300 mm, 400 mm]
    moves:
      - wander: 0.5 m/s
        within: [[750 mm, -700 mm, 300 mm], [1100 mm, -200 mm, 600 mm]]
        for: 2 s
claims:
  hand distance never below 10 mm: holds
"""


def run_in(folder: Path, space: str) -> Ledger:
    plan = plan_in(folder, PLAN, space)
    assert run_missing(plan, folder / "ledger.sqlite", processes(1))
    return Ledger.open(folder / "ledger.sqlite")


@pytest.mark.parametrize(
    ("varied", "words"),
    [
        ({"withdraw": "from 0.5 m/s to 0.6 m/s"}, "1 distinct runs of 12 in cell"),
        ({"side": "{one of: [-350 mm, -300 mm]}"}, "2 distinct runs of 12 in cell"),
    ],
    ids=["it acts after the end of the run", "two draws coincide"],
)
def test_runs_that_repeat_bear_no_bound(tmp_path: Path, varied: dict[str, str], words: str) -> None:
    """Neither when what varies never acts, nor when a choice has fewer values than there are runs."""
    with run_in(tmp_path, VISIT.format(**FIXED | varied)) as ledger:
        assert words in ledger.dependent
        assert state_of(ledger).bounds == ()
        with pytest.raises(StatisticsError, match="distinct runs"):
            ledger.sample("cell", ledger.declared.claims[0])


def test_the_last_bit_of_a_start_makes_another_run(tmp_path: Path) -> None:
    with run_in(tmp_path, VISIT.format(**FIXED | {"offset": "from 40 mm to 40.000001 mm"})) as ledger:
        assert ledger.dependent == ""
        assert len(state_of(ledger).bounds) == 1


def test_a_seed_in_a_space_changes_nothing(tmp_path: Path) -> None:
    """With ``seed: 0`` all draws had one wandering hand; now the results are those without the key."""
    margins = []
    for name, seed in (("own", ""), ("zero", "seed: 0\n")):
        with run_in(tmp_path / name, WANDER.format(seed=seed)) as ledger:
            assert ledger.dependent == ""
            margins.append(ledger.outcomes(0, 0)[2].tolist())
    assert margins[0] == margins[1]
    assert len(set(margins[0])) == 12


def test_certify_and_campaign_say_why_and_end_with_1(tmp_path: Path) -> None:
    """On the terminal, in JSON, on the page and in JUnit XML."""
    plan_in(tmp_path, PLAN, VISIT.format(**FIXED | {"withdraw": "from 0.5 m/s to 0.6 m/s"}))
    out, words = tmp_path / "report", "runs repeat others bit for bit"

    def command(*told: str | Path) -> Result:
        return CliRunner().invoke(app, [*map(str, told)])

    said = command("certify", tmp_path / "plan.yaml", "--workers", "1", "--out", out)
    assert said.exit_code == DIFFERS
    assert words in said.stdout
    evidence = read_evidence(out / JSON)
    assert evidence.claims[0].standing is ClaimStatus.NOT_SHOWN
    assert words in evidence.claims[0].why
    for name in ("evidence.html", "junit.xml"):
        assert words in (out / name).read_text()
    assert words in command("campaign", "status", out / "ledger.sqlite", "--json").stdout
    assert command("campaign", "resume", out / "ledger.sqlite").exit_code == DIFFERS
