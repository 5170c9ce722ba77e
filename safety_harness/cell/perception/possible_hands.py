"""Compute the box about a hand's predicted position in which the hand is with a stated probability.

The filter's u, v and z of all hands are n = 3 x hands independent numbers. Each is within k standard
deviations of its mean with the probability P^(1/n). Here k = q((1 + P^(1/n))/2), where q is the normal
quantile. So all n numbers together are within k with probability P. If the filter extrapolates by t, the
variance is

    P00 + 2 t P01 + t^2 P11 + t^4/4 s^2

(``hand_filter.wait``). From the intervals of u, v and z, interval arithmetic computes those of X = x D, Y = y
D and D. Here D = z + r/sqrt(x^2 + y^2 + 1). The result is a box along the base's axes. The module assumes,
without a check, that the filter's covariance is right.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from safety_harness.base.elementary import power, product
from safety_harness.base.special import normal_quantile

Floats = NDArray[np.float64]


def possible_half_widths_m(
    tracks: NDArray[np.void],
    at_time_s: float,
    parameters: NDArray[np.void],
    transform_sensor_to_base: Floats,
    probability: float,
) -> Floats:
    """Return the half widths (k, 3) [m], along the base's axes, of the boxes of the k valid tracks.

    The centre of a box is the position that ``predict_positions`` gives for ``at_time_s``. Every hand is in
    its box with this ``probability``. ``tracks`` (n,) TRACK, ``parameters`` (1,) FILTER_PARAMETERS,
    ``transform_sensor_to_base`` (4, 4).
    """
    valid, p = tracks[tracks["valid"]], parameters[0]
    if len(valid) == 0:
        return np.zeros((0, 3))
    deviations = normal_quantile(0.5 + 0.5 * power(probability, 1.0 / (3 * len(valid))))
    ahead_s = (at_time_s - valid["time_s"])[:, None]
    pairs = valid["pair_covariance"][:, :3]
    variance = pairs[:, :, 0] + ahead_s * (2.0 * pairs[:, :, 1] + ahead_s * pairs[:, :, 2])
    variance = variance + 0.25 * (ahead_s * ahead_s) * (ahead_s * ahead_s) * p["acceleration_variance"]
    half_px_m = deviations * np.sqrt(variance)
    ahead = valid["mean"][:, :3] + ahead_s * valid["mean"][:, 5:8]
    place = np.isfinite(ahead).all(axis=1) & (ahead[:, 2] > 0.0)
    middle = np.where(place[:, None], ahead, valid["mean"][:, :3])
    at = _ends_in_sensor_m(middle, np.zeros_like(half_px_m), p)[:, :, 0]
    half_m = np.abs(_ends_in_sensor_m(middle, half_px_m, p) - at[:, :, None]).max(axis=2)
    return np.asarray(product(half_m, np.abs(transform_sensor_to_base[:3, :3]).T))


def _ends_in_sensor_m(middle: Floats, half: Floats, parameters: np.void) -> Floats:
    """Return the least and greatest X, Y, Z [m], (k, 3, 2), of all (u, v, z) within ``half`` of ``middle``.

    ``middle`` and ``half`` are (k, 3).
    """
    p = parameters
    pixels = np.stack([middle - half, middle + half], axis=2)[:, :2] - [[p["c_u"]], [p["c_v"]]]
    slopes = pixels / p["focal_px"]  # (k, 2, 2): x, y; least, greatest
    squares = slopes * slopes
    across = (slopes[:, :, 0] <= 0.0) & (slopes[:, :, 1] >= 0.0)
    least = np.where(across, 0.0, squares.min(axis=2)).sum(axis=1)
    most = squares.max(axis=2).sum(axis=1)
    radius_m = p["assumed_radius_m"] / np.sqrt(np.stack([most, least], axis=1) + 1.0)
    depths = middle[:, 2:] + half[:, 2:] * [-1.0, 1.0] + radius_m  # (k, 2)
    sides = slopes[:, :, :, None] * depths[:, None, None, :]  # (k, 2, 2, 2)
    sides = sides.reshape(len(middle), 2, 4)
    return np.concatenate([np.stack([sides.min(axis=2), sides.max(axis=2)], axis=2), depths[:, None]], axis=1)
