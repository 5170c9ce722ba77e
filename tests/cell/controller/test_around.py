from __future__ import annotations

import numpy as np
from bench import AWAY, Bench

from safety_harness.cell.controller.around import ControllerWrapper


def assert_same(one: np.ndarray | np.void, other: np.ndarray | np.void) -> None:
    """Field by field: what lies between the fields of a record is anything."""
    for name in one.dtype.names or ():
        np.testing.assert_array_equal(one[name], other[name])


def test_a_controller_around_another_is_that_one_where_it_changes_nothing() -> None:
    bare, wrapped = Bench(), Bench()
    inner = wrapped.controller
    wrapped.controller = around = ControllerWrapper(inner)  # type: ignore[assignment]
    for hands in ((AWAY,), (bare.beside(0.3),), (bare.beside(0.3),), ()):
        assert_same(bare.tick(*hands), wrapped.tick(*hands))
        assert_same(bare.command, wrapped.command)
    assert around.name == inner.name
    assert len(around.decisions) == 1
    assert_same(around.decisions, bare.controller.decisions)
    assert np.array_equal(around.decision_latencies_s, inner.decision_latencies_s)
    assert len(around.decision_latencies_s) == 1
