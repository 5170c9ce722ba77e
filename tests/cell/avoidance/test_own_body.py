"""The distance of the wrist from the arm's own body, against brute force."""

from __future__ import annotations

import numpy as np
import pytest

from safety_harness.cell.avoidance.own_body import body_and_wrist, own_distances
from safety_harness.cell.robot.capsules import load_capsules
from safety_harness.cell.robot.description import load_arm
from safety_harness.cell.robot.kinematics import forward_kinematics

ARM, CAPSULES = load_arm(), load_capsules()
BODY, WRIST = body_and_wrist(ARM, CAPSULES)
JOINTS = np.random.default_rng(5).uniform(-np.pi, np.pi, (25, 6))


def axis_points(joints: np.ndarray, capsule: int, count: int) -> np.ndarray:
    """(count, 3) points on a capsule's axis in the base frame."""
    transforms = np.empty((8, 4, 4))
    forward_kinematics(ARM.chain[0], joints, transforms)
    ends = CAPSULES.start_in_link[capsule], CAPSULES.end_in_link[capsule]
    local = ends[0] + np.linspace(0.0, 1.0, count)[:, None] * (ends[1] - ends[0])
    link = transforms[CAPSULES.link_index[capsule]]
    return local @ link[:3, :3].T + link[:3, 3]


def test_the_wrist_and_the_body_are_the_links_that_one_thinks_of() -> None:
    names = np.array(CAPSULES.names)
    wrist = set(names[CAPSULES.link_index >= WRIST])
    body = {name.split("_")[0] for name in names[CAPSULES.link_index <= BODY]}
    assert wrist == {"wrist_1", "wrist_2", "wrist_3"}
    assert body == {"base", "shoulder", "upper"}


@pytest.mark.parametrize("joints", JOINTS, ids=range(len(JOINTS)))
def test_it_is_the_least_over_all_pairs_of_points_on_the_axes(joints: np.ndarray) -> None:
    least, count = np.inf, 60
    for wrist in np.flatnonzero(CAPSULES.link_index >= WRIST):
        for body in np.flatnonzero(CAPSULES.link_index <= BODY):
            apart = axis_points(joints, wrist, count)[:, None] - axis_points(joints, body, count)
            radii = CAPSULES.radius_m[wrist] + CAPSULES.radius_m[body]
            least = min(least, float(np.linalg.norm(apart, axis=2).min()) - radii)
    (exact,) = own_distances(ARM, CAPSULES, joints[None])
    assert exact <= least + 1e-12
    assert exact == pytest.approx(least, abs=0.005)


def test_turning_the_arm_about_its_pan_changes_nothing_while_the_upper_arm_is_nearest() -> None:
    joints = np.array([0.0, -1.27, 1.98, -2.27, -1.57, 0.3])
    turned = joints + [1.1, 0.0, 0.0, 0.0, 0.0, 0.0]
    before_m, after_m = own_distances(ARM, CAPSULES, np.array([joints, turned]))
    assert after_m == pytest.approx(before_m, abs=1e-12)


def test_a_joint_that_is_no_number_gives_no_distance() -> None:
    assert np.isnan(own_distances(ARM, CAPSULES, np.array([[0.0, np.nan, 0.0, 0.0, 0.0, 0.0]]))[0])
