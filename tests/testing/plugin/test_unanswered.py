"""No green for an avoider that does not answer: tests that judge its runs fail, the summary says why."""

from __future__ import annotations

import json
import xml.etree.ElementTree as ET
from pathlib import Path

import pytest

FAULTY = """\
from safety_harness import Proposal


class Raising:
    name = "raising"

    def propose(self, **question):
        raise ZeroDivisionError("no answer")


class Listing:
    name = "listing"

    def propose(self, *, tcp_position_in_base_m, **question):
        return list(tcp_position_in_base_m)
"""
IN_PYTHON = """\
from pathlib import Path

import pytest
from safety_harness import read_scenario
from safety_harness.testing import SafetyViolation, assert_holds
from faulty import Raising

FINE = read_scenario(Path("fine.yaml"))


def test_asserts(simulate):
    assert_holds("TCP speed never above 250 mm/s", simulate(FINE, avoider=Raising()))


def test_only_simulates(simulate):
    assert len(simulate(FINE, avoider=Raising()).ticks) > 0


def test_answers(simulate):
    assert_holds("TCP speed never above 250 mm/s", simulate(FINE))


def test_expects_it(simulate):
    expected = read_scenario(Path("expected.yaml"))
    assert_holds("TCP speed never above 250 mm/s", simulate(expected, avoider=Raising()))


def test_looks_for_it(simulate):
    with pytest.raises(SafetyViolation, match="the avoider answered"):
        assert_holds("the avoider answered", simulate(FINE, avoider=Raising()))
"""
SAID = "the avoider did not answer: with the fallback in its place in * of * decisions of 1 run"


@pytest.fixture(autouse=True)
def _faulty(project: Path) -> None:
    (project / "faulty.py").write_text(FAULTY)
    fine = (project / "fine.yaml").read_text()
    (project / "expected.yaml").write_text(fine + "  the avoider answered: violated\n")


@pytest.mark.parametrize(
    ("avoider", "why"), [("Raising", "ZeroDivisionError: no answer"), ("Listing", "got list")]
)
def test_every_claim_of_a_scenario_fails_whatever_came_of_it(run, avoider: str, why: str) -> None:
    result = run(
        "fine.yaml", f"--avoider=faulty.py:{avoider}", "--junitxml=junit.xml", "--safety-report=r.html"
    )
    result.assert_outcomes(failed=2)
    result.stdout.fnmatch_lines(["the avoider answered: violated", f"*usable answer; first: *{why}*", SAID])
    assert "with the fallback in its place" in Path("r.html").read_text().split("</h1>")[0]
    (of_run,) = json.loads(Path("r.json").read_text())["runs"]
    assert of_run["avoider_answered"]["verdict"] == "violated"
    claims = {claim["claim"]: claim["verdict"] for claim in of_run["claims"]}
    assert claims["the avoider answered"] == "violated"
    assert 'value="the avoider answered"' in Path("junit.xml").read_text()
    assert len(list(ET.parse("junit.xml").iter("failure"))) == 2


def test_a_file_that_expects_it_passes_and_the_summary_still_says_so(run) -> None:
    result = run("expected.yaml", "--avoider=faulty.py:Raising")
    result.assert_outcomes(passed=3)
    result.stdout.fnmatch_lines([SAID])


def test_an_avoider_that_answers_where_the_file_expects_none_fails(run) -> None:
    run("expected.yaml").assert_outcomes(passed=2, failed=1)


def test_a_space_fails_with_the_smallest_draw_that_it_is_kept_of(run, project: Path) -> None:
    result = run("reaches.yaml", "-k", "speed", "--avoider=faulty.py:Raising", "--safety-derandomize")
    result.assert_outcomes(failed=1, deselected=1)
    result.stdout.fnmatch_lines(
        ["the scenario, made smaller:", "the avoider did not answer: with the fallback*"]
    )
    (file,) = (file for file in (project / ".safety-harness").rglob("*.yaml") if file.is_file())
    assert "the avoider answered: holds" in file.read_text()


def test_suites_in_python_fail_too_even_where_nothing_is_asserted_of_the_run(run, project: Path) -> None:
    (project / "test_faulty.py").write_text(IN_PYTHON)
    result = run("test_faulty.py", "-v")
    result.assert_outcomes(passed=3, failed=2)
    result.stdout.fnmatch_lines(["*test_asserts FAILED*", "*test_only_simulates FAILED*"])
