"""Provide the test record of an item and the text of a mistake, for several parts of the plug-in."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from safety_harness.base.exceptions import explanation
from safety_harness.testing.session import TestRun

JUDGES_ITSELF = "judges_runs_itself"
TEST: pytest.StashKey[TestRun] = pytest.StashKey()


def explained(error: BaseException) -> str:
    """Return the text of a mistake.

    It states the place, the expected value, the actual value, a hint, and the line of the test that led to
    the mistake.
    """
    lines = [explanation(error), *(f"  {note}" for note in getattr(error, "__notes__", []))]
    return "\n".join(lines).replace(f"{Path.cwd()}{os.sep}", "")
