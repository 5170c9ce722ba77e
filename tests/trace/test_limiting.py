"""The limits that changed a controller's commands are counted in the terminal, summary.md and report.json."""

from __future__ import annotations

import numpy as np
import pytest

from safety_harness.admission.admit import admit
from safety_harness.admission.trial import judge, run_kinematic
from safety_harness.cell.controller.stop_when_near import StopWhenNear
from safety_harness.report.ci_formats import markdown
from safety_harness.report.evidence import JudgedRun
from safety_harness.scenario.read import parse_scenario
from safety_harness.seams.contract import Move, Seen
from safety_harness.trace.limiting import limit_lines, limited_data
from safety_harness.trace.trace import Trace

TEXT = """
scenario: an arm alone
duration: 400 ms
tcp start: {offset: [0 mm, -60 mm, 20 mm]}
hands: []
claims: {trace finite and monotone: holds}
"""


class Scaled(StopWhenNear):
    """A controller whose velocities [m/s] are too large by ``factor``, such as for mm/s."""

    name = "scaled"
    reports = ()

    def __init__(self, factor: float) -> None:
        self.factor = factor

    def act(self, seen: Seen) -> Move:
        """Return the scaled move towards the desired TCP."""
        away_m = self._target_in_base_m - seen.tcp_position_in_base_m
        return Move(tcp_velocity_mps=self.factor * self._gain * away_m)


def run_of(factor: float) -> Trace:
    return run_kinematic(admit(parse_scenario(TEXT), controller=Scaled(factor)))


def test_velocities_in_a_wrong_unit_are_named_with_the_limit_and_a_hint() -> None:
    trace = run_of(1000.0)
    (line,) = limit_lines([trace, trace])
    data = limited_data(trace)
    assert data is not None
    assert data["by_limit"]["TCP speed"] > 0.8 * data["commands"]
    assert line.startswith(f"scaled: {2 * data['limited']} of {2 * data['commands']} commands limited (")
    assert line.endswith("; are unit and scale of its actions as meant?")
    assert f"limits: {line}" in markdown([JudgedRun(trace, judge(trace), "")] * 2)


def test_velocities_within_the_limits_have_no_hint() -> None:
    for line in limit_lines([run_of(0.1)]):
        assert "meant" not in line


def test_the_counts_equal_the_flags_of_the_trace() -> None:
    trace = run_of(1000.0)
    data = limited_data(trace)
    assert data is not None
    assert data["limited"] == np.count_nonzero(trace.ticks["limits"] & 15)


def test_the_visual_servo_has_counts_and_no_line() -> None:
    trace = run_kinematic(admit(parse_scenario(TEXT)))
    assert limited_data(trace) is not None
    assert not limit_lines([trace])


def test_a_trace_without_limits_has_neither(monkeypatch: pytest.MonkeyPatch) -> None:
    trace = run_of(1000.0)
    monkeypatch.setattr(type(trace.known), "missing", lambda self, names: tuple(names))
    assert limited_data(trace) is None
    assert not limit_lines([trace])
