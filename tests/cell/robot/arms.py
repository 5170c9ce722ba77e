"""What the tests of this folder share: PyBullet as an oracle, and random joint positions."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pybullet

from safety_harness.cell.robot.description import ArmModel, load_arm, resolved_urdf
from safety_harness.cell.robot.kinematics import forward_kinematics

ARMS = ["ur10", "ur5", "ur3"]


def transforms_of(arm: ArmModel, joints: np.ndarray) -> np.ndarray:
    """All eight link-to-base transforms (8, 4, 4)."""
    transforms = np.full((8, 4, 4), np.nan)
    forward_kinematics(arm.chain[0], joints, transforms)
    return transforms


def random_joints(arm: ArmModel, count: int, seed: int) -> np.ndarray:
    """Joint positions (count, 6) anywhere within the limits."""
    rng = np.random.default_rng(seed)
    return rng.uniform(arm.position_lower_rad, arm.position_upper_rad, (count, 6))


class BulletArm:
    """One arm in PyBullet's DIRECT mode, moved by resetting its joints."""

    def __init__(self, client: int, name: str, folder: Path) -> None:
        file = folder / f"{name}.urdf"
        file.write_text(resolved_urdf(load_arm(name), visuals=False))
        self.client = client
        self.body = pybullet.loadURDF(str(file), useFixedBase=True, physicsClientId=client)
        info = [
            pybullet.getJointInfo(self.body, i, physicsClientId=client)
            for i in range(pybullet.getNumJoints(self.body, physicsClientId=client))
        ]
        self.index_of_joint = {row[1].decode(): row[0] for row in info}
        self.index_of_link = {row[12].decode(): row[0] for row in info}
        self.joints = [self.index_of_joint[joint] for joint in load_arm(name).joint_names]

    def move(self, joints: np.ndarray) -> None:
        for index, angle in zip(self.joints, joints, strict=True):
            pybullet.resetJointState(self.body, index, angle, physicsClientId=self.client)

    def transform(self, link: str) -> np.ndarray:
        if link == pybullet.getBodyInfo(self.body, self.client)[0].decode():
            return np.eye(4)  # the root, which stands in the origin
        return pose_of_link(self.body, self.index_of_link[link], self.client)

    def jacobian(self, joints: np.ndarray, link: str) -> np.ndarray:
        index = self.index_of_link[link]
        offset = pybullet.getLinkState(self.body, index, physicsClientId=self.client)[2]
        zero = [0.0] * 6
        linear, angular = pybullet.calculateJacobian(
            self.body, index, np.negative(offset).tolist(), joints.tolist(), zero, zero, self.client
        )
        return np.vstack((linear, angular))


def pose_of_link(body: int, index: int, client: int) -> np.ndarray:
    """(4, 4) link to base."""
    state = pybullet.getLinkState(body, index, computeForwardKinematics=True, physicsClientId=client)
    transform = np.eye(4)
    transform[:3, :3] = np.reshape(pybullet.getMatrixFromQuaternion(state[5]), (3, 3))
    transform[:3, 3] = state[4]
    return transform


def pose_in_the_engine(link: str) -> np.ndarray:
    """(4, 4) of a link of that name in the one engine that runs in this process."""
    (found,) = [
        (body, index, client)
        for client in range(32)
        if pybullet.isConnected(client)
        for body in range(pybullet.getNumBodies(client))
        for index in range(pybullet.getNumJoints(body, client))
        if pybullet.getJointInfo(body, index, client)[12].decode() == link
    ]
    return pose_of_link(*found)


@contextmanager
def bullet_arm(name: str) -> Iterator[BulletArm]:
    client = pybullet.connect(pybullet.DIRECT)
    try:
        with TemporaryDirectory() as folder:
            yield BulletArm(client, name, Path(folder))
    finally:
        pybullet.disconnect(client)
