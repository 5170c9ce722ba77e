"""A controller's computing time is measured and told, and is no part of what a run repeats."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from safety_harness.admission.admit import Admitter
from safety_harness.admission.avoiders import with_avoider
from safety_harness.admission.trial import run_trial
from safety_harness.cell.simulation.worlds import KINEMATIC
from safety_harness.report.decisions import computing_time_lines
from safety_harness.scenario.model import Driver
from safety_harness.trace.compare import first_difference
from safety_harness.trace.store import load_trace, save_trace
from safety_harness.trace.trace import Trace
from tests.search.short_space import SHORT

SLEEPING = """\
import time

from safety_harness import Stop


class Slow:
    name, sees = "slow", ()

    def reset(self, **begins):
        pass

    def act(self, seen):
        time.sleep(0.03)
        return Stop()
"""


@pytest.fixture(scope="module")
def slow(tmp_path_factory: pytest.TempPathFactory) -> Trace:
    """A run of a controller that sleeps 30 ms on each tick of 8 ms."""
    file = tmp_path_factory.mktemp("slow") / "slow.py"
    file.write_text(SLEEPING)
    scenario = with_avoider(SHORT.simplest, Driver(f"{file}:Slow"))
    return run_trial(Admitter().admit(scenario), world=KINEMATIC)


def test_a_slow_controller_is_told(slow: Trace) -> None:
    ticks = len(slow.ticks)
    modelled, line = computing_time_lines([slow])
    assert modelled == "slow: computing time not modelled"
    known = f"slow: on this machine {ticks} of {ticks} answers (100 %) took longer than the 8 ms"
    assert line.startswith(f"{known} that the runs allow, the slowest ")
    assert line.endswith(": it was tested as if it answered in time")
    assert (slow.answer_s >= 0.03).all()


def test_of_a_quick_one_it_is_not_modelled(slow: Trace) -> None:
    quick = replace(slow, answer_s=np.full(len(slow.ticks), 0.001))
    assert computing_time_lines([quick]) == ["slow: computing time not modelled"]


def test_what_it_took_is_no_part_of_the_trace(slow: Trace, tmp_path: Path) -> None:
    """Runs that took other times are the same run, and their files the same bytes."""
    other = replace(slow, answer_s=slow.answer_s * 2.0)
    assert first_difference(slow, other) is None
    for name, trace in (("a", slow), ("b", other)):
        save_trace(trace, tmp_path / name)
    assert (tmp_path / "a").read_bytes() == (tmp_path / "b").read_bytes()
    assert len(load_trace(tmp_path / "a").answer_s) == 0
