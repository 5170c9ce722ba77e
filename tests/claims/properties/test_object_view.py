"""Every loss of the object is as long as from its first tick to that of the recovery."""

from __future__ import annotations

from dataclasses import replace
from itertools import groupby

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from safety_harness.claims.properties.servoing import ObjectInView
from safety_harness.scenario.model import Verdict
from safety_harness.trace.trace import Trace

PERIOD_S = 0.008


def seen(trace: Trace, *lengths: int) -> Trace:
    """In view for the first length in ticks, out of view for the second, and so on in turn."""
    pattern = np.concatenate([np.full(length, k % 2 == 0) for k, length in enumerate(lengths)])
    ticks = trace.ticks.copy()
    ticks["object_visible"] = np.resize(pattern, len(ticks))
    return replace(trace, ticks=ticks)


@given(st.lists(st.integers(1, 90), min_size=1, max_size=12), st.integers(1, 80))
def test_the_margin_is_from_the_longest_loss(visit: Trace, lengths: list[int], allowed: int) -> None:
    trace = seen(visit, *lengths)
    limit_s = (allowed + 0.5) * PERIOD_S
    evaluation = ObjectInView(within_s=limit_s).evaluate(trace)
    runs = [(k, len(list(g))) for k, g in groupby(trace.ticks["object_visible"].tolist())]
    losses = [length for visible, length in runs[:-1] if not visible]
    open_end = runs[-1][1] - 1 if not runs[-1][0] else 0  # the last tick is the last that is known
    longest = max([*losses, open_end], default=0)
    if longest > allowed:
        assert evaluation.verdict is Verdict.VIOLATED
    elif not runs[-1][0]:
        assert evaluation.verdict is Verdict.INCONCLUSIVE
        return
    else:
        assert evaluation.verdict is Verdict.HOLDS
    assert evaluation.margin == pytest.approx(limit_s - longest * PERIOD_S)


def test_an_object_that_is_never_lost_leaves_the_whole_time(visit: Trace) -> None:
    evaluation = ObjectInView(within_s=2.0).evaluate(seen(visit, len(visit.ticks)))
    assert (evaluation.verdict, evaluation.margin) == (Verdict.HOLDS, 2.0)


def test_a_loss_to_the_end_is_open_until_it_is_too_long(visit: Trace) -> None:
    n = len(visit.ticks)
    late = ObjectInView(within_s=2.0).evaluate(seen(visit, n - 50, 50))
    assert late.verdict is Verdict.INCONCLUSIVE
    assert "out of view for 0.39 s when the run ends" in late.reason
    assert ObjectInView(within_s=0.3).evaluate(seen(visit, n - 50, 50)).verdict is Verdict.VIOLATED


def test_an_arm_that_stands_still_before_the_object_is_no_evidence(visit: Trace) -> None:
    still = seen(visit, len(visit.ticks))
    ticks = still.ticks.copy()
    ticks["tcp_speed_mps"] = 0.0
    assert ObjectInView(within_s=2.0).evaluate(replace(still, ticks=ticks)).verdict is Verdict.INCONCLUSIVE
