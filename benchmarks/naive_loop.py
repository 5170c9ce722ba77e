"""The control loop as one would write it first, for comparison: renderer, numpy, eager network.

Nothing here is used by the package.  The network is untrained: its time does not depend on its weights.
"""

from __future__ import annotations

from types import TracebackType
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from safety_harness.admission.admit import Admitted
from safety_harness.cell.perception.camera import transform_camera_to_tcp
from safety_harness.cell.perception.detector import OBJECT_BRIGHTEST
from safety_harness.cell.simulation.cell import build_cell, render
from safety_harness.cell.simulation.engine import pybullet

PASSES = 10
DROPOUT = 0.1
WIDTH = 32
TCP_LINK = b"tool0"


class NaiveLoop:
    """One PyBullet client with all meshes; ``tick`` does one control period from a recorded state."""

    def __init__(self, admitted: Admitted) -> None:
        settings = admitted.scenario.settings
        self._settings, self._view, self._efforts = (
            settings,
            admitted.view,
            admitted.arm.effort_limit.tolist(),
        )
        self._camera_to_tcp = transform_camera_to_tcp(settings.camera, calibrated=False)
        self._network = regression_network()
        self._client = int(pybullet.connect(pybullet.DIRECT))
        bodies = build_cell(self._client, settings, admitted.arm, admitted.joint_position_rad, rendered=True)
        self._robot, self._joints = bodies.robot, list(bodies.joints)
        self._tcp_link = next(
            i
            for i in range(pybullet.getNumJoints(self._robot, physicsClientId=self._client))
            if pybullet.getJointInfo(self._robot, i, physicsClientId=self._client)[12] == TCP_LINK
        )
        sphere = pybullet.createCollisionShape(
            pybullet.GEOM_SPHERE, radius=settings.hand.radius_m, physicsClientId=self._client
        )
        self._hand = pybullet.createMultiBody(0.0, sphere, physicsClientId=self._client)

    def __enter__(self) -> NaiveLoop:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        pybullet.disconnect(physicsClientId=self._client)

    def place(self, tick: np.void) -> None:
        """Bring robot and hand where the recorded ``tick`` has them; not part of what is timed."""
        pybullet.resetJointStatesMultiDof(
            self._robot,
            self._joints,
            tick["joint_position_rad"][:, None].tolist(),
            tick["joint_velocity_radps"][:, None].tolist(),
            physicsClientId=self._client,
        )
        pybullet.resetBasePositionAndOrientation(
            self._hand, tick["hand_position_in_base_m"][0], (0.0, 0.0, 0.0, 1.0), physicsClientId=self._client
        )

    def tick(self, *, critical: bool) -> float:
        """One control period; returns the distance of hand and robot [m]."""
        tcp_to_base = self._tcp_pose()
        camera = self._settings.camera
        colour, _ = render(
            self._client,
            tcp_to_base @ self._camera_to_tcp,
            camera.focal_px,
            camera.width_px,
            camera.height_px,
        )
        twist = servo_twist(colour, camera.focal_px, self._view, self._settings.servo.gain_far)
        if critical:
            hand = np.array(pybullet.getBasePositionAndOrientation(self._hand, self._client)[0])
            twist[:3] += monte_carlo_mean(self._network, np.concatenate([hand, tcp_to_base[:3, 3], [1.0]]))
        positions = [state[0] for state in self._joint_states()]
        zeros = [0.0] * len(positions)
        linear, angular = pybullet.calculateJacobian(
            self._robot, self._tcp_link, (0.0, 0.0, 0.0), positions, zeros, zeros, self._client
        )
        rates = np.linalg.pinv(np.concatenate([linear, angular])) @ twist
        pybullet.setJointMotorControlArray(
            self._robot,
            self._joints,
            pybullet.VELOCITY_CONTROL,
            targetVelocities=rates.tolist(),
            forces=self._efforts,
            physicsClientId=self._client,
        )
        for _ in range(self._settings.clock.physics_substeps):
            pybullet.stepSimulation(physicsClientId=self._client)
        nearest = pybullet.getClosestPoints(self._robot, self._hand, 5.0, physicsClientId=self._client)
        return float(min(point[8] for point in nearest))

    def _joint_states(self) -> Any:
        return pybullet.getJointStates(self._robot, self._joints, physicsClientId=self._client)

    def _tcp_pose(self) -> NDArray[np.float64]:
        state = pybullet.getLinkState(
            self._robot, self._tcp_link, computeForwardKinematics=True, physicsClientId=self._client
        )
        pose = np.eye(4)
        pose[:3, :3] = np.array(pybullet.getMatrixFromQuaternion(state[5])).reshape(3, 3)
        pose[:3, 3] = state[4]
        return pose


def servo_twist(colour: NDArray[np.uint8], focal_px: float, view: Any, gain: float) -> NDArray[np.float64]:
    """Eqs. 1 to 5 on a rendered image in plain numpy; zero if the object is not in view."""
    mask = cv2.inRange(colour, (0, 0, 0), (OBJECT_BRIGHTEST,) * 3)
    rows, columns = np.nonzero(mask)
    if len(rows) == 0:
        return np.zeros(6)
    x = (columns - colour.shape[1] / 2.0) / focal_px
    y = (rows - colour.shape[0] / 2.0 + 1.0) / focal_px
    x_g, y_g = x.mean(), y.mean()
    mu = {
        (i, j): np.sum((x - x_g) ** i * (y - y_g) ** j) / focal_px**2 for i in range(7) for j in range(7 - i)
    }
    a_n = view.depth_m * np.sqrt(view.area / mu[0, 0])
    features, interaction = features_and_interaction(mu, x_g, y_g, a_n)
    error = features - view.features
    error[5] = (error[5] + np.pi / 2) % np.pi - np.pi / 2
    return -gain * np.linalg.pinv(interaction) @ error


def features_and_interaction(
    mu: dict[tuple[int, int], float], x_g: float, y_g: float, a_n: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Features (6,) and L (6, 6) of a dense object in a plane parallel to the image at depth ``a_n``."""
    n20, n11, n02 = mu[2, 0] / mu[0, 0], mu[1, 1] / mu[0, 0], mu[0, 2] / mu[0, 0]

    def row(i: int, j: int) -> NDArray[np.float64]:
        def m(p: int, q: int) -> float:
            return mu.get((p, q), 0.0)

        w_x = (i + j + 3) * m(i, j + 1) + i * x_g * m(i - 1, j + 1) + (i + 2 * j + 3) * y_g * m(i, j)
        w_x -= 4 * i * n11 * m(i - 1, j) + 4 * j * n02 * m(i, j - 1)
        w_y = -(i + j + 3) * m(i + 1, j) - (2 * i + j + 3) * x_g * m(i, j) - j * y_g * m(i + 1, j - 1)
        w_y += 4 * i * n20 * m(i - 1, j) + 4 * j * n11 * m(i, j - 1)
        w_z = i * m(i - 1, j + 1) - j * m(i + 1, j - 1)
        return np.array([0.0, 0.0, (i + j + 2) * m(i, j) / a_n, w_x, w_y, w_z])

    def squares(first: int, second: int) -> tuple[float, NDArray[np.float64]]:
        """In of eq. 5, c^2 + s^2, and its row; ``first`` and ``second`` weigh the middle and last moments."""
        c = mu[5, 0] + first * mu[3, 2] + second * mu[1, 4]
        s = mu[0, 5] + first * mu[2, 3] + second * mu[4, 1]
        c_row = row(5, 0) + first * row(3, 2) + second * row(1, 4)
        s_row = row(0, 5) + first * row(2, 3) + second * row(4, 1)
        return c * c + s * s, 2.0 * (c * c_row + s * s_row)

    (in1, row1), (in2, row2), (in3, row3) = squares(2, 1), squares(-2, -3), squares(-10, 5)
    x_row = np.array([-1.0 / a_n, 0.0, x_g / a_n, x_g * y_g + 4 * n11, -(1.0 + x_g * x_g + 4 * n20), y_g])
    y_row = np.array([0.0, -1.0 / a_n, y_g / a_n, 1.0 + y_g * y_g + 4 * n02, -x_g * y_g - 4 * n11, -x_g])
    a_row = -0.5 * a_n / mu[0, 0] * row(0, 0)
    d = mu[2, 0] - mu[0, 2]
    alpha_row = (d * row(1, 1) - mu[1, 1] * (row(2, 0) - row(0, 2))) / (d * d + 4 * mu[1, 1] ** 2)
    alpha = 0.5 * np.arctan2(2.0 * mu[1, 1], d)
    features = np.array([a_n * x_g, a_n * y_g, a_n, in1 / in3, in2 / in3, alpha])
    interaction = np.stack(
        [
            a_row * x_g + a_n * x_row,
            a_row * y_g + a_n * y_row,
            a_row,
            (row1 - in1 / in3 * row3) / in3,
            (row2 - in2 / in3 * row3) / in3,
            alpha_row,
        ]
    )
    return features, interaction


def regression_network() -> Any:
    """Three stages of a dense and two identity blocks of FC-BN-ReLU, dropout after each; 7 to 3."""
    import torch
    from torch import nn

    torch.set_num_threads(1)
    torch.manual_seed(0)

    def main_path(inputs: int) -> nn.Sequential:
        return nn.Sequential(
            nn.Linear(inputs, WIDTH),
            nn.BatchNorm1d(WIDTH),
            nn.ReLU(),
            nn.Linear(WIDTH, WIDTH),
            nn.BatchNorm1d(WIDTH),
            nn.ReLU(),
            nn.Linear(WIDTH, WIDTH),
            nn.BatchNorm1d(WIDTH),
        )

    class Block(nn.Module):
        def __init__(self, inputs: int, *, dense: bool) -> None:
            super().__init__()
            self.path = main_path(inputs)
            shortcut = [nn.Linear(inputs, WIDTH), nn.BatchNorm1d(WIDTH)] if dense else [nn.Identity()]
            self.shortcut = nn.Sequential(*shortcut)

        def forward(self, x: Any) -> Any:
            return torch.relu(self.path(x) + self.shortcut(x))

    stages: list[nn.Module] = []
    for inputs in (7, WIDTH, WIDTH):
        stages += [Block(inputs, dense=True), Block(WIDTH, dense=False), Block(WIDTH, dense=False)]
        stages.append(nn.Dropout(DROPOUT))
    network = nn.Sequential(*stages, nn.BatchNorm1d(WIDTH), nn.Linear(WIDTH, 3)).eval()
    for module in network.modules():
        if isinstance(module, nn.Dropout):
            module.train()  # Monte Carlo dropout: drop at prediction time, normalise as evaluated
    return network


def monte_carlo_mean(network: Any, values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Mean (3,) of ``PASSES`` eager passes, one after the other."""
    import torch

    x = torch.as_tensor(values, dtype=torch.float32)[None]
    with torch.no_grad():
        answers = [network(x).numpy()[0] for _ in range(PASSES)]
    mean: NDArray[np.float64] = np.mean(answers, axis=0).astype(np.float64)
    return mean
