"""A tutorial as a user goes through it: files are written, commands run, and output compared, in order.

A fenced block with ``title="FILE"`` is that file.  A block of ``sh`` has a command a line; it has to end with
0, or with what its comment says: ``# exit code 1``.  A block of ``text`` after it is its standard output, in
which ``...`` stands for whatever there is.
"""

from __future__ import annotations

import os
import re
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

_FENCE = re.compile(r"^```(\w+)(?: title=\"([^\"]+)\")?\n(.*?)^```$", re.DOTALL | re.MULTILINE)
_EXIT = re.compile(r"#\s*exit code (\d+(?:\|\d+)*)\s*$")
SCRIPTS = Path(sys.executable).parent


@dataclass(frozen=True)
class Block:
    """A fenced block: its language, the file that it is (or ""), and its text."""

    language: str
    file: str
    text: str


class TutorialError(AssertionError):
    """What the tutorial says is not what happens."""


def blocks_of(page: str) -> list[Block]:
    return [Block(*(part or "" for part in found)) for found in _FENCE.findall(page)]


def follow(page: str, folder: Path, ready: Path | None = None) -> None:
    """Do everything that a page tells, in ``folder``; TutorialError where it tells something else.

    After its first line of shell, which is as a user has it, programs of the folder ``ready`` come first.
    """
    said, programs = "", [SCRIPTS]
    for block in blocks_of(page):
        if block.file:
            (folder / block.file).write_text(block.text)
        elif block.language == "sh":
            said = ""
            for line in block.text.splitlines():
                said += _run(line, folder, programs)
                programs = [ready, SCRIPTS] if ready else programs
        elif block.language == "text" and not _fits(block.text, said):
            raise TutorialError(f"told:\n{block.text}\nsaid:\n{said}")


def environment_of(programs: Sequence[Path]) -> dict[str, str]:
    """Of commands that find the programs of these folders first."""
    path = os.pathsep.join([*map(str, programs), os.environ["PATH"]])
    environment = os.environ | {"PATH": path, "COLUMNS": "200"}
    environment.pop("PYTEST_ADDOPTS", None)
    return environment


def _run(line: str, folder: Path, programs: Sequence[Path]) -> str:
    """Standard output of a command line that ends as it says."""
    words, environment = ["bash", "-c", line], environment_of(programs)
    done = subprocess.run(words, cwd=folder, env=environment, capture_output=True, text=True, timeout=900)
    expected = _EXIT.search(line)
    codes = (expected[1] if expected else "0").split("|")
    if str(done.returncode) not in codes:
        raise TutorialError(f"{line}\nended with {done.returncode}\n{done.stdout}\n{done.stderr}")
    return done.stdout


def _fits(told: str, said: str) -> bool:
    """Whether output is as told; runs of blanks are one, and ``...`` is anything, over lines too."""
    parts = [re.escape(" ".join(part.split())) for part in re.split(r"\.\.\.", told)]
    pattern = ".*".join(parts)
    return re.fullmatch(pattern, " ".join(said.split()), re.DOTALL) is not None
