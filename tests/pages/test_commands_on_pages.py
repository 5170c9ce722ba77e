"""The command on a page repeats what the page shows."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

import safety_harness
from safety_harness import KINEMATIC
from tests.cli.test_own_avoider import VISIT
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


def test_a_search_writes_its_page_and_its_map(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("short.yaml").write_text(TEXT)
    safety_harness.fuzz("short.yaml", budget=4, claims=["joint speeds within limits"]).write("out")
    assert "fuzz short.yaml" in Path("out/fuzz.html").read_text()
    assert Path("out/coverage.svg").read_text().lstrip().startswith("<svg")
