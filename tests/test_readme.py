"""The README's examples run as they stand."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from safety_harness import admit, judge, parse_scenario, run_trial

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
    (code,) = blocks("python")
    monkeypatch.chdir(README.parent)
    exec(compile(code, "README", "exec"), {"__name__": "readme"})
    lines = capsys.readouterr().out.splitlines()
    assert any(line.startswith("repulsive poses reachable holds") for line in lines)


def test_every_linked_document_exists() -> None:
    for link in re.findall(r"\]\(([^)#]+)\)", README.read_text()):
        assert (README.parent / link).exists(), link
