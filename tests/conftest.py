"""Fixtures: runs that several tests look at are made once."""

from __future__ import annotations

import signal
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import disagreement
import pytest
from browsing import started
from examples import VISIT, run, scenario
from hypothesis import settings

from safety_harness.trace.trace import Trace

TESTS = Path(__file__).parent
# Where each of two workers starts (``--dist worksteal``), the second at the middle: with the worlds, and with
# networks and what else they call.  So neither compiles what the other does, on a fresh machine two minutes'
# work, and neither ends with what takes long.
WORLDS = ("simulation", "admission", "controller", "campaign", "cli", "search", "certification")
PARTS = ("learning", "avoidance", "perception", "servoing", "geometry", "robot", "docs", "pytest_plugin")


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--oracles", type=Path, help="write the largest disagreements with oracles to this file")


def pytest_configure() -> None:
    """No deadlines: whoever calls a kernel first compiles it, and machines are busy.

    A shell that starts tests in the background has Ctrl-C ignored; some tests send it to themselves.
    """
    settings.register_profile("unhurried", settings(), deadline=None)
    settings.load_profile("unhurried")
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)


def pytest_sessionfinish(session: pytest.Session) -> None:
    path = session.config.getoption("--oracles")
    if path is not None:
        disagreement.write(path)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """The worlds' tests at the beginning, those of the parts in the middle."""
    rooms = [item.path.relative_to(TESTS).parts[0] if TESTS in item.path.parents else "" for item in items]
    worlds, parts = (
        [item for room in first for item, its in zip(items, rooms, strict=True) if its == room]
        for first in (WORLDS, PARTS)
    )
    others = [
        item for item, room in zip(items, rooms, strict=True) if room not in WORLDS and room not in PARTS
    ]
    cut = max(0, (len(items) + 1) // 2 - len(worlds))
    items[:] = worlds + others[:cut] + parts + others[cut:]


@pytest.fixture(scope="session")
def visit() -> Trace:
    """A hand comes, stays for a moment and goes; the TCP gives way by the opposite pose."""
    return run(scenario(VISIT, duration_s=4.0))


@pytest.fixture(scope="session")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Any]:
    """One browser for all pages."""
    chrome = started(tmp_path_factory.mktemp("profile"))
    yield chrome
    chrome.quit()
