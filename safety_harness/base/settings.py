"""All defaults of the system under test and of its cell, in the frozen object ``DEFAULTS``.

Lengths are in metres, angles in radians, times in seconds, images in pixels.  Positions are in the robot's
base frame (x forward, y left, z up, origin at the foot of the UR10).  A scenario file may replace single
values for its runs, but never changes this object.

Most values were fixed before the first run.  The following values were changed or added later:

* the object's polygon: 4/3 of its first size, so that servoing with raster images reaches 5 mm;
* the object's yaw: 25 degrees in place of 0, chosen after a scan of yaws for the least pixel noise;
* the object's position: right under the camera, which is mounted beside the TCP, for the best conditioning;
* the overhead camera: 0.4 m higher and 0.13 m aside, when the first scenarios were written;
* the full gate: added later, and the default since then.

The first three values were chosen for the convergence of servoing without hands (docs/results/arms.md), and
never for a claim about a hand.
"""

from __future__ import annotations

from dataclasses import dataclass, field, fields, replace
from enum import Enum
from functools import cached_property
from math import pi, radians
from typing import Any, TypeVar

Vector3 = tuple[float, float, float]
HAND_SLOTS = (2, 4, 8)  # the possible numbers of hands that the records of a run have room for
_TURN_RAD = 2.0 * pi
T = TypeVar("T")


def setting(
    default: T,
    meaning: str,
    least: float | None = None,
    most: float | None = None,
    *,
    takes: str = "",
    example: str = "",
) -> T:
    """Return a field with its default and its description for scenario files.

    A value outside the bounds indicates a mistaken unit or an unrealistic system.  Within the bounds, every
    number that a run computes is finite, and the servo loop is stable.  (The largest gain times the longest
    control period is 0.5.)

    Args:
        default: The value that applies if no file states one.
        meaning: The meaning of the value, for the reference of keys.
        least: The smallest allowed value, in SI units.  None means the bound of its dimension (``units``).
        most: The largest allowed value, in SI units.  None means the bound of its dimension.
        takes: A text that states a requirement which the value's type cannot express.
        example: An example for the reference, needed if the default does not show the form.

    """
    description = {"meaning": meaning, "least": least, "most": most, "takes": takes, "example": example}
    return field(default=default, metadata=description)


class ImageSource(Enum):
    """The source of the object's image moments."""

    EXACT = "exact"  # closed-form moments of the projected polygon
    RASTER = "raster"  # the same polygon, sampled at pixel centres
    RENDERED = "rendered"  # PyBullet's renderer, thresholded


class ObjectKind(Enum):
    """The domain over which the moments are summed: a region, or a set of points."""

    DENSE = "dense"
    DISCRETE = "discrete"


class InteractionChoice(Enum):
    """The interaction matrix that the control law inverts."""

    CURRENT = "current"
    DESIRED = "desired"
    MEAN = "mean"


class HandSensorKind(Enum):
    """The sensor that watches the hands."""

    IDEAL = "ideal"  # the overhead camera without field of view, occlusion, noise or delay
    OVERHEAD = "overhead"  # a fixed RGB-D camera over the table
    SURROUND = "surround"  # cameras all around as one: as overhead, and nothing hides a hand from it
    EYE_IN_HAND = "eye in hand"  # the servoing camera itself: blind outside its field of view


class DetectorKind(Enum):
    """The method that turns the sensor's view into bounding boxes."""

    EXACT = "exact"  # geometry of the projected sphere, with occlusion by the robot
    RENDERED = "rendered"  # the rendered colour and depth images


class GateKind(Enum):
    """The checks that a repulsive position must pass before the arm moves there."""

    REACH = "reach"  # finite, reachable, above the table: the plain system
    FULL = "full"  # also certain, reachable with margin, away from every hand, clear of the arm itself


@dataclass(frozen=True, kw_only=True)
class Cell:
    """The table and the desired pose.

    The defaults form a workspace in which the arm can reach every TCP start.
    ``preferred_joint_position_rad`` selects the branch of the inverse kinematics for the start, by default
    with the elbow up.
    """

    table_height_m: float = setting(-0.300, "z of the table", -2.0, 2.0)
    desired_tcp_position_in_base_m: Vector3 = setting((0.700, 0.0, 0.350), "where the servoing should end")
    preferred_joint_position_rad: tuple[float, ...] = setting(
        (-0.22, -1.27, 1.98, -2.27, -1.57, -1.79),
        "a start by `offset` takes the joint angles nearest to it; as many as the arm has joints",
    )


@dataclass(frozen=True, kw_only=True)
class Object:
    """The object that the arm servos to.

    The object is a flat polygon in its own frame, and the settings also state the pose of that frame.  If the
    TCP is at the desired position, the object is right below the camera by default.  The object is then 45 mm
    beside the TCP.  If the object were not at the image's centre, the condition number of the interaction
    matrix would be 28.6 instead of 15.9.
    """

    # Close to a 3-4-5 right triangle, the best conditioned shape, with its centroid at the origin;
    # at two thirds of the size, servoing with raster images does not reach 5 mm (docs/results/arms.md).
    polygon_m: tuple[tuple[float, float], ...] = setting(
        ((-0.053, -0.040), (0.106, -0.040), (-0.053, 0.080)),
        "outline in the object's own frame, one corner after another; convex for rendered images",
        -1.0,
        1.0,
    )
    position_in_base_m: Vector3 = setting((0.700, 0.045, -0.300), "of the object's own origin")
    # No edge along the pixel rows or columns at the desired pose: a whole row of pixels would flip
    # at once, and the pixel noise of gamma would be three times as large.
    yaw_rad: float = setting(radians(25.0), "turn about the vertical", -_TURN_RAD, _TURN_RAD)


@dataclass(frozen=True, kw_only=True)
class Camera:
    """The eye-in-hand camera: a pinhole with the colour intrinsics of an Intel RealSense D435, undistorted.

    ``transform_camera_to_tcp`` is a rotation by ``mount_yaw_rad`` about the tool axis and a shift by
    ``mount_offset_in_tcp_m``.  The two ``calibration_error`` values are the *controller's* errors relative to
    the true mount.  One error is a rotation vector in the camera frame, and the other error is a shift in the
    TCP frame.  Zero means a perfect hand-eye calibration.
    """

    width_px: int = setting(640, "of the image", 16, 4096)
    height_px: int = setting(480, "of the image", 16, 4096)
    focal_px: float = setting(615.0, "focal length", 50.0, 20_000.0)
    mount_yaw_rad: float = setting(
        pi / 2, "turn of the true mount about the tool axis", -_TURN_RAD, _TURN_RAD
    )
    mount_offset_in_tcp_m: Vector3 = setting(
        (0.0, -0.045, 0.0), "shift of the true mount, in the TCP frame", -1.0, 1.0
    )
    calibration_error_rotation_rad: Vector3 = setting((0.0, 0.0, 0.0), "in the camera frame")
    calibration_error_offset_m: Vector3 = setting((0.0, 0.0, 0.0), "in the TCP frame", -1.0, 1.0)
    source: ImageSource = setting(ImageSource.EXACT, "where the object's moments come from")
    # None: an image at every control tick
    rate_hz: float | None = setting(None, "of the images; at most the rate of the control ticks")
    latency_s: float = setting(0.0, "from the image to the controller", 0.0, 10.0)


@dataclass(frozen=True, kw_only=True)
class HandSensor:
    """The camera that watches the hands, with its errors.

    The depth noise of a stereo camera grows with the square of the depth z: sigma_z = ``depth_noise_per_m``
    z^2.  For a D435 the factor is 0.0025/m.  This follows from 0.08 px subpixel error, 640 px focal length
    and 50 mm baseline (Intel's depth-quality formula).
    """

    kind: HandSensorKind = setting(
        HandSensorKind.IDEAL,
        "`ideal` is the overhead camera without field of view, occlusion, noise and delay, and "
        "refuses the keys for them; `surround` stands for cameras all around, with noise and delay, but "
        "without field of view and occlusion; `eye in hand` has the servoing camera's optics and is blind "
        "outside its view",
        example="hand sensor: {kind: eye in hand}",
    )
    detector: DetectorKind = setting(DetectorKind.EXACT, "from geometry, or from rendered images")
    overhead_position_in_base_m: Vector3 = setting(
        (0.750, -0.250, 1.800),
        "where the overhead camera hangs, looking straight down; all kinds except `eye in hand` see a "
        "hand only if it is at least its radius below",
    )
    width_px: int = setting(640, "of the image", 16, 4096)
    height_px: int = setting(480, "of the image", 16, 4096)
    focal_px: float = setting(615.0, "focal length", 50.0, 20_000.0)
    pixel_noise_px: float = setting(0.0, "standard deviation of the box's place", 0.0, 100.0)
    depth_noise_per_m: float = setting(
        0.0, "standard deviation of the depth, divided by the depth squared", 0.0, 1.0
    )
    dropout_probability: float = setting(0.0, "how probable it is that an image shows no hand")
    rate_hz: float | None = setting(None, "of the images; at most the rate of the control ticks")
    latency_s: float = setting(0.0, "from the image to the controller", 0.0, 10.0)


@dataclass(frozen=True, kw_only=True)
class HandFilter:
    """The Kalman filter of eq. 7, and the tracking of hands with it."""

    prediction_horizon_s: float = setting(0.1, "how far ahead the hand is predicted", 0.0, 2.0)
    measurement_std_px: float = setting(2.0, "assumed error of the box's place")
    measurement_std_depth_m: float = setting(0.005, "assumed error of the depth")
    measurement_std_area_px2: float = setting(400.0, "assumed error of the box's area")
    measurement_std_aspect: float = setting(0.05, "assumed error of the box's aspect ratio")
    acceleration_std_pxps2: float = setting(3000.0, "assumed motion of the hand")
    acceleration_std_depth_mps2: float = setting(5.0, "assumed motion along the view")
    area_rate_std_px2ps: float = setting(2.0e4, "assumed change of the area, per root second")
    initial_speed_std_pxps: float = setting(1000.0, "of a hand that has just been seen")
    initial_speed_std_depth_mps: float = setting(2.0, "the same along the view")
    gate_px: float = setting(150.0, "how far a box may be from a track to belong to it")
    track_timeout_s: float = setting(0.5, "how long a track lives without a box")
    assumed_hand_radius_m: float = setting(0.060, "what the controller takes the hand for", 0.01, 0.3)


@dataclass(frozen=True, kw_only=True)
class Servo:
    """Image-based visual servoing, eqs. 1 to 5 and 15 of the paper."""

    object_kind: ObjectKind = setting(ObjectKind.DENSE, "moments over a region, or over points")
    interaction: InteractionChoice = setting(
        InteractionChoice.DESIRED, "the interaction matrix that is inverted"
    )
    gain_far: float = setting(0.4, "lambda, per second, before the gain switch", 1e-3, 10.0)
    gain_near: float = setting(0.1, "lambda, per second, after it", 1e-3, 10.0)
    gain_switch_sse: float = setting(
        0.005, "the squared feature error at which the gain switches", 1e-9, 10.0
    )  # |f - f*|^2; its root is 70.7 mm when upright


@dataclass(frozen=True, kw_only=True)
class Motion:
    """The limits on the controller's commands to the arm.

    The trace shows each limit that was active.
    """

    max_tcp_speed_mps: float = setting(0.25, "that the controller may demand")
    max_tcp_acceleration_mps2: float = setting(1.0, "that the controller may demand")
    max_tcp_angular_speed_radps: float = setting(0.5, "that the controller may demand")
    max_tcp_angular_acceleration_radps2: float = setting(2.0, "that the controller may demand")
    min_singular_value: float = setting(0.02, "of the Jacobian; below it the arm is stopped", 1e-4, 1.0)


class DecisionCost(Enum):
    """The rule for the simulated time of a decision, if the scenario states no decision times."""

    AS_DECLARED = "as declared"  # by the avoider; an avoider that declares nothing costs nothing
    WALL_CLOCK = "wall clock"  # the time of the answer on this machine; such a run does not repeat


@dataclass(frozen=True, kw_only=True)
class Measured:
    """The origin of a measured profile of decision times.

    The profile is valid for one avoider, and was measured on one machine.
    """

    avoider: str  # as a scenario names it
    sha256: str  # of its file; empty for one without
    machine: str
    questions: int


@dataclass(frozen=True, kw_only=True)
class DecisionTimes:
    """The simulated time that a decision takes, which is drawn anew for each decision.

    ``quantiles_s`` are in rising order, and the interval between two neighbouring quantiles always has the
    same probability.  A single value means a constant time, and two values mean a uniform distribution.
    """

    quantiles_s: tuple[float, ...]
    measured: Measured | None = None

    @property
    def most_s(self) -> float:
        """The longest decision time, or 0 if decisions take no time."""
        return self.quantiles_s[-1]


@dataclass(frozen=True, kw_only=True)
class Avoidance:
    """The conditions and parameters of the TCP's retreat (sections 3.3 and 4.1 of the paper)."""

    critical_distance_m: float = setting(
        0.400, "from the TCP to a predicted hand; zero is no avoidance at all", 0.0, 3.0
    )
    radius_m: float = setting(0.100, "how far away a repulsive position is", 1e-3, 2.0)
    repulsion_speed_mps: float = setting(0.25, "on the way to it")
    repulsion_acceleration_mps2: float = setting(1.0, "on the way to it")
    arrival_tolerance_m: float = setting(0.001, "when it counts as reached", 1e-5, 0.05)
    candidate_count: int = setting(100, "candidates of the nearest-candidate avoider", 1, 10_000)
    candidate_sigma_rad: float = setting(pi / 4, "their spread in azimuth and elevation")
    # A 60-degree cone is exactly a quarter of the sphere; for a narrow cone, nearly all draws are rejected.
    candidate_cone_rad: float = setting(pi / 3, "the cone that they are cut to", radians(5.0), pi)
    nominal_hand_position_in_base_m: Vector3 = setting(
        (0.840, -0.350, 0.005), "the hand that the cone points away from"
    )
    hand_pull: float = setting(0.05, "the factor of eq. 13 of the paper", 0.0, 1.0)
    gate: GateKind = setting(
        GateKind.FULL,
        "what is checked before a position is used ([avoiders](reference/controller.md#the-gate)); "
        "`reach` is the plain system",
    )
    table_clearance_m: float = setting(0.050, "the TCP is never sent nearer to the table")
    # An avoider that takes longer has not answered: the answer must fit into the system's reaction time.
    decision_deadline_s: float = setting(0.1, "a later answer, in simulated time, counts as missing")
    decision_time: DecisionCost | DecisionTimes = setting(
        DecisionCost.AS_DECLARED,
        "what a decision costs in simulated time, or an answer of your controller, drawn anew for each; as "
        "the avoider declares it ([avoiders](how-to/avoider.md#computing-time), "
        "[controllers](how-to/controller.md#how-long-it-computes))",
        example="settings: {avoidance: {decision time: 40 ms}}",
    )
    restart_delay_s: float = setting(
        0.5,
        "how long hands must be away before a stop is released",
        takes="time, at least as long as a stop takes",
    )


@dataclass(frozen=True, kw_only=True)
class Hand:
    """The shape of a hand.

    The hand is a sphere, and the forearm is a capsule from the hand's centre to the elbow.
    """

    radius_m: float = setting(0.060, "of the sphere that is the hand", 0.01, 0.3)
    forearm_radius_m: float = setting(0.045, "of the capsule that is the forearm", 0.01, 0.3)
    forearm_length_m: float = setting(0.300, "from the hand's centre, where no elbow was recorded", 0.01, 1.0)


@dataclass(frozen=True, kw_only=True)
class Braking:
    """A protective stop: a reaction time, then uniform braking that takes T_s(v) = base + slope v.

    v is the TCP's speed.  The defaults follow the worst-case stop times in the UR10 CB3 manual: 450, 500 and
    550 ms at 1.0, 1.5 and 2.0 m/s.  These times lie on the straight line 0.35 s + 0.1 s^2/m v.
    """

    reaction_time_s: float = setting(0.1, "before a protective stop begins to brake", 0.0, 5.0)
    stop_time_base_s: float = setting(0.35, "braking time, however slow the TCP is", 0.0, 5.0)
    stop_time_per_speed_s2pm: float = setting(0.1, "further time for each m/s of TCP speed", 0.0, 10.0)


@dataclass(frozen=True, kw_only=True)
class Clock:
    """The control period, the number of physics steps in each control period, and the time limit for answers.

    The UR10 accepts a new speed at 125 Hz, and the physics steps divide this period.  If an avoider does not
    answer within ``wall_limit_s``, the run ends.  This limit never affects a trajectory.
    """

    # At most 50 ms, because the arm is assumed to move evenly between two ticks.
    control_period_s: float = setting(0.008, "from one speed command to the next", 1e-3, 0.05)
    physics_substeps: int = setting(4, "steps of the physics in one control period", 1, 100)
    wall_limit_s: float = setting(
        30.0, "an avoider that takes longer in real time ends the run, which has failed", 0.1, 3600.0
    )


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

    @cached_property
    def _hash(self) -> int:
        """The hash of all settings, computed only once."""
        return hash(tuple(getattr(self, part.name) for part in fields(self)))

    def __hash__(self) -> int:  # stored: admission asks for it several times a scenario
        return self._hash

    def __getstate__(self) -> dict[str, Any]:  # without the stored hash: hashes of text differ by process
        return {part.name: getattr(self, part.name) for part in fields(self)}

    @cached_property
    def steady(self) -> Settings:
        """A copy of these settings, in which the hand sensor has no noise and no delay.

        The scenarios of a space may differ in noise and delay.  Therefore a computation that ignores noise
        and delay can reuse its result for all scenarios of a space.
        """
        hand_sensor = replace(
            self.hand_sensor,
            pixel_noise_px=0.0,
            depth_noise_per_m=0.0,
            dropout_probability=0.0,
            rate_hz=None,
            latency_s=0.0,
        )
        return replace(self, hand_sensor=hand_sensor)


DEFAULTS = Settings()

# Servoing has converged below these errors; Servo.gain_switch_sse is the gain switch's image threshold.
CONVERGED_POSITION_M = 0.001
CONVERGED_ANGLE_RAD = radians(0.1)
