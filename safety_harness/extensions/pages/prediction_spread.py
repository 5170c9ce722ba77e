"""Compute the hand filter's uncertainty about a predicted hand from the filter's settings, for pictures.

A trace contains the predictions without their covariance. The covariance of a linear filter depends only on
the times of its measurements. Therefore, the result is exact if the hand was visible in every image since the
track began. If an image missed the hand, the true covariance is larger than the result.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from safety_harness.base.settings import HandSensorKind
from safety_harness.cell.controller.records import overhead_transform_sensor_to_base
from safety_harness.cell.perception.camera import transform_camera_to_tcp
from safety_harness.cell.perception.hand_filter import filter_parameters
from safety_harness.trace.known import Source
from safety_harness.trace.trace import Trace

Floats = NDArray[np.float64]
UPPER = np.triu_indices(3)


def prediction_spread_m(trace: Trace) -> Floats:
    """Return the upper half of a symmetric matrix S [m], shape (n, tracks, 6).

    S S is the covariance of a predicted hand's centre. S is expressed in the base frame. The result is NaN at
    ticks without a track, and if another filter made the predictions.
    """
    ticks = trace.ticks
    valid = ticks["track_valid"].astype(bool)
    upper = np.full((*valid.shape, 6), np.nan)
    if trace.scenario.driven or trace.known.column("predicted_hand_in_base_m").source is not Source.SIMULATED:
        return upper
    settings = trace.scenario.settings
    sensor_in_base = np.broadcast_to(overhead_transform_sensor_to_base(settings), (len(ticks), 4, 4))
    if settings.hand_sensor.kind is HandSensorKind.EYE_IN_HAND:
        sensor_in_base = ticks["transform_tcp_to_base"] @ transform_camera_to_tcp(
            settings.camera, calibrated=True
        )
    turn, place = sensor_in_base[:, None, :3, :3], sensor_in_base[:, None, :3, 3]
    seen = np.einsum("...ji,...j->...i", turn, ticks["predicted_hand_in_base_m"] - place)  # sensor frame
    focal_px, depth = settings.hand_sensor.focal_px, seen[..., 2]
    to_place = np.zeros((*valid.shape, 3, 3))  # d(x, y, z) / d(u, v, z)
    to_place[..., 0, 0] = to_place[..., 1, 1] = depth / focal_px
    to_place[..., :2, 2] = seen[..., :2] / depth[..., None]
    to_place[..., 2, 2] = 1.0
    root = turn @ to_place * np.sqrt(_variances(trace, valid))[..., None, :]
    sure = valid & np.isfinite(root).all(axis=(2, 3))
    values, axes = np.linalg.eigh(root[sure] @ np.swapaxes(root[sure], -1, -2))
    symmetric = axes * np.sqrt(np.maximum(values, 0.0))[:, None, :] @ np.swapaxes(axes, -1, -2)
    upper[sure] = symmetric[:, UPPER[0], UPPER[1]]
    return upper


def _variances(trace: Trace, valid: NDArray[np.bool_]) -> Floats:
    """Return the variances of u, v [px^2] and z [m^2] at the time of the prediction, shape (n, tracks, 3)."""
    settings = trace.scenario.settings
    sensor, horizon_s = settings.hand_sensor, settings.hand_filter.prediction_horizon_s
    parameters = filter_parameters(settings.hand_filter, sensor)[0]
    push = parameters["acceleration_variance"]
    rate_hz = sensor.rate_hz or 1.0 / settings.clock.control_period_s
    frame = np.floor((trace.time_s - sensor.latency_s) * rate_hz + 1e-6)  # the last arrived frame's number
    begins = valid & ~np.vstack([np.zeros_like(valid[:1]), valid[:-1]])
    first = np.maximum.accumulate(np.where(begins, frame[:, None], -np.inf), axis=0)
    age = np.where(valid, frame[:, None] - first, 0.0).astype(np.int64)  # frames since the track began
    by_age = _after_frames(parameters, 1.0 / rate_hz, int(age.max(initial=0)))
    value, mixed, rate = np.moveaxis(by_age[np.minimum(age, len(by_age) - 1)], 2, 0)
    ahead_s = (trace.time_s + horizon_s - frame / rate_hz)[:, None, None]
    total: Floats = value + ahead_s * (2.0 * mixed + ahead_s * rate) + 0.25 * ahead_s**4 * push
    return total


def _after_frames(parameters: np.void, dt_s: float, most: int) -> Floats:
    """Return var(value), cov(value, rate) and var(rate) of u, v and z after 1, 2, ... frames.

    The shape is (k, 3, 3), where k is at most ``most`` + 1. After more than k frames, the last entry applies.
    The recursion is the same as in the filter's ``initialise``, ``wait`` and ``update``.
    """
    noise, push = parameters["measurement_variance"][:3], parameters["acceleration_variance"]
    states = [np.array([noise, np.zeros(3), parameters["initial_rate_variance"]])]
    while len(states) <= most and (
        len(states) == 1 or not np.allclose(states[-2], states[-1], rtol=1e-12, atol=0.0)
    ):
        value, mixed, rate = states[-1]
        value = value + dt_s * (2.0 * mixed + dt_s * rate) + 0.25 * dt_s**4 * push
        mixed = mixed + dt_s * rate + 0.5 * dt_s**3 * push
        rate = rate + dt_s**2 * push
        gain = noise / (value + noise)
        states.append(np.array([value * gain, mixed * gain, rate - mixed**2 / (value + noise)]))
    return np.array(states)
