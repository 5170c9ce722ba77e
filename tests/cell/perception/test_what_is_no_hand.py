"""Spheres, boxes and settings that cannot be: refused, whatever else is right about them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from safety_harness.base.exceptions import SettingsError
from safety_harness.base.settings import DEFAULTS
from safety_harness.cell.perception.detector import copy_detections
from safety_harness.cell.perception.hand_boxes import line_of_sight_blocked, sphere_box
from safety_harness.cell.perception.hand_filter import filter_parameters


@pytest.mark.parametrize("radius_m", [0.0, -0.06, np.nan, np.inf])
def test_a_sphere_without_a_size_has_no_box(radius_m: float) -> None:
    box = np.full(5, 7.0)
    assert not sphere_box(np.array([0.1, 0.0, 1.0]), radius_m, 600.0, 320.0, 240.0, box)
    assert np.all(box == 7.0)


@pytest.mark.parametrize(
    ("column", "value"),
    [(0, np.nan), (1, np.inf), (2, 0.0), (2, -1.0), (2, np.nan), (3, np.nan), (3, np.inf), (4, np.nan)],
)
def test_a_box_that_is_no_measurement_takes_the_place_of_none_that_is(column: int, value: float) -> None:
    rows = np.array([[k, 0.0, 1.0, 10.0 + k, 1.0] for k in range(4)] + [[9.0, 0.0, 1.0, 99.0, 1.0]])
    rows[-1, column] = value
    out = np.zeros((4, 5))
    assert copy_detections(rows, out) == 4
    assert np.array_equal(out, rows[:-1])


@pytest.mark.parametrize(
    "field",
    ["measurement_std_px", "measurement_std_depth_m", "measurement_std_area_px2", "measurement_std_aspect"]
    + ["gate_px", "track_timeout_s"],
)
@pytest.mark.parametrize("value", [0.0, -1.0, np.inf, np.nan])
def test_what_the_filter_divides_by_or_waits_for_is_finite_and_above_zero(field: str, value: float) -> None:
    with pytest.raises(SettingsError, match=field):
        filter_parameters(replace(DEFAULTS.hand_filter, **{field: value}), DEFAULTS.hand_sensor)


@pytest.mark.parametrize(
    "field",
    ["acceleration_std_pxps2", "acceleration_std_depth_mps2", "area_rate_std_px2ps"]
    + ["initial_speed_std_pxps", "initial_speed_std_depth_mps", "assumed_hand_radius_m"],
)
def test_noise_and_size_may_be_nothing_but_not_less_and_not_without_end(field: str) -> None:
    filter_parameters(replace(DEFAULTS.hand_filter, **{field: 0.0}), DEFAULTS.hand_sensor)
    for value in (-1e-9, np.inf, np.nan):
        with pytest.raises(SettingsError, match=field):
            filter_parameters(replace(DEFAULTS.hand_filter, **{field: value}), DEFAULTS.hand_sensor)


def test_a_capsule_that_is_not_among_those_given_hides_nothing() -> None:
    """It lies behind them in memory, in the middle of the line."""
    camera, hand = np.array([0.0, 0.0, 1.0]), np.zeros(3)
    aside, between = [[5.0, 0.0, 0.0], [5.0, 0.0, 1.0]], [[-1.0, 0.0, 0.5], [1.0, 0.0, 0.5]]
    capsules, radii_m = np.array([aside, between]), np.full(2, 0.05)
    assert line_of_sight_blocked(camera, hand, 0.06, capsules, radii_m)
    assert not line_of_sight_blocked(camera, hand, 0.06, capsules[:1], radii_m[:1])
