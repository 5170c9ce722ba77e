"""What can be wrong between the hands and what the controller takes for them."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np
from numpy.typing import NDArray

from safety_harness.admission.admit import Admitted
from safety_harness.controller.cycle import ControllerRecords
from safety_harness.geometry.rotations import rotation_from_vector
from safety_harness.perception.hand_boxes import sensor_principal_point_px
from safety_harness.perception.tracking import MAX_DETECTIONS
from safety_harness.selftest.fault import FaultyPart, SeededFault, SeverityLevels
from safety_harness.selftest.system import Change, ChangedSystem, Delayed, Records

U, V, Z, AREA = range(4)
GHOST_DEPTH_M = 1.45


def seen(
    change: Callable[[Admitted, float, Records], None],
) -> Callable[[ChangedSystem, float], ChangedSystem]:
    """Seeds a change of each observation that remembers nothing."""

    def seed_into(system: ChangedSystem, magnitude: float) -> ChangedSystem:
        def make(admitted: Admitted) -> Change:
            def see(observation: Records) -> Records:
                change(admitted, magnitude, observation)
                return observation

            return see

        return system.seeing(make)

    return seed_into


def parameters(
    edit: Callable[[ControllerRecords, float], None],
) -> Callable[[ChangedSystem, float], ChangedSystem]:
    """Seeds an edit of what the controller takes for given."""
    return lambda system, magnitude: system.with_records(lambda records: edit(records, magnitude))


def keep(observation: Records, wanted: NDArray[np.bool_]) -> None:
    """Only those of the boxes."""
    o = observation[0]
    kept = o["boxes"][: o["box_count"]][wanted]
    o["boxes"][: len(kept)] = kept
    o["box_count"] = len(kept)


def _late(delay_s: float, admitted: Admitted) -> Change:
    """Frames arrive late and are taken for new ones."""
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


def _swapped(admitted: Admitted, weight: float, observation: Records) -> None:
    c_u, c_v = sensor_principal_point_px(admitted.scenario.settings.hand_sensor)
    boxes = observation[0]["boxes"]
    u, v = boxes[:, U] - c_u, boxes[:, V] - c_v
    boxes[:, U], boxes[:, V] = c_u + (1 - weight) * u + weight * v, c_v + (1 - weight) * v + weight * u


def _lost_at_border(admitted: Admitted, border_px: float, observation: Records) -> None:
    sensor, o = admitted.scenario.settings.hand_sensor, observation[0]
    boxes = o["boxes"][: o["box_count"]]
    inside = (boxes[:, U] > border_px) & (boxes[:, U] < sensor.width_px - border_px)
    inside &= (boxes[:, V] > border_px) & (boxes[:, V] < sensor.height_px - border_px)
    keep(observation, inside)


def _ghost(admitted: Admitted, share: float, observation: Records) -> None:
    o = observation[0]
    count = int(o["box_count"])
    if count == MAX_DETECTIONS or o["time_s"] % 2.0 >= 2.0 * share:
        return
    settings = admitted.scenario.settings
    c_u, c_v = sensor_principal_point_px(settings.hand_sensor)
    side_px = settings.hand_sensor.focal_px * 2.0 * settings.hand.radius_m / GHOST_DEPTH_M
    o["boxes"][count] = (c_u - 60.0, c_v, GHOST_DEPTH_M, side_px * side_px, 1.0)
    o["box_count"] = count + 1


def _first_only(admitted: Admitted, most: float, observation: Records) -> None:
    keep(observation, np.arange(observation[0]["box_count"]) < most)


def _wrong_depth(admitted: Admitted, factor: float, observation: Records) -> None:
    observation[0]["boxes"][:, Z] *= factor


def _blind(admitted: Admitted, share: float, observation: Records) -> None:
    if observation[0]["time_s"] % 1.0 < share:
        observation[0]["boxes_new"] = False


def _near_only(admitted: Admitted, depth_m: float, observation: Records) -> None:
    """What is as near to the overhead camera as a head is taken for one."""
    o = observation[0]
    keep(observation, o["boxes"][: o["box_count"], Z] > depth_m)


def _shifted(records: ControllerRecords, by_m: float) -> None:
    records.parameters["transform_sensor_to_base"][0, 1, 3] -= by_m  # hands seem to be farther to the right


def _rotated(records: ControllerRecords, angle_rad: float) -> None:
    pose = records.parameters["transform_sensor_to_base"][0]
    pose[:3, :3] = pose[:3, :3] @ rotation_from_vector(np.array([angle_rad, 0.0, 0.0]))


def _no_velocity(records: ControllerRecords, share: float) -> None:
    for name in ("acceleration_variance", "initial_rate_variance"):
        records.filter_parameters[name] *= 1.0 - share


def _backwards(records: ControllerRecords, horizon_s: float) -> None:
    records.parameters["prediction_horizon_s"] = horizon_s


def _deaf_filter(records: ControllerRecords, factor: float) -> None:
    records.filter_parameters["measurement_variance"] *= factor


def _short_sighted(records: ControllerRecords, distance_m: float) -> None:
    records.parameters["critical_distance_m"] = distance_m


_perception = partial(SeededFault, part=FaultyPart.PERCEPTION)

PERCEPTION_FAULTS = (
    _perception(
        name="latency that nobody counts",
        hazard="the arm gives way to where the hand was",
        seed_into=lambda s, delay_s: s.seeing(partial(_late, delay_s)),
        ladder=SeverityLevels((0.5, 0.2, 0.1, 0.04), "ms", 1e3),
    ),
    _perception(
        name="wrong extrinsics, shifted",
        hazard="every hand is taken to be farther away than it is",
        seed_into=parameters(_shifted),
        ladder=SeverityLevels((0.3, 0.1, 0.05, 0.02), "mm", 1e3),
    ),
    _perception(
        name="wrong extrinsics, turned",
        hazard="hands are seen elsewhere, the more the farther from the camera",
        seed_into=parameters(_rotated),
        ladder=SeverityLevels((0.2, 0.1, 0.05, 0.02), "deg", 180.0 / np.pi),
    ),
    _perception(
        name="swapped image axes",
        hazard="rows for columns: hands are seen on the other side",
        seed_into=seen(_swapped),
        ladder=SeverityLevels((1.0, 0.5, 0.2), "% of the way", 100.0),
    ),
    _perception(
        name="filter that never learns velocity",
        hazard="a hand that comes fast is taken to stand still",
        seed_into=parameters(_no_velocity),
        ladder=SeverityLevels((1.0, 0.9999, 0.99), "% of the rates' variance lost", 100.0),
    ),
    _perception(
        name="filter that trusts itself",
        hazard="measurements hardly count: the predicted hand stays where it was",
        seed_into=parameters(_deaf_filter),
        ladder=SeverityLevels((1e8, 1e6, 1e4), "times the noise"),
    ),
    _perception(
        name="prediction into the past",
        hazard="the controller sees hands where they were",
        seed_into=parameters(_backwards),
        ladder=SeverityLevels((-0.3, -0.1, 0.0), "ms of horizon", 1e3),
    ),
    _perception(
        name="ghost hands",
        hazard="an arm that gives way to nobody: people switch its avoidance off",
        seed_into=seen(_ghost),
        ladder=SeverityLevels((1.0, 0.25, 0.05, 0.01), "% of the time", 100.0),
    ),
    _perception(
        name="hand lost at the image border",
        hazard="a hand that comes in from the side is seen late",
        seed_into=seen(_lost_at_border),
        ladder=SeverityLevels((200.0, 120.0, 60.0), "px"),
    ),
    _perception(
        name="one hand only",
        hazard="a second hand that nobody sees",
        seed_into=seen(_first_only),
        ladder=SeverityLevels((0.0, 1.0), "hands seen"),
    ),
    _perception(
        name="wrong depth scale",
        hazard="a hand above the tool is taken to be below it",
        seed_into=seen(_wrong_depth),
        ladder=SeverityLevels((1.5, 1.2, 1.1, 1.05), "times"),
    ),
    _perception(
        name="high hands dropped",
        hazard="a hand from above is filtered out as something else",
        seed_into=seen(_near_only),
        ladder=SeverityLevels((1.6, 1.5, 1.4), "m below the camera"),
    ),
    _perception(
        name="frames lost",
        hazard="the sensor is blind for part of every second",
        seed_into=seen(_blind),
        ladder=SeverityLevels((1.0, 0.8, 0.5, 0.2), "% of the time", 100.0),
    ),
    _perception(
        name="critical distance misread",
        hazard="the arm waits until the hand is too near",
        seed_into=parameters(_short_sighted),
        ladder=SeverityLevels((0.1, 0.2, 0.3, 0.35), "mm", 1e3),
    ),
)
