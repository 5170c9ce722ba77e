"""How sure the hand filter is of where it predicts a hand, computed again from its settings, for pictures.

A trace has the predictions and not their covariance.  That of a linear filter depends on the times of its
measurements only, so it is known where every image since the beginning of a track showed the hand; a missed
image makes it larger than it is here.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from safety_harness.controller.records import overhead_transform_sensor_to_base
from safety_harness.perception.camera import transform_camera_to_tcp
from safety_harness.perception.hand_filter import filter_parameters
from safety_harness.settings import HandSensorKind
from safety_harness.trace.known import Source
from safety_harness.trace.trace import Trace

Floats = NDArray[np.float64]
UPPER = np.triu_indices(3)


def prediction_spread_m(trace: Trace) -> Floats:
    """(n, tracks, 6) the upper half of S, where S S is the covariance of a predicted hand's centre in base.

    NaN without a track, and in a trace whose predictions are not those of our filter.
    """
    ticks = trace.ticks
    valid = ticks["track_valid"].astype(bool)
    found = np.full((*valid.shape, 6), np.nan)
    if trace.scenario.driven or trace.known.of("predicted_hand_in_base_m").source is not Source.SIMULATED:
        return found
    settings = trace.scenario.settings
    sensor_in_base = np.broadcast_to(overhead_transform_sensor_to_base(settings), (len(ticks), 4, 4))
    if settings.hand_sensor.kind is HandSensorKind.EYE_IN_HAND:
        sensor_in_base = ticks["transform_tcp_to_base"] @ transform_camera_to_tcp(
            settings.camera, calibrated=True
        )
    turn, place = sensor_in_base[:, None, :3, :3], sensor_in_base[:, None, :3, 3]
    seen = np.einsum("...ji,...j->...i", turn, ticks["predicted_hand_in_base_m"] - place)  # in the sensor
    focal_px, depth = settings.hand_sensor.focal_px, seen[..., 2]
    to_place = np.zeros((*valid.shape, 3, 3))  # d(x, y, z) / d(u, v, z)
    to_place[..., 0, 0] = to_place[..., 1, 1] = depth / focal_px
    to_place[..., :2, 2] = seen[..., :2] / depth[..., None]
    to_place[..., 2, 2] = 1.0
    root = turn @ to_place * np.sqrt(_variances(trace, valid))[..., None, :]
    sure = valid & np.isfinite(root).all(axis=(2, 3))
    values, axes = np.linalg.eigh(root[sure] @ np.swapaxes(root[sure], -1, -2))
    symmetric = axes * np.sqrt(np.maximum(values, 0.0))[:, None, :] @ np.swapaxes(axes, -1, -2)
    found[sure] = symmetric[:, UPPER[0], UPPER[1]]
    return found


def _variances(trace: Trace, valid: NDArray[np.bool_]) -> Floats:
    """(n, tracks, 3) of u, v [px^2] and z [m^2] where a hand is predicted, at the time that it is for."""
    settings = trace.scenario.settings
    sensor, parameters = settings.hand_sensor, filter_parameters(settings.hand_filter, settings.hand_sensor)[0]
    noise, push = parameters["measurement_variance"][:3], parameters["acceleration_variance"]
    horizon_s, latency_s = settings.hand_filter.prediction_horizon_s, sensor.latency_s
    period_s = settings.clock.control_period_s
    rate_hz = sensor.rate_hz or 1.0 / period_s
    found = np.full((*valid.shape, 3), np.nan)
    p = np.full((3, valid.shape[1], 3), np.nan)  # var(value), cov, var(rate) of each track's u, v, z
    last, tracked = -1.0, np.zeros(valid.shape[1], np.bool_)
    for k, time_s in enumerate(trace.time_s):
        frame_s = np.floor((time_s - latency_s) * rate_hz + 1e-6) / rate_hz  # when it was taken
        if frame_s > last + 1e-9:
            dt_s = frame_s - last
            p[0] += dt_s * (2.0 * p[1] + dt_s * p[2]) + 0.25 * dt_s**4 * push
            p[1] += dt_s * p[2] + 0.5 * dt_s**3 * push
            p[2] += dt_s**2 * push
            total = p[0] + noise
            p[2] -= p[1] ** 2 / total
            p[0], p[1] = p[0] * noise / total, p[1] * noise / total
            last = frame_s
        new = valid[k] & ~tracked
        p[0, new], p[1, new], p[2, new] = noise, 0.0, parameters["initial_rate_variance"]
        tracked = valid[k]
        ahead_s = time_s + horizon_s - last
        grown = p[0] + ahead_s * (2.0 * p[1] + ahead_s * p[2]) + 0.25 * ahead_s**4 * push
        found[k] = np.where(tracked[:, None], grown, np.nan)
    return found
