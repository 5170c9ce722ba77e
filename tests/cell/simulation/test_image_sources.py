"""Three ways to an image of the same scene: closed form, pixel centres, PyBullet's renderer.

Against the closed form the features of both kinds of pixel images have these standard deviations:
0.03 mm sideways, 0.07 mm in height, 1e-3 in gamma and delta, 0.4 mrad in alpha.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
from examples import VISIT, hand, run, scenario

from safety_harness.admission.admit import admit
from safety_harness.admission.poses import start_joint_position
from safety_harness.base.settings import DEFAULTS, DetectorKind, HandSensorKind, ImageSource, Settings
from safety_harness.cell.controller.desired import view_of
from safety_harness.cell.controller.records import overhead_transform_sensor_to_base
from safety_harness.cell.perception.camera import transform_camera_to_tcp
from safety_harness.cell.perception.moments import MOMENT_COUNT
from safety_harness.cell.robot.kinematics import TCP
from safety_harness.cell.robot.robots import arm_model
from safety_harness.cell.servoing.features import features
from safety_harness.cell.simulation.cameras import sensors
from safety_harness.cell.simulation.cell import Bodies, build_cell, place_hands, render, rendered_object
from safety_harness.cell.simulation.engine import pybullet
from safety_harness.cell.simulation.exact_views import exact_object
from safety_harness.cell.simulation.hand_programs import hands_at_start
from safety_harness.cell.simulation.pybullet_world import PyBulletWorld
from safety_harness.scenario.robots import Robot
from tests.cell.robot.arms import transforms_of

Vector = tuple[float, float, float]
CAMERA = DEFAULTS.camera
SIGMA = np.array([3e-5, 3e-5, 7e-5, 1e-3, 1e-3, 4e-4])


def joints_at(offset: Vector, tilt: Vector = (0.0, 0.0, 0.0)) -> np.ndarray:
    return start_joint_position(scenario(offset=offset, tilt=tilt), arm_model(Robot.UR10))


def pose_at(joints: np.ndarray) -> np.ndarray:
    return transforms_of(arm_model(Robot.UR10), joints)[TCP].copy()


def a_dozen() -> list[np.ndarray]:
    rng = np.random.default_rng(4)
    scale = np.array([0.06, 0.12, 0.1])
    return [
        joints_at(tuple(rng.uniform(-1, 1, 3) * scale), tuple(rng.uniform(-0.08, 0.08, 3))) for _ in range(12)
    ]


class Cell:
    """A painted cell in a client of its own, in which the arm is put where it is wanted."""

    def __init__(self) -> None:
        self.client = int(pybullet.connect(pybullet.DIRECT))
        self.bodies: Bodies = build_cell(
            self.client,
            DEFAULTS,
            arm_model(Robot.UR10),
            joints_at((0.0, 0.0, 0.0)),
            rendered=True,
        )

    def put(self, joints: np.ndarray, hands: np.ndarray | None = None) -> np.ndarray:
        """Arm and hands; returns the pose (4, 4) of the TCP."""
        pybullet.resetJointStatesMultiDof(
            self.bodies.robot,
            self.bodies.joints,
            [[q] for q in joints],
            [[0.0]] * 6,
            physicsClientId=self.client,
        )
        place_hands(self.client, self.bodies, nowhere() if hands is None else hands)
        return pose_at(joints)

    def photo(self, camera_to_base: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return render(self.client, camera_to_base, CAMERA.focal_px, CAMERA.width_px, CAMERA.height_px)

    def object_features(self, pose: np.ndarray) -> np.ndarray | None:
        colour, _ = self.photo(pose @ transform_camera_to_tcp(CAMERA, calibrated=False))
        visible, moments = rendered_object(colour, CAMERA.focal_px)
        return six_features(moments) if visible else None


def hands_at(*positions: Vector, towards: Vector = (1.6, -1.2, 0.3)) -> np.ndarray:
    trajectories = [replace(hand(at=position), elbow_towards_in_base_m=towards) for position in positions]
    return hands_at_start(scenario(*trajectories)).state


def nowhere() -> np.ndarray:
    return hands_at((5.0, 5.0, -5.0), (5.0, 6.0, -5.0))


@pytest.fixture(scope="module")
def cell() -> Iterator[Cell]:
    cell = Cell()
    yield cell
    pybullet.disconnect(physicsClientId=cell.client)


def six_features(moments: np.ndarray) -> np.ndarray:
    view, f = view_of(DEFAULTS), np.empty(6)
    assert features(moments, view.area, view.depth_m, view.dense, f)
    return f


def computed_features(source: ImageSource, pose: np.ndarray) -> np.ndarray:
    settings = replace(DEFAULTS, camera=replace(CAMERA, source=source))
    cameras = sensors(settings, 1, 0, overhead_transform_sensor_to_base(settings))
    moments = np.full(MOMENT_COUNT, np.nan)
    assert exact_object(cameras.state, cameras.polygon_in_base_m, pose, moments)
    return six_features(moments)


def assert_unbiased_noise(errors: np.ndarray) -> None:
    """No error above four sigma, the mean of n below four sigma / root n, and some noise at all."""
    assert np.abs(errors / SIGMA).max() < 4.0
    assert np.abs(errors.mean(axis=0) / SIGMA).max() < 4.0 / np.sqrt(len(errors))
    assert (errors.std(axis=0) > 0.1 * SIGMA).all()


def test_sampled_images_agree_with_the_closed_form_but_for_pixel_noise() -> None:
    poses = [pose_at(joints) for joints in a_dozen()]
    exact, raster = (
        np.array([computed_features(source, pose) for pose in poses])
        for source in (ImageSource.EXACT, ImageSource.RASTER)
    )
    assert_unbiased_noise(raster - exact)


def test_rendered_images_agree_with_the_closed_form_but_for_pixel_noise(cell: Cell) -> None:
    """The renderer has the arm in its scene, at its true joint angles."""
    errors = []
    for joints in a_dozen()[::2]:
        rendered = cell.object_features(cell.put(joints))
        assert rendered is not None
        errors.append(rendered - computed_features(ImageSource.EXACT, pose_at(joints)))
    assert_unbiased_noise(np.array(errors))


def test_a_hand_beside_the_object_changes_nothing_and_one_above_it_does(cell: Cell) -> None:
    joints = joints_at((0.0, 0.0, 0.0))
    alone = cell.object_features(cell.put(joints))
    beside = cell.object_features(cell.put(joints, hands_at((0.85, -0.15, -0.1))))
    assert alone is not None
    assert beside is not None
    assert np.array_equal(alone, beside)
    above = cell.object_features(cell.put(joints, hands_at((0.72, 0.03, -0.15), towards=(1.6, 0.0, 0.3))))
    assert above is None or np.abs(above - alone).max() > 0.01
    colour, _ = cell.photo(cell.put(joints) @ transform_camera_to_tcp(CAMERA, calibrated=False))
    with_hand = hands_at((0.85, -0.15, -0.1))
    there, _ = cell.photo(cell.put(joints, with_hand) @ transform_camera_to_tcp(CAMERA, calibrated=False))
    assert (colour != there).any()  # it was in the picture


def test_an_object_out_of_view_is_not_found_in_the_rendered_image(cell: Cell) -> None:
    assert cell.object_features(cell.put(joints_at((0.0, 0.3, 0.0)))) is None


def test_depth_is_along_the_optical_axis_and_infinite_where_nothing_is(cell: Cell) -> None:
    """The table, 1 m below a camera that looks straight down, is 1 m deep in every pixel."""
    pose = cell.put(joints_at((0.0, 0.0, 0.0)))
    down = np.eye(4)
    down[:3, :3], down[:3, 3] = np.diag([1.0, -1.0, -1.0]), (1.5, -0.8, DEFAULTS.cell.table_height_m + 1.0)
    _, depth_m = cell.photo(down)
    assert depth_m == pytest.approx(np.full(depth_m.shape, 1.0005), abs=2e-4)
    up = np.eye(4)
    up[:3, 3] = pose[:3, 3] + (0.5, 0.0, 0.5)
    assert np.isinf(cell.photo(up)[1]).all()


# Hands -----------------------------------------------------------------------------------------------

HANDS: list[Vector] = [
    (0.84, -0.35, 0.25),
    (0.95, -0.55, 0.05),
    (0.55, -0.65, 0.30),
    (0.30, -0.60, 0.10),
    (1.00, 0.30, 0.20),
]


def rendered_detector(kind: HandSensorKind) -> Settings:
    sensor = replace(DEFAULTS.hand_sensor, kind=kind, detector=DetectorKind.RENDERED)
    return replace(DEFAULTS, hand_sensor=sensor)


def boxes_in(settings: Settings, *hands: Vector, source: ImageSource = ImageSource.EXACT) -> np.ndarray:
    """(k, 5) of the first observation of a world; forearms hang down, where they hide no hand."""
    settings = replace(settings, camera=replace(settings.camera, source=source))
    people = [
        replace(hand(at=at), elbow_towards_in_base_m=tuple(np.add(at, (0.5, -0.5, -0.5)))) for at in hands
    ]
    what = scenario(*people, settings=settings, duration_s=0.1)
    admitted = admit(what)
    with PyBulletWorld(what, admitted.arm, admitted.joint_position_rad) as world:
        observation = world.observe()[0]
        return observation["boxes"][: observation["box_count"]].copy()


@pytest.mark.parametrize(
    "position", [*HANDS[:3], *(pytest.param(position, marks=pytest.mark.long) for position in HANDS[3:])]
)
def test_a_rendered_hand_has_the_box_of_the_exact_one(position: Vector) -> None:
    """Centre within 1 px (after half a pixel in c_u and c_v), depth within 3 mm, sides within 2 px."""
    rendered = boxes_in(rendered_detector(HandSensorKind.OVERHEAD), position)
    overhead = replace(DEFAULTS, hand_sensor=replace(DEFAULTS.hand_sensor, kind=HandSensorKind.OVERHEAD))
    exact = boxes_in(overhead, position)
    assert len(rendered) == len(exact) == 1
    shift = (0.5, -0.5)  # rendered less exact principal point
    assert rendered[0, :2] - exact[0, :2] == pytest.approx(shift, abs=1.0)
    assert rendered[0, 2] == pytest.approx(exact[0, 2], abs=3e-3)
    sides = [
        np.sqrt(np.array([area * aspect, area / aspect])) for area, aspect in (rendered[0, 3:], exact[0, 3:])
    ]
    assert sides[0] == pytest.approx(sides[1], abs=2.0)


def test_two_rendered_hands_are_two_boxes() -> None:
    assert len(boxes_in(rendered_detector(HandSensorKind.OVERHEAD), HANDS[0], HANDS[3])) == 2


def test_no_hand_is_no_box() -> None:
    assert len(boxes_in(rendered_detector(HandSensorKind.OVERHEAD))) == 0


def test_of_a_rendered_hand_under_the_wrist_only_a_part_is_seen() -> None:
    """The exact sensor's all or nothing says nothing here (test_sensing); the renderer cuts the box."""
    under = (0.70, 0.02, 0.05)
    (ideal,) = boxes_in(DEFAULTS, under)
    for box in boxes_in(rendered_detector(HandSensorKind.OVERHEAD), under):
        assert box[3] < 0.8 * ideal[3]


def test_a_run_in_which_all_images_are_rendered_perceives_what_the_exact_one_does() -> None:
    """Some ticks of camera and detector on the renderer at 30 Hz; the hand within 10 mm of the exact one."""
    sensor = replace(
        DEFAULTS.hand_sensor, kind=HandSensorKind.OVERHEAD, detector=DetectorKind.RENDERED, rate_hz=30.0
    )
    settings = replace(
        DEFAULTS, camera=replace(CAMERA, source=ImageSource.RENDERED, rate_hz=30.0), hand_sensor=sensor
    )
    trace = run(scenario(VISIT, duration_s=0.15, settings=settings))
    assert trace.complete
    assert trace.ticks["object_visible"].all()
    exact = run(scenario(VISIT, duration_s=0.15)).ticks
    at_frame = [0, 5, 9, 13]
    error = trace.ticks["features"][at_frame] - exact["features"][at_frame]
    assert np.abs(error[:, :3]).max() < 1e-3
    seen = trace.ticks["predicted_hand_in_base_m"][0, 0]
    assert seen == pytest.approx(exact["predicted_hand_in_base_m"][0, 0], abs=1e-2)
