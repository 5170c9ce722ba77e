"""``safety_harness.run``: what it returns, and that the command writes and says the same."""

from __future__ import annotations

from dataclasses import FrozenInstanceError, replace
from pathlib import Path

import pytest

import safety_harness
from safety_harness.base.exceptions import InputError
from safety_harness.base.input_errors import InputErrors
from safety_harness.cell.simulation.worlds import KINEMATIC
from safety_harness.cli.scenario_commands import run as run_command
from safety_harness.report.run_result import RunResult
from safety_harness.scenario.model import Verdict
from safety_harness.trace.compare import first_difference
from safety_harness.trace.store import load_trace
from tests.kinds_of_files import VISIT

CLAIMS = """
claims:
  joint speeds within limits: holds
  always hand distance > 9 m: violated
"""


@pytest.fixture
def file(tmp_path: Path) -> Path:
    path = tmp_path / "near.yaml"
    path.write_text(
        VISIT.partition("\nclaims:")[0].replace("tcp start", "avoider: opposite pose\ntcp start") + CLAIMS
    )
    return path


@pytest.fixture
def made(file: Path) -> RunResult:
    return safety_harness.run(file, world="kinematic")


def report(folder: Path) -> list[str]:
    """The lines of report.json, but for the time of day and the hash of a trace, which has times in it."""
    lines = (folder / "report.json").read_text().splitlines()
    return [line for line in lines if "made_at" not in line and "trace_sha256" not in line]


def test_the_result_is_frozen_and_says_its_verdict_in_a_line_with_its_world(made: RunResult) -> None:
    assert made.verdict is Verdict.VIOLATED
    assert repr(made).startswith("<violated: near, claims: 1 holds, 1 violated. Basis: in ")
    assert "kinematic" in repr(made)
    assert "exercised in 1 of 1 runs" in repr(made)
    assert "\n" not in repr(made)
    assert made["always hand distance > 9 m"].verdict is Verdict.VIOLATED
    assert len(made.trace.ticks) > 1
    assert made.exit_code == 0  # as its file expects
    with pytest.raises(FrozenInstanceError):
        made.failed = ()  # type: ignore[misc]


def test_a_claim_that_nobody_made_is_refused_with_those_that_were(made: RunResult) -> None:
    with pytest.raises(InputError, match="joint speeds within limits, always hand distance"):
        made["no such claim"]


def test_what_is_written_afterwards_is_what_the_command_writes(
    file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, made: RunResult
) -> None:
    monkeypatch.chdir(tmp_path)
    assert run_command([file], Path("out"), world="kinematic") == made.exit_code
    by_command = report(Path("out")), (Path("out") / "report.sarif").read_bytes()
    Path("out").rename("by-command")
    written = made.write("out")
    assert (report(Path("out")), (Path("out") / "report.sarif").read_bytes()) == by_command
    traces = (load_trace(Path(name) / "traces" / "near.trace") for name in ("out", "by-command"))
    assert first_difference(*traces) is None
    assert written.runs[0].trace_file == Path("out") / "traces" / "near.trace"
    assert made.runs[0].trace_file is None


def test_a_scenario_of_a_program_becomes_a_file_beside_its_report(
    file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    scenario = replace(safety_harness.read_scenario(file), name="changed", seed=7, file=None)
    safety_harness.run(scenario, world=KINEMATIC).write("out")
    again = safety_harness.run("out/scenarios/changed.yaml", world=KINEMATIC)
    assert again.trace.scenario.seed == 7


def test_every_input_that_cannot_be_used_is_named_and_nothing_is_run(file: Path, tmp_path: Path) -> None:
    for name in ("one", "two"):
        (tmp_path / f"{name}.yaml").write_text(VISIT.replace("-120 mm", "-120"))
    with pytest.raises(InputErrors, match=r"two\.yaml") as raised:
        safety_harness.run([file, tmp_path / "one.yaml", tmp_path / "two.yaml"], world=KINEMATIC)
    assert len(raised.value.errors) == 2
    assert raised.value.left == 1
    found = safety_harness.run([file, tmp_path / "one.yaml"], world=KINEMATIC, keep_going=True)
    assert len(found.runs) == len(found.refused) == 1
    assert found.exit_code == 2


def test_progress_goes_to_the_functions_that_are_given(file: Path) -> None:
    said: list[str] = []
    safety_harness.run(file, world=KINEMATIC, output=safety_harness.Output.to(said.append))
    assert said[0].startswith("holds ")


def test_what_is_no_scenario_is_refused() -> None:
    with pytest.raises(InputError, match="expected a path; got int 3"):
        safety_harness.run(3)  # type: ignore[arg-type]
