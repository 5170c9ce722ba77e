"""Campaigns, reports and their verification in the user's own simulator."""

from __future__ import annotations

import json
import shutil
import sys
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

import pytest

from safety_harness.base.exceptions import EditedProgramError, InadmissibleError, LedgerError, ScenarioError
from safety_harness.cell.simulation import worlds
from safety_harness.cli.console import AS_EXPECTED, BAD_INPUT, DIFFERS
from safety_harness.extensions.assurance.campaign.episodes import EpisodeRunner
from safety_harness.extensions.assurance.campaign.ledger import Ledger
from safety_harness.extensions.assurance.campaign.pilot import pilot
from safety_harness.extensions.assurance.campaign.plan import Plan, read_plan
from safety_harness.extensions.assurance.campaign.rows import Row
from safety_harness.extensions.assurance.campaign.session import processes, run_missing
from safety_harness.extensions.assurance.certification.counterexamples import searches_of
from safety_harness.extensions.assurance.certification.folder import stored_files, write_manifest
from safety_harness.extensions.assurance.certify_job import certify
from safety_harness.extensions.assurance.commands.campaign import compare, resume
from safety_harness.extensions.assurance.commands.campaign_attribute import attribute_ledger
from safety_harness.extensions.assurance.commands.certify import verify
from safety_harness.extensions.assurance.statistics.sample import EpisodeOutcome
from safety_harness.extensions.worlds.program import simulator
from safety_harness.search import session
from tests.assurance.campaign.plans import plan_in

KINEMATIC_CELL = Path(__file__).parents[2] / "examples" / "worlds" / "kinematic_cell.py"
PLAN = """\
plan: in a simulator of mine
avoider: opposite pose
world: WORLD
seed: 7
strata:
  - stratum: near
    space: short.yaml
    runs: 8
claims:
  - claim: hand distance never below 150 mm
    violated in at most: 50 %
  - claim: joint speeds within limits
keep:
  random traces: 2
  violations: 1
"""
MOVE = "joints_rad = [q + dq * period_s for q, dq in zip(joints_rad, speeds_radps, strict=True)]"
START = 'period_s, joints_rad = message["period_s"], message["joint_position_rad"]'


@pytest.fixture(autouse=True)
def _here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(worlds, "_named", set())
    yield
    simulator.cache_clear()


def cell_in(folder: Path, *changes: tuple[str, str]) -> str:
    """Write the shipped simulator with changes, and return its reference."""
    text = KINEMATIC_CELL.read_text()
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    (folder / "cell.py").write_text(text)
    return f"exec:{sys.executable} cell.py"


def plan_with(folder: Path, *changes: tuple[str, str], more: str = "") -> Plan:
    return plan_in(folder, PLAN.replace("WORLD", cell_in(folder, *changes)) + more)


def drifts_after(episodes: int) -> tuple[tuple[str, str], ...]:
    """Return changes after which joints turn a little otherwise from a number of episodes on."""
    return (
        ("import sys", "import sys\n\nepisodes = 0"),
        (START, f"{START}\n        episodes += 1"),
        (MOVE, f"{MOVE}\n        joints_rad[0] += 1e-9 * (episodes > {episodes})"),
    )


def plain(row: Row) -> object:
    """Return a row's results; margins to 1e-12, since bounds between ticks are another sum there."""
    judged = [(one.outcome, round(one.margin, 12), one.worst_time_s, one.exercised) for one in row.judgements]
    return judged, row.decisions, row.cell, row.draws


def rows_of(plan: Plan) -> list[Row]:
    return [row for row in EpisodeRunner(plan).run(0, range(plan.strata[0].runs))]


def test_a_campaign_in_a_simulator_that_moves_as_our_own_world_has_its_rows(tmp_path: Path) -> None:
    theirs = rows_of(plan_with(tmp_path))
    ours = rows_of(plan_in(tmp_path, PLAN.replace("WORLD", "kinematic")))
    assert list(map(plain, theirs)) == list(map(plain, ours))
    assert any(row.violates for row in ours)


def test_a_ledger_names_the_simulator_and_reading_it_executes_nothing(tmp_path: Path) -> None:
    plan = plan_with(tmp_path)
    assert run_missing(plan, tmp_path / "ledger.sqlite", processes(1))
    (tmp_path / "cell.py").write_text("open('executed', 'w')")
    with Ledger.open(tmp_path / "ledger.sqlite") as ledger:
        world = ledger.declared.world
        assert (world.label, world.program, world.model_only) == (plan.world.label, True, True)
        assert ledger.repeated.asked
        assert not ledger.dependent
        assert ledger.stream(0).model_only
    assert not (tmp_path / "executed").exists()


def test_an_edited_simulator_continues_no_campaign(tmp_path: Path) -> None:
    plan = plan_with(tmp_path)
    with Ledger.create(tmp_path / "ledger.sqlite", plan) as ledger:
        ledger.record([next(EpisodeRunner(plan).run(0, [0]))])
    edited = plan_with(tmp_path, ('version="1"', 'version="2"'))
    with pytest.raises(LedgerError, match="the simulator changed"):
        run_missing(edited, tmp_path / "ledger.sqlite", processes(1))


def test_a_simulator_that_does_not_repeat_itself_begins_no_campaign(tmp_path: Path) -> None:
    plan = plan_with(tmp_path, *drifts_after(3))  # two episodes are those in which every simulator is tried
    with pytest.raises(InadmissibleError, match="repeats short#0 to the last bit") as error:
        run_missing(plan, tmp_path / "ledger.sqlite", processes(1))
    assert "seed" in error.value.hint
    assert not (tmp_path / "ledger.sqlite").exists()


def test_a_pilot_too_needs_a_simulator_that_repeats_itself(tmp_path: Path) -> None:
    with pytest.raises(InadmissibleError, match="repeats short#0 to the last bit"):
        pilot(plan_with(tmp_path, *drifts_after(3)), 2)


def test_a_simulator_that_changes_during_a_campaign_leaves_no_bound(tmp_path: Path) -> None:
    plan = plan_with(tmp_path, *drifts_after(6))
    assert run_missing(plan, tmp_path / "ledger.sqlite", processes(1))
    with Ledger.open(tmp_path / "ledger.sqlite") as ledger:
        assert "the simulator or the system in it" in ledger.repeated.remembers
        assert "episodes are not independent, no bound is stated" in ledger.dependent


def test_episodes_after_an_edit_stay_missing(tmp_path: Path) -> None:
    plan = plan_with(tmp_path)
    runner = EpisodeRunner(plan)
    assert not next(runner.run(0, [0])).failure
    cell_in(tmp_path, ('version="1"', 'version="22"'))
    with pytest.raises(EditedProgramError):
        next(runner.run(0, [1]))


def test_an_import_that_changed_between_two_sessions_leaves_no_bound(tmp_path: Path) -> None:
    imports = ("import sys", "import sys\n\nfrom physics import advance")
    moves = (MOVE, MOVE.replace("q + dq * period_s", "advance(q, dq, period_s)"))
    (tmp_path / "physics.py").write_text("def advance(q, dq, dt):\n    return q + dq * dt\n")
    plan = plan_with(tmp_path, imports, moves)
    assert not run_missing(plan, tmp_path / "ledger.sqlite", processes(1), part=(0, 2))
    simulator.cache_clear()
    (tmp_path / "physics.py").write_text("def advance(q, dq, dt):\n    return q + dq * dt * 1.0000001\n")
    assert run_missing(plan, tmp_path / "ledger.sqlite", processes(1))
    with Ledger.open(tmp_path / "ledger.sqlite") as ledger:
        assert "no bound is stated" in ledger.dependent


def test_an_episode_that_breaks_the_simulator_has_failed_and_is_never_held(tmp_path: Path) -> None:
    broken = (
        "speeds_radps = message",
        "assert period_s < 0.0, message['tick']\n        speeds_radps = message",
    )
    rows = rows_of(plan_with(tmp_path, broken))
    assert all("the run failed" in row.failure for row in rows)
    assert {one.outcome for row in rows for one in row.judgements} == {EpisodeOutcome.FAILED}


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with a plan and a report of its campaign and its search in a simulator."""
    folder = tmp_path_factory.mktemp("made")
    plan = plan_with(folder, more="search:\n  runs: 6\n")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        patch.setattr(session, "SHRINKING_RUNS", 5)
        certify(plan.file, out="report", workers=1)
    return folder


@pytest.fixture
def report(made: Path, tmp_path: Path) -> Path:
    shutil.copytree(made, tmp_path, dirs_exist_ok=True)
    return tmp_path / "report"


def test_a_report_names_its_simulator_and_shows_nothing(report: Path) -> None:
    evidence = json.loads((report / "evidence.json").read_text())
    assert "shown" not in {claim["standing"] for claim in evidence["claims"]}
    assert evidence["plan"]["model_only"]
    libraries = dict(evidence["provenance"]["libraries"])
    assert libraries["simulator"].startswith("sha256 ")
    (search,) = (report / "search").glob("*/findings.json")
    assert json.loads(search.read_text())["searched_in"].startswith("the simulator exec:")
    page = (report / "evidence.html").read_text()
    assert "in the simulator exec:" in page
    assert "in the kinematic world, " not in page


def test_verify_executes_a_simulator_only_with_permission(
    report: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert verify(report) == BAD_INPUT
    assert "--execute-programs" in capsys.readouterr().err
    assert verify(report, runs=2, execute_programs=True) == AS_EXPECTED
    assert "made again in the simulator" in capsys.readouterr().out


def test_verify_without_the_simulator_tells_what_it_did_not_repeat(
    report: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    Path("cell.py").write_text("raise SystemExit(1)")
    assert verify(report, runs=2, execute_programs=True) == DIFFERS
    printed = capsys.readouterr().out
    assert "since the report: the simulator changed" in printed
    assert "made again in the simulator" not in printed


@pytest.mark.parametrize("command", [resume, partial(compare, against="nearest candidate")])
def test_a_ledger_of_somebody_else_executes_its_simulator_only_with_permission(
    report: Path, command: Callable[[Path], int], capsys: pytest.CaptureFixture[str]
) -> None:
    assert command(report / "ledger.sqlite") == BAD_INPUT
    assert "--execute-programs, since the ledger names the simulator" in capsys.readouterr().err


def test_campaigns_in_two_simulators_are_not_compared(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    ledgers = []
    for version in ("1", "22"):
        folder = tmp_path / version
        folder.mkdir()
        plan = plan_with(tmp_path, ('version="1"', f'version="{version}"'))
        ledgers.append(folder / "ledger.sqlite")
        simulator.cache_clear()  # another job
        assert run_missing(plan, ledgers[-1], processes(1))
    assert compare(*ledgers) == BAD_INPUT
    assert "another simulator" in capsys.readouterr().err


def test_a_search_in_another_world_is_not_the_plans(report: Path) -> None:
    (file,) = (report / "search").glob("*/findings.json")
    stored = json.loads(file.read_text()) | {"searched_in": "PyBullet and on the real cell"}
    file.write_text(json.dumps(stored))
    (search,) = searches_of(read_plan(report.parent / "plan.yaml"), report)
    assert search.problem == "is another search's than the plan's"


def test_a_replay_command_of_the_report_names_the_simulator(report: Path) -> None:
    evidence = json.loads((report / "evidence.json").read_text())
    commands = [one["command"] for one in evidence["counterexamples"] if one["independent"]]
    assert commands
    assert all("--world 'exec:" in command for command in commands)


def test_a_trace_of_another_simulator_is_no_trace_of_the_report(
    report: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with Ledger.open(report / "ledger.sqlite", write=True) as ledger:
        identity = dict(ledger.declared.identity.parts) | {"the simulator": "sha256 " + "0" * 64}
        ledger.connection.execute(
            "UPDATE about SET value = ? WHERE key = 'identity'", (json.dumps(list(identity.items())),)
        )
        ledger.connection.commit()
    write_manifest(report, stored_files(report))
    assert verify(report, runs=0) == DIFFERS
    assert "its simulator is not the declared one: sha256 0000" in capsys.readouterr().out


def test_causes_of_violations_are_sought_in_the_simulator(
    report: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(LedgerError, match="--execute-programs"):
        attribute_ledger(report / "ledger.sqlite", 1, False, None, False)
    attribute_ledger(report / "ledger.sqlite", 1, True, None, False)
    assert "hand distance never below 150 mm" in capsys.readouterr().out


def test_a_report_needs_a_named_world(tmp_path: Path) -> None:
    plan = plan_in(tmp_path, PLAN.replace("world: WORLD\n", ""))
    with pytest.raises(ScenarioError, match="a world, on which the report will rest") as error:
        certify(plan.file, out=tmp_path / "report", workers=1)
    assert error.value.hint == "world: PyBullet"


def test_an_unknown_world_of_a_plan_is_refused_with_the_names(tmp_path: Path) -> None:
    with pytest.raises(
        ScenarioError, match="PyBullet, kinematic, MuJoCo, or a simulator: exec:COMMAND"
    ) as error:
        plan_in(tmp_path, PLAN.replace("WORLD", "PyBulet"))
    assert "PyBullet" in error.value.hint
