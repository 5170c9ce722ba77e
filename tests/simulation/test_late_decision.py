"""A decision that comes too late is a fault in the trace, and a replay repeats it whatever the clock says."""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np
import pytest
from examples import VISIT, scenario

from safety_harness import admit, run_trial
from safety_harness.avoidance.avoider import Proposal
from safety_harness.trace.compare import first_difference
from safety_harness.trace.records import Check, Outcome
from safety_harness.trace.store import load_trace, save_trace
from safety_harness.trace.trace import Trace


class Dawdler:
    """100 mm up; hesitates before its first answer in a run (the one before the run is a rehearsal)."""

    name = "a dawdler"

    def __init__(self, hesitates_s: float = 0.0) -> None:
        self._hesitates_s = hesitates_s
        self._asked = 0

    def propose(self, *, tcp_position_in_base_m: np.ndarray, **rest: object) -> Proposal:
        self._asked += 1
        if self._asked == 2:
            time.sleep(self._hesitates_s)
        return Proposal(tcp_position_in_base_m + [0.0, 0.0, 0.1])


WHAT = scenario(VISIT, duration_s=1.6)


@pytest.fixture(scope="module")
def late() -> Trace:
    return run_trial(admit(WHAT, avoider=Dawdler(hesitates_s=0.3)))


def test_a_late_decision_is_a_fault_with_the_opposite_pose_in_its_place(late: Trace) -> None:
    first, rest = late.decisions[0], late.decisions[1:]
    assert first["fault"] == "no answer within 100 ms"
    assert first["proposed_failed"] == Check.LATE
    assert first["outcome"] == Outcome.OPPOSITE
    assert late.decision_latency_s[0] > 0.1
    assert not (rest["proposed_failed"] & Check.LATE).any()


def test_a_replay_is_late_where_the_record_is(late: Trace) -> None:
    repeated = run_trial(admit(WHAT, avoider=Dawdler()), recorded=late)
    assert first_difference(late, repeated) is None


def test_without_the_record_the_same_avoider_in_time_makes_another_trace(late: Trace) -> None:
    assert first_difference(late, run_trial(admit(WHAT, avoider=Dawdler()))) is not None


def test_a_replay_waits_for_an_answer_that_was_in_time_on_record(late: Trace) -> None:
    in_time = run_trial(admit(WHAT, avoider=Dawdler()))
    slow = run_trial(admit(WHAT, avoider=Dawdler(hesitates_s=0.3)), recorded=in_time)
    assert first_difference(in_time, slow) is None
    assert slow.decision_latency_s[0] > 0.1


def test_latencies_are_stored_with_the_trace(late: Trace, tmp_path: Path) -> None:
    save_trace(late, tmp_path / "late.trace")
    stored = load_trace(tmp_path / "late.trace")
    assert len(stored.decision_latency_s) == len(stored.decisions)
    np.testing.assert_array_equal(stored.decision_latency_s, late.decision_latency_s)
