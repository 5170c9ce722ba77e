"""The command on a page repeats what the page shows."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

import safety_harness
from safety_harness import KINEMATIC
from safety_harness.cli.scenario_commands import run
from tests.cli.test_own_avoider import MINE, SLEEPY, VISIT
from tests.search.short_space import TEXT


def test_a_page_has_the_options_of_its_runs_and_the_files_of_scenarios_that_had_none(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("visit.yaml").write_text(VISIT)
    safety_harness.run("visit.yaml", world=KINEMATIC).write("out")
    assert "--out out --world kinematic" in Path("out/report.html").read_text()
    scenario = replace(safety_harness.read_scenario(Path("visit.yaml")), name="changed", seed=7, file=None)
    safety_harness.run(scenario, world=KINEMATIC).write("out")
    assert "safety-harness run out/scenarios/changed.yaml" in Path("out/report.html").read_text()


def test_a_page_repeats_the_command_with_an_avoider_of_the_user(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("visit.yaml").write_text(VISIT)
    Path("mine.py").write_text(MINE)
    assert run([Path("visit.yaml")], Path("out"), "mine.py:Mine") == 0
    page = Path("out/report.html").read_text()
    assert "safety-harness run visit.yaml --out out --avoider mine.py:Mine" in page
    assert "safety-harness replay out/traces/visit.trace --avoider mine.py:Mine" in page


@pytest.mark.parametrize(
    ("declared", "modelled"),
    [("None", "computing time not modelled"), ("0.04", "40 ms a decision, as the avoider declares")],
)
def test_a_page_says_how_computing_time_is_modelled(
    declared: str, modelled: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("visit.yaml").write_text(VISIT)
    Path("mine.py").write_text(SLEEPY.replace("DECLARED", declared))
    Path("mine.s").write_text("0")
    run([Path("visit.yaml")], Path("out"), "mine.py:Mine")
    assert modelled in Path("out/report.html").read_text()


def test_the_page_of_a_search_names_its_reference(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("short.yaml").write_text(TEXT)
    found = safety_harness.fuzz("short.yaml", avoider="mc-dropout", against="opposite pose", budget=4)
    found.write("out")
    assert "Against opposite pose" in Path("out/fuzz.html").read_text()


def test_a_search_writes_its_page_and_its_map(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("short.yaml").write_text(TEXT)
    safety_harness.fuzz("short.yaml", budget=4, claims=["joint speeds within limits"]).write("out")
    assert "fuzz short.yaml" in Path("out/fuzz.html").read_text()
    assert Path("out/coverage.svg").read_text().lstrip().startswith("<svg")
