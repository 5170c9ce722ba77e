"""A program in another language as the controller, through every command; it drives as a class in Python."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from safety_harness import load_trace
from safety_harness.admission import repeatability
from safety_harness.extensions.assurance.certification import whose_fault
from tests.whole.test_own_controller import MINE, PLAN, SPACE, VISIT, command, search_little_in

EXAMPLES = Path(__file__).parents[2] / "examples"
CLIENT = ("--controller", "exec:./stop_and_go")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The C++ example, built with this machine's compiler, and files that name it."""
    compiler = shutil.which("c++")
    if compiler is None:
        pytest.skip("no C++ compiler on this machine")
    folder = tmp_path_factory.mktemp("program")
    source = EXAMPLES / "controllers" / "stop_and_go.cpp"
    flags = ["-O1", "-std=c++17", "-Wall", "-Wextra", "-Werror"]
    subprocess.run([compiler, *flags, "-o", str(folder / "stop_and_go"), str(source)], check=True)
    (folder / "mine.py").write_text(MINE)
    (folder / "scenarios").mkdir()
    for name, text in (
        ("visit", VISIT),
        ("scenarios/visit", VISIT),
        ("space", SPACE),
        ("plan", PLAN),
        ("other", PLAN.replace("mine.py:StopAndGo", "stop when near")),
    ):
        (folder / f"{name}.yaml").write_text(text.replace("mine.py:StopAndGo", '"exec:./stop_and_go"'))
    return folder


@pytest.fixture(autouse=True)
def _there(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    search_little_in(folder, monkeypatch)
    for module, least in ((whose_fault, "MOST"), (repeatability, "LEAST_RUNS")):
        monkeypatch.setattr(module, least, 1)  # each begins a process


def test_the_program_drives_as_the_class_does() -> None:
    runs = []
    for name, reference in (("program", CLIENT[1]), ("class", "mine.py:StopAndGo")):
        found = command("run", "visit.yaml", "--controller", reference, "--out", name, "--world", "kinematic")
        assert found.exit_code == 0, found.output
        runs.append(load_trace(Path(name) / "traces" / "visit.trace"))
    ways = [run.ticks["joint_position_rad"] for run in runs]
    assert np.array_equal(*ways)
    assert np.ptp(ways[0]) > 0.0
    assert runs[0].system.controller.name == "stop and go in C++"
    assert runs[0].system.controller.sha256 != runs[1].system.controller.sha256


def test_through_run_replay_fuzz_attribute_and_selftest() -> None:
    assert command("run", "visit.yaml", "--out", "out").exit_code == 0
    trace = "out/traces/visit.trace"
    again = command("replay", trace, *CLIENT)
    assert (again.exit_code, "identical: visit" in again.output) == (0, True), again.output
    refused = command("replay", trace, "--controller", "mine.py:StopAndGo")
    assert (refused.exit_code, "stop and go in C++" in refused.output) == (2, True), refused.output
    found = command("fuzz", "space.yaml", *CLIENT, "--budget", "4", "--out", "found")
    assert found.exit_code in (0, 1), found.output
    data = json.loads(Path("found/findings.json").read_text())
    assert data["system"]["controller"]["name"] == "stop and go in C++"
    assert command("attribute", trace, *CLIENT).exit_code == 0
    options = ("--scenarios", "scenarios", "--jobs", "1", "--out", "trial", *CLIENT, "--fault", "overspeed")
    assert command("selftest", *options).exit_code == 0


def test_through_pytest_beside_the_class(folder: Path) -> None:
    (folder / "class.yaml").write_text(VISIT)
    (folder / "wrong.yaml").write_text((folder / "visit.yaml").read_text().replace(": violated", ": holds"))
    words = ["-q", "-p", "no:cacheprovider", "--safety-world", "kinematic"]
    files = ("visit.yaml", "class.yaml", "wrong.yaml")
    done = subprocess.run(
        [sys.executable, "-m", "pytest", *words, *files], capture_output=True, text=True, check=False
    )
    assert "1 failed, 5 passed, 9 skipped" in done.stdout, done.stdout + done.stderr
    assert re.search(r"FAILED wrong.yaml::.*hand distance never below 600 mm", done.stdout)


def test_through_campaign_compare_certify_and_verify() -> None:
    for name in ("plan", "other"):
        found = command("campaign", "run", f"{name}.yaml", "--ledger", f"{name}.sqlite", "--workers", "1")
        assert found.exit_code == 0, found.output
    compared = command("campaign", "compare", "plan.sqlite", "other.sqlite")
    assert compared.exit_code == 0, compared.output
    made = command("certify", "plan.yaml", "--out", "report", "--workers", "1")
    assert made.exit_code in (0, 1), made.output
    stands = command("verify", "report", "--runs", "1", "--execute-programs")
    assert stands.exit_code == 0, stands.output
