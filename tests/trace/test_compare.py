from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from examples import run, scenario

from safety_harness.trace.compare import TraceDifference, first_difference
from safety_harness.trace.records import intervention_dtype
from safety_harness.trace.store import load_trace, save_trace
from safety_harness.trace.trace import Trace

Change = Callable[[np.ndarray], None]


def changed(trace: Trace, change: Change) -> Trace:
    ticks = trace.ticks.copy()
    change(ticks)
    return replace(trace, ticks=ticks)


def put(field: str, index: int, value: object) -> Change:
    def change(ticks: np.ndarray) -> None:
        ticks[field][index] = value

    return change


def found(first: Trace, second: Trace) -> TraceDifference:
    difference = first_difference(first, second)
    assert difference is not None
    return difference


def test_a_trace_equals_its_copy(visit: Trace) -> None:
    copy = replace(visit, ticks=visit.ticks.copy(), decisions=visit.decisions.copy())
    assert first_difference(visit, copy) is None


def test_traces_without_decisions_or_ticks_can_be_compared(visit: Trace) -> None:
    quiet = run(scenario(duration_s=0.1))
    assert len(quiet.decisions) == 0
    assert first_difference(quiet, quiet) is None
    empty = replace(visit, ticks=visit.ticks[:0].copy(), decisions=visit.decisions[:0].copy())
    assert first_difference(empty, empty) is None
    assert found(visit, empty).index == 0


def test_nan_equals_itself_and_nothing_else(visit: Trace) -> None:
    with_nan = changed(visit, put("sse", 9, np.nan))
    assert first_difference(with_nan, changed(visit, put("sse", 9, np.nan))) is None
    assert found(visit, with_nan).fields == ("sse",)


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("joint_position_rad", 0.25),
        ("transform_tcp_to_base", 0.25),
        ("object_visible", False),
        ("hand_present", True),
        ("mode", 3),
        ("limits", 63),
    ],
)
def test_the_first_tick_and_field_that_differ_are_named(field: str, value: object, visit: Trace) -> None:
    def change(ticks: np.ndarray) -> None:
        put(field, 7, value)(ticks)
        put("gain", 8, 77.0)(ticks)

    difference = found(visit, changed(visit, change))
    assert (difference.what, difference.index, difference.fields) == ("tick", 7, (field,))
    assert difference.time_s == visit.time_s[7]
    assert field in str(difference)


def test_one_unit_in_the_last_place_and_the_sign_of_zero_count(visit: Trace) -> None:
    value = visit.ticks["joint_position_rad"][5, 2]
    nudged = changed(visit, lambda ticks: put("joint_position_rad", 5, value)(ticks))
    assert found(visit, nudged).index == 5
    ulp = visit.ticks.copy()
    ulp["joint_position_rad"][5, 2] = np.nextafter(value, 9.0)
    assert found(visit, replace(visit, ticks=ulp)).fields == ("joint_position_rad",)
    zero, minus = (changed(visit, put("gain", 3, number)) for number in (0.0, -0.0))
    assert found(zero, minus).fields == ("gain",)


def test_all_fields_that_differ_first_are_named(visit: Trace) -> None:
    def change(ticks: np.ndarray) -> None:
        put("sse", 4, -1.0)(ticks)
        put("mode", 4, 3)(ticks)

    assert found(visit, changed(visit, change)).fields == ("sse", "mode")


def test_a_shorter_trace_differs_where_it_ends(visit: Trace) -> None:
    shorter = replace(visit, ticks=visit.ticks[:100].copy(), decisions=visit.decisions[:0].copy())
    for difference in (found(visit, shorter), found(shorter, visit)):
        assert difference.index in (0, 100)
        assert difference.fields == ("length",)
    only_ticks = replace(visit, ticks=visit.ticks[:-1].copy())
    assert found(visit, only_ticks).index == len(visit.ticks) - 1
    assert found(visit, only_ticks).time_s == visit.time_s[-1]


def test_a_decision_that_differs_is_found_and_the_earlier_record_wins(visit: Trace) -> None:
    decisions = visit.decisions.copy()
    decisions["seed"][-1] += 1
    other = replace(visit, decisions=decisions)
    difference = found(visit, other)
    assert (difference.what, difference.index) == ("decision", len(decisions) - 1)
    assert difference.time_s == visit.decisions["time_s"][-1]
    assert found(visit, changed(other, put("sse", 0, 7.0))).what == "tick"
    assert found(visit, changed(other, put("sse", -1, 7.0))).what == "decision"


def test_a_trace_as_it_is_read_is_compared_with_its_run_made_again(tmp_path: Path, visit: Trace) -> None:
    """Without a shield there are no interventions, whichever fields they would have."""
    file = tmp_path / "one.trace"
    save_trace(visit, file)
    again = replace(visit, interventions=np.zeros(0, intervention_dtype(visit.scenario.hand_slots)))
    assert first_difference(load_trace(file), again) is None
