"""Does image-based visual servoing reach the desired pose?  Run: python benchmarks/convergence.py.

A free-flying camera (no arm, no limits on its speed) starts from TCP positions drawn uniformly from
+-(60, 150, 100) mm around the desired one, upright or tilted about random axes, and follows the
control law for 1.25 times the time that an exponential decrease of the error would take.  Each
twist is held for one control period and integrated exactly on SE(3).  A start succeeds if its
final *pose* is right: |f - f*| -> 0 is not enough, since a triangle looks alike from several poses.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import log, sqrt

import numpy as np
from numpy.typing import NDArray

from safety_harness.base.compiled import compiled
from safety_harness.base.geometry.rotations import rotation_from_vector, vector_from_rotation
from safety_harness.base.geometry.transforms import compose_into, inverse_transform, transform_from
from safety_harness.base.settings import (
    CONVERGED_ANGLE_RAD,
    CONVERGED_POSITION_M,
    DEFAULTS,
    ImageSource,
    InteractionChoice,
    Object,
    ObjectKind,
)
from safety_harness.cell.perception.camera import (
    polygon_in_camera,
    polygon_inside_image,
    project,
    transform_camera_to_tcp,
)
from safety_harness.cell.perception.moments import MOMENT_COUNT, polygon_moments
from safety_harness.cell.perception.raster import raster_moments
from safety_harness.cell.servoing.control import camera_twist, choice_code, desired_view
from safety_harness.cell.servoing.features import feature_error, features

STARTS = 200
SEED = 20_240_611
START_RANGE_M = (0.060, 0.150, 0.100)
TILTS_DEG = (0.0, 3.0, 5.0)
TIME_MARGIN = 1.25
# What counts as success: (position [m], angle [rad]).
TOLERANCE = {
    ImageSource.EXACT: (CONVERGED_POSITION_M, CONVERGED_ANGLE_RAD),
    ImageSource.RASTER: (0.005, np.radians(1.0)),
}

ARRIVED, OUT_OF_VIEW_AT_START, OUT_OF_VIEW_LATER, NO_TWIST = range(4)  # how a flight ended

SQUARED_ANGLE_FOR_SERIES = 1e-4  # above it the closed forms are good to 1e-11


@dataclass(frozen=True, kw_only=True)
class Row:
    """One line of the table; counts of starts."""

    source: ImageSource
    choice: InteractionChoice
    tilt_deg: float
    succeeded: int
    pose_off: int  # lasted to the end, but not within tolerance
    out_of_view_at_start: int
    out_of_view_later: int
    no_twist: int
    median_m: float  # of the final distances from the desired pose, of flights that arrived
    percentile_90_m: float


@compiled
def move_camera(
    transform_object_to_camera: NDArray[np.float64],  # (4, 4), changed in place
    twist: NDArray[np.float64],  # (6,) of the camera in its own frame
    period_s: float,
) -> None:
    """Move the camera by the twist for one period: T <- exp(-period twist) T.

    exp of (u, r) is the turn R(r) and the shift V u, V = I + b [r]x + c [r]x^2, with
    b = (1 - cos t)/t^2, c = (t - sin t)/t^3, t = |r|.
    """
    shift = np.empty(3)
    turn = np.empty(3)
    for k in range(3):
        shift[k] = -period_s * twist[k]
        turn[k] = -period_s * twist[3 + k]
    squared = turn[0] ** 2 + turn[1] ** 2 + turn[2] ** 2
    if squared < SQUARED_ANGLE_FOR_SERIES:
        b = 0.5 - squared / 24.0 + squared * squared / 720.0
        c = 1.0 / 6.0 - squared / 120.0 + squared * squared / 5040.0
    else:
        angle = np.sqrt(squared)
        b = (1.0 - np.cos(angle)) / squared
        c = (angle - np.sin(angle)) / (squared * angle)
    once = np.cross(turn, shift)
    twice = np.cross(turn, once)
    step = transform_from(rotation_from_vector(turn), shift + b * once + c * twice)
    compose_into(step, transform_object_to_camera.copy(), transform_object_to_camera)


@compiled
def fly(
    transform_object_to_camera: NDArray[np.float64],  # (4, 4) start; the end is written into it
    polygon_m: NDArray[np.float64],  # (n, 2)
    desired_features: NDArray[np.float64],
    desired_interaction: NDArray[np.float64],
    desired_interaction_pinv: NDArray[np.float64],
    desired_area: float,
    desired_depth_m: float,
    choice: int,
    rasterised: bool,
    image: tuple[float, int, int],  # focal length, width, height [px]
    gains: tuple[float, float, float],  # far, near, and the |e|^2 of the switch
    period_s: float,
    converged_m: float,
    time_margin: float,
) -> int:
    """One flight; returns ARRIVED when its time is over, else why it ended early."""
    focal_px, width_px, height_px = image
    gain_far, gain_near, switch_sse = gains
    in_camera, normalised = np.empty((len(polygon_m), 3)), np.empty((len(polygon_m), 2))
    moments = np.empty(MOMENT_COUNT)
    current, error, twist = np.empty(6), np.empty(6), np.empty(6)
    tick, ticks = 0, 1
    while tick < ticks:
        polygon_in_camera(polygon_m, transform_object_to_camera, in_camera)
        if not (
            project(in_camera, normalised) and polygon_inside_image(normalised, focal_px, width_px, height_px)
        ):
            return OUT_OF_VIEW_AT_START if tick == 0 else OUT_OF_VIEW_LATER
        if rasterised:
            raster_moments(normalised, focal_px, width_px, height_px, moments)
        else:
            polygon_moments(normalised, moments)
        if not features(moments, desired_area, desired_depth_m, True, current):
            return NO_TWIST
        sse = feature_error(current, desired_features, error)
        if tick == 0:
            distance, switch = sqrt(sse), sqrt(switch_sse)
            time_s = log(switch / converged_m) / gain_near + max(0.0, log(distance / switch)) / gain_far
            ticks = int(np.ceil(time_margin * time_s / period_s))
        if not camera_twist(
            choice,
            desired_interaction,
            desired_interaction_pinv,
            moments,
            current,
            desired_area,
            desired_depth_m,
            True,
            gain_near if sse < switch_sse else gain_far,
            error,
            twist,
        ):
            return NO_TWIST
        move_camera(transform_object_to_camera, twist, period_s)
        tick += 1
    return ARRIVED


def desired_transform_tcp_to_base() -> NDArray[np.float64]:  # (4, 4)
    """The tool points straight down at the desired position."""
    return transform_from(np.diag([1.0, -1.0, -1.0]), np.array(DEFAULTS.cell.desired_tcp_position_in_base_m))


def transform_object_to_camera(
    transform_tcp_to_base: NDArray[np.float64], shape: Object
) -> NDArray[np.float64]:  # (4, 4)
    """Where a camera on the true mount has the object."""
    object_to_base = transform_from(
        rotation_from_vector(np.array([0.0, 0.0, shape.yaw_rad])),
        np.array(shape.position_in_base_m),
    )
    camera_to_base = transform_tcp_to_base @ transform_camera_to_tcp(DEFAULTS.camera, calibrated=False)
    return np.ascontiguousarray(inverse_transform(camera_to_base) @ object_to_base)


def draw_starts(count: int, tilt_deg: float, seed: int) -> list[NDArray[np.float64]]:
    """TCP poses (``transform_tcp_to_base``): uniform in the box, tilted about uniformly drawn axes.

    The positions depend on the seed alone, so that rows of the table share them.
    """
    rng = np.random.default_rng(seed)
    offsets_m = rng.uniform(-1.0, 1.0, (count, 3)) * START_RANGE_M
    axes = rng.normal(size=(count, 3))
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    desired = desired_transform_tcp_to_base()
    starts = []
    for offset_m, axis in zip(offsets_m, axes, strict=True):
        rotation = desired[:3, :3] @ rotation_from_vector(np.radians(tilt_deg) * axis)
        starts.append(transform_from(rotation, desired[:3, 3] + offset_m))
    return starts


def pose_difference(
    first: NDArray[np.float64], second: NDArray[np.float64]
) -> tuple[float, float]:  # (4, 4) each, ``transform_object_to_camera``
    """How far apart two camera poses are: distance of their origins [m] and angle [rad]."""
    between = inverse_transform(first) @ second
    centre = inverse_transform(second)[:3, 3] - inverse_transform(first)[:3, 3]
    angle_rad = np.linalg.norm(vector_from_rotation(np.ascontiguousarray(between[:3, :3])))
    return float(np.linalg.norm(centre)), float(angle_rad)


def count_row(
    source: ImageSource,
    choice: InteractionChoice,
    tilt_deg: float,
    *,
    starts: int = STARTS,
    seed: int = SEED,
    shape: Object = DEFAULTS.object,
) -> Row:
    """Fly from every start and count how the flights ended; ``shape`` is the object and its yaw."""
    camera, servo = DEFAULTS.camera, DEFAULTS.servo
    polygon_m = np.array(shape.polygon_m)
    target = transform_object_to_camera(desired_transform_tcp_to_base(), shape)
    view = desired_view(polygon_m, target, ObjectKind.DENSE)
    position_tolerance_m, angle_tolerance_rad = TOLERANCE[source]
    ended: list[int] = []
    distances_m: list[float] = []
    succeeded = 0
    for start in draw_starts(starts, tilt_deg, seed):
        pose = transform_object_to_camera(start, shape)
        end = fly(
            pose,
            polygon_m,
            view.features,
            view.interaction,
            view.interaction_pinv,
            view.area,
            view.depth_m,
            choice_code(choice),
            source is ImageSource.RASTER,
            (camera.focal_px, camera.width_px, camera.height_px),
            (servo.gain_far, servo.gain_near, servo.gain_switch_sse),
            DEFAULTS.clock.control_period_s,
            CONVERGED_POSITION_M,
            TIME_MARGIN,
        )
        ended.append(end)
        if end == ARRIVED:
            distance_m, angle_rad = pose_difference(pose, target)
            distances_m.append(distance_m)
            succeeded += distance_m <= position_tolerance_m and angle_rad <= angle_tolerance_rad
    return Row(
        source=source,
        choice=choice,
        tilt_deg=tilt_deg,
        succeeded=succeeded,
        pose_off=ended.count(ARRIVED) - succeeded,
        out_of_view_at_start=ended.count(OUT_OF_VIEW_AT_START),
        out_of_view_later=ended.count(OUT_OF_VIEW_LATER),
        no_twist=ended.count(NO_TWIST),
        median_m=float(np.percentile(distances_m, 50)),
        percentile_90_m=float(np.percentile(distances_m, 90)),
    )


def aligned_object() -> Object:
    """A smaller object (120 x 90 mm) with its edges along the pixels' rows and columns.

    Where an edge runs along a row, half a pixel of motion adds or drops the whole row at once.
    """
    polygon_m = ((-0.040, -0.030), (0.080, -0.030), (-0.040, 0.060))
    return replace(DEFAULTS.object, polygon_m=polygon_m, yaw_rad=0.0)


def print_row(name: str, row: Row) -> None:
    """One line of the table."""
    view = f"{row.out_of_view_at_start} / {row.out_of_view_later}"
    print(
        f"{name:10}{row.source.value:8}{row.choice.value:9}{row.tilt_deg:5.0f}{row.succeeded:9}"
        f"{row.pose_off:10}{view:>10}{row.no_twist:10}"
        f"{1e3 * row.median_m:10.2f}{1e3 * row.percentile_90_m:8.2f}",
        flush=True,
    )


def main() -> None:
    """Print the table."""
    print(f"{STARTS} starts a row, seed {SEED}; success: final pose within 1 mm and 0.1 deg (exact),")
    print("5 mm and 1 deg (raster).  'view': object not wholly in the image, at the start / later.")
    print("Median and 90th percentile of the final distance [mm] of the flights that lasted.")
    print("object    image   matrix   tilt  success  pose off      view  no twist    median     90%")
    for source in TOLERANCE:
        for choice in InteractionChoice:
            for tilt_deg in TILTS_DEG:
                print_row("default", count_row(source, choice, tilt_deg))
    for tilt_deg in TILTS_DEG:
        row = count_row(ImageSource.RASTER, InteractionChoice.DESIRED, tilt_deg, shape=aligned_object())
        print_row("aligned", row)


if __name__ == "__main__":
    main()
