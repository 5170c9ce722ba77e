from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from safety_harness.base.exceptions import SettingsError
from safety_harness.base.settings import DEFAULTS, Settings
from safety_harness.cell.avoidance.candidates import CandidateCap, continuous_optimum

CAP = CandidateCap.from_settings(DEFAULTS)
MANY = replace(CAP, count=40_000)


def drawn(cap: CandidateCap, seed: int = 1) -> np.ndarray:
    return cap.draw(np.random.default_rng(seed))


def angles(cap: CandidateCap, offsets: np.ndarray) -> np.ndarray:
    """Angle (n,) between each offset and the cap's axis."""
    return np.arccos(np.clip(offsets @ cap.axis_in_base / cap.radius_m, -1.0, 1.0))


def with_avoidance(**changes: object) -> Settings:
    return replace(DEFAULTS, avoidance=replace(DEFAULTS.avoidance, **changes))


def test_candidates_lie_on_the_sphere_and_within_the_cone() -> None:
    offsets = drawn(MANY)
    assert offsets.shape == (MANY.count, 3)
    assert np.linalg.norm(offsets, axis=1) == pytest.approx(CAP.radius_m, abs=1e-15)
    assert angles(MANY, offsets).max() <= CAP.cone_rad + 1e-7
    assert angles(MANY, offsets).max() > 0.999 * CAP.cone_rad  # and they use all of it


def test_the_axis_points_from_the_nominal_hand_to_the_desired_tcp() -> None:
    away = np.array(DEFAULTS.cell.desired_tcp_position_in_base_m) - np.array(
        DEFAULTS.avoidance.nominal_hand_position_in_base_m
    )
    assert np.linalg.norm(CAP.axis_in_base) == pytest.approx(1.0, abs=1e-15)
    assert np.cross(CAP.axis_in_base, away) == pytest.approx(np.zeros(3), abs=1e-15)
    assert CAP.axis_in_base @ away > 0.0


def test_the_cap_covers_a_quarter_of_the_sphere() -> None:
    directions = np.random.default_rng(2).standard_normal((400_000, 3))
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    share = np.mean(directions @ CAP.axis_in_base >= np.cos(CAP.cone_rad))
    assert share == pytest.approx(0.25, abs=4.0 * np.sqrt(0.25 * 0.75 / len(directions)))


@pytest.mark.parametrize("within_rad", np.radians([15.0, 30.0, 45.0]))
def test_azimuth_and_elevation_are_normal_about_the_axis(within_rad: float) -> None:
    """The share within an inner cone, against the quadrature of two independent normal angles."""
    angle = np.linspace(-6.0 * CAP.sigma_rad, 6.0 * CAP.sigma_rad, 3001)
    weight = np.exp(-0.5 * (angle / CAP.sigma_rad) ** 2)
    density = np.outer(weight, weight)
    cosine = np.outer(np.cos(angle), np.cos(angle))
    expected = density[cosine >= np.cos(within_rad)].sum() / density[cosine >= np.cos(CAP.cone_rad)].sum()
    share = np.mean(angles(MANY, drawn(MANY)) <= within_rad)
    assert share == pytest.approx(expected, abs=4.0 * np.sqrt(0.25 / MANY.count) + 2e-3)
    uniform = (1.0 - np.cos(within_rad)) / (1.0 - np.cos(CAP.cone_rad))
    assert share > 1.05 * uniform


def test_the_candidates_favour_no_side_of_the_axis() -> None:
    mean = drawn(MANY).mean(axis=0) / CAP.radius_m
    sideways = mean - (mean @ CAP.axis_in_base) * CAP.axis_in_base
    assert np.linalg.norm(sideways) < 5.0 / np.sqrt(MANY.count)


def test_one_seed_is_one_set_of_candidates() -> None:
    assert np.array_equal(drawn(CAP, 7), drawn(CAP, 7))
    assert not np.isin(drawn(CAP, 7), drawn(CAP, 8)).any()


@pytest.mark.parametrize("below", [1.0, -1.0])
def test_a_vertical_axis_is_an_axis_like_any_other(below: float) -> None:
    x, y, z = DEFAULTS.cell.desired_tcp_position_in_base_m
    cap = CandidateCap.from_settings(with_avoidance(nominal_hand_position_in_base_m=(x, y, z - below)))
    offsets = drawn(cap)
    assert np.linalg.norm(offsets, axis=1) == pytest.approx(cap.radius_m, abs=1e-15)
    assert angles(cap, offsets).max() <= cap.cone_rad + 1e-7
    assert offsets[:, 2].min() * below > -cap.radius_m
    assert np.ptp(offsets, axis=0).min() > 0.4 * cap.radius_m


def test_what_can_never_be_drawn_is_refused() -> None:
    desired = DEFAULTS.cell.desired_tcp_position_in_base_m
    with pytest.raises(SettingsError, match="nominal hand position"):
        CandidateCap.from_settings(with_avoidance(nominal_hand_position_in_base_m=desired))
    with pytest.raises(SettingsError, match="candidate cone"):
        CandidateCap.from_settings(with_avoidance(candidate_cone_rad=1e-6))
    narrow = CandidateCap.from_settings(with_avoidance(candidate_cone_rad=np.radians(1.5)))
    assert angles(narrow, drawn(narrow)).max() <= np.radians(1.5) + 1e-7


def test_at_the_desired_position_rounding_does_not_choose_the_optimum() -> None:
    """Two ways to compute one pose differ by 1e-16 m, two worlds by 1e-11: both get the axis."""
    desired = np.array(DEFAULTS.cell.desired_tcp_position_in_base_m)
    for size in (0.0, 1e-16, 1e-11):
        tcps = desired + size * np.vstack((np.eye(3), -np.eye(3)))
        np.testing.assert_allclose(
            continuous_optimum(DEFAULTS, tcps) - tcps,
            np.tile(CAP.radius_m * CAP.axis_in_base, (6, 1)),
            atol=1e-15,
        )
