"""Fixtures: runs that several tests look at are made once."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent))

from examples import VISIT, run, scenario

from safety_harness.trace.trace import Trace


@pytest.fixture(scope="session")
def visit() -> Trace:
    """A hand comes, stays for a moment and goes; the TCP gives way by the opposite pose."""
    return run(scenario(VISIT, duration_s=4.0))
