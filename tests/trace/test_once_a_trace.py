"""A result that is kept with its trace is computed once, and goes with it."""

from __future__ import annotations

import gc
import weakref
from dataclasses import replace

from safety_harness.trace.trace import Trace, once_a_trace


def test_it_is_computed_once_for_each_trace_and_kept_no_longer(visit: Trace) -> None:
    calls = []

    @once_a_trace
    def length(trace: Trace) -> int:
        calls.append(trace.ended)
        return len(trace.ticks)

    other = replace(visit, ended="cut short")
    assert length(visit) == length(visit) == length(other) == len(visit.ticks)
    assert calls == [visit.ended, "cut short"]
    gone = weakref.ref(other)
    del other
    gc.collect()
    assert gone() is None
