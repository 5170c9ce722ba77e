"""Provide what several parts of the plug-in need: an item's test record, and the text of a mistake."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from safety_harness.base.exceptions import explanation
from safety_harness.testing.session import TestRun

JUDGES_ITSELF = "judges_runs_itself"
TEST: pytest.StashKey[TestRun] = pytest.StashKey()


def explained(error: BaseException) -> str:
    """Return the text of a mistake: place, expected, got, hint, and the test line that led to it."""
    lines = [explanation(error), *(f"  {note}" for note in getattr(error, "__notes__", []))]
    return "\n".join(lines).replace(f"{Path.cwd()}{os.sep}", "")
