"""What was not measured is no difference, no error, no count, and is not run again."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from partly_measured import UNSEEN, partly_measured

from safety_harness.base.exceptions import TraceError
from safety_harness.claims.properties.finite import bad_decisions, bad_ticks
from safety_harness.trace.compare import first_difference
from safety_harness.trace.known import COLUMNS_OF_A_TRACE, NOT_MEASURED, OF_DECISIONS, Measurement, Source
from safety_harness.trace.overruling import Overruling, is_measured
from safety_harness.trace.trace import Trace
from safety_harness.trace.unmeasured import (
    as_measured,
    decided,
    knowing,
    measured,
    refuse_not_simulated,
    without_gaps,
)


def with_anything(trace: Trace) -> Trace:
    """``trace`` with numbers where nothing was measured, as a careless reader of a log would leave them."""
    ticks, decisions = trace.ticks.copy(), trace.decisions.copy()
    for name in trace.known.missing(trace.known.columns):
        of_ticks = not name.startswith(OF_DECISIONS)
        values = ticks[name] if of_ticks else decisions[name.removeprefix(OF_DECISIONS)]
        values[...] = "x" if values.dtype.kind == "U" else 1
    return replace(trace, ticks=ticks, decisions=decisions)


def test_where_a_column_was_measured_is_known_of_each_tick_and_hand(visit: Trace) -> None:
    trace = partly_measured(visit)
    assert measured(visit, "mode").all()
    assert not measured(trace, "mode").any()
    hands = measured(trace, "hand_distance_m")
    assert np.flatnonzero(~hands[:, 0]).tolist() == list(range(UNSEEN.first, UNSEEN.after))
    assert hands[:, 1:].all()
    assert (decided(visit), decided(trace), decided(trace, "tick")) == (True, False, False)


def test_a_blank_is_no_wrong_number_and_a_measured_nan_is_one(visit: Trace) -> None:
    trace = partly_measured(visit)
    assert np.isnan(trace.ticks["camera_twist"]).all()
    assert not bad_ticks(trace).any()
    assert not bad_decisions(trace).any()
    ticks = trace.ticks.copy()
    ticks["joint_position_rad"][7, 2] = np.nan
    assert np.flatnonzero(bad_ticks(replace(trace, ticks=ticks))).tolist() == [7]
    assert without_gaps(visit, COLUMNS_OF_A_TRACE) is visit


def test_two_traces_are_compared_in_what_was_measured_of_both(visit: Trace) -> None:
    trace = partly_measured(visit)
    assert first_difference(trace, with_anything(trace)) is None
    ticks = trace.ticks.copy()
    ticks["tcp_speed_mps"][9] += 1e-9
    found = first_difference(trace, replace(trace, ticks=ticks))
    assert found is not None
    assert (found.index, found.fields) == (9, ("tcp_speed_mps",))


@pytest.mark.parametrize(
    ("one", "told"),
    [
        (NOT_MEASURED, "simulated truth against not measured"),
        (Measurement(source=Source.SENSOR), "simulated truth against sensor"),
        (Measurement(uncertainty=0.5), "simulated truth against simulated truth within 0.5"),
    ],
)
def test_a_column_that_was_not_measured_alike_is_a_difference(
    visit: Trace, one: Measurement, told: str
) -> None:
    found = str(first_difference(visit, knowing(visit, {"gain": one})))
    assert found == f"not measured alike in known.gain: {told}"


def test_proposals_that_were_not_measured_are_not_counted(visit: Trace) -> None:
    trace = with_anything(partly_measured(visit))
    assert Overruling.from_traces([visit]).proposals > 0
    assert Overruling.from_traces([trace, visit]) == Overruling.from_traces([visit])
    assert (is_measured(visit), is_measured(trace)) == (True, False)


def test_blanks_take_the_place_of_whatever_is_stored(visit: Trace) -> None:
    trace = partly_measured(visit)
    blank = as_measured(with_anything(trace)).ticks
    for name in blank.dtype.names or ():
        assert blank[name].tobytes() == trace.ticks[name].tobytes()
    assert as_measured(visit) is visit


def test_only_what_was_simulated_can_be_run_again(visit: Trace) -> None:
    refuse_not_simulated(visit)
    with pytest.raises(TraceError) as caught:
        refuse_not_simulated(partly_measured(visit), Path("a.trace"))
    assert "only that can be run again" in caught.value.expected
    assert "sensor (2)" in caught.value.got
    assert caught.value.hint == "safety-harness judge a.trace"
