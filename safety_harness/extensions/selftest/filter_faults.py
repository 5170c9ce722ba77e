"""Define faults of a user's safety filter.

They concern the filter's view of hands, its timing, and its effect. The faults change no code of the filter.
They are tried where the filter alone protects hands, because the controller does not avoid hands.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import replace
from typing import Any

from safety_harness.admission.admit import Admitted
from safety_harness.cell.controller.filtered import FilterCalls
from safety_harness.extensions.selftest.fault import (
    Precondition,
    SeededFault,
    Seeds,
    faults_in,
    minds_nobody,
    of_motion,
    of_timing,
    seeded,
)
from safety_harness.extensions.selftest.shield_faults import FAR_M
from safety_harness.extensions.selftest.system import ChangedSystem, Records

OF_HANDS = (
    *("hand_count", "hands", "boxes_new", "boxes_time_s", "box_count", "boxes"),
    *("tracked", "last_seen_s", "predicted", "predicted_velocity", "predicted_covariance"),
)
ALONE = Precondition(
    "behind the safety filter alone",
    lambda system: system if system.admitted.driver else system.with_records(minds_nobody),
)


def viewed(make: Callable[[float, Admitted], Callable[[Records], None]]) -> Seeds:
    """Seed a fault that changes the filter's view SEEN (1,) at each tick.

    ``make`` creates a new change for each run; the change may remember earlier views.
    """

    def seed(system: ChangedSystem, magnitude: float) -> ChangedSystem:
        def edit(calls: FilterCalls) -> None:
            change, perceive = make(magnitude, system.admitted), calls.perceive

            def changed(observation: Records) -> Any:
                seen = perceive(observation)
                change(seen)
                return seen

            calls.perceive = changed  # type: ignore[method-assign]

        return system.with_filter(edit)

    return seed


def heard(make: Callable[[float, Admitted], Callable[[Records], bool]]) -> Seeds:
    """Seed a fault that lets the controller's command bypass the safety filter at some ticks.

    At each tick, the filter has an effect only if the function that ``make`` returns is true. This function
    gets the observation (1,) of each tick.
    """

    def seed(system: ChangedSystem, magnitude: float) -> ChangedSystem:
        def edit(calls: FilterCalls) -> None:
            counts, filtered = make(magnitude, system.admitted), calls.filter

            def passed(wanted: Records, observation: Records) -> Records:
                # Call the filter at each tick, so that only its effect is missing.
                own = filtered(wanted, observation)
                return own if counts(observation) else wanted

            calls.filter = passed  # type: ignore[method-assign]

        return system.with_filter(edit)

    return seed


def needs_filter(fault: SeededFault) -> SeededFault:
    """Decorate a fault that applies only to a system with a safety filter."""
    return replace(fault, of_filter=True)


@needs_filter
@of_motion("safety filter looks elsewhere", "it sees hands in wrong places and misses the real hands", ALONE)
@seeded(viewed, (FAR_M, 1.0, 0.5, 0.2), "m")
def _elsewhere(by_m: float, admitted: Admitted) -> Callable[[Records], None]:
    def change(seen: Records) -> None:
        for name in ("hands", "predicted"):
            seen[name][..., 1] -= by_m  # hands seem farther to the right
        seen["transform_sensor_to_base"][..., 1, 3] -= by_m

    return change


@needs_filter
@of_motion("safety filter takes hands for slow", "it slows or moves the arm too late", ALONE)
@seeded(viewed, (0.0, 0.2, 0.5), "times")
def _slow(factor: float, admitted: Admitted) -> Callable[[Records], None]:
    def change(seen: Records) -> None:
        seen["predicted_velocity"] *= factor

    return change


@needs_filter
@of_motion("safety filter sees one hand", "another hand is not protected", ALONE)
@seeded(viewed, (0.0, 1.0), "hands seen")
def _first_only(most: float, admitted: Admitted) -> Callable[[Records], None]:
    def change(seen: Records) -> None:
        for name in ("hand_count", "box_count"):
            seen[name] = seen[name].clip(max=int(most))
        seen["tracked"][..., int(most) :] = 0

    return change


@needs_filter
@of_timing("safety filter sees hands late", "it protects where the hand was", ALONE)
@seeded(viewed, (0.5, 0.3, 0.1), "ms", 1e3)
def _late(delay_s: float, admitted: Admitted) -> Callable[[Records], None]:
    cycles = round(delay_s / admitted.scenario.settings.clock.control_period_s)
    waiting: deque[dict[str, Any]] = deque(maxlen=cycles + 1)

    def change(seen: Records) -> None:
        waiting.append({name: seen[name].copy() for name in OF_HANDS})
        for name, value in waiting[0].items():
            seen[name] = value

    return change


@needs_filter
@of_timing("safety filter not heard", "the controller's command passes for part of every second", ALONE)
@seeded(heard, (1.0, 0.8, 0.5), "% of the time", 100.0)
def _unheard(share: float, admitted: Admitted) -> Callable[[Records], bool]:
    return lambda observation: float(observation[0]["time_s"]) % 1.0 >= share


FILTER_FAULTS = faults_in(globals())
