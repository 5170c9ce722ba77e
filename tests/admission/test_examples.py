"""The examples of docs/how-to/avoider.md run as they stand."""

from __future__ import annotations

import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from safety_harness import admit, read_scenario, run_trial
from safety_harness.admission.avoiders import NAMES
from safety_harness.base.exceptions import ModelError
from safety_harness.base.settings import DEFAULTS, Avoidance
from safety_harness.report.words import flag_words
from safety_harness.scenario.model import Scenario
from safety_harness.seams.contract import SIGHTS
from safety_harness.trace.records import Check, DecisionOutcome
from safety_harness.trace.trace import Trace

ROOT = Path(__file__).parents[2]
EXAMPLES = ROOT / "examples"
FILE = ROOT / "docs/how-to/avoider.md"
PAGE = FILE.read_text()
PREDICTORS = (ROOT / "docs/how-to/predictor.md").read_text()
ONNX, GATE = ((ROOT / f"docs/reference/{name}.md").read_text() for name in ("onnx", "controller"))


def visit(avoider: str) -> Scenario:
    """The scenario of the page's command lines, up to shortly after its first decision."""
    shipped = read_scenario(ROOT / "scenarios/hand-visits-and-leaves.yaml")
    return replace(shipped, avoider=avoider, duration_s=3.2)


def run(avoider: str) -> Trace:
    trace = run_trial(admit(visit(avoider)))
    assert len(trace.decisions) > 0
    assert (trace.decisions["fault"] == "").all()
    return trace


@pytest.fixture(scope="module")
def model_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("models") / "constant.safetensors"
    subprocess.run([sys.executable, str(EXAMPLES / "model_file.py"), str(path)], check=True, cwd=ROOT)
    return path


def test_a_class_of_a_file_decides() -> None:
    decisions = run("../examples/upwards.py:Upwards").decisions
    assert (decisions["outcome"] == DecisionOutcome.PROPOSED).all()
    up = decisions["chosen_position_in_base_m"] - decisions["tcp_position_in_base_m"]
    assert up == pytest.approx(np.tile([0.0, 0.0, 0.1], (len(up), 1)), abs=1e-12)


def test_an_object_of_a_file_decides_while_it_is_certain_enough() -> None:
    decisions = run("../examples/three_guesses.py:guesses").decisions
    assert (decisions["outcome"] == DecisionOutcome.PROPOSED).all()
    assert (decisions["proposed_spread_m"].max(axis=1) <= decisions["spread_threshold_m"]).all()
    decisions = run("../examples/three_guesses.py:hesitant").decisions
    assert (decisions["outcome"] == DecisionOutcome.OPPOSITE).all()
    assert (decisions["proposed_failed"] & Check.UNCERTAIN).all()
    assert (decisions["proposed_spread_m"].max(axis=1) > decisions["spread_threshold_m"]).all()


def test_a_model_file_decides(model_file: Path) -> None:
    decisions = run(str(model_file)).decisions
    assert (decisions["outcome"] == DecisionOutcome.PROPOSED).all()
    assert decisions["chosen_position_in_base_m"] == pytest.approx(
        np.tile([0.66, 0.05, 0.45], (len(decisions), 1)), abs=1e-6
    )


def test_a_model_file_of_another_workspace_is_refused(model_file: Path) -> None:
    elsewhere = replace(DEFAULTS, avoidance=Avoidance(nominal_hand_position_in_base_m=(0.3, 0.9, 0.2)))
    with pytest.raises(ModelError, match="another workspace"):
        admit(replace(visit(str(model_file)), settings=elsewhere))


def test_an_onnx_file_decides(tmp_path: Path) -> None:
    path = tmp_path / "up.onnx"
    subprocess.run([sys.executable, str(EXAMPLES / "onnx_model.py"), str(path)], check=True, cwd=ROOT)
    decisions = run(str(path)).decisions
    assert (decisions["outcome"] == DecisionOutcome.PROPOSED).all()
    up = decisions["chosen_position_in_base_m"] - decisions["tcp_position_in_base_m"]
    assert up == pytest.approx(np.tile([0.0, 0.0, 0.1], (len(up), 1)), abs=1e-6)
    assert decisions["proposed_spread_m"] == pytest.approx(np.full((len(up), 3), 0.005))
    assert decisions["spread_threshold_m"] == pytest.approx(0.01)


def test_a_file_that_is_no_model_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "mine.safetensors"
    file.write_bytes(b"import os")
    with pytest.raises(ModelError, match="safetensors"):
        admit(visit(str(file)))


def test_the_page_shows_what_the_example_holds() -> None:
    code, seeing, *_ = re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL)
    assert code in (EXAMPLES / "upwards.py").read_text()
    made: dict[str, object] = {}
    exec(seeing, made)
    assert set(made["AwayFromAll"].sees) <= {sight.word for sight in SIGHTS}


def test_the_page_names_every_avoider_of_ours_every_example_and_every_check() -> None:
    for name in NAMES:
        assert f"| `{name}` |" in PAGE
    for file in EXAMPLES.glob("*.py"):
        assert f"(../../examples/{file.name})" in PAGE + ONNX + PREDICTORS
    for link in re.findall(r"\]\(([^)#]+)\)", PAGE):
        assert (FILE.parent / link).exists(), link
    table = GATE.split("## The gate", 1)[1].split("\n## ", 1)[0]
    assert re.findall(r"^\| ([a-z ]+) \|.*(?:yes|no) \|$", table, re.M) != []
    named = set(re.findall(r"^\| ([a-z ]+) \|.*(?:yes|no) \|$", table, re.M))
    assert named == {flag_words(check) for check in Check if check}
