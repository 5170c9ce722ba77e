"""A delay that a controller declares and no run would have is refused."""

from __future__ import annotations

import pytest

from safety_harness.base.exceptions import ControllerError
from safety_harness.seams.contract import reports_of


class Slow:
    name, sees = "slow", ("joints",)
    decision_time_s = 0.08


def test_a_declared_delay_of_a_controller_is_refused() -> None:
    with pytest.raises(ControllerError, match="decision_time_s"):
        reports_of(Slow())  # type: ignore[arg-type]


def test_a_controller_that_declares_none_is_taken() -> None:
    class Quick(Slow):
        decision_time_s = 0.0

    assert reports_of(Quick()) == ()  # type: ignore[arg-type]
