"""When the drives begin to brake, to the tick."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from safety_harness.base.settings import DEFAULTS
from safety_harness.cell.robot.drive import drive, drive_tick

PERIOD_S = DEFAULTS.clock.control_period_s


@pytest.mark.parametrize("ticks", [0, 1, 3, 12, 50])
def test_a_reaction_time_of_so_many_periods_lasts_so_many_ticks_whenever_it_begins(ticks: int) -> None:
    settings = replace(
        DEFAULTS, braking=replace(DEFAULTS.braking, reaction_time_s=round(ticks * PERIOD_S, 6))
    )
    demand = np.arange(1.0, 7.0)
    for asked in (*range(1, 60), 999, 12345):
        drives = drive(settings, len(demand))
        drive_tick(drives, demand, False, 1.0, (asked - 1) * PERIOD_S)
        kept = []
        for tick in range(asked, asked + ticks + 2):
            assert drive_tick(drives, demand, True, 1.0, tick * PERIOD_S)
            kept.append(np.array_equal(drives["setpoint_radps"][0], demand))
        assert kept == [True] * ticks + [False, False]
