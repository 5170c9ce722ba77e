from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import pybullet
import pytest
from numpy.typing import NDArray

from safety_harness.base.exceptions import SimulationError
from safety_harness.cell.perception.detector import (
    HAND_COLOUR_RGBA,
    MINIMUM_AREA_PX,
    SLEEVE_COLOUR_RGBA,
    BoundingBoxDetector,
    SkinColourDetector,
    copy_detections,
)
from safety_harness.cell.perception.hand_boxes import rendered_principal_point_px, sphere_box

FOCAL, NEAR_M, FAR_M = 615.0, 0.05, 4.0
RADIUS = 0.06
DETECTOR: BoundingBoxDetector = SkinColourDetector()
SKIN = tuple(int(255 * share) for share in HAND_COLOUR_RGBA[:3])


def round_mesh(radius_m: float) -> tuple[list[list[float]], list[int]]:
    """A finely divided sphere: PyBullet's own is a polyhedron several pixels too narrow."""
    rings, sectors = 40, 80
    polar, azimuth = np.meshgrid(
        np.linspace(0, np.pi, rings + 1), np.linspace(0, 2 * np.pi, sectors, endpoint=False), indexing="ij"
    )
    directions = (np.sin(polar) * np.cos(azimuth), np.sin(polar) * np.sin(azimuth), np.cos(polar))
    vertices = radius_m * np.stack(directions, axis=-1).reshape(-1, 3)
    index = np.arange((rings + 1) * sectors).reshape(rings + 1, sectors)
    a, b = index[:-1], np.roll(index[:-1], -1, axis=1)
    c, d = index[1:], np.roll(index[1:], -1, axis=1)
    triangles = np.stack([a, c, b, b, c, d], axis=-1)
    return vertices.tolist(), triangles.ravel().tolist()


@dataclass
class Scene:
    """Things in the camera's own frame (x right, y down, z forward), and a camera there."""

    client: int

    def add(self, shape: int, rgba: tuple[float, ...], position: tuple[float, ...], **kwargs: object) -> int:
        visual = pybullet.createVisualShape(shape, rgbaColor=rgba, physicsClientId=self.client, **kwargs)
        return int(pybullet.createMultiBody(0, -1, visual, position, physicsClientId=self.client))

    def add_hand(self, position: tuple[float, ...]) -> int:
        vertices, indices = round_mesh(RADIUS)
        return self.add(
            pybullet.GEOM_MESH,
            HAND_COLOUR_RGBA,
            position,
            vertices=vertices,
            indices=indices,
            normals=vertices,
        )

    def move(self, body: int, position: NDArray[np.float64]) -> None:
        pybullet.resetBasePositionAndOrientation(body, position, (0, 0, 0, 1), physicsClientId=self.client)

    def render(self, width: int = 640, height: int = 480) -> tuple[NDArray[np.uint8], NDArray[np.float64]]:
        focal_px = FOCAL * width / 640
        projection = np.zeros((4, 4))
        projection[0, 0], projection[1, 1] = 2 * focal_px / width, 2 * focal_px / height
        projection[2, 2] = -(FAR_M + NEAR_M) / (FAR_M - NEAR_M)
        projection[2, 3] = -2 * FAR_M * NEAR_M / (FAR_M - NEAR_M)
        projection[3, 2] = -1.0
        _, _, colour, buffer, _ = pybullet.getCameraImage(
            width,
            height,
            np.diag([1.0, -1.0, -1.0, 1.0]).ravel().tolist(),  # OpenGL looks along -z with y up
            projection.T.ravel().tolist(),
            renderer=pybullet.ER_TINY_RENDERER,
            shadow=0,
            physicsClientId=self.client,
        )
        colour = np.asarray(colour, np.uint8).reshape(height, width, 4)[..., :3]
        buffer = np.asarray(buffer, np.float64).reshape(height, width)
        return np.ascontiguousarray(colour), FAR_M * NEAR_M / (FAR_M - (FAR_M - NEAR_M) * buffer)


@pytest.fixture
def scene() -> Iterator[Scene]:
    client = pybullet.connect(pybullet.DIRECT)
    yield Scene(client)
    pybullet.disconnect(client)


def expected_box(position: NDArray[np.float64], c_u: float, c_v: float) -> NDArray[np.float64]:
    box = np.empty(5)
    assert sphere_box(position, RADIUS, FOCAL, c_u, c_v, box)
    return box


def width_and_height(box: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.array([np.sqrt(box[3] * box[4]), np.sqrt(box[3] / box[4])])


def random_positions(count: int, seed: int) -> NDArray[np.float64]:
    rng = np.random.default_rng(seed)
    depth_m = rng.uniform(0.4, 1.6, count)
    return (
        np.stack([rng.uniform(-0.4, 0.4, count), rng.uniform(-0.27, 0.27, count), np.ones(count)], 1)
        * (depth_m[:, None])
    )


def test_a_rendered_hand_has_the_box_of_its_sphere(scene: Scene) -> None:
    """Noise of sampling: below one pixel in place and size, below 1 mm in depth."""
    hand = scene.add_hand((0, 0, 1))
    centre_errors = []
    for position in random_positions(25, seed=1):
        scene.move(hand, position)
        boxes = DETECTOR.detect(*scene.render())
        assert boxes.shape == (1, 5)
        box, expected = boxes[0], expected_box(position, *rendered_principal_point_px(640, 480))
        assert np.abs(box[:2] - expected[:2]).max() < 1.0
        assert np.abs(width_and_height(box) - width_and_height(expected)).max() < 1.5
        assert abs(box[2] - expected[2]) < 0.001
        centre_errors.append(box[:2] - expected[:2])
    # The mean error tells the renderer's principal point from the exact one, half a pixel away.
    assert np.abs(np.mean(centre_errors, axis=0)).max() < 0.15


def test_the_renderer_has_its_own_principal_point_at_odd_sizes_too(scene: Scene) -> None:
    width, height = 161, 121
    hand = scene.add_hand((0, 0, 1))
    c_u, c_v = rendered_principal_point_px(width, height)
    errors = []
    for position in random_positions(25, seed=2):
        scene.move(hand, position)
        box = DETECTOR.detect(*scene.render(width, height))[0]
        exact = np.empty(5)
        assert sphere_box(position, RADIUS, FOCAL * width / 640, c_u, c_v, exact)
        errors.append(box[:2] - exact[:2])
    assert np.abs(np.mean(errors, axis=0)).max() < 0.15


def test_only_hands_are_found_among_arm_sleeve_table_and_object(scene: Scene) -> None:
    positions = np.array([[0.15, 0.05, 1.0], [-0.2, -0.1, 1.1]])
    hands = [scene.add_hand(tuple(position)) for position in positions]
    scene.add(pybullet.GEOM_BOX, (0.92, 0.90, 0.86, 1), (0, 0, 1.5), halfExtents=(1.5, 1.5, 0.01))
    scene.add(pybullet.GEOM_BOX, (0.03, 0.03, 0.03, 1), (0, 0.2, 1.48), halfExtents=(0.06, 0.06, 0.005))
    scene.add(pybullet.GEOM_CYLINDER, (0.55, 0.62, 0.72, 1), (0.0, -0.2, 0.9), radius=0.05, length=0.3)
    scene.add(pybullet.GEOM_CYLINDER, (0.6, 0.6, 0.6, 1), (0.3, -0.2, 0.9), radius=0.05, length=0.3)
    for position in positions:  # the forearm leads away behind the hand
        scene.add(
            pybullet.GEOM_CAPSULE,
            SLEEVE_COLOUR_RGBA,
            tuple(position + np.array([0, 0, 0.15])),
            radius=0.045,
            length=0.3,
        )
    boxes = DETECTOR.detect(*scene.render())
    assert len(boxes) == len(hands)
    for position in positions:
        expected = expected_box(position, *rendered_principal_point_px(640, 480))
        assert np.abs(boxes[:, :2] - expected[:2]).max(axis=1).min() < 1.0


def test_no_hand_gives_no_boxes(scene: Scene) -> None:
    scene.add(pybullet.GEOM_CAPSULE, SLEEVE_COLOUR_RGBA, (0, 0, 1), radius=0.045, length=0.3)
    assert DETECTOR.detect(*scene.render()).shape == (0, 5)


def painted(*rectangles: tuple[int, int, int, int]) -> tuple[NDArray[np.uint8], NDArray[np.float64]]:
    """Skin-coloured rectangles (left, top, width, height) at 1 m before a grey wall at 3 m."""
    colour, depth_m = np.full((120, 160, 3), 128, np.uint8), np.full((120, 160), 3.0)
    for left, top, width, height in rectangles:
        colour[top : top + height, left : left + width] = SKIN
        depth_m[top : top + height, left : left + width] = 1.0
    return colour, depth_m


def test_box_of_a_painted_rectangle_is_exact() -> None:
    (box,) = DETECTOR.detect(*painted((10, 20, 30, 15)))
    # Pixel centres 10 .. 39 and 20 .. 34.
    assert list(box) == [np.arange(10, 40).mean(), np.arange(20, 35).mean(), 1.0, 450.0, 2.0]


def test_the_four_largest_areas_are_kept_and_specks_are_not() -> None:
    sizes = [8, 16, 12, 10, 14]
    boxes = DETECTOR.detect(*painted(*((30 * k, 10, size, size) for k, size in enumerate(sizes))))
    assert [np.sqrt(box[3]) for box in boxes] == [16, 14, 12, 10]
    side = int(np.sqrt(MINIMUM_AREA_PX - 1))
    assert len(DETECTOR.detect(*painted((10, 10, side, side)))) == 0


@pytest.mark.parametrize("unknown", [0.0, np.nan, np.inf])
def test_depth_comes_from_the_hand_even_if_its_middle_has_none(unknown: float) -> None:
    colour, depth_m = painted((10, 20, 31, 31))
    depth_m[30:41, 20:31] = unknown
    assert DETECTOR.detect(colour, depth_m)[0, 2] == 1.0
    depth_m[:] = unknown
    assert len(DETECTOR.detect(colour, depth_m)) == 0


def test_depth_comes_from_the_hand_and_not_from_what_hides_its_middle() -> None:
    colour, depth_m = painted((10, 20, 31, 31))
    colour[30:41, 20:31] = (60, 60, 60)
    depth_m[30:41, 20:31] = 0.5
    (box,) = DETECTOR.detect(colour, depth_m)
    assert list(box[:3]) == [25.0, 35.0, 1.0]


def test_one_wrong_depth_in_the_middle_does_not_matter() -> None:
    colour, depth_m = painted((10, 20, 31, 31))
    depth_m[35, 25] = 0.2
    assert DETECTOR.detect(colour, depth_m)[0, 2] == 1.0


def test_copied_detections_are_the_largest_usable_ones_in_order() -> None:
    rows = np.array([[k, 0.0, 1.0, area, 1.0] for k, area in enumerate([5.0, 1.0, 9.0, 7.0, 8.0, 99.0])])
    rows[5, 2] = np.nan
    out = np.zeros((4, 5))
    assert copy_detections(rows, out) == 4
    assert list(out[:, 0]) == [0, 2, 3, 4]
    assert copy_detections(np.empty((0, 5)), out) == 0


@pytest.mark.parametrize("answer", [np.zeros(5), np.zeros((2, 4)), None, [["a"] * 5]])
def test_an_answer_that_is_no_boxes_is_refused(answer: object) -> None:
    with pytest.raises(SimulationError, match="detector"):
        copy_detections(answer, np.zeros((4, 5)))  # type: ignore[arg-type]
