"""Filter a hand's bounding box by a Kalman filter (eq. 7 of the paper), on compiled records.

The state is x = (u, v, z, area, aspect, u', v', z', area'). A measurement is a box, which contains the first
five entries. The quantities u, v, z and the area form four pairs of a value and its rate. The aspect ratio
has no rate. Initial and measurement covariances are diagonal, and the noise acts on each pair separately. So
the filter of nine states separates *exactly* into four filters of two states and a filter of one state.
Therefore a track stores only 4 x 3 + 1 numbers of its covariance, and the filter inverts no matrix.
"""

from __future__ import annotations

from math import isfinite

import numpy as np
from numpy.typing import NDArray

from safety_harness.base.compiled import njit_no_nrt
from safety_harness.base.exceptions import Place, SettingsError
from safety_harness.base.settings import HandFilter, HandSensor
from safety_harness.cell.perception.hand_boxes import sensor_principal_point_px

PAIRS = 4  # u, v, z, area: pair i has its value in mean[i] and its rate in mean[5 + i]
ASPECT = 4
FEW_BOXES = 4  # up to this number of boxes, the assignment tries all pairings with tracks

TRACK = np.dtype(
    [
        ("valid", np.bool_),
        ("id", np.int64),  # 1, 2, ... in order of appearance; 0: never used
        ("time_s", np.float64),  # of the state
        ("last_seen_s", np.float64),  # capture time of the last measurement
        ("mean", np.float64, (9,)),  # eq. 7: px, px, m, px^2, 1, and per second
        ("pair_covariance", np.float64, (4, 3)),  # rows u, v, z, area: var(value), cov, var(rate)
        ("aspect_variance", np.float64),
        # of the present frame
        ("box", np.int64),  # the index of this track's box; -1: the frame has no box of it
        ("distance_px", np.float64, (FEW_BOXES,)),  # from the frame's first boxes; infinite: impossible pair
    ],
    align=True,
)

FILTER_PARAMETERS = np.dtype(
    [
        ("measurement_variance", np.float64, (5,)),
        ("acceleration_variance", np.float64, (3,)),  # u, v, z
        ("area_rate_density", np.float64),  # [px^4/s^3]
        ("initial_rate_variance", np.float64, (3,)),  # u, v, z
        ("gate_px", np.float64),
        ("track_timeout_s", np.float64),
        ("assumed_radius_m", np.float64),
        ("focal_px", np.float64),
        ("c_u", np.float64),
        ("c_v", np.float64),
    ],
    align=True,
)

_POSITIVE = (
    "measurement_std_px",
    "measurement_std_depth_m",
    "measurement_std_area_px2",
    "measurement_std_aspect",
    "gate_px",
    "track_timeout_s",
)
_NOT_NEGATIVE = (
    "acceleration_std_pxps2",
    "acceleration_std_depth_mps2",
    "area_rate_std_px2ps",
    "initial_speed_std_pxps",
    "initial_speed_std_depth_mps",
    "assumed_hand_radius_m",
)


def filter_parameters(hand_filter: HandFilter, hand_sensor: HandSensor) -> NDArray[np.void]:
    """Return the filter's settings for compiled code, as an array (1,) of ``FILTER_PARAMETERS``.

    Args:
        hand_filter: The filter's settings.
        hand_sensor: The sensor, with its focal length and principal point.

    Raises:
        SettingsError: A setting has a value for which the filter is not defined.

    """
    _require(hand_filter, _POSITIVE, zero_allowed=False)
    _require(hand_filter, _NOT_NEGATIVE, zero_allowed=True)
    _require(hand_sensor, ("focal_px", "width_px", "height_px"), zero_allowed=False)
    h = hand_filter
    parameters = np.zeros(1, FILTER_PARAMETERS)
    record = parameters[0]
    measurement_std = (
        h.measurement_std_px,
        h.measurement_std_px,
        h.measurement_std_depth_m,
        h.measurement_std_area_px2,
        h.measurement_std_aspect,
    )
    record["measurement_variance"] = np.square(measurement_std)
    acceleration_std = (h.acceleration_std_pxps2, h.acceleration_std_pxps2, h.acceleration_std_depth_mps2)
    record["acceleration_variance"] = np.square(acceleration_std)
    record["area_rate_density"] = h.area_rate_std_px2ps * h.area_rate_std_px2ps
    rate_std = (h.initial_speed_std_pxps, h.initial_speed_std_pxps, h.initial_speed_std_depth_mps)
    record["initial_rate_variance"] = np.square(rate_std)
    record["gate_px"] = h.gate_px
    record["track_timeout_s"] = h.track_timeout_s
    record["assumed_radius_m"] = h.assumed_hand_radius_m
    record["focal_px"] = hand_sensor.focal_px
    record["c_u"], record["c_v"] = sensor_principal_point_px(hand_sensor)
    return parameters


def _require(settings: HandFilter | HandSensor, names: tuple[str, ...], *, zero_allowed: bool) -> None:
    """Raise ``SettingsError`` unless the settings in ``names`` are finite and positive.

    If ``zero_allowed`` is True, they may also be zero.
    """
    for name in names:
        value = getattr(settings, name)
        if not (isfinite(value) and (value >= 0.0 if zero_allowed else value > 0.0)):
            raise SettingsError(
                place=Place(field=f"{type(settings).__name__}.{name}"),
                expected="a finite number, " + ("zero or more" if zero_allowed else "more than zero"),
                got=repr(value),
            )


@njit_no_nrt
def initialise(track: np.void, box: NDArray[np.float64], time_s: float, parameters: np.void) -> None:
    """Start ``track``, a record TRACK, with the state x = (box, 0).

    ``box`` (5,) is the bounding box that the sensor measured at ``time_s``. The values are as uncertain as a
    measurement. The settings state the uncertainty of the rates. The area's rate has no setting of its own.
    The area is proportional to 1/z^2, hence area' = -2 (area/z) z'. So the initial standard deviation of
    area' is the deviation of z' times 2 area/z. The caller sets the id of the track.
    """
    mean, covariance = track["mean"], track["pair_covariance"]
    for i in range(5):
        mean[i] = box[i]
    for i in range(PAIRS):
        mean[5 + i] = 0.0
        covariance[i, 0] = parameters["measurement_variance"][i]
        covariance[i, 1] = 0.0
    for i in range(3):
        covariance[i, 2] = parameters["initial_rate_variance"][i]
    rate_by_depth = 2.0 * box[3] / box[2]
    covariance[3, 2] = rate_by_depth * rate_by_depth * parameters["initial_rate_variance"][2]
    track["aspect_variance"] = parameters["measurement_variance"][ASPECT]
    track["time_s"] = time_s
    track["last_seen_s"] = time_s
    track["valid"] = True


@njit_no_nrt
def predict(track: np.void, dt_s: float, parameters: np.void) -> None:
    """Advance a track by ``dt_s`` >= 0.

    The function adds dt times the rate to each value, and calls ``wait`` for the covariance.
    """
    mean = track["mean"]
    for i in range(PAIRS):
        mean[i] += dt_s * mean[5 + i]
    wait(track, dt_s, parameters)


@njit_no_nrt
def wait(track: np.void, dt_s: float, parameters: np.void) -> None:
    """Advance the time and the covariance of a track by ``dt_s`` >= 0, without a change of its mean.

    The covariance P of each pair becomes F P F' + Q with F = ((1, dt), (0, 1)). For u, v and z, Q is s^2
    ((dt^4/4, dt^3/2), (dt^3/2, dt^2)). This noise assumes piecewise white acceleration: it has the standard
    deviation s, is constant during a step, and is independent between steps. For the area, Q is q ((dt^3/3,
    dt^2/2), (dt^2/2, dt)), which assumes a rate on a random walk of density q.
    """
    covariance = track["pair_covariance"]
    for i in range(PAIRS):
        # F P F^T of one pair. The value comes first, because it needs the covariance before this step.
        covariance[i, 0] += dt_s * (2.0 * covariance[i, 1] + dt_s * covariance[i, 2])
        covariance[i, 1] += dt_s * covariance[i, 2]
    squared = dt_s * dt_s
    for i in range(3):
        variance = parameters["acceleration_variance"][i]
        covariance[i, 0] += 0.25 * squared * squared * variance
        covariance[i, 1] += 0.5 * squared * dt_s * variance
        covariance[i, 2] += squared * variance
    density = parameters["area_rate_density"]
    covariance[3, 0] += density * squared * dt_s / 3.0
    covariance[3, 1] += 0.5 * density * squared
    covariance[3, 2] += density * dt_s
    track["time_s"] += dt_s


@njit_no_nrt
def update(track: np.void, box: NDArray[np.float64], parameters: np.void) -> None:
    """Correct a track with ``box`` (5,), which was measured at the time of the track's state.

    For each pair, x <- x + K (z - H x) with H = (1, 0) and the measurement z of variance R. The gain is K =
    (P00, P01)/S with S = P00 + R. The covariance becomes P00 R/S, P01 R/S, P11 - P01^2/S. These formulas
    result from multiplying out Joseph's form, which is symmetric by construction.
    """
    mean, covariance = track["mean"], track["pair_covariance"]
    for i in range(PAIRS):
        noise = parameters["measurement_variance"][i]
        total = covariance[i, 0] + noise
        innovation = box[i] - mean[i]
        value_gain, rate_gain = covariance[i, 0] / total, covariance[i, 1] / total
        mean[i] += value_gain * innovation
        mean[5 + i] += rate_gain * innovation
        # The rate's variance comes first, because it needs the old covariance of value and rate.
        covariance[i, 2] -= rate_gain * covariance[i, 1]
        covariance[i, 0] = value_gain * noise
        covariance[i, 1] = rate_gain * noise
    noise = parameters["measurement_variance"][ASPECT]
    gain = track["aspect_variance"] / (track["aspect_variance"] + noise)
    mean[ASPECT] += gain * (box[ASPECT] - mean[ASPECT])
    track["aspect_variance"] = gain * noise
    track["last_seen_s"] = track["time_s"]
