"""The joints of a straight way put the TCP on it, continuously, as far as the arm can follow."""

from __future__ import annotations

import numpy as np

from safety_harness.base.settings import DEFAULTS
from safety_harness.cell.robot.description import load_arm
from safety_harness.cell.robot.inverse import InverseKinematics, straight_way
from safety_harness.cell.robot.kinematics import forward_kinematics

ARM = load_arm("ur10")
START = np.array(DEFAULTS.cell.preferred_joint_position_rad)


def pose(joints: np.ndarray) -> np.ndarray:
    transforms = np.empty((8, 4, 4))
    forward_kinematics(ARM.chain[0], joints, transforms)
    return transforms[7]


def test_every_row_is_on_the_way_with_the_same_orientation() -> None:
    start = pose(START)
    end = start[:3, 3] + [0.05, -0.08, 0.03]
    rows = straight_way(ARM, START, end, step_m=0.01)
    assert len(rows) == 11
    assert np.array_equal(rows[0], START)
    for k, row in enumerate(rows):
        found = pose(row)
        assert np.allclose(found[:3, 3], start[:3, 3] + k / 10 * (end - start[:3, 3]), atol=1e-9)
        assert np.allclose(found[:3, :3], start[:3, :3], atol=1e-9)


def test_its_last_row_is_the_nearest_of_the_closed_form_solutions() -> None:
    target = pose(START).copy()
    target[:3, 3] += [0.0, 0.1, -0.05]
    nearest = InverseKinematics(ARM).nearest(target, START)
    assert nearest is not None
    assert np.allclose(straight_way(ARM, START, target[:3, 3], step_m=0.005)[-1], nearest, atol=1e-8)


def test_a_way_that_leads_out_of_reach_ends_there() -> None:
    rows = straight_way(ARM, START, pose(START)[:3, 3] + [5.0, 0.0, 0.0], step_m=0.01)
    assert 10 < len(rows) < 200
    assert np.linalg.norm(pose(rows[-1])[:3, 3]) < 1.5


def test_a_way_of_no_length_is_where_the_arm_is() -> None:
    assert np.array_equal(straight_way(ARM, START, pose(START)[:3, 3], step_m=0.01)[:1], START[None])
