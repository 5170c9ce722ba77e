"""Compute a box around a hand's predicted position that contains the hand with a given probability.

For h hands, the filter's values u, v and z are n = 3 h independent numbers. Each number is within k standard
deviations of its mean with the probability P^(1/n). Here k = q((1 + P^(1/n))/2), where q is the normal
quantile. So all n numbers are simultaneously within k standard deviations with the probability P. If the
filter extrapolates by t, the variance is

    P00 + 2 t P01 + t^2 P11 + t^4/4 s^2

(``hand_filter.wait``). Interval arithmetic computes the intervals of X = x D, Y = y D and D from the
intervals of u, v and z. Here D = z + r/sqrt(x^2 + y^2 + 1). The result is a box along the base's axes. The
module assumes, without a check, that the filter's covariance is right.
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
    """Return the half widths of the boxes of the k valid tracks, along the base's axes, shape (k, 3) [m].

    The centre of a box is the position that ``predict_positions`` computes for ``at_time_s``. All hands are
    simultaneously in their boxes with the probability ``probability``. ``tracks`` (n,) contains records
    TRACK, ``parameters`` (1,) is a record FILTER_PARAMETERS, and ``transform_sensor_to_base`` (4, 4) is the
    pose of the sensor.
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
    """Return the least and the greatest X, Y and Z [m] of all (u, v, z) near ``middle``, shape (k, 3, 2).

    The entries of (u, v, z) differ from ``middle`` by at most ``half``. ``middle`` and ``half`` have the
    shape (k, 3).
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
