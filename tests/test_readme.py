"""The README's examples run as they stand."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest

from safety_harness import admit, judge, parse_scenario, read_space, run_trial
from safety_harness.testing.simulating import simulate

README = Path(__file__).parents[1] / "README.md"


def blocks(language: str) -> list[str]:
    return re.findall(rf"```{language}\n(.*?)```", README.read_text(), re.DOTALL)


def test_the_scenario_of_the_readme_comes_out_as_it_expects() -> None:
    (text,) = blocks("yaml")
    trace = run_trial(admit(parse_scenario(text)))
    assert [e.verdict for e in judge(trace)] == [c.expected for c in trace.scenario.claims]


def test_the_python_of_the_readme_runs(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    _, code = blocks("python")
    monkeypatch.chdir(README.parent)
    exec(compile(code, "README", "exec"), {"__name__": "readme"})
    lines = capsys.readouterr().out.splitlines()
    assert any(line.startswith("repulsive poses reachable holds") for line in lines)


def test_the_test_of_the_readme_passes_for_a_draw_of_its_space(monkeypatch: pytest.MonkeyPatch) -> None:
    code, _ = blocks("python")
    monkeypatch.chdir(README.parent)
    namespace: dict[str, Any] = {}
    exec(compile(code, "README", "exec"), namespace)
    draw = read_space("shipped:reaching-hands").draw(seed=0, k=2)
    namespace["test_keeps_its_distance"].hypothesis.inner_test(scenario=draw, simulate=simulate)


def test_every_linked_document_exists() -> None:
    for link in re.findall(r"\]\(([^)#]+)\)", README.read_text()):
        assert (README.parent / link).exists(), link
