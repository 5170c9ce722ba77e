"""A user's controller, as it is, through every command: one class that sees joints and hands and stops."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner, Result

from safety_harness import load_trace
from safety_harness.admission.admit import Admitter
from safety_harness.admission.avoiders import with_avoider
from safety_harness.admission.repeatability import Repeatability
from safety_harness.admission.trial import run_kinematic
from safety_harness.cli.main import app
from safety_harness.extensions.attribution import search_attribution
from safety_harness.scenario.model import Driver
from safety_harness.scenario.read import read_scenario
from safety_harness.search import session as search_session
from safety_harness.testing.simulating import Simulate
from safety_harness.trace.compare import first_difference
from safety_harness.trace.known import NOT_REPORTED

EXAMPLE = Path(__file__).parents[2] / "examples" / "stop_and_go.py"
MINE = (
    EXAMPLE.read_text()
    + '''

from dataclasses import replace

from safety_harness import Report
from safety_harness.seams.contract import Decision
from safety_harness.trace.records import Mode


class Broken(StopAndGo):
    """At the third tick it answers with whatever ``answer`` is."""

    def reset(self, **start):
        super().reset(**start)
        self.ticks = 0

    def act(self, seen):
        self.ticks += 1
        return super().act(seen) if self.ticks < 3 else self.answer()


class NotANumber(Broken):
    answer = staticmethod(lambda: Move(tcp_velocity_mps=np.array([np.nan, 0.0, 0.0])))


class WrongShape(Broken):
    answer = staticmethod(lambda: Move(joint_velocity_radps=[0.0, 0.0]))


class Text(Broken):
    answer = staticmethod(lambda: "stop")


class Raising(Broken):
    answer = staticmethod(lambda: 1 // 0)


class Leaves(Broken):
    answer = staticmethod(lambda: exit(3))


class SeesMore(Broken):
    sees = ("joints",)

    def act(self, seen):
        return seen.hands


class Telling(StopAndGo):
    """It reports its mode, and one decision at its tenth tick, with its doubt."""

    reports = ("mode", "decisions", "doubt")

    def reset(self, **start):
        super().reset(**start)
        self.ticks = 0

    def act(self, seen):
        self.ticks += 1
        if self.ticks != 10:
            return replace(super().act(seen), report=Report(mode=Mode.SERVOING))
        tcp_in_base_m = seen.tcp_position_in_base_m
        decision = Decision(
            hand_position_in_base_m=seen.hands[0].position_in_base_m,
            proposed_position_in_base_m=tcp_in_base_m + [0.0, 0.1, 0.0],
            chosen_position_in_base_m=tcp_in_base_m + [0.0, 0.1, 0.0],
            spread_m=np.full(3, 0.002),
            spread_threshold_m=0.01,
        )
        return Move(
            tcp_velocity_mps=np.array([0.0, 0.1, 0.0]), report=Report(mode=Mode.REPULSING, decision=decision)
        )


class Counting(StopAndGo):
    """It carries its episodes over."""

    episodes = 0

    def reset(self, **start):
        super().reset(**start)
        self.episodes += 1
        self.target_in_base_m[2] += 0.05 * self.episodes
'''
)
HAND = """\
  - hand: right hand
    starts at: [900 mm, -500 mm, 400 mm]
    elbow towards: [1600 mm, -1200 mm, 300 mm]
    moves:
      - move to: [760 mm, -150 mm, 350 mm]
        speed: 1 m/s
"""
VISIT = f"""\
scenario: a hand comes to the TCP
duration: 240 ms
controller: mine.py:StopAndGo
tcp start:
  offset: [40 mm, -120 mm, 60 mm]
hands:
{HAND}claims:
  hand distance never below 600 mm: violated
  joint speeds within limits: holds
  always not repulsing: inconclusive
  retreats at most 3 times: inconclusive
  certain answers are used: inconclusive
"""
SPACE = """\
scenario space: a hand nearby
duration: 240 ms
tcp start:
  offset: [0 mm, from -40 mm to 40 mm, 20 mm]
hands:
  - hand: right hand
    starts at: [from 700 mm to 900 mm, -500 mm, 400 mm]
    elbow towards: [1000 mm, -1200 mm, 500 mm]
    moves:
      - reach for tcp: from 1.5 m/s to 2 m/s
        stop at distance: 50 mm
        give up after: 2 s
claims:
  hand distance never below 250 mm: holds
  joint speeds within limits: holds
"""
PLAN = """\
plan: a hand nearby
about: a test
controller: mine.py:StopAndGo
world: kinematic
seed: 7
strata:
  - stratum: near
    space: space.yaml
    runs: 8
claims:
  - claim: joint speeds within limits
    violated in at most: 50 %
  - claim: hand distance never below 250 mm
keep:
  random traces: 1
  violations: 1
"""
MINE_AS_OPTION = ("--controller", "mine.py:StopAndGo")


def with_files(folder: Path) -> Path:
    """The folder, with the class, a scenario, a space and a plan."""
    (folder / "scenarios").mkdir()
    for name, text in (("mine.py", MINE), ("visit.yaml", VISIT), ("space.yaml", SPACE), ("plan.yaml", PLAN)):
        (folder / name).write_text(text)
    return folder


def search_little_in(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Work there, and shrink and attribute little of what a search finds."""
    monkeypatch.chdir(folder)
    monkeypatch.setattr(search_session, "SHRINKING_RUNS", 4)
    monkeypatch.setattr(search_session, "MOST_SHRUNK", 1)
    monkeypatch.setattr(search_attribution, "MOST_ATTRIBUTED", 1)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return with_files(tmp_path_factory.mktemp("own-controller"))


@pytest.fixture(autouse=True)
def _there(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    search_little_in(folder, monkeypatch)


def command(*words: str) -> Result:
    """One command, whatever it says; an exception that it lets through is a defect."""
    found = CliRunner().invoke(app, list(words))
    assert found.exception is None or isinstance(found.exception, SystemExit), found.exception
    return found


@pytest.fixture(scope="module")
def trace(folder: Path) -> Path:
    """Of the scenario, run once; from elsewhere, so that nothing is sought in the working directory."""
    found = command("run", str(folder / "visit.yaml"), "--out", str(folder / "out"))
    assert found.exit_code == 0, found.output
    return folder / "out" / "traces" / "visit.trace"


def words_of(page: Path) -> str:
    """What a page says, without its pictures, styles, and the sentences that are on each of them."""
    text = re.sub(r"<(style|script|svg)\b.*?</\1>", "", page.read_text(), flags=re.S)
    return re.sub(r"<[^>]+>", " ", text).lower()


def test_run_says_what_is_not_reported(trace: Path) -> None:
    run = load_trace(trace)
    assert len(run.ticks) == run.scenario.ticks + 1
    assert len(run.decisions) == 0
    assert run.known.column("mode") == run.known.column("decision.tick") == NOT_REPORTED
    found = json.loads((trace.parents[1] / "report.json").read_text())["runs"][0]
    why = {claim["claim"]: claim["reason"] for claim in found["claims"] if claim["verdict"] == "inconclusive"}
    assert set(why) == {"always not repulsing", "retreats at most 3 times", "certain answers are used"}
    assert all("not reported" in reason for reason in why.values()), why


def test_the_system_under_test_is_one_record_of_trace_and_report(trace: Path) -> None:
    system = load_trace(trace).system
    assert (system.controller.name, system.avoider, system.gate) == ("stop and go", None, None)
    assert len(system.controller.sha256) == len(system.robot.sha256) == len(system.settings.sha256) == 64
    found = json.loads((trace.parents[1] / "report.json").read_text())["runs"][0]
    assert found["system"]["controller"] == {"name": "stop and go", "sha256": system.controller.sha256}
    assert found["system"]["avoider"] is None
    assert found["avoider_answered"] is None
    assert system.controller.sha256 in (trace.parents[1] / "report.html").read_text()


def test_what_it_reports_of_itself_is_judged(folder: Path) -> None:
    found = command("run", "visit.yaml", "--controller", "mine.py:Telling", "--out", "out-telling")
    assert found.exit_code == 1
    data = json.loads((folder / "out-telling" / "report.json").read_text())["runs"][0]
    verdicts = {claim["claim"]: claim["verdict"] for claim in data["claims"]}
    assert verdicts["always not repulsing"] == "violated"
    assert verdicts["retreats at most 3 times"] == "holds"
    run = load_trace(folder / "out-telling" / "traces" / "visit.trace")
    assert run.decisions["tick"].tolist() == [9]
    assert run.decisions["spread_threshold_m"] == 0.01
    again = command("replay", "out-telling/traces/visit.trace", "--controller", "mine.py:Telling")
    assert again.exit_code == 0, again.output


@pytest.mark.judges_runs_itself
def test_pytest_simulates_with_an_object(trace: Path, folder: Path, simulate: Simulate) -> None:
    found: dict[str, Any] = {}
    exec(MINE, found)  # the file's own text
    run = simulate(folder / "visit.yaml", controller=found["StopAndGo"]())
    assert first_difference(load_trace(trace), run) is None
    assert (run.system.controller.name, run.system.avoider) == ("stop and go", None)


def test_no_page_of_a_run_speaks_of_an_avoider(trace: Path) -> None:
    assert "avoider" not in words_of(trace.parents[1] / "report.html")


def test_replay_is_bit_identical_and_refuses_another_controller(trace: Path) -> None:
    unnamed = command("replay", str(trace))
    assert unnamed.exit_code == 2
    assert "--controller" in unnamed.output
    again = command("replay", str(trace), *MINE_AS_OPTION)
    assert again.exit_code == 0
    assert "identical: visit" in again.output
    for other in ("stop when near", "visual servo", "mine.py:Counting"):
        refused = command("replay", str(trace), "--controller", other)
        assert refused.exit_code == 2, refused.output
        assert "stop and go" in refused.output


def test_replay_refuses_the_same_controller_from_an_edited_file(trace: Path, folder: Path) -> None:
    (folder / "edited.py").write_text(MINE + "# edited\n")
    refused = command("replay", str(trace), "--controller", "edited.py:StopAndGo")
    assert refused.exit_code == 2
    assert "which drove then" in refused.output


def test_fuzz_covers_by_distance_and_motion(folder: Path) -> None:
    found = command("fuzz", "space.yaml", *MINE_AS_OPTION, "--budget", "6", "--out", "found")
    assert found.exit_code == 1, found.output
    data = json.loads((folder / "found" / "findings.json").read_text())
    assert data["system"]["controller"]["name"] == "stop and go"
    assert sum(data["coverage"].values()) == 6
    (file, *_) = data["counterexamples"]
    text = (folder / "found" / file).read_text()
    assert "avoider" not in text
    page = (folder / "found" / "fuzz.html").read_text()
    assert "--controller mine.py:StopAndGo" in page
    assert "random numbers" not in page
    assert command("run", f"found/{file}", "--out", "again").exit_code == 0


def test_attribute_leaves_out_what_it_does_not_have(trace: Path) -> None:
    found = command("attribute", str(trace), *MINE_AS_OPTION)
    assert found.exit_code == 0, found.output
    assert "of 1: 1 " in found.output
    assert "avoider" not in found.output


@pytest.mark.parametrize(
    ("name", "why"),
    [
        ("NotANumber", "velocities that are not finite"),
        ("WrongShape", "joint_velocity_radps"),
        ("Text", "no Move and no Stop: 'stop'"),
        ("Raising", "ZeroDivisionError"),
        ("Leaves", "SystemExit"),
        ("SeesMore", '"hands" is not among this controller\'s sees'),
    ],
)
def test_what_act_may_not_return_costs_the_run_with_a_reason(name: str, why: str) -> None:
    found = command("run", "visit.yaml", "--controller", f"mine.py:{name}", "--out", f"out-{name}")
    assert found.exit_code == 1
    assert why in " ".join(found.output.split()), found.output
    assert "Traceback" not in found.output


def test_what_is_carried_over_from_episode_to_episode_is_named(folder: Path) -> None:
    visit = with_avoider(read_scenario(folder / "visit.yaml"), Driver("mine.py:Counting"))
    admitter, repeatability = Admitter(), Repeatability()
    for name in ("first", "second"):
        repeatability.add(run_kinematic(admitter.admit(replace(visit, name=name))))
    found = repeatability.check()
    assert "carries something over" in found.words
    assert found.differing == 1


def test_one_who_sees_no_object_starts_where_none_is_in_view(folder: Path) -> None:
    offset = "offset: [40 mm, -120 mm, 60 mm]"
    away = VISIT.replace(offset, f"{offset}\n  tilt: [80 deg, 0 deg, 0 deg]")
    (folder / "away.yaml").write_text(away)
    assert command("run", "away.yaml", "--out", "out-away").exit_code in (0, 1)
    servo = command("run", "away.yaml", "--controller", "visual servo", "--out", "out-servo")
    assert servo.exit_code == 2
    assert "object" in servo.output
