"""Define faults that act between the hands and the controller's estimate of the hands."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from safety_harness.admission.admit import Admitted
from safety_harness.base.elementary import product
from safety_harness.base.geometry.rotations import rotation_from_vector
from safety_harness.cell.controller.cycle import ControllerRecords
from safety_harness.cell.perception.hand_boxes import sensor_principal_point_px
from safety_harness.extensions.selftest.fault import faults_in, known, of_perception, seeded, seeing, seen
from safety_harness.extensions.selftest.system import Change, Delayed, Records

U, V, Z, AREA = range(4)  # columns of a box
GHOST_DEPTH_M = 1.45  # below the sensor; a choice


def _keep(observation: Records, wanted: NDArray[np.bool_]) -> None:
    """Remove the boxes for which ``wanted`` is False from the observation."""
    o = observation[0]
    kept = o["boxes"][: o["box_count"]][wanted]
    o["boxes"][: len(kept)] = kept
    o["box_count"] = len(kept)


@of_perception("latency that nobody counts", "the arm gives way to where the hand was")
@seeded(seeing, (0.5, 0.2, 0.1, 0.04), "ms", 1e3)
def _late(delay_s: float, admitted: Admitted) -> Change:
    """Deliver each camera frame late, and replace its time by the time of delivery."""
    frames = Delayed(delay_s)

    def see(observation: Records) -> Records:
        o = observation[0]
        if o["boxes_new"]:
            frames.put(float(o["time_s"]), (o["boxes"].copy(), int(o["box_count"])))
        frame = frames.due(float(o["time_s"]))
        o["boxes_new"] = frame is not None
        if frame is not None:
            (o["boxes"], o["box_count"]), o["boxes_time_s"] = frame, o["time_s"]
        return observation

    return see


@of_perception("wrong extrinsics, shifted", "every hand seems farther away than it is")
@seeded(known, (0.3, 0.1, 0.05, 0.02), "mm", 1e3)
def _shifted(records: ControllerRecords, by_m: float) -> None:
    records.parameters["transform_sensor_to_base"][0, 1, 3] -= by_m  # hands seem farther to the right


@of_perception("wrong extrinsics, turned", "hands are seen elsewhere, the more the farther from the camera")
@seeded(known, (0.2, 0.1, 0.05, 0.02), "deg", 180.0 / np.pi)
def _rotated(records: ControllerRecords, angle_rad: float) -> None:
    pose = records.parameters["transform_sensor_to_base"][0]
    pose[:3, :3] = product(pose[:3, :3], rotation_from_vector(np.array([angle_rad, 0.0, 0.0])))


@of_perception("swapped image axes", "rows for columns: hands seem to be on the wrong side")
@seeded(seen, (1.0, 0.5, 0.2), "% of the way", 100.0)
def _swapped(admitted: Admitted, weight: float, observation: Records) -> None:
    c_u, c_v = sensor_principal_point_px(admitted.scenario.settings.hand_sensor)
    boxes = observation[0]["boxes"]
    u, v = boxes[:, U] - c_u, boxes[:, V] - c_v
    boxes[:, U], boxes[:, V] = c_u + (1 - weight) * u + weight * v, c_v + (1 - weight) * v + weight * u


# They are in the visual servo's Kalman filter, which a scenario's predictor replaces.
OF_KALMAN_FILTER = (
    "filter that never learns velocity",
    "filter that trusts itself",
    "prediction into the past",
)


@of_perception("filter that never learns velocity", "a fast hand seems to stand still")
@seeded(known, (1.0, 0.9999, 0.99), "% of the rates' variance lost", 100.0)
def _no_velocity(records: ControllerRecords, share: float) -> None:
    for name in ("acceleration_variance", "initial_rate_variance"):
        records.filter_parameters[name] *= 1.0 - share


@of_perception(
    "filter that trusts itself", "measurements hardly count: the predicted hand stays where it was"
)
@seeded(known, (1e8, 1e6, 1e4), "times the noise")
def _deaf_filter(records: ControllerRecords, factor: float) -> None:
    records.filter_parameters["measurement_variance"] *= factor


@of_perception("prediction into the past", "the controller sees hands where they were")
@seeded(known, (-0.3, -0.1, 0.0), "ms of horizon", 1e3)
def _backwards(records: ControllerRecords, horizon_s: float) -> None:
    records.parameters["prediction_horizon_s"] = horizon_s


@of_perception("ghost hands", "an arm that gives way without a hand: people switch its avoidance off")
@seeded(seen, (1.0, 0.25, 0.05, 0.01), "% of the time", 100.0)
def _ghost(admitted: Admitted, share: float, observation: Records) -> None:
    o = observation[0]
    count = int(o["box_count"])
    if count == len(o["boxes"]) or o["time_s"] % 2.0 >= 2.0 * share:
        return
    settings = admitted.scenario.settings
    c_u, c_v = sensor_principal_point_px(settings.hand_sensor)
    # The ghost looks as large as the scenario's hand at this depth.
    side_px = settings.hand_sensor.focal_px * 2.0 * settings.hand.radius_m / GHOST_DEPTH_M
    o["boxes"][count] = (c_u - 60.0, c_v, GHOST_DEPTH_M, side_px * side_px, 1.0)
    o["box_count"] = count + 1


@of_perception("hand lost at the image border", "a hand that comes in from the side is seen late")
@seeded(seen, (200.0, 120.0, 60.0), "px")
def _lost_at_border(admitted: Admitted, border_px: float, observation: Records) -> None:
    sensor, o = admitted.scenario.settings.hand_sensor, observation[0]
    boxes = o["boxes"][: o["box_count"]]
    inside = (boxes[:, U] > border_px) & (boxes[:, U] < sensor.width_px - border_px)
    inside &= (boxes[:, V] > border_px) & (boxes[:, V] < sensor.height_px - border_px)
    _keep(observation, inside)


@of_perception("one hand only", "the system does not see a second hand")
@seeded(seen, (0.0, 1.0), "hands seen")
def _first_only(admitted: Admitted, most: float, observation: Records) -> None:
    _keep(observation, np.arange(observation[0]["box_count"]) < most)


@of_perception("wrong depth scale", "a hand above the tool seems to be below it")
@seeded(seen, (1.5, 1.2, 1.1, 1.05), "times")
def _wrong_depth(admitted: Admitted, factor: float, observation: Records) -> None:
    observation[0]["boxes"][:, Z] *= factor


@of_perception("high hands dropped", "a hand from above is filtered out as something else")
@seeded(seen, (1.6, 1.5, 1.4), "m below the camera")
def _near_only(admitted: Admitted, depth_m: float, observation: Records) -> None:
    """Ignore hands near the overhead camera, as if they were heads.

    A hand is near if its depth below the camera is at most ``depth_m``.
    """
    o = observation[0]
    _keep(observation, o["boxes"][: o["box_count"], Z] > depth_m)


@of_perception("frames lost", "the sensor is blind for part of every second")
@seeded(seen, (1.0, 0.8, 0.5, 0.2), "% of the time", 100.0)
def _blind(admitted: Admitted, share: float, observation: Records) -> None:
    if observation[0]["time_s"] % 1.0 < share:
        observation[0]["boxes_new"] = False


@of_perception("critical distance misread", "the arm waits until the hand is too near")
@seeded(known, (0.1, 0.2, 0.3, 0.35), "mm", 1e3)
def _short_sighted(records: ControllerRecords, distance_m: float) -> None:
    records.parameters["critical_distance_m"] = distance_m


PERCEPTION_FAULTS = faults_in(globals())
