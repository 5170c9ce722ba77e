"""Commands of wings end with the next command, as those of the core do."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.whole.test_next_commands import TRACE, folder, in_folder, next_words

__all__ = ["folder"]  # a fixture


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (["history", "runs", "--out", "page.html"], ["attribute", "runs/2/traces"]),
        (["export", TRACE, "--out", "run.mcap"], ["judge", "LOG.yaml"]),
    ],
)
def test_a_command_of_a_wing_that_ends_well_ends_with_the_next_command(
    folder: Path,
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
    arguments: list[str],
    expected: list[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    assert next_words(in_folder(folder, arguments)) == in_folder(folder, expected)
