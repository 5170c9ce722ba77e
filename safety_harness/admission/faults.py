"""Faults that cannot be simulated as they are written: refused before anything runs."""

from __future__ import annotations

import numpy as np

from safety_harness.controller.records import overhead_transform_sensor_to_base
from safety_harness.exceptions import InadmissibleError
from safety_harness.scenario.fault_table import fault_table
from safety_harness.scenario.faults import CameraHidden, CameraLate, FalseHand, HandSensorLate
from safety_harness.scenario.model import Scenario
from safety_harness.settings import HandSensorKind, ImageSource
from safety_harness.simulation.cameras import RING, sensors
from safety_harness.simulation.faults import false_box


def check_faults(scenario: Scenario) -> None:
    """Refuse a false hand out of a fixed sensor's sight, a second occlusion, too many late pictures."""
    for number, fault in enumerate(scenario.faults):
        if isinstance(fault, FalseHand):
            _check_seen(scenario, number)
        if isinstance(fault, CameraHidden) and scenario.settings.camera.source is ImageSource.RENDERED:
            raise InadmissibleError(
                place=scenario.place(f"faults[{number}]"),
                expected="exact or raster images of the camera that hands hide the object from",
                got="rendered ones, in which hands cover pixels of the object as it is",
            )
    settings = scenario.settings
    for kind, camera in ((HandSensorLate, settings.hand_sensor), (CameraLate, settings.camera)):
        late = [(n, fault.delay_s) for n, fault in enumerate(scenario.faults) if isinstance(fault, kind)]
        total_s = camera.latency_s + sum(delay_s for _, delay_s in late)
        period_s = max(1.0 / camera.rate_hz if camera.rate_hz else 0.0, settings.clock.control_period_s)
        if late and total_s / period_s + 2.0 > RING:
            raise InadmissibleError(
                place=scenario.place(f"faults[{late[-1][0]}].delay"),
                expected=f"at most {RING - 2} pictures under way at a time, all latencies together",
                got=f"{total_s:g} s, which is {total_s / period_s:.0f} pictures",
                hint="a camera with a lower rate has fewer under way",
            )


def _check_seen(scenario: Scenario, number: int) -> None:
    """A false hand has to be where a fixed sensor could see one; one that is carried about may turn to it."""
    settings = scenario.settings
    if settings.hand_sensor.kind is HandSensorKind.EYE_IN_HAND:
        return
    pose = overhead_transform_sensor_to_base(settings)
    state = sensors(settings, scenario.seed, 0, pose).state
    place = fault_table(scenario.faults)[number]["vector_m"].copy()
    if not false_box(state, pose, place, np.zeros(5)):
        raise InadmissibleError(
            place=scenario.place(f"faults[{number}].at"),
            expected="a false hand where the hand sensor could see one",
            got=f"({', '.join(f'{1e3 * value:.0f}' for value in place)}) mm, which is out of its view",
        )
