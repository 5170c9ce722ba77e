"""Define the simplest shipped controller, which moves straight to the desired TCP and stops near a hand."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from safety_harness.base.elementary import arctan2, product
from safety_harness.base.settings import Settings
from safety_harness.seams.contract import (
    HANDS,
    JOINTS,
    MODE,
    Action,
    DrivenArm,
    Move,
    Moves,
    Report,
    Seen,
    Start,
    Stop,
)
from safety_harness.trace.records import Mode

_GOING, _STOPPED = Report(mode=Mode.SERVOING), Report(mode=Mode.PROTECTIVE_STOP)


class StopWhenNear:
    """A controller that servoes with the encoders alone.

    The twist is v = g (t* - t), w = g r. Here t is the TCP's position, t* the desired position, r the
    rotation vector to the desired pose, and g the settings' ``gain_far``. The controller stops while any hand
    in the sensor's last frame is within the critical distance of the TCP.
    """

    name = "stop when near"
    sees = (JOINTS, HANDS)
    reports = (MODE,)

    def reset(self, *, settings: Settings, arm: DrivenArm, start: Start, seed: int) -> None:
        """Read the target, the gain and the critical distance from the settings."""
        self._target_in_base_m = np.array(settings.cell.desired_tcp_position_in_base_m)
        self._gain = settings.servo.gain_far
        self._near_m = settings.avoidance.critical_distance_m
        self._numbers = (*self._target_in_base_m.tolist(), self._gain, self._near_m)

    def another(self) -> StopWhenNear:
        """Return a second controller, for an episode in another lane."""
        return StopWhenNear()

    def act(self, seen: Seen) -> Action:
        """Return a stop, or a move towards the desired pose."""
        tcp = seen.tcp_position_in_base_m
        for hand in seen.hands:
            offset = hand.position_in_base_m - tcp
            if (
                not product(offset, offset) >= self._near_m * self._near_m
            ):  # also true for a NaN: such a hand counts as near
                return Stop(report=_STOPPED)
        return Move(
            tcp_velocity_mps=self._gain * (self._target_in_base_m - tcp),
            tcp_angular_velocity_radps=self._gain * _turn(seen.transform_tcp_to_base),
            report=_GOING,
        )

    @staticmethod
    def act_many(controllers: Sequence[StopWhenNear], seen: Mapping[str, NDArray[Any]]) -> Moves:
        """Return the moves of all controllers.

        Each move equals the result of ``act`` bit for bit.

        Args:
            controllers: The controllers (n,).
            seen: The views of the controllers by name, each with n rows.

        """
        numbers = np.array([controller._numbers for controller in controllers])
        target, gains, near_m = numbers[:, :3], numbers[:, 3:4], numbers[:, 4:]
        tcp = seen["tcp_position_in_base_m"]
        offset = np.ascontiguousarray(seen["hands"] - tcp[:, None])
        is_near = ~(_squared(offset) >= near_m * near_m) & (seen["hands_there"] != 0)
        stop = is_near.any(axis=1)
        return Moves(
            tcp_velocity_mps=gains * (target - tcp),
            tcp_angular_velocity_radps=gains * _turns(seen["transform_tcp_to_base"]),
            stop=stop,
            mode=np.where(stop, int(Mode.PROTECTIVE_STOP), int(Mode.SERVOING)),
        )


def _squared(vectors: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the squares of ``vectors`` (..., 3), shape (...,).

    Each square equals ``product(v, v)`` bit for bit.
    """
    squares: NDArray[np.float64] = (vectors * vectors).sum(axis=-1)
    return squares


def _turn(transform_tcp_to_base: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the rotation vector (3,) from the TCP's orientation to straight down, in the base frame."""
    x, y, z, _ = transform_tcp_to_base.tolist()  # of diag(1, -1, -1) R^T, of less than half a turn
    axis = np.array([0.5 * (z[1] - y[2]), 0.5 * (z[0] + x[2]), -0.5 * (x[1] + y[0])])
    sine = math.sqrt(product(axis, axis))
    angle = arctan2(sine, 0.5 * (x[0] - y[1] - z[2] - 1.0))
    return axis if sine < 1e-9 else axis * (angle / sine)


def _turns(transforms_tcp_to_base: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the rotation vectors (n, 3) of transforms (n, 4, 4).

    Each vector equals the result of ``_turn`` bit for bit. Both functions compute an angle in the same way.
    """
    x, y, z = (transforms_tcp_to_base[:, row] for row in range(3))
    halves = 0.5 * (z[:, 1] - y[:, 2]), 0.5 * (z[:, 0] + x[:, 2]), -0.5 * (x[:, 1] + y[:, 0])
    axis = np.stack(halves, axis=1)
    sine = np.sqrt(_squared(axis))
    cosine = 0.5 * (x[:, 0] - y[:, 1] - z[:, 2] - 1.0)
    angle = arctan2(sine, cosine)
    tiny = sine < 1e-9
    scale = np.where(tiny, 1.0, angle / np.where(tiny, 1.0, sine))
    return axis * scale[:, None]
