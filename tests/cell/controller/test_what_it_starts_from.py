"""What the controller knows before it has seen anything, and what it does where it cannot compute."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from bench import AWAY, Bench

from safety_harness.base.geometry.transforms import inverse_transform
from safety_harness.base.settings import DEFAULTS, Settings
from safety_harness.cell.controller.desired import view_of
from safety_harness.cell.controller.motion import servo_twist
from safety_harness.cell.perception.camera import transform_camera_to_tcp
from safety_harness.cell.servoing.control import DesiredView
from safety_harness.trace.records import TICK, Mode


def test_before_the_first_image_it_knows_of_no_feature_and_stands() -> None:
    bench = Bench()
    observation = bench.observation((AWAY,))
    observation["image_new"] = False
    command = bench.controller.step(observation)
    row = np.zeros(1, TICK)
    bench.controller.report(row)
    assert row["mode"][0] == Mode.OBJECT_LOST
    for name in ("features", "feature_error", "sse"):
        assert np.isnan(row[name]).all(), name
    assert not command["joint_velocity_radps"].any()


@pytest.mark.parametrize("error", [np.inf, np.nan])
def test_where_eq_1_has_no_answer_the_object_counts_as_lost_and_nothing_is_demanded(error: float) -> None:
    bench = Bench()
    assert bench.tick(AWAY)["mode"] == Mode.SERVOING
    state, twist = bench.controller.records.state, np.zeros(6)
    state["feature_error"][0, 2] = error
    servo_twist(bench.controller.records.parameters, state, twist)
    assert state["mode"][0] == Mode.OBJECT_LOST
    assert state["gain"][0] == 0.0
    assert not state["camera_twist"].any()
    assert not twist.any()


def with_camera(**changes: object) -> Settings:
    return replace(DEFAULTS, camera=replace(DEFAULTS.camera, **changes))


def test_the_desired_image_is_that_of_the_true_camera_however_wrong_its_calibration() -> None:
    wrong = view_of(
        with_camera(
            calibration_error_rotation_rad=(0.02, -0.03, 0.1), calibration_error_offset_m=(0.01, 0.02, 0.0)
        )
    )
    right = view_of(DEFAULTS)
    for name in ("area", "depth_m", "features", "interaction"):
        assert np.array_equal(getattr(wrong, name), getattr(right, name)), name


@pytest.mark.parametrize("yaw_rad", [0.0, 0.3, -0.7])
def test_the_desired_image_of_a_turned_object_is_turned_and_nothing_else(yaw_rad: float) -> None:
    """Straight above a flat object a_n and the invariants do not change; alpha does by the angle."""
    turned: DesiredView = view_of(replace(DEFAULTS, object=replace(DEFAULTS.object, yaw_rad=yaw_rad)))
    straight = view_of(DEFAULTS)
    yaw_rad -= DEFAULTS.object.yaw_rad
    assert turned.area == pytest.approx(straight.area, rel=1e-12)
    assert turned.features[2:5] == pytest.approx(straight.features[2:5], rel=1e-9)
    off = np.abs(turned.features[5] - straight.features[5])
    assert min(off % np.pi, np.pi - off % np.pi) == pytest.approx(abs(yaw_rad), abs=1e-9)
    mount = transform_camera_to_tcp(DEFAULTS.camera, calibrated=False)
    assert turned.depth_m == pytest.approx(
        DEFAULTS.cell.desired_tcp_position_in_base_m[2]
        - DEFAULTS.object.position_in_base_m[2]
        + inverse_transform(mount)[2, 3],
        abs=1e-12,
    )
