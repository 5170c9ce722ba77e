"""Define a kind of input file, so that ``judge``, ``view`` and pytest can read a real cell's log as a run."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from safety_harness.base.extension_points import InputFile
from safety_harness.scenario.kinds import FileKind
from safety_harness.scenario.model import Claim

if TYPE_CHECKING:
    from safety_harness.extensions.field.logs.certain import LoggedTrace


def _recorded(path: Path, claims: tuple[Claim, ...]) -> LoggedTrace:
    from safety_harness.extensions.field.logs.judging import recorded

    return recorded(path, claims)


LOGS = InputFile(words=FileKind.LOG.words, command=FileKind.LOG.command, recorded=_recorded)
