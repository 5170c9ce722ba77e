"""Whole controllers on top of ``stop when near``, each with one fault that comes out in the motion alone."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from safety_harness import Move, Stop
from safety_harness.cell.controller.stop_when_near import StopWhenNear
from safety_harness.scenario.model import NO_AVOIDER, Scenario
from safety_harness.seams.contract import Action, Seen


class Sound(StopWhenNear):
    """It reports no mode, so that nothing but its motion can be judged."""

    name = "sound"
    reports = ()  # type: ignore[assignment]
    act_many = None  # type: ignore[assignment]

    def act(self, seen: Seen) -> Action:
        return replace(super().act(seen), report=None)


class IgnoresTheSecondHand(Sound):
    name = "ignores the second hand"

    def act(self, seen: Seen) -> Action:
        return super().act(_OneHand(seen))  # type: ignore[arg-type]


class _OneHand:
    def __init__(self, seen: Seen) -> None:
        self._seen = seen

    def __getattr__(self, name: str) -> Any:
        return self._seen.hands[:1] if name == "hands" else getattr(self._seen, name)


class Drifts(Sound):
    """Once it is within ``arrived_m`` of where it should be it leaves at 4 mm/s, for ``until_m`` of way."""

    name = "drifts"

    def __init__(self, arrived_m: float = 0.02, until_m: float = np.inf) -> None:
        self._arrived_m, self._until_m, self._from_m = arrived_m, until_m, np.full(3, np.nan)

    def act(self, seen: Seen) -> Action:
        tcp_m, action = seen.tcp_position_in_base_m, super().act(seen)
        if np.linalg.norm(self._target_in_base_m - tcp_m) < self._arrived_m and np.isnan(self._from_m[0]):
            self._from_m = tcp_m.copy()
        if isinstance(action, Stop) or np.isnan(self._from_m[0]):
            return action
        left_m = self._until_m - float(np.linalg.norm(tcp_m - self._from_m))
        return Move(tcp_velocity_mps=np.array([0.0, min(0.004, max(left_m, 0.0) / seen.period_s), 0.0]))


class StopsLate(Sound):
    """It stops ``late`` ticks late; or, without ``brakes``, holds still so late."""

    name = "stops late"

    def __init__(self, late: int = 25, *, brakes: bool = True) -> None:
        self._late, self._brakes = late, brakes

    def reset(self, **start: Any) -> None:
        super().reset(**start)
        self._asked = deque([False] * (self._late + 1), self._late + 1)

    def act(self, seen: Seen) -> Action:
        self._asked.append(isinstance(super().act(seen), Stop))
        if self._asked[0]:
            return Stop() if self._brakes else Move()
        velocity = self._gain * (self._target_in_base_m - seen.tcp_position_in_base_m)
        return Move(tcp_velocity_mps=velocity)


class Blind(Sound):
    """It goes to where it should be, slows as it arrives there, and sees no hand."""

    name = "blind"

    def __init__(self, gain: float, most_mps: float) -> None:
        self._per_s, self._most_mps = gain, most_mps

    def act(self, seen: Seen) -> Action:
        velocity = self._per_s * (self._target_in_base_m - seen.tcp_position_in_base_m)
        return Move(tcp_velocity_mps=velocity * min(1.0, self._most_mps / float(np.linalg.norm(velocity))))


class Wanders(Sound):
    """It goes with the velocity [m/s] that a function of time [s] gives, whoever is there."""

    name = "wanders"

    def __init__(self, velocity: Callable[[float], tuple[float, float, float]]) -> None:
        self._velocity = velocity

    def act(self, seen: Seen) -> Action:
        return Move(tcp_velocity_mps=np.array(self._velocity(seen.time_s)))


class SaysThatItRetreats(Sound):
    """It stands, and reports all the while that it gives way."""

    name = "says that it retreats"

    def act(self, seen: Seen) -> Action:
        return Move()


def alone(scenario: Scenario) -> Scenario:
    """The scenario for a controller that is given as an object, without claims."""
    return replace(scenario, avoider=NO_AVOIDER, controller=Sound.name, claims=())
