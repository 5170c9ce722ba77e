"""The tutorials do what they say, from an empty folder."""

from __future__ import annotations

from pathlib import Path

import pytest
from tutorial import TutorialError, blocks_of, follow

TUTORIALS = sorted((Path(__file__).parents[2] / "docs" / "tutorials").glob("*.md"))


def test_there_is_a_tutorial_for_each_of_the_three_jobs() -> None:
    assert [page.stem for page in TUTORIALS] == ["fuzz", "report", "suite"]


@pytest.mark.parametrize("page", TUTORIALS, ids=lambda page: page.stem)
def test_every_file_and_command_of_the_tutorial_does_what_it_says(page: Path, tmp_path: Path) -> None:
    follow(page.read_text(), tmp_path)


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
