"""How near an arm is to a box, beside coal's distances."""

import coal
import numpy as np
import pytest

from safety_harness.base.geometry.rotations import rotation_from_vector
from safety_harness.cell.robot.capsules import load_capsules
from safety_harness.cell.robot.description import load_arm
from safety_harness.cell.robot.distance import place_capsules
from safety_harness.cell.robot.obstacles import box_records, distance_from, segment_box_distance
from safety_harness.scenario.obstacles import Obstacle
from tests.cell.robot.arms import random_joints, transforms_of


def box(rng: np.random.Generator) -> Obstacle:
    return Obstacle(
        size_m=tuple(rng.uniform(0.05, 0.8, 3)),
        position_in_base_m=tuple(rng.uniform(-1.0, 1.0, 3)),
        yaw_rad=rng.uniform(-np.pi, np.pi),
    )


def coal_distance(obstacle: Obstacle, start: np.ndarray, end: np.ndarray, radius: float) -> float:
    """0 or less where they touch: how deep is not compared."""
    turn = rotation_from_vector(np.array([0.0, 0.0, obstacle.yaw_rad]))
    place = coal.Transform3s(turn, np.array(obstacle.position_in_base_m))
    way = end - start
    length = np.linalg.norm(way)
    axes = np.linalg.svd(way[None])[2][::-1]
    axes[2] *= np.sign(axes[2] @ way)
    axes[0] *= np.linalg.det(axes)
    capsule = coal.Capsule(radius, length), coal.Transform3s(axes.T, 0.5 * (start + end))
    request, result = coal.DistanceRequest(), coal.DistanceResult()
    return float(coal.distance(coal.Box(*obstacle.size_m), place, *capsule, request, result))


def test_a_segment_is_as_far_from_a_box_as_coal_says() -> None:
    rng = np.random.default_rng(1)
    clear = 0
    for _ in range(500):
        obstacle, (start, end) = box(rng), rng.uniform(-1.0, 1.0, (2, 3))
        ours = segment_box_distance(box_records((obstacle,)), 0, start, end)
        theirs = coal_distance(obstacle, start, end, 1e-4) + 1e-4
        if ours > 1e-3:
            assert ours == pytest.approx(theirs, abs=1e-6)
            clear += 1
        else:
            assert theirs <= 2e-3
    assert 100 < clear < 500


def test_the_arm_is_as_far_from_boxes_as_its_nearest_capsule_and_the_base_does_not_count() -> None:
    rng, arm, capsules = np.random.default_rng(2), load_arm("ur10"), load_capsules("ur10")
    boxes = tuple(box(rng) for _ in range(3))
    ends = np.empty((len(capsules.radius_m), 2, 3))
    for joints in random_joints(arm, 20, seed=3):
        place_capsules(capsules.records, transforms_of(arm, joints), ends)
        each = [
            coal_distance(one, *ends[k], capsules.radius_m[k])
            for one in boxes
            for k in np.flatnonzero(capsules.link_index > 0)
        ]
        ours = distance_from(box_records(boxes), arm, capsules, joints)
        if min(each) > 1e-3:
            assert ours == pytest.approx(min(each), abs=1e-6)
        else:
            assert ours <= 2e-3


def test_without_boxes_nothing_is_near_and_a_lost_joint_is_not_far() -> None:
    arm, capsules = load_arm("ur10"), load_capsules("ur10")
    assert distance_from(box_records(()), arm, capsules, np.zeros(6)) == np.inf
    around = box_records((box(np.random.default_rng(4)),))
    assert np.isnan(distance_from(around, arm, capsules, np.array([0.0, np.nan, 0.0, 0.0, 0.0, 0.0])))


def test_its_corners_are_on_its_surface_and_their_edges_its_own() -> None:
    obstacle = box(np.random.default_rng(5))
    corners = obstacle.corners_in_base_m
    lengths = [np.linalg.norm(corners[a] - corners[b]) for a, b in ((1, 0), (2, 1), (4, 0))]
    np.testing.assert_allclose(lengths, obstacle.size_m, atol=1e-12)
    records = box_records((obstacle,))
    outwards = (corners - corners.mean(axis=0)) * 1e-3
    for corner, out in zip(corners, outwards, strict=True):
        assert segment_box_distance(records, 0, corner + out, corner + out) == pytest.approx(
            np.linalg.norm(out)
        )
