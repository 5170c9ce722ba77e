"""A cell in which a hand came too near, once for all tests of this folder."""

from __future__ import annotations

from pathlib import Path

import pytest
from cells_made import CELL, run_of_cell, write_log

from safety_harness.trace.trace import Trace

NEAR = "hand distance never below 150 mm"


@pytest.fixture(scope="session")
def happened() -> Trace:
    """What the cell's arm and hand did."""
    return run_of_cell()


@pytest.fixture
def cell(tmp_path: Path) -> Path:
    """The scenario of the cell, in a folder of its own."""
    file = tmp_path / "cells" / "cell.yaml"
    file.parent.mkdir()
    file.write_text(CELL)
    return file


@pytest.fixture
def log(tmp_path: Path, happened: Trace) -> Path:
    """The log of what happened."""
    return write_log(happened, tmp_path / "log", f"{NEAR}: violated", "joint speeds within limits: holds")
