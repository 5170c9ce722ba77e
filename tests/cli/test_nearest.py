"""What is mistyped is answered with what is nearest and where all of them are, never with all of them."""

from __future__ import annotations

from pathlib import Path

import pytest
from typer.testing import CliRunner

from safety_harness.claims.properties.catalogue import CATALOGUE
from safety_harness.cli.console import BAD_INPUT
from safety_harness.cli.main import app
from tests.kinds_of_files import SCENARIO

NEAR = [
    ("joint speeds within limits", "joint speed within limit", "joint speeds within limits"),
    ("joint speeds within limits", "joint positions in limits", "joint positions within limits"),
    ("joint speeds within limits", "always hand distence > 5 mm", "hand distance"),
    ("opposite pose", "oposite pose", "opposite pose"),
    ("opposite pose", "mc-dropuot", "mc-dropout"),
    ("tcp start", "tcp strat", "tcp start"),
    ("duration: 300 ms", "duration: 300 ms\nrobot: ur-5", "UR5"),
]


@pytest.mark.parametrize(("right", "written", "nearest"), NEAR)
def test_the_nearest_of_a_mistyped_word_is_told(
    right: str, written: str, nearest: str, tmp_path: Path
) -> None:
    file = tmp_path / "mine.yaml"
    file.write_text(SCENARIO.replace(right, written))
    found = CliRunner().invoke(app, ["validate", str(file)])
    assert found.exit_code == BAD_INPUT
    hint = next(line for line in found.output.splitlines() if line.startswith("  hint"))
    assert f'"{nearest}"'.lower() in hint.lower()


def test_a_mistyped_claim_gets_three_and_the_command_that_lists_all(tmp_path: Path) -> None:
    file = tmp_path / "mine.yaml"
    file.write_text(SCENARIO.replace("joint speeds within limits", "joint speed within limits"))
    said = CliRunner().invoke(app, ["validate", str(file)]).output
    assert sum(f'"{entry.example}"' in said for entry in CATALOGUE) == 3
    assert "all of them: safety-harness claims" in said


@pytest.mark.parametrize(
    ("words", "nearest"),
    [
        (["fuzz", "SPACE", "--searcher", "cma"], "cma-es"),
        (["claims", "joint speed"], "joint speeds within limits"),
        (["explain", "critical distence"], "critical distance"),
    ],
)
def test_so_is_that_of_an_option(words: list[str], nearest: str, tmp_path: Path) -> None:
    found = CliRunner().invoke(app, [str(tmp_path) if word == "SPACE" else word for word in words])
    assert found.exit_code == BAD_INPUT
    assert f'did you mean "{nearest}"' in found.output
