from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from disagreement import noted
from filterpy.kalman import KalmanFilter
from numpy.typing import NDArray

from safety_harness.base.exceptions import SettingsError
from safety_harness.base.settings import DEFAULTS, HandFilter
from safety_harness.cell.perception.hand_filter import (
    TRACK,
    filter_parameters,
    initialise,
    predict,
    update,
    wait,
)

PARAMETERS = filter_parameters(DEFAULTS.hand_filter, DEFAULTS.hand_sensor)[0]
PAIR_STATES = ((0, 5), (1, 6), (2, 7), (3, 8))


def random_box(rng: np.random.Generator) -> NDArray[np.float64]:
    return np.array(
        [rng.uniform(0, 640), rng.uniform(0, 480), rng.uniform(0.4, 1.7), rng.uniform(500, 2e4), 1.1]
    )


def started(box: NDArray[np.float64], time_s: float = 0.0) -> np.void:
    track = np.zeros(1, TRACK)[0]
    initialise(track, box, time_s, PARAMETERS)
    return track


def full_covariance(track: np.void) -> NDArray[np.float64]:  # (9, 9)
    covariance = np.zeros((9, 9))
    for row, (value, rate) in zip(track["pair_covariance"], PAIR_STATES, strict=True):
        covariance[value, value], covariance[rate, rate] = row[0], row[2]
        covariance[value, rate] = covariance[rate, value] = row[1]
    covariance[4, 4] = track["aspect_variance"]
    return covariance


def reference(box: NDArray[np.float64], settings: HandFilter) -> KalmanFilter:
    """Eq. 7 as a textbook filter with full matrices."""
    peer = KalmanFilter(dim_x=9, dim_z=5)
    peer.x = np.concatenate([box, np.zeros(4)])[:, None]
    peer.H = np.eye(5, 9)
    deviations = [
        settings.measurement_std_px,
        settings.measurement_std_px,
        settings.measurement_std_depth_m,
        settings.measurement_std_area_px2,
        settings.measurement_std_aspect,
    ]
    peer.R = np.diag(np.square(deviations))
    pixel, depth = settings.initial_speed_std_pxps, settings.initial_speed_std_depth_mps
    peer.P = np.diag(np.square([*deviations, pixel, pixel, depth, 2 * box[3] / box[2] * depth]))
    return peer


def reference_predict(peer: KalmanFilter, dt_s: float, settings: HandFilter) -> None:
    pixel, depth = settings.acceleration_std_pxps2, settings.acceleration_std_depth_mps2
    motion, noise = np.eye(9), np.zeros((9, 9))
    for value, rate in PAIR_STATES:
        motion[value, rate] = dt_s
    for (value, rate), acceleration in zip(PAIR_STATES[:3], (pixel, pixel, depth), strict=True):
        effect = np.zeros(9)
        effect[value], effect[rate] = dt_s**2 / 2, dt_s
        noise += acceleration**2 * np.outer(effect, effect)
    # The area's rate walks at random: integrate the effect of its increments over the step.
    nodes, weights = np.polynomial.legendre.leggauss(3)
    for ago, weight in zip((nodes + 1) / 2 * dt_s, weights / 2 * dt_s, strict=True):
        effect = np.zeros(9)
        effect[3], effect[8] = ago, 1.0
        noise += weight * settings.area_rate_std_px2ps**2 * np.outer(effect, effect)
    peer.predict(F=motion, Q=noise)


@pytest.mark.parametrize("seed", range(5))
def test_the_decoupled_filter_is_the_nine_state_filter(seed: int) -> None:
    rng = np.random.default_rng(seed)
    box = random_box(rng)
    track, peer = started(box), reference(box, DEFAULTS.hand_filter)
    scale = np.array([640, 640, 1, 1e4, 1, 1e3, 1e3, 1, 1e5])
    for _ in range(200):
        dt_s = rng.choice([0.008, 1 / 30, rng.uniform(0.0, 0.2)])
        predict(track, dt_s, PARAMETERS)
        reference_predict(peer, dt_s, DEFAULTS.hand_filter)
        if rng.random() < 0.7:
            box = random_box(rng)
            update(track, box, PARAMETERS)
            peer.update(box[:, None])
        noted(
            "filterpy",
            "the hand filter's state",
            "parts of its scale",
            track["mean"] / scale,
            peer.x[:, 0] / scale,
        )
        np.testing.assert_allclose(track["mean"] / scale, peer.x[:, 0] / scale, rtol=1e-9, atol=1e-9)
        expected = peer.P / np.outer(scale, scale)
        np.testing.assert_allclose(
            full_covariance(track) / np.outer(scale, scale), expected, rtol=1e-9, atol=1e-9
        )


def test_the_covariance_stays_positive_definite() -> None:
    rng = np.random.default_rng(7)
    track = started(random_box(rng))
    for _ in range(20_000):
        predict(track, 0.008, PARAMETERS)
        update(track, random_box(rng), PARAMETERS)
    for value, cross, rate in track["pair_covariance"]:
        assert value > 0
        assert rate > 0
        assert value * rate - cross**2 > 0
    assert track["aspect_variance"] > 0


def test_a_measurement_never_makes_the_filter_less_certain() -> None:
    rng = np.random.default_rng(8)
    track = started(random_box(rng))
    for _ in range(50):
        predict(track, rng.uniform(0.001, 0.1), PARAMETERS)
        before = full_covariance(track)
        update(track, random_box(rng), PARAMETERS)
        smaller = np.linalg.eigvalsh(before - full_covariance(track))
        assert smaller.min() >= -1e-9 * np.abs(before).max()


def test_an_unseen_track_grows_uncertain() -> None:
    track = started(random_box(np.random.default_rng(9)))
    for _ in range(50):
        before = track["pair_covariance"].copy()
        predict(track, 0.008, PARAMETERS)
        assert np.all(track["pair_covariance"][:, [0, 2]] > before[:, [0, 2]])
    assert track["last_seen_s"] == 0.0
    assert track["time_s"] == pytest.approx(0.4)


def test_waiting_grows_as_uncertain_as_predicting_but_does_not_move() -> None:
    rng = np.random.default_rng(10)
    waiting, moving = started(random_box(rng)), started(random_box(rng))
    waiting["mean"][5:] = moving["mean"][5:] = 1.0
    waiting["pair_covariance"] = moving["pair_covariance"]
    before = waiting["mean"].copy()
    wait(waiting, 0.1, PARAMETERS)
    predict(moving, 0.1, PARAMETERS)
    assert np.array_equal(waiting["mean"], before)
    assert np.array_equal(waiting["pair_covariance"], moving["pair_covariance"])


def test_the_filter_finds_a_constant_velocity() -> None:
    box = np.array([100.0, 200.0, 1.0, 5000.0, 1.2])
    rate = np.array([300.0, -200.0, -0.5, 4000.0, 0.0])
    track = started(box)
    for k in range(1, 101):
        predict(track, 0.01, PARAMETERS)
        update(track, box + 0.01 * k * rate, PARAMETERS)
    np.testing.assert_allclose(track["mean"][5:], rate[:4], rtol=1e-3)
    assert track["mean"][4] == pytest.approx(1.2)
    assert track["last_seen_s"] == track["time_s"]


@pytest.mark.parametrize(
    ("field", "value"),
    [("measurement_std_px", 0.0), ("gate_px", np.nan), ("acceleration_std_pxps2", -1.0)],
)
def test_an_impossible_setting_is_named(field: str, value: float) -> None:
    with pytest.raises(SettingsError, match=field):
        filter_parameters(replace(DEFAULTS.hand_filter, **{field: value}), DEFAULTS.hand_sensor)
