"""The tutorials do what they say, from an empty folder."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from runpy import run_path

import pytest
import ready
from tutorial import SCRIPTS, TutorialError, blocks_of, environment_of, follow
from typer.testing import CliRunner

from safety_harness.cli.main import app
from safety_harness.extensions.field.logs.read import read_log
from safety_harness.extensions.lab.proof.plan import read_proof_plan

TUTORIALS = sorted((Path(__file__).parents[2] / "docs" / "tutorials").glob("*.md"))


LONG = ("release",)  # minutes of processor time; what it needs least is tried below


@pytest.fixture(scope="module")
def commands() -> Iterator[Path]:
    with ready.command(environment_of([SCRIPTS])) as folder:
        yield folder


def test_there_is_a_tutorial_for_each_job() -> None:
    assert [page.stem for page in TUTORIALS] == ["first-run", "fuzz", "release", "report", "suite"]


@pytest.mark.parametrize(
    "page",
    [pytest.param(page, marks=[pytest.mark.long] * (page.stem in LONG)) for page in TUTORIALS],
    ids=lambda page: page.stem,
)
def test_every_file_and_command_of_the_tutorial_does_what_it_says(
    page: Path, tmp_path: Path, commands: Path
) -> None:
    follow(page.read_text(), tmp_path, commands)


@pytest.mark.parametrize("stem", LONG)
def test_the_files_of_a_long_tutorial_can_be_used(
    stem: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    blocks = blocks_of(next(page for page in TUTORIALS if page.stem == stem).read_text())
    lines = [line for block in blocks if block.language == "sh" for line in block.text.splitlines()]
    for block in blocks:
        if block.file:
            Path(block.file).write_text(block.text)
    (copied,) = (line for line in lines if line.startswith("safety-harness copy"))
    for words in (copied, "safety-harness validate handover.yaml next.yaml plan.yaml"):
        done = CliRunner().invoke(app, words.split()[1:])
        assert done.exit_code == 0, done.output
    assert read_proof_plan(Path("proof.yaml")).proofs
    run_path("cell.py")
    read_log(Path("LOG.yaml"))


@pytest.mark.parametrize(
    ("page", "why"),
    [
        ("```sh\nfalse\n```\n", "ended with 1"),
        ("```sh\ntrue # exit code 1\n```\n", "ended with 0"),
        ("```sh\nexit 2 # exit code 0|1\n```\n", "ended with 2"),
        ("```sh\necho one two\n```\n```text\none ... three\n```\n", "told"),
        ("```sh\necho one two\n```\n```text\none\n```\n", "told"),
        ('```yaml title="a"\nx\n```\n```sh\ncat a\n```\n```text\ny\n```\n', "told"),
    ],
)
def test_a_tutorial_that_tells_something_else_fails(page: str, why: str, tmp_path: Path) -> None:
    with pytest.raises(TutorialError, match=why):
        follow(page, tmp_path)


def test_dots_stand_for_anything_over_lines_and_blanks_do_not_count(tmp_path: Path) -> None:
    follow("```sh\nprintf 'a  b\\nc\\nd\\n' # exit code 0\n```\n```text\na b\n...\nd\n```\n", tmp_path)


def test_every_command_and_file_of_a_page_is_found() -> None:
    for page in TUTORIALS:
        text = page.read_text()
        assert len(blocks_of(text)) == text.count("\n```") // 2
