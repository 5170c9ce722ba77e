"""A safety filter of your own: a control barrier function with a small quadratic program (CBF-QP).

For each hand and each point of the arm, h = |p - hand| - DISTANCE_M is the room that is left. The filter
finds the joint velocities nearest to the wanted ones for which no room shrinks faster than RATE_PER_S h.
(Ames et al., Control barrier functions: theory and applications, ECC 2019, eq. 18.)
"""

import numpy as np

from safety_harness import Move

DISTANCE_M, RATE_PER_S, SWEEPS = 0.45, 3.0, 50


class BarrierFilter:
    """The filter; it sees the tracked hands and the command that the controller wants."""

    name = "control barrier"
    sees = ("joints", "predicted hands", "wanted command")

    def reset(self, *, settings, arm, start, seed):
        """Begin an episode with this arm."""
        self.arm = arm

    def act(self, seen):
        """Return the wanted command, or the nearest one that keeps all barriers."""
        wanted = seen.wanted_command
        if wanted.stop:
            return wanted.action
        rows, least = [], []
        for point, jacobian in points_of(self.arm, seen.joint_position_rad):
            for hand in seen.predicted_hands:
                away = point - hand.position_in_base_m
                room_m = np.linalg.norm(away) - DISTANCE_M
                away /= np.linalg.norm(away)
                rows.append(away @ jacobian)
                least.append(away @ hand.velocity_in_base_mps - RATE_PER_S * room_m)
        return Move(
            joint_velocity_radps=nearest(wanted.joint_velocity_radps, np.array(rows), np.array(least))
        )


def nearest(wanted, rows, least):
    """Return the x nearest to ``wanted`` with ``rows @ x >= least``, by Hildreth's method."""
    rates, weights = wanted, np.zeros(len(rows))
    for _ in range(SWEEPS):
        for k in np.flatnonzero((weights > 0.0) | (rows @ rates < least)) if len(rows) else ():
            step = max((least[k] - rows[k] @ rates) / (rows[k] @ rows[k] + 1e-9), -weights[k])
            weights[k] += step
            rates = rates + step * rows[k]
    return rates


def points_of(arm, joint_position_rad):
    """Yield the origin of each link from the third on, and the TCP, with the Jacobian (3, n) of the point."""
    pose, axes, origins = np.eye(4), [], []
    for k, angle_rad in enumerate(joint_position_rad):
        pose = pose @ arm.joint_origins[k]
        axes.append(pose[:3, :3] @ arm.joint_axes[k])
        origins.append(pose[:3, 3])
        pose = pose @ turn(arm.joint_axes[k], angle_rad)
    for point in (*origins[2:], (pose @ arm.flange)[:3, 3]):
        yield point, np.array([np.cross(a, point - o) for a, o in zip(axes, origins, strict=True)]).T


def turn(axis, angle_rad):
    """Return the rotation (4, 4) about an axis (Rodrigues)."""
    x, y, z = axis
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    pose = np.eye(4)
    pose[:3, :3] += np.sin(angle_rad) * cross + (1 - np.cos(angle_rad)) * cross @ cross
    return pose
