"""Speed limits count what happened between two ticks as well: traces edited to jump, oracles by hand."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from safety_harness.cell.robot.description import load_arm
from safety_harness.claims.properties.base import Property, Unit
from safety_harness.claims.properties.limits import JointSpeedLimits, TcpSpeedLimit
from safety_harness.scenario.model import Verdict
from safety_harness.trace.trace import Trace

JOINTS, TCP = JointSpeedLimits(), TcpSpeedLimit(maximum_mps=0.25)
PERIOD_S = 0.008
LIMIT_RADPS = load_arm("ur10").velocity_limit_radps


def still(trace: Trace, ticks: int, edit: Callable[[NDArray[np.void]], None] = lambda rows: None) -> Trace:
    """The first ticks with the arm at rest where it was, then edited."""
    rows = trace.ticks[:ticks].copy()
    for name in ("joint_velocity_radps", "tcp_speed_mps"):
        rows[name] = 0.0
    for name in ("joint_position_rad", "transform_tcp_to_base"):
        rows[name] = rows[name][0]
    edit(rows)
    scenario = replace(trace.scenario, duration_s=PERIOD_S * (ticks - 1))
    return replace(trace, scenario=scenario, ticks=rows, decisions=trace.decisions[:0])


@pytest.mark.parametrize("ticks", [2, 6])
def test_a_jump_of_the_tcp_between_two_ticks_counts_with_its_mean_speed(visit: Trace, ticks: int) -> None:
    def jump(rows: NDArray[np.void]) -> None:
        rows["transform_tcp_to_base"][1:, 2, 3] += 0.004  # 4 mm in 8 ms

    trace = still(visit, ticks, jump)
    evaluation = TCP.evaluate(trace)
    assert evaluation.margin == pytest.approx(0.25 - 0.5)
    assert (evaluation.verdict, evaluation.worst_time_s) == (Verdict.VIOLATED, trace.time_s[0])
    assert evaluation.reason == "fastest 500.0 mm/s"
    assert evaluation.exercised == 1


@pytest.mark.parametrize("ticks", [2, 6])
def test_a_jump_of_a_joint_between_two_ticks_counts_with_its_mean_speed(visit: Trace, ticks: int) -> None:
    def jump(rows: NDArray[np.void]) -> None:
        rows["joint_position_rad"][1:, 4] -= 0.04  # 5 rad/s

    trace = still(visit, ticks, jump)
    evaluation = JOINTS.evaluate(trace)
    assert evaluation.margin == pytest.approx(LIMIT_RADPS[4] - 5.0)
    assert (evaluation.verdict, evaluation.worst_time_s) == (Verdict.VIOLATED, trace.time_s[0])
    assert (evaluation.reason, evaluation.exercised) == ("wrist_2_joint", 1)


def test_a_joint_at_its_speed_limit_holds_and_one_a_billionth_over_is_violated(visit: Trace) -> None:
    """Positions are rounded, so that their differences are over the limit at some ticks.

    In a world whose motors do what they are told; an engine's miss more than that.
    """
    exact = replace(visit.provenance, world="kinematic")
    start_rad = visit.ticks["joint_position_rad"][0, 2]
    for share, verdict in ((1.0, Verdict.HOLDS), (1.0 + 1e-9, Verdict.VIOLATED)):

        def turn(rows: NDArray[np.void], rate_radps: float = share * LIMIT_RADPS[2]) -> None:
            rows["joint_position_rad"][:, 2] = start_rad + rate_radps * rows["time_s"]
            rows["joint_velocity_radps"][:, 2] = min(rate_radps, LIMIT_RADPS[2])

        trace = still(visit, 40, turn)
        mean_radps = np.diff(trace.ticks["joint_position_rad"][:, 2]) / np.diff(trace.time_s)
        assert mean_radps.max() > LIMIT_RADPS[2]
        in_engine = Verdict.INCONCLUSIVE if verdict is Verdict.VIOLATED else verdict
        assert JOINTS.evaluate(trace).verdict is in_engine
        assert JOINTS.evaluate(replace(trace, provenance=exact)).verdict is verdict


def test_the_speed_at_the_last_tick_counts_though_nothing_follows(visit: Trace) -> None:
    def hurry(rows: NDArray[np.void]) -> None:
        rows["tcp_speed_mps"][-1] = 0.3

    trace = still(visit, 5, hurry)
    assert TCP.evaluate(trace).margin == pytest.approx(-0.05)
    assert TCP.evaluate(trace).worst_time_s == trace.time_s[-1]


@pytest.mark.parametrize("prop", [JOINTS, TCP], ids=lambda prop: prop.sentence)
def test_one_tick_at_rest_is_no_evidence(visit: Trace, prop: Property) -> None:
    evaluation = prop.evaluate(still(visit, 1))
    assert (evaluation.verdict, evaluation.exercised) == (Verdict.INCONCLUSIVE, 0)


@pytest.mark.parametrize("prop", [JOINTS, TCP], ids=lambda prop: prop.sentence)
def test_what_cannot_be_read_is_inconclusive_and_says_which(visit: Trace, prop: Property) -> None:
    name = "tcp_speed_mps" if prop.unit is Unit.SPEED else "joint_velocity_radps"

    def spoil(rows: NDArray[np.void]) -> None:
        rows[name][2] = np.nan

    evaluation = prop.evaluate(still(visit, 4, spoil))
    assert evaluation.verdict is Verdict.INCONCLUSIVE
    assert f"{name} is not finite from 0.016 s" in evaluation.reason
