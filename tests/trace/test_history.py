"""Fields side by side in memory are the fields."""

from __future__ import annotations

import pytest

from safety_harness.trace.records import TICK
from safety_harness.trace.trace import Trace, history


@pytest.mark.parametrize("name", TICK.names or ())
def test_a_history_has_the_values_of_the_field(name: str, visit: Trace) -> None:
    found, field = history(visit, name), visit.ticks[name]
    assert found.dtype == field.dtype
    assert found.shape == field.shape
    assert found.tobytes() == field.tobytes()  # NaN too
    assert found.strides[0] == found.itemsize


def test_nobody_writes_to_a_history(visit: Trace) -> None:
    with pytest.raises(ValueError, match="read-only"):
        history(visit, "sse")[0] = 1.0
    assert history(visit, "sse") is history(visit, "sse")
