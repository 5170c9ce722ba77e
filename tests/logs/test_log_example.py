"""The example works as it stands, from the command line, on its page and in pytest."""

from __future__ import annotations

import json
from pathlib import Path

from typer.testing import CliRunner

from safety_harness.cli.main import app

EXAMPLE = Path(__file__).parents[2] / "examples" / "logs" / "LOG.yaml"


def test_it_is_judged_as_it_says_and_its_page_says_recorded_first(tmp_path: Path) -> None:
    found = CliRunner().invoke(app, ["judge", str(EXAMPLE), "--out", str(tmp_path)])
    assert found.exit_code == 0, found.output
    page = (tmp_path / "report.html").read_text()
    recorded = page.index("<strong>Recorded.</strong>")
    assert "Not measured: object visible" in page[recorded : recorded + 400]
    assert recorded < page.index("hand distance never below 50 mm")
    (run,) = json.loads((tmp_path / "report.json").read_text())["runs"]
    assert run["world"] == "recorded"
    assert run["known"]["joint_position_rad"]["source"] == "log"
    again = CliRunner().invoke(app, ["judge", str(tmp_path / "traces" / "LOG.trace")])
    assert again.exit_code == 0, again.output
    replayed = CliRunner().invoke(app, ["replay", str(tmp_path / "traces" / "LOG.trace")])
    assert replayed.exit_code == 2


def test_another_claim_may_be_made_of_it() -> None:
    found = CliRunner().invoke(app, ["judge", str(EXAMPLE), "--claim", "always hand distance > 400 mm"])
    assert found.exit_code == 1
    assert "violated" in found.output


def test_it_is_no_scenario() -> None:
    found = CliRunner().invoke(app, ["run", str(EXAMPLE)])
    assert found.exit_code == 2
    assert "the log of a cell" in found.output
    assert "safety-harness judge" in found.output
