"""What lasts as long as its limit, to the tick, holds with margin 0: no rounding of seconds decides."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from safety_harness.cell.controller.desired import desired_transform_tcp_to_base
from safety_harness.claims.formulas.claim import FormulaClaim
from safety_harness.claims.formulas.language import elapsed_time, eventually, initially, s
from safety_harness.claims.properties.base import Property, time_left_s
from safety_harness.claims.properties.reaction import GivesWay, GivesWayToTrueHand
from safety_harness.claims.properties.servoing import GainSwitchReached, NeverStarved, ObjectInView
from safety_harness.scenario.model import Verdict
from safety_harness.trace.records import DECISION, Mode
from safety_harness.trace.trace import Trace

TICKS = 900
LONGEST = 845  # ticks
BEGIN = 20  # where something begins
PERIODS_S = (0.008, 0.01, 1.0 / 240.0)
Ticks = NDArray[np.void]


def made(visit: Trace, period_s: float, ticks: Ticks) -> Trace:
    """A run of the scenario of ``visit`` at another period, of these ticks."""
    settings = visit.scenario.settings
    clock = replace(settings.clock, control_period_s=period_s)
    ticks["time_s"] = np.arange(len(ticks)) * period_s
    return replace(
        visit,
        scenario=replace(
            visit.scenario,
            duration_s=(len(ticks) - 1) * period_s,
            settings=replace(settings, clock=clock),
        ),
        ticks=ticks,
        decisions=np.zeros(0, DECISION),
        decision_latency_s=np.zeros(0),
    )


def quiet(visit: Trace) -> Ticks:
    """Far from the desired pose and from any hand; the object is seen, and nothing gives way."""
    ticks = np.resize(visit.ticks[:1], TICKS)
    ticks["decision"] = -1
    ticks["mode"] = Mode.SERVOING
    ticks["object_visible"] = True
    ticks["track_valid"] = np.array([True, False, False, False])
    ticks["hand_position_in_base_m"][:, 0] = (2.0, 2.0, 1.0)
    ticks["predicted_hand_in_base_m"][:, 0] = (2.0, 2.0, 1.0)
    ticks["predicted_distance_m"] = 2.0
    ticks["sse"] = 0.1
    return ticks


def lost(visit: Trace, count: int) -> Ticks:
    ticks = quiet(visit)
    ticks["object_visible"][BEGIN : BEGIN + count] = False
    return ticks


def starved(visit: Trace, count: int) -> Ticks:
    ticks = quiet(visit)
    ticks["mode"] = Mode.REPULSING
    ticks["transform_tcp_to_base"][count + 1 :] = desired_transform_tcp_to_base(visit.scenario.settings)
    return ticks


def unanswered(visit: Trace, count: int) -> Ticks:
    ticks = quiet(visit)
    tcp = ticks["transform_tcp_to_base"][0, :3, 3]
    for name in ("hand_position_in_base_m", "predicted_hand_in_base_m"):
        ticks[name][BEGIN : BEGIN + count + 5, 0] = tcp + [0.2, 0.0, 0.0]
    ticks["mode"][BEGIN + count :] = Mode.REPULSING
    return ticks


def servoed(visit: Trace, count: int) -> Ticks:
    ticks = quiet(visit)
    ticks["sse"][count:] = 0.001
    return ticks


CASES: dict[str, tuple[Callable[[Trace, int], Ticks], Callable[[float], Property]]] = {
    "object in view": (lost, lambda limit_s: ObjectInView(within_s=limit_s)),
    "never starved": (starved, lambda limit_s: NeverStarved(longest_s=limit_s)),
    "predicted hand": (unanswered, lambda limit_s: GivesWay(within_s=limit_s)),
    "true hand": (unanswered, lambda limit_s: GivesWayToTrueHand(within_s=limit_s)),
    "gain switch": (servoed, lambda limit_s: GainSwitchReached(within_s=limit_s)),
}


def limits_s(ticks: int, period_s: float) -> set[float]:
    """A limit of so many ticks as the float nearest to the decimals, and as a product of floats."""
    decimals = {float(f"{ticks * period_s:.12g}")} if period_s != PERIODS_S[2] else set()
    return {ticks * period_s, *decimals}


@pytest.mark.parametrize("period_s", PERIODS_S)
def test_every_limit_of_whole_ticks_leaves_nothing_at_that_tick_and_half_a_tick_beside_it(
    period_s: float, visit: Trace
) -> None:
    trace = made(visit, period_s, quiet(visit))
    for count in range(1, LONGEST + 1):
        for limit_s in limits_s(count, period_s):
            assert time_left_s(trace, limit_s, count) == 0.0
            assert time_left_s(trace, limit_s, count + 1) == pytest.approx(-period_s)
            assert time_left_s(trace, limit_s, count - 1) == pytest.approx(period_s)
        assert time_left_s(trace, (count - 1e-9) * period_s, count) < 0.0


def rounding_decides(period_s: float) -> list[int]:
    """Counts of ticks at which times that are subtracted, or added up, are beyond the limit."""
    time_s, added_s = np.arange(TICKS) * period_s, np.cumsum(np.full(TICKS, period_s))
    found = []
    for count in range(1, LONGEST + 1):
        limit_s = float(f"{count * period_s:.12g}")
        if time_s[BEGIN + count] - time_s[BEGIN] > limit_s or added_s[count - 1] > limit_s:
            found.append(count)
    return found


@pytest.mark.parametrize("case", CASES)
def test_a_limit_of_whole_ticks_that_is_just_kept_holds(case: str, visit: Trace) -> None:
    make, claim = CASES[case]
    assert len(rounding_decides(0.008)) > 100
    for count in (1, 2, *rounding_decides(0.008)[:60:10], LONGEST):
        trace = made(visit, 0.008, make(visit, count))
        for limit_s in limits_s(count, 0.008):
            kept = claim(limit_s).evaluate(trace)
            assert (kept.verdict, kept.margin) == (Verdict.HOLDS, 0.0), (count, limit_s, kept)
        overrun = claim((count - 0.5) * 0.008).evaluate(trace)
        assert overrun.verdict is Verdict.VIOLATED, (count, overrun)
        assert overrun.margin == pytest.approx(-0.004)


@pytest.mark.parametrize("period_s", PERIODS_S)
def test_elapsed_time_at_a_tick_is_the_decimal_that_a_limit_is_written_with(
    period_s: float, visit: Trace
) -> None:
    trace = made(visit, period_s, quiet(visit))
    value = elapsed_time.sample(trace).value
    if period_s != PERIODS_S[2]:
        assert value.tolist() == [float(f"{k * round(1e3 * period_s)}e-3") for k in range(TICKS)]
    assert value == pytest.approx(trace.time_s, rel=1e-15)


def test_a_formula_is_decided_at_the_limit_by_its_sign(visit: Trace) -> None:
    trace = made(visit, 0.008, quiet(visit))
    for count in range(1, LONGEST + 1, 29):
        limit = s(count * 8 / 1000)
        window = (s((count * 8 - 4) / 1000), s((count * 8 + 4) / 1000))  # that one tick
        reached = eventually(elapsed_time() >= limit, window=window)
        assert FormulaClaim(reached).evaluate(trace).verdict is Verdict.HOLDS
        beyond = eventually(elapsed_time() > limit, window=window)
        assert FormulaClaim(initially(~beyond)).evaluate(trace).verdict is not Verdict.VIOLATED
