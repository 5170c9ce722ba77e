"""A project of a user's: scenario files, an avoider, and pytest run on it in a process of its own."""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Callable
from importlib.metadata import entry_points
from pathlib import Path

import pytest
from pytest_sessions import CACHE, CLAIMS, HEAD, ROOT, Sessions

PLUGIN = "safety_harness.testing.plugin.plugin"

AVOIDERS = """\
import numpy as np

from safety_harness import Proposal


class Upwards:
    name = "upwards"

    def propose(self, *, hand_position_in_base_m, tcp_position_in_base_m, seed):
        return Proposal(tcp_position_in_base_m + [0.0, 0.0, 0.1])


class Doubting(Upwards):
    name = "doubting"
    spread_threshold_m = 0.01

    def propose(self, *, tcp_position_in_base_m, **question):
        return Proposal(tcp_position_in_base_m + [0.0, 0.0, 0.1], np.full(3, 0.02))


class Unseeded(Upwards):
    name = "unseeded"

    def propose(self, **question):
        shake = np.random.default_rng().normal(0.0, 1e-3, 3)
        return Proposal(question["tcp_position_in_base_m"] + [0.0, 0.0, 0.1] + shake)
"""

TEST = """\
from hypothesis import given, settings
from safety_harness.testing import assert_holds, hand_distance, mm, scenarios


@settings(max_examples=6)
@given(scenario=scenarios("reaches.yaml"))
def test_keeps_its_distance(scenario, simulate):
    assert_holds(hand_distance() > mm(50), simulate(scenario))


@settings(max_examples=6)
@given(scenario=scenarios("reaches.yaml"))
def test_is_slow(scenario, simulate):
    assert_holds("TCP speed never above 250 mm/s", simulate(scenario))
"""

INI = "[pytest]\nfilterwarnings = error\n"

Run = Callable[..., pytest.RunResult]


@pytest.fixture
def run(pytester: pytest.Pytester, monkeypatch: pytest.MonkeyPatch, sessions: Sessions) -> Run:
    """Pytest with the plug-in, whether it is installed or not, in a process of its own.

    Its world is the kinematic one; a test of the world that is taken without a setting writes ``INI`` alone.

    ``fresh`` starts that process from nothing, as a user does.
    """
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")]))
    monkeypatch.setenv("SAFETY_HARNESS_CACHE", str(CACHE))
    pytester.makeini(f"{INI}safety_world = kinematic\n")
    installed = any(entry.value == PLUGIN for entry in entry_points(group="pytest11"))

    def run_pytest(*args: str, fresh: bool = False) -> pytest.RunResult:
        given = (*(() if installed else ("-p", PLUGIN)), "-p", "no:randomly", *args)
        if fresh:
            return pytester.runpytest_subprocess(*given)
        started = time.monotonic()
        done = sessions(pytester.path, *given)
        sys.stdout.write(done.stdout)
        sys.stderr.write(done.stderr)
        lines = (done.stdout.splitlines(), done.stderr.splitlines())
        return pytest.RunResult(done.returncode, *lines, time.monotonic() - started)

    return run_pytest


@pytest.fixture
def project(pytester: pytest.Pytester) -> Path:
    """fast.yaml fails, fine.yaml says that it violates, reaches.yaml is a space; avoiders.py, test_it.py."""
    folder = pytester.path
    fast = HEAD.format(title="scenario: a fast reach", speed="2 m/s")
    (folder / "fast.yaml").write_text(fast + CLAIMS.format(distance="holds"))
    (folder / "fine.yaml").write_text(fast + CLAIMS.format(distance="violated"))
    space = HEAD.format(title="scenario space: reaches", speed="from 0.2 m/s to 2 m/s")
    (folder / "reaches.yaml").write_text(space + CLAIMS.format(distance="holds"))
    (folder / "avoiders.py").write_text(AVOIDERS)
    (folder / "test_it.py").write_text(TEST)
    return folder
