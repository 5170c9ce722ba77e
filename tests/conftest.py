"""Fixtures: runs that several tests look at are made once."""

from __future__ import annotations

import gc
import os
import signal
import sys
from collections.abc import Generator, Iterator
from functools import lru_cache
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import disagreement
import pytest
import typer.testing
from browsing import started
from examples import VISIT, run, scenario
from hypothesis import settings
from pytest_sessions import Sessions, sessions_in

from safety_harness.trace.trace import Trace

TESTS = Path(__file__).parent
# Where each of two workers starts (``--dist worksteal``), the second at the middle: with the worlds, and with
# networks and what else they call.  So neither compiles what the other does, on a fresh machine two minutes'
# work, and neither ends with what takes long.
WORLDS = ("cell/simulation", "admission", "cell/controller", "assurance", "cli", "search")
PARTS = (
    *("lab", "cell/avoidance", "cell/perception", "cell/servoing", "base/geometry", "cell/robot", "docs"),
    "testing/plugin",
)


# What "make test" leaves to "make slow"; .ci/slow.py writes the list from measured times.
SLOW = frozenset((TESTS / "slow.txt").read_text().split())

# Of one tree of commands, which takes longer to make than most of them to answer.
typer.testing._get_command = lru_cache(typer.testing._get_command)  # type: ignore[attr-defined]
NO_PYBULLET = find_spec("pybullet") is None
asked_for_pybullet = [False]  # by the test that runs


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--oracles", type=Path, help="write the largest disagreements with oracles to this file")


def pytest_configure(config: pytest.Config) -> None:
    """No deadlines: whoever calls a kernel first compiles it, and machines are busy.

    A shell that starts tests in the background has Ctrl-C ignored; some tests send it to themselves.  Workers
    of pytest-xdist are told of 80 columns, at which what is printed would be folded.
    """
    os.environ.pop("COLUMNS", None)
    if NO_PYBULLET and os.environ.get("SAFETY_HARNESS_REQUIRE_PYBULLET"):
        pytest.exit("PyBullet is not installed, and SAFETY_HARNESS_REQUIRE_PYBULLET asks for it", 1)
    if NO_PYBULLET:
        sys.meta_path.insert(0, Finder())
        config.pluginmanager.register(WithoutPyBullet())
    settings.register_profile("unhurried", settings(), deadline=None)
    settings.load_profile("unhurried")
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)


def pytest_sessionfinish(session: pytest.Session) -> None:
    path = session.config.getoption("--oracles")
    if path is not None:
        disagreement.write(path)


@lru_cache  # of a file: there are forty times as many tests
def room_of(path: Path) -> str:
    """Return the folder of ``WORLDS`` or ``PARTS`` that a test file lies in; empty for any other file."""
    return next((room for room in (*WORLDS, *PARTS) if TESTS / room in path.parents), "")


@pytest.hookimpl(tryfirst=True)  # before pytest deselects by markers
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Slow tests marked; the worlds' tests at the beginning, those of the parts in the middle."""
    for item in items:
        if f"{item.path.name}::{getattr(item, 'originalname', item.name)}" in SLOW:
            item.add_marker("slow")
    rooms = [room_of(item.path) for item in items]
    worlds, parts = (
        [item for room in first for item, its in zip(items, rooms, strict=True) if its == room]
        for first in (WORLDS, PARTS)
    )
    others = [
        item for item, room in zip(items, rooms, strict=True) if room not in WORLDS and room not in PARTS
    ]
    cut = max(0, (len(items) + 1) // 2 - len(worlds))
    items[:] = worlds + others[:cut] + parts + others[cut:]


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Generator[None, Any, Any]:
    """The garbage collector need not look at nine thousand tests again and again, now or later."""
    gc.disable()
    try:
        return (yield)
    finally:
        gc.enable()
        gc.collect()
        gc.freeze()


class WithoutPyBullet:
    """Where PyBullet is not installed, what fails after it was asked for is skipped; nothing elsewhere.

    That much works without it is tested where it is hidden, ``simulation/test_without_pybullet.py``.
    """

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_protocol(self, item: pytest.Item) -> Generator[None, Any, Any]:
        asked_for_pybullet[0] = False
        return (yield)

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_makereport(self, item: pytest.Item) -> Generator[None, Any, pytest.TestReport]:
        report: pytest.TestReport = yield
        needed = asked_for_pybullet[0] or "needs pybullet, which" in str(report.longrepr)
        return skipped(report, item.path) if report.failed and needed else report

    @pytest.hookimpl(wrapper=True)
    def pytest_make_collect_report(
        self, collector: pytest.Collector
    ) -> Generator[None, Any, pytest.CollectReport]:
        report: pytest.CollectReport = yield
        missing = report.failed and "No module named 'pybullet'" in str(report.longrepr)
        return skipped(report, collector.path) if missing else report


def skipped(report: Any, path: Path) -> Any:
    report.outcome, report.longrepr = "skipped", (str(path), 0, "Skipped: needs PyBullet")
    return report


class Finder:
    """Notes that PyBullet was looked for, and finds nothing."""

    @staticmethod
    def find_spec(name: str, path: Any = None, target: Any = None) -> None:
        asked_for_pybullet[0] |= name == "pybullet"


@pytest.fixture(scope="session")
def visit() -> Trace:
    """A hand comes, stays for a moment and goes; the TCP gives way by the opposite pose."""
    return run(scenario(VISIT, duration_s=4.0))


@pytest.fixture(scope="session")
def sessions(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Sessions]:
    """Sessions of pytest that find everything loaded."""
    with sessions_in(tmp_path_factory.mktemp("sessions")) as made:
        yield made


@pytest.fixture(scope="session")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Any]:
    """One browser for all pages."""
    chrome = started(tmp_path_factory.mktemp("profile"))
    yield chrome
    chrome.quit()
