"""SARIF, Markdown, the action and the hooks: what a code host shows is what the report says, at its line."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import factory
import yaml
from jsonschema.validators import validator_for

from safety_harness.base.exceptions import Place
from safety_harness.report.ci_formats import MOST_LINES, markdown, sarif
from safety_harness.report.evidence import JudgedRun
from safety_harness.scenario.model import Claim
from safety_harness.trace.system import Component

ROOT = Path(__file__).parents[2]
STILL = """\
scenario: still
duration: 80 ms
tcp start:
  offset: [0 mm, 0 mm, 20 mm]
claims:
  trace finite and monotone: holds
"""


def at_lines(run: JudgedRun, file: Path) -> JudgedRun:
    """The same, its claims from line 10 of a file on."""

    def at(claim: Claim, line: int) -> Claim:
        return replace(claim, place=Place(file=file, line=line))

    claims = tuple(at(claim, line) for line, claim in enumerate(run.trace.scenario.claims, start=10))
    scenario = replace(run.trace.scenario, claims=claims, file=file)
    return replace(run, trace=replace(run.trace, scenario=scenario))


def test_each_claim_that_is_not_as_expected_is_an_error_at_its_line(tmp_path: Path) -> None:
    run = at_lines(factory.violated_run(), Path("scenarios/two hands.yaml"))
    (found,) = sarif([factory.holds_run(), run])["runs"]
    unlike = [k for k, expected in enumerate(run.as_expected) if not expected]
    errors = [one for one in found["results"] if one["level"] == "error"]
    places = [one["locations"][0]["physicalLocation"] for one in errors]
    assert [place["region"]["startLine"] for place in places] == [10 + k for k in unlike]
    assert {place["artifactLocation"]["uri"] for place in places} == {"scenarios/two%20hands.yaml"}  # a URI
    rules = {rule["id"] for rule in found["tool"]["driver"]["rules"]}
    assert rules == {one["ruleId"] for one in found["results"]}
    assert all(one["message"]["text"] for one in found["results"])
    json.dumps(found, allow_nan=False)


def test_a_run_without_a_file_has_no_place_and_what_holds_is_not_told() -> None:
    (found,) = sarif([factory.holds_run()])["runs"]
    assert found["results"] == []
    (found,) = sarif([factory.violated_run()])["runs"]
    assert found["results"]


# The schema of OASIS's SARIF 2.1.0, as Microsoft's SARIF Multitool 5.7.0 (MIT) ships it.
PUBLISHED = json.loads((Path(__file__).parent / "sarif-2.1.0.json").read_text(encoding="utf-8"))


def test_it_is_of_the_published_schema(tmp_path: Path) -> None:
    validator = validator_for(PUBLISHED)(PUBLISHED)
    runs = [factory.violated_run(), factory.hostile_run(), at_lines(factory.violated_run(), tmp_path / "a b")]
    written = json.loads(json.dumps(sarif(runs)))
    assert len(written["runs"][0]["results"]) > 1
    assert [error.message for error in validator.iter_errors(written)] == []
    written["runs"][0]["results"][0]["level"] = "grave"
    assert len(list(validator.iter_errors(written))) == 1


def test_the_summary_begins_with_the_answer_and_has_one_row_a_line() -> None:
    hostile = factory.hostile_run()
    text = markdown([factory.violated_run(), hostile])
    assert text.startswith("### ")
    assert "as expected" in text.splitlines()[0]
    rows = [line for line in text.splitlines() if line.startswith("| ")][1:]
    assert all(row.replace("\\|", "").count("|") == 7 for row in rows)
    assert "<script" not in text
    named = replace(hostile.trace.scenario, name="![a](http://b) | `c` & <d>")
    text = markdown([replace(hostile, trace=replace(hostile.trace, scenario=named))] * 2)
    assert r"| \!\[a\](http://b) \| \`c\` &amp; &lt;d> |" in text
    many = markdown([factory.violated_run()] * MOST_LINES)
    assert len(many.splitlines()) < MOST_LINES + 12
    assert "more are in report.html" in many


def test_the_action_runs_tells_the_job_and_fails_with_what_is_not_as_expected(tmp_path: Path) -> None:
    action = yaml.safe_load((ROOT / "action.yml").read_text())
    steps = {step["name"]: step for step in action["runs"]["steps"]}
    assert all(step.get("shell") == "bash" or "uses" in step for step in steps.values())
    (tmp_path / "a.yaml").write_text(STILL.replace(": holds", ": violated"))
    defaults = {name: one["default"] for name, one in action["inputs"].items()}
    environment = os.environ | {
        "PATHS": "a.yaml",
        "OPTIONS": "--world kinematic",
        "OUT": defaults["out"],
        "GITHUB_STEP_SUMMARY": str(tmp_path / "job.md"),
        "PATH": f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}",
    }
    codes = [
        subprocess.run(
            ["bash", "-e", "-c", steps[name]["run"]], cwd=tmp_path, env=environment, capture_output=True
        ).returncode
        for name in ("Run", "Summary")
    ]
    assert codes == [1, 0]
    assert "0 of 1 verdicts as expected" in (tmp_path / "job.md").read_text()
    (found,) = json.loads((tmp_path / defaults["out"] / "report.sarif").read_text())["runs"]
    (place,) = found["results"][0]["locations"]
    assert place["physicalLocation"] == {"artifactLocation": {"uri": "a.yaml"}, "region": {"startLine": 6}}


def test_the_hooks_name_commands_that_are_there(tmp_path: Path) -> None:
    hooks = yaml.safe_load((ROOT / ".pre-commit-hooks.yaml").read_text())
    good = tmp_path / "good.yaml"
    good.write_text(STILL)
    for hook in hooks:
        assert {"id", "name", "entry", "language"} <= hook.keys()
        words = [sys.executable, "-m", *hook["entry"].replace("safety-harness", "safety_harness").split()]
        done = subprocess.run([*words, str(good)], capture_output=True, text=True)
        assert done.returncode == 0, done.stdout + done.stderr


def test_the_summary_names_what_was_tested_and_counts_the_rest() -> None:
    run = factory.holds_run()
    systems = [
        replace(run.trace.system, controller=Component(name=f"mine {number}"), avoider=None)
        for number in range(5)
    ]
    runs = [replace(run, trace=replace(run.trace, system=system)) for system in systems]
    lines = [line for line in markdown(runs).splitlines() if line.startswith("tested: ")]
    assert "controller mine 0" in lines[0]
    assert lines[3:] == ["tested: 2 more systems"]
    assert markdown([run, run]).count("tested: ") == 1
