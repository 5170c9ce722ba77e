"""The example works as it stands, from the command line, on its page and in pytest."""

from __future__ import annotations

import json
from pathlib import Path
from shutil import copytree

from typer.testing import CliRunner

from safety_harness.cli.main import app

EXAMPLE = Path(__file__).parents[3] / "examples" / "logs" / "LOG.yaml"


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
    assert "VIOLATED" in found.output


def test_it_is_no_scenario() -> None:
    found = CliRunner().invoke(app, ["run", str(EXAMPLE)])
    assert found.exit_code == 2
    assert "the log of a cell" in found.output
    assert "safety-harness judge" in found.output


def test_a_log_that_claims_nothing_is_not_judged(tmp_path: Path) -> None:
    said = copied(tmp_path)
    said.write_text(said.read_text().partition("claims:")[0])
    found = CliRunner().invoke(app, ["judge", str(said)])
    assert found.exit_code == 2
    assert (
        CliRunner().invoke(app, ["judge", str(said), "--claim", "always joint speed < 90 deg/s"]).exit_code
        != 2
    )


def test_where_no_sample_is_in_time_it_says_what_times_there_are(tmp_path: Path) -> None:
    said = copied(tmp_path)
    said.write_text(said.read_text().replace("137 ms", "137 s"))
    found = CliRunner().invoke(app, ["judge", str(said)])
    assert found.exit_code == 2
    assert "its times are" in found.output


def copied(folder: Path) -> Path:
    """The example in a folder of its own."""
    copytree(EXAMPLE.parent, folder, dirs_exist_ok=True)
    return folder / EXAMPLE.name
