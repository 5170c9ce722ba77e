"""What the gate overrules is counted by every command: always in doubt is 100 %, the fallback itself 0 %."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest

from safety_harness.cli.console import AS_EXPECTED, DIFFERS
from safety_harness.cli.fuzz import fuzz
from safety_harness.cli.scenario_commands import run
from safety_harness.extensions.assurance.certification.evidence import read_evidence
from safety_harness.extensions.assurance.commands import campaign
from safety_harness.extensions.assurance.commands.certify import certify, verify
from safety_harness.search import session as search_session
from tests.assurance.campaign.plans import plan_in
from tests.cli.test_own_avoider import VISIT
from tests.search.short_space import TEXT

DOUBTING = """\
from safety_harness import Proposal
class Mine:
    name = "doubting"
    spread_threshold_m = 0.01
    def propose(self, *, hand_position_in_base_m, tcp_position_in_base_m, seed):
        return Proposal(tcp_position_in_base_m + [0.0, 0.1, 0.0], [0.02, 0.02, 0.02])
"""
REACH = "settings: {avoidance: {gate: reach}}\n"
PLAN = """\
plan: a hand nearby
avoider: AVOIDER
world: WORLD
strata:
  - stratum: near
    space: short.yaml
    runs: 8
claims:
  - claim: joint speeds within limits
    violated in at most: 50 %
keep:
  random traces: 1
"""
# avoider, what the files begin with, overruled of all
EVERY = [("mine.py:Mine", "", True), ("opposite pose", REACH, False)]
every = pytest.mark.parametrize(("avoider", "settings", "all_of_them"), EVERY, ids=["in doubt", "fallback"])


@pytest.fixture(autouse=True)
def _here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "mine.py").write_text(DOUBTING)


def the_line(shown: str) -> str:
    (line,) = [line.strip() for line in shown.splitlines() if line.strip().startswith("overruled ")]
    return line


def says(line: str, all_of_them: bool) -> bool:
    """Is it of all proposals, for their doubt, or of none?"""
    counts = line.removeprefix("overruled ").split(" proposal")[0].replace(",", "").split(" of ")
    overruled, proposals = map(int, counts)
    if not all_of_them:
        return overruled == 0 < proposals and line.endswith("(0 %)")
    return overruled == proposals > 0 and f"(100 %): {proposals} uncertain" in line


@every
def test_run_says_it_in_the_terminal_the_page_and_the_json(
    avoider: str, settings: str, all_of_them: bool, capsys: pytest.CaptureFixture[str]
) -> None:
    Path("visit.yaml").write_text(VISIT.replace("tcp start", f"{settings}tcp start", 1))
    run([Path("visit.yaml")], Path("out"), avoider)
    line = the_line(capsys.readouterr().err)
    assert says(line, all_of_them)
    assert line in Path("out/report.html").read_text()
    found = json.loads(Path("out/report.json").read_text())
    (of_one,) = found["overruling"].values()
    assert of_one == found["runs"][0]["overruling"]
    assert of_one["overruled"] == of_one["proposals"] * all_of_them


@every
def test_fuzz_says_it_of_the_search_in_the_terminal_the_page_and_the_json(
    avoider: str,
    settings: str,
    all_of_them: bool,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setattr(search_session, "SHRINKING_RUNS", 12)
    Path("short.yaml").write_text(TEXT.replace("tcp start", f"{settings}tcp start", 1))
    fuzz(Path("short.yaml"), out=Path("out"), avoider=avoider, budget=6)
    line = the_line(capsys.readouterr().err)
    assert says(line, all_of_them)
    assert line in Path("out/fuzz.html").read_text()
    found = json.loads(Path("out/findings.json").read_text())
    assert list(Path("out").glob("*.yaml"))  # it was shrunk as well, and that is not counted
    assert found["overruling"]["proposals"] == found["decisions"] > 0


@every
def test_a_campaign_says_it_and_answers_questions_of_it(
    avoider: str, settings: str, all_of_them: bool, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    space = TEXT.replace("tcp start", f"{settings}tcp start", 1)
    plan_in(tmp_path, PLAN.replace("AVOIDER", avoider).replace("WORLD", "kinematic"), space)
    ledger = Path("ledger.sqlite")
    assert campaign.run(Path("plan.yaml"), ledger=ledger, workers=1) == AS_EXPECTED
    capsys.readouterr()
    assert campaign.status(ledger) == AS_EXPECTED
    assert says(the_line(capsys.readouterr().out), all_of_them)
    sums = "SELECT sum(overruled), sum(overruled_uncertain), sum(proposals), sum(decisions) FROM episodes"
    campaign.query(ledger, sums)
    overruled, uncertain, proposals, decisions = map(int, capsys.readouterr().out.split()[-1].split(","))
    assert proposals == decisions > 0
    assert overruled == uncertain == proposals * all_of_them
    assert campaign.export(ledger, Path("table.csv")) == AS_EXPECTED
    assert "overruled_uncertain" in Path("table.csv").read_text().splitlines()[0].split(",")


@every
def test_a_certificate_bounds_the_share_of_runs_and_verify_makes_it_again(
    avoider: str, settings: str, all_of_them: bool, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    space = TEXT.replace("tcp start", f"{settings}tcp start", 1)
    plan_in(tmp_path, PLAN.replace("AVOIDER", avoider).replace("WORLD", "PyBullet"), space)
    expected_code = DIFFERS if all_of_them else AS_EXPECTED  # an avoider that never acts is shown with doubt
    assert certify(Path("plan.yaml"), out=Path("report"), workers=1) == expected_code
    (found,) = read_evidence(Path("report/evidence.json")).overruling
    assert says(found.words, all_of_them)
    assert found.runs_overruled == found.runs * all_of_them
    assert found.overruled == found.proposals * all_of_them
    assert found.bound is not None
    assert found.bound.confidence == pytest.approx(0.95)
    one_in_40 = 1.0 - 0.025 ** (1.0 / found.runs)  # Clopper and Pearson, of none of so many
    expected = (1.0 - one_in_40, 1.0) if all_of_them else (0.0, one_in_40)
    assert (found.bound.lower, found.bound.upper) == pytest.approx(expected)
    assert found.words in Path("report/evidence.html").read_text()
    told = f"near: {found.words}; in {found.runs_overruled} of {found.runs} runs with a proposal ("
    assert told in capsys.readouterr().out
    assert verify(Path("report"), runs=1, seed=1, execute_programs=True) == AS_EXPECTED


def test_two_campaigns_over_the_same_episodes_are_compared_in_it(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    ledgers = []
    for folder, avoider in (("before", "opposite pose"), ("after", "mine.py:Mine")):
        (tmp_path / folder).mkdir()
        (tmp_path / folder / "mine.py").write_text(DOUBTING)
        text = PLAN.replace("AVOIDER", avoider).replace("WORLD", "kinematic")
        plan_in(tmp_path / folder, text, TEXT)
        ledgers.append(tmp_path / folder / "ledger.sqlite")
        campaign.run(tmp_path / folder / "plan.yaml", ledger=ledgers[-1], workers=1)
    capsys.readouterr()
    assert campaign.compare(*ledgers) == AS_EXPECTED
    (line,) = [line for line in capsys.readouterr().out.splitlines() if "near: overruled" in line]
    assert re.fullmatch(
        r"near: overruled 100 % of \d+ proposals, before 0 % of \d+ \(\+100\.0%\); of 8 episodes some "
        r"proposal was overruled both times in 0, only after in 8, only before in 0; p 0\.00781 "  # 2 / 2^8
        r"\(McNemar, of its own line alone\)",
        line,
    )
