"""Refuse sensors, times and faults that are valid alone but do not fit the cell or the avoider."""

from __future__ import annotations

import shlex

import numpy as np
from numpy.typing import NDArray

from safety_harness.base.exceptions import AvoiderError, InadmissibleError
from safety_harness.base.geometry.segments import segment_segment_distance
from safety_harness.base.geometry.transforms import inverse_transform
from safety_harness.base.settings import (
    DecisionCost,
    DecisionTimes,
    DetectorKind,
    GateKind,
    HandSensor,
    HandSensorKind,
    ImageSource,
    ObjectKind,
)
from safety_harness.cell.avoidance.avoider import Avoider, decision_time_of
from safety_harness.cell.controller.desired import view_of
from safety_harness.cell.controller.records import overhead_transform_sensor_to_base
from safety_harness.cell.robot.drive import delay_ticks, settled_s
from safety_harness.cell.robot.robots import drive_model
from safety_harness.cell.servoing.control import DesiredView
from safety_harness.cell.simulation.cameras import RING, sensors
from safety_harness.cell.simulation.exact_views import hand_box
from safety_harness.scenario.fault_table import fault_table
from safety_harness.scenario.faults import CameraHidden, CameraLate, FalseHand, HandSensorLate
from safety_harness.scenario.model import Scenario
from safety_harness.scenario.references import file_and_name
from safety_harness.scenario.robots import YesNo

TOUCHING_M = 1e-6  # nearer edges of an outline count as touching
# Above this number, triangles servo to 5 mm in raster images from at most two of eight starts; below 500
# from most, below 25 from all.  With exact moments rounding alone would set the bound, far higher.
MOST_CONDITION = 1000.0
# The faults that an ideal hand sensor cannot have: their fields, and their keys in a file.
_FAULTS = {
    "pixel_noise_px": "pixel noise",
    "depth_noise_per_m": "depth noise",
    "dropout_probability": "dropout",
    "latency_s": "latency",
    "rate_hz": "rate",
    "detector": "detector",
}


def checked_view(scenario: Scenario) -> DesiredView:
    """Return the view of the object at the desired pose, after checking that the cell allows servoing.

    The result is valid for any hands, any start and any hand sensor.
    """
    _check_object(scenario)
    view = view_of(scenario.settings)
    _check_view(scenario, view)
    return view


def _check_object(scenario: Scenario) -> None:
    """Refuse an object inside the table, and an object whose outline crosses itself or cannot be rendered."""
    cell, shape, camera = scenario.settings.cell, scenario.settings.object, scenario.settings.camera
    height_m = shape.position_in_base_m[2]
    if height_m < cell.table_height_m:
        expected = f"an object on or above the table (z = {cell.table_height_m * 1e3:.0f} mm)"
        got = f"z = {height_m * 1e3:.0f} mm"
        raise scenario.inadmissible(expected, got, "object.position", "settings.cell.table height")
    corners = np.column_stack([np.array(shape.polygon_m), np.zeros(len(shape.polygon_m))])
    if scenario.settings.servo.object_kind is ObjectKind.DENSE and _crosses_itself(corners):
        expected = "an outline that does not cross or touch itself"
        raise scenario.inadmissible(expected, "one that does", "object.polygon")
    edges = np.roll(corners, -1, axis=0) - corners
    turns = np.cross(edges, np.roll(edges, -1, axis=0))[:, 2]
    if camera.source is ImageSource.RENDERED and turns.min() < 0.0 < turns.max():
        expected = "a convex object where images are rendered"
        raise scenario.inadmissible(expected, "an outline that turns both ways", "object.polygon")


def _check_view(scenario: Scenario, view: DesiredView) -> None:
    """Refuse an object that is too symmetric for servoing, by the condition number of its view."""
    if not view.condition_number <= MOST_CONDITION:
        raise InadmissibleError(
            place=scenario.place("object.polygon", "object.position", "object.yaw", "object"),
            expected="an object whose interaction matrix at the desired pose has a condition number of at "
            f"most {MOST_CONDITION:g}",
            got=f"{view.condition_number:.0f}",
            hint="the object is almost mirror-symmetric, like an isosceles triangle, so that its image hides "
            "one motion; a triangle near 3:4:5 is best",
        )


def _crosses_itself(corners: NDArray[np.float64]) -> bool:
    """Return whether two edges of a polygon that are not neighbours meet.

    The polygon has corners (n, 3).
    """
    ends, n = np.roll(corners, -1, axis=0), len(corners)
    return any(
        segment_segment_distance(corners[i], ends[i], corners[j], ends[j]) < TOUCHING_M
        for i in range(n)
        # The first and the last edge are neighbours too.
        for j in range(i + 2, n - (i == 0))
    )


def _check_restart_delay(scenario: Scenario) -> None:
    """Refuse a restart delay that is shorter than the longest stop.

    After such a restart, the drives would jump to the commanded position.
    """
    settings = scenario.settings
    braking = settings.braking
    speed_mps = max(settings.motion.max_tcp_speed_mps, settings.avoidance.repulsion_speed_mps)
    stop_s = braking.reaction_time_s + braking.stop_time_base_s + braking.stop_time_per_speed_s2pm * speed_mps
    if settings.avoidance.restart_delay_s < stop_s:
        raise InadmissibleError(
            place=scenario.place(
                "settings.avoidance.restart delay",
                "settings.avoidance.repulsion speed",
                "settings.motion.max tcp speed",
                "settings.braking.reaction time",
                "settings.braking.stop time base",
                "settings.braking.stop time per speed",
            ),
            expected=f"a restart delay of at least {stop_s:.3f} s, which a stop from full speed takes",
            got=f"{settings.avoidance.restart_delay_s:g} s",
            hint=f"reaction time {braking.reaction_time_s:g} s, stop time base {braking.stop_time_base_s:g} "
            f"s, stop time per speed {braking.stop_time_per_speed_s2pm:g} s2/m, fastest {speed_mps:g} m/s",
        )


def check_cameras(scenario: Scenario) -> None:
    """Refuse settings of the cameras that contradict each other or the control ticks.

    The function also refuses a restart delay shorter than a stop, and a shield whose sensor does not see the
    whole cell.
    """
    settings = scenario.settings
    _check_restart_delay(scenario)
    most_hz = 1.0 / settings.clock.control_period_s
    for name, rate_hz in (("camera", settings.camera.rate_hz), ("hand sensor", settings.hand_sensor.rate_hz)):
        # The tolerance covers the rounding of the quotient.
        if rate_hz is not None and rate_hz > most_hz * (1.0 + 1e-9):
            expected = f'a rate of at most {most_hz:g} Hz, the rate of the control ticks, or "every tick"'
            got = f"{rate_hz:g} Hz"
            raise scenario.inadmissible(expected, got, f"{name}.rate", "settings.clock.control period")
    hangs_m, table_m = settings.hand_sensor.overhead_position_in_base_m[2], settings.cell.table_height_m
    if settings.hand_sensor.kind is not HandSensorKind.EYE_IN_HAND and not hangs_m > table_m:
        raise InadmissibleError(
            place=scenario.place("hand sensor.overhead position", "settings.cell.table height"),
            expected=f"a camera above the table (z = {table_m * 1e3:.0f} mm), as it looks straight down",
            got=f"z = {hangs_m * 1e3:.0f} mm",
        )
    if settings.hand_sensor.kind is HandSensorKind.IDEAL:
        _check_ideal(scenario, settings.hand_sensor)
    _refuse_shield(scenario, settings.hand_sensor.kind)
    if settings.hand_sensor.kind is HandSensorKind.EYE_IN_HAND:
        _check_one_optics(scenario)


def refuse_gate(scenario: Scenario) -> None:
    """Refuse a gate rule that is empty, has a reversed box, or belongs to a system without the full gate."""
    full = scenario.settings.avoidance.gate is GateKind.FULL
    if scenario.gate is not None and (scenario.driven or not full):
        got = "another controller" if scenario.driven else "the gate of reach alone"
        raise scenario.inadmissible("the visual servo with its full gate, whose rule this is", got, "gate")
    if scenario.gate is not None and not any(scenario.gate.demands):
        expected = "every hand within, every hand in its set, or questions within"
        raise InadmissibleError(place=scenario.place("gate"), expected=expected, got="none of them")
    _refuse_sets(scenario)
    region = None if scenario.gate is None else scenario.gate.questions_within
    for box in () if region is None else (region.hand, region.tcp):
        if not all(low < high for low, high in zip(box.low_m, box.high_m, strict=True)):
            expected = "boxes whose from is below to on each axis"
            raise InadmissibleError(place=scenario.place("gate"), expected=expected, got=box.summary)


def _refuse_sets(scenario: Scenario) -> None:
    """Refuse a gate rule about predicted hands that the scenario's predictor cannot serve."""
    rule = scenario.gate
    if rule is None:
        return
    if scenario.predictor and rule.hands_within is not None:
        got, hint = f"predictor {scenario.predictor}", "every hand in its set: yes"
        expected = "the Kalman filter's covariance for every hand within"
        raise scenario.inadmissible(expected, got, "gate.every hand within", hint=hint)
    if rule.hands_in_sets is YesNo.YES and not scenario.predictor:
        hint = "predictor: kalman filter"
        expected = "a predictor, whose sets the gate takes"
        raise scenario.inadmissible(expected, "none", "gate.every hand in its set", hint=hint)


def refuse_late_drives(scenario: Scenario) -> None:
    """Refuse a shield whose reaction time is shorter than the arm's drives need.

    Such a shield would violate assumption 7 of the shield's proof.
    """
    if scenario.shield is None:
        return
    period_s = scenario.settings.clock.control_period_s
    needed_s = settled_s(drive_model(scenario.robot), period_s)
    given_s = delay_ticks(scenario.shield.reaction_time_s, period_s) * period_s
    if given_s < needed_s - 1e-9:
        raise InadmissibleError(
            place=scenario.place("shield.reaction time", "shield"),
            expected=f"a reaction time of at least {needed_s * 1e3:.0f} ms, which the robot's drives need "
            "for a command",
            got=f"{scenario.shield.reaction_time_s * 1e3:g} ms",
            hint="that is their dead time in whole control periods, seven times their lag, and one control "
            "period where they lag or have a torque limit",
        )


def _refuse_shield(scenario: Scenario, kind: HandSensorKind) -> None:
    """Refuse a shield if the hand sensor does not see the whole cell, because of its ``kind``."""
    if scenario.shield is not None and kind not in (HandSensorKind.IDEAL, HandSensorKind.SURROUND):
        expected = "a hand sensor that sees the whole cell, since a shield uses it"
        hint = "hand sensor: {kind: surround}"
        raise scenario.inadmissible(expected, f"{kind.value}, blind outside its view", "shield", hint=hint)


def _check_ideal(scenario: Scenario, sensor: HandSensor) -> None:
    """Refuse noise, delays and similar faults of an ideal hand sensor, because no run would simulate them."""
    faultless = HandSensor()
    for field, name in _FAULTS.items():
        value = getattr(sensor, field)
        if value != getattr(faultless, field):
            expected = f"an ideal hand sensor without a {name} of its own"
            hint = 'a sensor with faults is "kind: overhead" or "kind: eye in hand"'
            got = str(value.value) if isinstance(value, DetectorKind) else f"{value:g}"
            raise scenario.inadmissible(expected, got, f"hand sensor.{name}", "hand sensor", hint=hint)


def _check_one_optics(scenario: Scenario) -> None:
    """Refuse an eye-in-hand sensor whose optics differ from the servoing camera's.

    The two are one physical camera.
    """
    camera, sensor = scenario.settings.camera, scenario.settings.hand_sensor
    for name in ("width", "height", "focal"):
        of_camera, of_sensor = getattr(camera, f"{name}_px"), getattr(sensor, f"{name}_px")
        if of_camera != of_sensor:
            expected = f"an eye-in-hand sensor with the camera's {name}, {of_camera:g} px"
            got = f"{of_sensor:g} px"
            place = scenario.place(f"hand sensor.{name}", f"camera.{name}", "hand sensor")
            raise InadmissibleError(place=place, expected=expected, got=got)


def check_decision_time(scenario: Scenario, avoider: Avoider, own: str) -> None:
    """Refuse a time profile that was measured for another program.

    The function also refuses an avoider that declares an invalid time. It refuses a wall-clock cost for the
    decisions of a controller, because runs of a controller must be repeatable.

    Args:
        scenario: The scenario.
        avoider: Its avoider.
        own: The hash of the avoider's or controller's file, or an empty text if there is no file.

    """
    try:
        decision_time_of(avoider)
    except AvoiderError as error:
        raise scenario.inadmissible("an avoider that declares a time", str(error), "avoider") from None
    cost, tested = scenario.settings.avoidance.decision_time, str(scenario.under_test)
    if scenario.driven and cost is DecisionCost.WALL_CLOCK:
        expected = "a time or a measured profile, because runs of a controller have to repeat"
        raise scenario.inadmissible(expected, cost.value, "settings.avoidance.decision time")
    measured = cost.measured if isinstance(cost, DecisionTimes) else None
    if measured is None:
        return
    another_class = file_and_name(measured.avoider)[1] != file_and_name(tested)[1]
    if measured.sha256 != own or another_class or (not own and measured.avoider != tested):
        expected = f"a profile of {tested}, as its file is now"
        option = "--controller " if scenario.driven else ""
        hint = f"safety-harness time {option}{shlex.quote(tested)} --out FILE.json"
        got = f"one of {measured.avoider}" + (f", sha256 {measured.sha256[:12]}..." if own else "")
        raise scenario.inadmissible(expected, got, "settings.avoidance.decision time", hint=hint)


def check_faults(scenario: Scenario) -> None:
    """Refuse faults that no run can simulate.

    Such faults are a false hand outside a fixed sensor's view, and a fault in which hands hide the object
    from a camera whose images are rendered. The function also refuses a delay at which more pictures would be
    in transit than the buffer can store.
    """
    for number, fault in enumerate(scenario.faults):
        if isinstance(fault, FalseHand):
            _check_seen(scenario, number)
        if isinstance(fault, CameraHidden) and scenario.settings.camera.source is ImageSource.RENDERED:
            expected = "exact or raster images of the camera that hands hide the object from"
            got = "rendered ones, in which hands cover pixels of the object as it is"
            raise scenario.inadmissible(expected, got, f"faults[{number}]")
    settings = scenario.settings
    for kind, camera in ((HandSensorLate, settings.hand_sensor), (CameraLate, settings.camera)):
        late = [(n, fault.delay_s) for n, fault in enumerate(scenario.faults) if isinstance(fault, kind)]
        total_s = camera.latency_s + sum(delay_s for _, delay_s in late)
        period_s = max(1.0 / camera.rate_hz if camera.rate_hz else 0.0, settings.clock.control_period_s)
        if late and total_s / period_s + 2.0 > RING:
            expected = f"at most {RING - 2} pictures under way at a time, all latencies together"
            hint = "a camera with a lower rate has fewer under way"
            got = f"{total_s:g} s, which is {total_s / period_s:.0f} pictures"
            raise scenario.inadmissible(expected, got, f"faults[{late[-1][0]}].delay", hint=hint)


def _check_seen(scenario: Scenario, number: int) -> None:
    """Refuse a false hand that a fixed sensor cannot see.

    A sensor on the arm is accepted, because it may still turn towards the hand.
    """
    settings = scenario.settings
    if settings.hand_sensor.kind is HandSensorKind.EYE_IN_HAND:
        return
    pose = overhead_transform_sensor_to_base(settings)
    state = sensors(settings, scenario.seed, 0, pose).state
    place = fault_table(scenario.faults)[number]["vector_m"].copy()
    if not hand_box(state, inverse_transform(pose), place, np.zeros(5)):
        expected = "a false hand where the hand sensor could see one"
        got = f"({', '.join(f'{1e3 * value:.0f}' for value in place)}) mm, which is out of its view"
        raise scenario.inadmissible(expected, got, f"faults[{number}].at")
