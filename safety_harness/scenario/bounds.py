"""How small and how large a setting may be: by its dimension, narrower for single keys.

What lies beyond is a slip of the unit or a system that nobody builds; within, every number that a
run computes stays finite and the servo loop stable (the largest gain times the longest control
period is 0.5).  docs/scenario-language.md names every bound.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from math import pi, radians

from safety_harness.scenario.fields import LARGEST_ANGLE_RAD, LARGEST_COORDINATE_M
from safety_harness.scenario.units import (
    ACCELERATION,
    ANGLE,
    ANGULAR_ACCELERATION,
    ANGULAR_SPEED,
    FRACTION,
    LENGTH,
    NUMBER,
    PER_LENGTH,
    PIXEL_ACCELERATION,
    PIXEL_AREA,
    PIXEL_AREA_RATE,
    PIXEL_SPEED,
    PIXELS,
    RATE,
    SPEED,
    TIME,
    TIME_PER_SPEED,
    Dimension,
)


@dataclass(frozen=True)
class Bounds:
    """The least and the largest value, in SI; both are allowed."""

    least: float
    most: float


BY_DIMENSION: Mapping[str, Bounds] = {
    dimension.name: Bounds(least, most)
    for dimension, least, most in (
        (LENGTH, 1e-5, 10.0),
        (TIME, 1e-3, 60.0),
        (SPEED, 1e-3, 10.0),
        (ACCELERATION, 1e-3, 100.0),
        (ANGLE, radians(1.0), LARGEST_ANGLE_RAD),
        (ANGULAR_SPEED, 1e-3, 10.0),
        (ANGULAR_ACCELERATION, 1e-3, 100.0),
        (RATE, 0.1, 1000.0),
        (PIXELS, 1e-3, 1e4),
        (PIXEL_AREA, 1e-3, 1e6),
        (PIXEL_SPEED, 1e-3, 1e5),
        (PIXEL_ACCELERATION, 1e-3, 1e6),
        (PIXEL_AREA_RATE, 1e-3, 1e7),
        (PER_LENGTH, 1e-5, 1.0),
        (TIME_PER_SPEED, 1e-3, 10.0),
        (FRACTION, 0.0, 1.0),
        (NUMBER, 1e-6, 10.0),
    )
}
_HAND_SIZE = Bounds(0.01, 0.3)
_IMAGE_SIZE = Bounds(16, 4096)
_FOCAL = Bounds(50.0, 20_000.0)
_LATENCY = Bounds(0.0, 10.0)
_GAIN = Bounds(1e-3, 10.0)
BY_KEY: Mapping[str, Bounds] = {
    "Clock.control_period_s": Bounds(1e-3, 0.05),  # between two ticks the arm is taken to move evenly
    "Clock.physics_substeps": Bounds(1, 100),
    "Clock.wall_limit_s": Bounds(0.1, 3600.0),
    "Cell.table_height_m": Bounds(-2.0, 2.0),
    "Object.yaw_rad": Bounds(-LARGEST_ANGLE_RAD, LARGEST_ANGLE_RAD),
    "Object.polygon_m": Bounds(-1.0, 1.0),
    "Camera.width_px": _IMAGE_SIZE,
    "Camera.height_px": _IMAGE_SIZE,
    "Camera.focal_px": _FOCAL,
    "Camera.mount_yaw_rad": Bounds(-LARGEST_ANGLE_RAD, LARGEST_ANGLE_RAD),
    "Camera.mount_offset_in_tcp_m": Bounds(-1.0, 1.0),
    "Camera.calibration_error_offset_m": Bounds(-1.0, 1.0),
    "Camera.latency_s": _LATENCY,
    "HandSensor.width_px": _IMAGE_SIZE,
    "HandSensor.height_px": _IMAGE_SIZE,
    "HandSensor.focal_px": _FOCAL,
    "HandSensor.pixel_noise_px": Bounds(0.0, 100.0),
    "HandSensor.depth_noise_per_m": Bounds(0.0, 1.0),
    "HandSensor.latency_s": _LATENCY,
    "HandFilter.prediction_horizon_s": Bounds(0.0, 2.0),
    "HandFilter.assumed_hand_radius_m": _HAND_SIZE,
    "Hand.radius_m": _HAND_SIZE,
    "Hand.forearm_radius_m": _HAND_SIZE,
    "Hand.forearm_length_m": Bounds(0.01, 1.0),
    "Servo.gain_far": _GAIN,
    "Servo.gain_near": _GAIN,
    "Servo.gain_switch_sse": Bounds(1e-9, 10.0),
    "Motion.min_singular_value": Bounds(1e-4, 1.0),
    "Avoidance.critical_distance_m": Bounds(0.0, 3.0),  # zero: no avoidance at all
    "Avoidance.radius_m": Bounds(1e-3, 2.0),
    "Avoidance.arrival_tolerance_m": Bounds(1e-5, 0.05),
    "Avoidance.candidate_count": Bounds(1, 10_000),
    "Avoidance.candidate_cone_rad": Bounds(radians(5.0), pi),  # a narrow one is drawn into for ever
    "Avoidance.hand_pull": Bounds(0.0, 1.0),
    "Braking.reaction_time_s": Bounds(0.0, 5.0),
    "Braking.stop_time_base_s": Bounds(0.0, 5.0),
    "Braking.stop_time_per_speed_s2pm": Bounds(0.0, 10.0),
}


def bounds_of(group: str, name: str, dimension: Dimension, *, several: bool) -> Bounds:
    """Of the field ``name`` of the settings dataclass ``group``.

    ``several`` are coordinates or angles of a list, which may have either sign.
    """
    own = BY_KEY.get(f"{group}.{name}")
    if own is not None:
        return own
    if several:
        most = LARGEST_ANGLE_RAD if dimension is ANGLE else LARGEST_COORDINATE_M
        return Bounds(-most, most)
    return BY_DIMENSION[dimension.name]
