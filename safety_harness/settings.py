"""Every default of the system under test and of its cell, in one frozen object: ``DEFAULTS``.

Lengths in metres, angles in radians, times in seconds, images in pixels; positions in the robot's
base frame (x forward, y left, z up, origin at the foot of the UR10).  A scenario file may change
single values; it never changes this object.

The numbers were written down before anything had been run.  Those that changed afterwards, and why:

* the object's polygon: 4/3 of its first size, for raster images to servo to 5 mm;
* its yaw, 25 degrees in place of 0: chosen after a scan of yaws, for the least pixel noise;
* its position: right under the camera, which sits beside the TCP, for the best conditioning;
* the overhead camera: 0.4 m higher and 0.13 m aside, with the first scenarios;
* the full gate: a later addition, and the default since.

The first three were judged by how servoing without hands converges (docs/servoing.md), not by any
claim about a hand.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import Enum
from math import pi, radians

Vector3 = tuple[float, float, float]


class ImageSource(Enum):
    """Where the image moments of the object come from."""

    EXACT = "exact"  # closed-form moments of the projected polygon
    RASTER = "raster"  # the same polygon, sampled at pixel centres
    RENDERED = "rendered"  # PyBullet's renderer, thresholded


class ObjectKind(Enum):
    """What the moments are sums over: a region, or a set of points."""

    DENSE = "dense"
    DISCRETE = "discrete"


class InteractionChoice(Enum):
    """Which interaction matrix the control law inverts."""

    CURRENT = "current"
    DESIRED = "desired"
    MEAN = "mean"


class HandSensorKind(Enum):
    """Which sensor watches the hands."""

    IDEAL = "ideal"  # the overhead camera without field of view, occlusion, noise or delay
    OVERHEAD = "overhead"  # a fixed RGB-D camera over the table
    EYE_IN_HAND = "eye in hand"  # the servoing camera itself: blind outside its field of view


class DetectorKind(Enum):
    """What turns the sensor's view into bounding boxes."""

    EXACT = "exact"  # geometry of the projected sphere, with occlusion by the robot
    RENDERED = "rendered"  # the rendered colour and depth images


class GateKind(Enum):
    """How much the gate asks of a repulsive position before the arm goes there."""

    REACH = "reach"  # finite, reachable, above the table: the plain system
    FULL = "full"  # also certain, reachable with margin, away from every hand, clear of the arm itself


@dataclass(frozen=True, kw_only=True)
class Cell:
    """Table and desired pose: a workspace in which every TCP start can be reached.

    ``preferred_joint_position_rad`` picks the inverse-kinematics branch of a start: elbow up.
    """

    table_height_m: float = -0.300
    desired_tcp_position_in_base_m: Vector3 = (0.700, 0.0, 0.350)
    preferred_joint_position_rad: tuple[float, ...] = (-0.22, -1.27, 1.98, -2.27, -1.57, -1.79)


@dataclass(frozen=True, kw_only=True)
class Object:
    """What is servoed on: a flat polygon, in its own frame, and where it lies.

    By default right under the camera of the desired TCP, which is 45 mm beside the TCP: off the
    image's centre the interaction matrix is worse conditioned (28.6 instead of 15.9).
    """

    # Close to a 3-4-5 right triangle, the best conditioned shape, with its centroid at the origin;
    # at two thirds of the size raster images do not servo to 5 mm (docs/servoing.md).
    polygon_m: tuple[tuple[float, float], ...] = ((-0.053, -0.040), (0.106, -0.040), (-0.053, 0.080))
    position_in_base_m: Vector3 = (0.700, 0.045, -0.300)
    # No edge along the pixel rows or columns at the desired pose: a whole row of pixels would flip
    # at once, and the pixel noise of gamma would be three times as large.
    yaw_rad: float = radians(25.0)


@dataclass(frozen=True, kw_only=True)
class Camera:
    """The eye-in-hand camera: Intel RealSense D435 colour intrinsics, pinhole, no distortion.

    ``transform_camera_to_tcp`` is a turn by ``mount_yaw_rad`` about the tool axis and a shift by
    ``mount_offset_in_tcp_m``.  The two ``calibration_error`` values are what the *controller*
    believes wrongly on top of the true mount (a rotation vector in the camera frame, a shift in
    the TCP frame); zero means a perfect hand-eye calibration.
    """

    width_px: int = 640
    height_px: int = 480
    focal_px: float = 615.0
    mount_yaw_rad: float = pi / 2
    mount_offset_in_tcp_m: Vector3 = (0.0, -0.045, 0.0)
    calibration_error_rotation_rad: Vector3 = (0.0, 0.0, 0.0)
    calibration_error_offset_m: Vector3 = (0.0, 0.0, 0.0)
    source: ImageSource = ImageSource.EXACT
    rate_hz: float | None = None  # None: an image at every control tick
    latency_s: float = 0.0


@dataclass(frozen=True, kw_only=True)
class HandSensor:
    """The camera that watches the hands, and how it errs.

    Depth noise of a stereo camera grows with the square of the depth:
    sigma_z = ``depth_noise_per_m`` z^2; 0.0025/m is a D435 with 0.08 px subpixel error,
    640 px focal length and 50 mm baseline (Intel's depth-quality formula).
    """

    kind: HandSensorKind = HandSensorKind.IDEAL
    detector: DetectorKind = DetectorKind.EXACT
    overhead_position_in_base_m: Vector3 = (0.750, -0.250, 1.800)  # looks straight down
    width_px: int = 640
    height_px: int = 480
    focal_px: float = 615.0
    pixel_noise_px: float = 0.0
    depth_noise_per_m: float = 0.0
    dropout_probability: float = 0.0
    rate_hz: float | None = None
    latency_s: float = 0.0


@dataclass(frozen=True, kw_only=True)
class HandFilter:
    """The Kalman filter of eq. 7 and the tracks that it serves."""

    prediction_horizon_s: float = 0.1
    measurement_std_px: float = 2.0
    measurement_std_depth_m: float = 0.005
    measurement_std_area_px2: float = 400.0
    measurement_std_aspect: float = 0.05
    acceleration_std_pxps2: float = 3000.0
    acceleration_std_depth_mps2: float = 5.0
    area_rate_std_px2ps: float = 2.0e4  # random walk of the area's rate, per root second
    initial_speed_std_pxps: float = 1000.0
    initial_speed_std_depth_mps: float = 2.0
    gate_px: float = 150.0
    track_timeout_s: float = 0.5
    assumed_hand_radius_m: float = 0.060


@dataclass(frozen=True, kw_only=True)
class Servo:
    """Image-based visual servoing, eqs. 1 to 5 and 15 of the paper."""

    object_kind: ObjectKind = ObjectKind.DENSE
    interaction: InteractionChoice = InteractionChoice.DESIRED
    gain_far: float = 0.4  # [1/s]
    gain_near: float = 0.1  # [1/s]
    gain_switch_sse: float = 0.005  # |f - f*|^2; its root is 70.7 mm when upright


@dataclass(frozen=True, kw_only=True)
class Motion:
    """Limits on what the controller may demand of the arm; each acts visibly in the trace."""

    max_tcp_speed_mps: float = 0.25
    max_tcp_acceleration_mps2: float = 1.0
    max_tcp_angular_speed_radps: float = 0.5
    max_tcp_angular_acceleration_radps2: float = 2.0
    min_singular_value: float = 0.02  # of the geometric Jacobian; below it the arm is stopped


class DecisionCost(Enum):
    """What a decision costs in simulated time, where no time is given for it."""

    AS_DECLARED = "as declared"  # by the avoider; one that declares nothing costs nothing
    WALL_CLOCK = "wall clock"  # what the answer took on this machine: such a run does not repeat


@dataclass(frozen=True, kw_only=True)
class Measured:
    """Of which avoider the times of a profile are, and where they were measured."""

    avoider: str  # as a scenario names it
    sha256: str  # of its file; empty for one without
    machine: str
    questions: int


@dataclass(frozen=True, kw_only=True)
class DecisionTimes:
    """What a decision costs in simulated time, drawn anew for each.

    ``quantiles_s`` rise, and what lies between two neighbours is equally probable: one is always the
    same time, two are a uniform distribution.
    """

    quantiles_s: tuple[float, ...]
    measured: Measured | None = None


@dataclass(frozen=True, kw_only=True)
class Avoidance:
    """When and how the TCP gives way (sections 3.3 and 4.1 of the paper)."""

    critical_distance_m: float = 0.400
    radius_m: float = 0.100
    repulsion_speed_mps: float = 0.25
    repulsion_acceleration_mps2: float = 1.0
    arrival_tolerance_m: float = 0.001
    candidate_count: int = 100
    candidate_sigma_rad: float = pi / 4
    candidate_cone_rad: float = pi / 3  # a 60-degree cone is exactly a quarter of the sphere
    nominal_hand_position_in_base_m: Vector3 = (0.840, -0.350, 0.005)
    hand_pull: float = 0.05  # the factor of eq. 13
    gate: GateKind = GateKind.FULL
    table_clearance_m: float = 0.050  # the TCP is never sent lower than this above the table
    # An avoider that takes longer has not answered: the system's reaction time, in which all has to fit.
    decision_deadline_s: float = 0.1
    decision_time: DecisionCost | DecisionTimes = DecisionCost.AS_DECLARED
    restart_delay_s: float = 0.5  # how long the hands must be away before a stop is released


@dataclass(frozen=True, kw_only=True)
class Hand:
    """A hand is a sphere; its forearm a capsule from the hand's centre towards the elbow."""

    radius_m: float = 0.060
    forearm_radius_m: float = 0.045
    forearm_length_m: float = 0.300


@dataclass(frozen=True, kw_only=True)
class Braking:
    """A protective stop: reaction time, then uniform braking within T_s(v) = base + slope v.

    Defaults are the worst-case stop times of the UR10 CB3 manual, 450, 500 and 550 ms at 1.0,
    1.5 and 2.0 m/s, which lie on the straight line 0.35 s + 0.1 s^2/m v.
    """

    reaction_time_s: float = 0.1
    stop_time_base_s: float = 0.35
    stop_time_per_speed_s2pm: float = 0.1


@dataclass(frozen=True, kw_only=True)
class Clock:
    """The UR10 takes a new speed at 125 Hz; physics sub-steps divide the control period.

    ``wall_limit_s`` ends a run whose avoider hangs; it changes no trajectory.
    """

    control_period_s: float = 0.008
    physics_substeps: int = 4
    wall_limit_s: float = 30.0


@dataclass(frozen=True, kw_only=True)
class Settings:
    """All settings of one run."""

    clock: Clock = field(default_factory=Clock)
    cell: Cell = field(default_factory=Cell)
    object: Object = field(default_factory=Object)
    camera: Camera = field(default_factory=Camera)
    hand: Hand = field(default_factory=Hand)
    hand_sensor: HandSensor = field(default_factory=HandSensor)
    hand_filter: HandFilter = field(default_factory=HandFilter)
    servo: Servo = field(default_factory=Servo)
    motion: Motion = field(default_factory=Motion)
    avoidance: Avoidance = field(default_factory=Avoidance)
    braking: Braking = field(default_factory=Braking)


DEFAULTS = Settings()

# What counts as converged; the image threshold of the gain switch is Servo.gain_switch_sse.
CONVERGED_POSITION_M = 0.001
CONVERGED_ANGLE_RAD = radians(0.1)
