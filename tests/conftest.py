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

from safety_harness.trace.trace import Trace


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--oracles", type=Path, help="write the largest disagreements with oracles to this file")


def pytest_configure() -> None:
    """A shell that starts tests in the background has Ctrl-C ignored; some tests send it to themselves."""
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)


def pytest_sessionfinish(session: pytest.Session) -> None:
    path = session.config.getoption("--oracles")
    if path is not None:
        disagreement.write(path)


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
