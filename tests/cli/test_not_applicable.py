"""The shipped `hand-visits-and-leaves` has 15 claims of 26 that are about an avoider: not of a controller."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from typer.testing import CliRunner

from safety_harness.cli.console import AS_EXPECTED
from safety_harness.cli.main import app

SHIPPED = Path(__file__).parents[2] / "scenarios" / "hand-visits-and-leaves.yaml"
CONTROLLER = ["--controller", "stop when near"]


def test_a_run_with_a_controller_is_as_expected(tmp_path: Path) -> None:
    words = ["run", str(SHIPPED), *CONTROLLER, "--world", "kinematic", "--out", str(tmp_path)]
    result = CliRunner().invoke(app, words)
    assert result.exit_code == AS_EXPECTED, result.output
    assert "11 of 11 verdicts as expected" in result.output
    assert "15 claims not applicable to the controller" in result.output
    claims = json.loads((tmp_path / "report.json").read_text())["runs"][0]["claims"]
    assert len(claims) == 26


def test_a_search_with_a_controller_is_as_expected(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """But for the one claim that the file expects to be violated, which a search has to find."""
    text = SHIPPED.read_text().replace("scenario:", "scenario space:", 1)
    text = text.replace("    speed: 0.5 m/s", "    speed: from 0.4 m/s to 0.5 m/s").replace(
        "  protective separation kept: violated\n", ""
    )
    file = tmp_path / "space.yaml"
    file.write_text(text)
    words = ["fuzz", str(file), *CONTROLLER, "--budget", "4", "--out", str(tmp_path / "found")]
    result = CliRunner().invoke(app, words)
    assert result.exit_code == AS_EXPECTED, result.output
    assert "NOT FOUND" not in result.output
    assert result.output.count("not applicable to the controller") >= 1
