"""The braking model: on for the reaction time, then down to zero within T_s(v), once begun to the end."""

from __future__ import annotations

import numpy as np
import pytest
from examples import run, scenario

from safety_harness.base.settings import DEFAULTS
from safety_harness.cell.controller.records import COMMAND
from safety_harness.cell.robot.drive import drive, drive_tick
from safety_harness.trace.records import DECISION, Limit

PERIOD_S = DEFAULTS.clock.control_period_s
REACTION_S = DEFAULTS.braking.reaction_time_s
DEMAND = np.array([0.3, -0.2, 0.1, 0.0, 0.5, -0.4])


def stop_time_s(speed_mps: float) -> float:
    return 0.35 + 0.1 * speed_mps  # the manual's worst cases: 450, 500 and 550 ms at 1.0, 1.5 and 2.0 m/s


class Drives:
    """Drives on a clock of their own; ``history`` holds the set points, one row a tick."""

    def __init__(self) -> None:
        self.record = drive(DEFAULTS, 6)
        self.tick = 0
        self.history: list[np.ndarray] = []

    def run(
        self, ticks: int, demanded: np.ndarray = DEMAND, *, stop: bool = False, speed_mps: float = 1.0
    ) -> list[bool]:
        acting = []
        for _ in range(ticks):
            acting.append(drive_tick(self.record, demanded, stop, speed_mps, self.tick * PERIOD_S))
            self.history.append(self.record[0]["setpoint_radps"].copy())
            self.tick += 1
        return acting


def test_drives_follow_the_demand_until_they_are_stopped() -> None:
    drives = Drives()
    assert not any(drives.run(3))
    assert not any(drives.run(2, -DEMAND))
    assert np.array_equal(drives.history, [DEMAND] * 3 + [-DEMAND] * 2)


def test_they_keep_their_velocity_for_the_reaction_time() -> None:
    drives = Drives()
    drives.run(5)
    assert all(drives.run(40, np.zeros(6), stop=True))
    kept = [np.array_equal(row, DEMAND) for row in drives.history[5:]]
    first_braking = kept.index(False)
    assert not any(kept[first_braking:])
    assert REACTION_S <= first_braking * PERIOD_S < REACTION_S + PERIOD_S  # never less than 0.1 s


@pytest.mark.parametrize("speed_mps", [0.0, 0.25, 1.0, 1.5, 2.0])
def test_braking_takes_the_stop_time_and_half_of_it_in_way(speed_mps: float) -> None:
    """The way is the integral of the ramp, v T_s / 2; only its last, cut tick is off by v dt^2 / (8 T_s)."""
    drives = Drives()
    drives.run(4)
    drives.run(100, stop=True, speed_mps=speed_mps)
    rows = np.array(drives.history[4:])
    braking = rows[~(rows == DEMAND).all(axis=1)]
    stop_s = stop_time_s(speed_mps)
    moving = np.abs(braking).max(axis=1) > 0.0
    assert moving.sum() * PERIOD_S == pytest.approx(stop_s, abs=0.5 * PERIOD_S + 1e-12)
    assert not braking[~moving].any()
    way = braking.sum(axis=0) * PERIOD_S
    tolerance = np.abs(DEMAND).max() * PERIOD_S**2 / (8.0 * stop_s) + 1e-15
    assert way == pytest.approx(0.5 * DEMAND * stop_s, abs=tolerance)


def test_all_joints_brake_together_and_uniformly() -> None:
    drives = Drives()
    drives.run(1)
    drives.run(60, stop=True)
    rows = np.array(drives.history)
    share = rows[:, 0] / DEMAND[0]
    assert rows == pytest.approx(np.outer(share, DEMAND), abs=1e-15)
    ramp = share[(share > 0.0) & (share < 1.0)]
    assert np.diff(ramp) == pytest.approx(np.full(len(ramp) - 1, -PERIOD_S / stop_time_s(1.0)), abs=1e-12)


def test_a_stop_is_carried_through_although_it_is_released() -> None:
    kept, released = Drives(), Drives()
    for drives in (kept, released):
        drives.run(3)
    kept.run(75, stop=True)
    released.run(1, stop=True)
    released.run(74, -DEMAND)
    standstill = next(k for k, row in enumerate(kept.history) if not row.any())
    assert np.array_equal(kept.history[: standstill + 1], released.history[: standstill + 1])
    assert np.array_equal(released.history[standstill + 1], -DEMAND)  # and then it is free again


def test_once_at_standstill_the_first_tick_that_is_released_obeys() -> None:
    drives = Drives()
    drives.run(2)
    assert all(drives.run(80, stop=True))
    assert drives.run(1, 0.01 * DEMAND) == [False]
    assert np.array_equal(drives.history[-1], 0.01 * DEMAND)


def test_a_second_request_does_not_begin_the_stop_anew() -> None:
    once, again = Drives(), Drives()
    for drives in (once, again):
        drives.run(2)
    once.run(80, stop=True)
    again.run(1, stop=True)
    again.run(20)
    again.run(59, stop=True)
    assert np.array_equal(once.history, again.history)


def test_the_arm_stands_for_as_long_as_the_stop_is_asked_for_and_can_stop_again() -> None:
    drives = Drives()
    drives.run(2)
    drives.run(200, stop=True)
    assert not np.any(drives.history[80:])
    drives.run(10)
    assert np.array_equal(drives.history[-1], DEMAND)
    drives.run(80, stop=True)
    assert np.array_equal(drives.history[-80], DEMAND)
    assert not drives.history[-1].any()


class StopsAfter:
    """A controller that turns the first joint, then asks for a protective stop for ever."""

    name = "stops after a while"

    def __init__(self, rate_radps: float, ticks: int) -> None:
        self.command, self.ticks, self.done = np.zeros(1, COMMAND), ticks, 0
        self.command["joint_velocity_radps"][0, 0] = rate_radps

    def step(self, observation: np.ndarray) -> np.ndarray:
        self.command["protective_stop"] = self.done >= self.ticks
        self.done += 1
        return self.command

    def report(self, tick: np.ndarray) -> None:
        tick["decision"] = -1

    @property
    def decisions(self) -> np.ndarray:
        return np.zeros(0, DECISION)

    @property
    def decision_latencies_s(self) -> np.ndarray:
        return np.zeros(0)


@pytest.mark.parametrize("rate_radps", [0.3, -1.2])
def test_the_engine_stops_as_late_and_as_far_as_the_model(rate_radps: float) -> None:
    """In PyBullet: the time to standstill within a tick, the way within 1e-4 of itself."""
    asked = 40
    trace = run(scenario(duration_s=1.2), controller=StopsAfter(rate_radps, asked))
    speed_mps = trace.ticks["tcp_speed_mps"][asked + 12]
    assert speed_mps == pytest.approx(
        abs(rate_radps) * np.hypot(*trace.ticks[0]["transform_tcp_to_base"][:2, 3])
    )
    stop_s = stop_time_s(speed_mps)
    reaction_s = np.ceil(REACTION_S / PERIOD_S - 1e-9) * PERIOD_S
    way = np.ptp(trace.ticks["joint_position_rad"][asked:, 0])
    assert way == pytest.approx(abs(rate_radps) * (reaction_s + 0.5 * stop_s), rel=1e-4)
    moving = np.abs(trace.ticks["joint_velocity_radps"][:, 0]) > 1e-6
    assert trace.time_s[moving][-1] - trace.time_s[asked] == pytest.approx(reaction_s + stop_s, abs=PERIOD_S)
    braking = (trace.ticks["limits"] & Limit.BRAKING) > 0
    assert not braking[:asked].any()
    assert braking[asked:-1].all()
