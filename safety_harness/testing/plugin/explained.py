"""What the files of the plug-in share: the test of an item, and a mistake in words."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from safety_harness.base.exceptions import explanation
from safety_harness.testing.session import TestRun

JUDGES_ITSELF = "judges_runs_itself"
TEST: pytest.StashKey[TestRun] = pytest.StashKey()


def explained(error: BaseException) -> str:
    """Where, what was expected, what came, the hint; and the line of the test that asked."""
    lines = [explanation(error), *(f"  {note}" for note in getattr(error, "__notes__", []))]
    return "\n".join(lines).replace(f"{Path.cwd()}{os.sep}", "")
