"""The camera's twist as one of the TCP: against a rigid body that is moved a little."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from bench import AWAY, Bench

from safety_harness.base.geometry.rotations import rotation_from_vector, vector_from_rotation
from safety_harness.base.geometry.transforms import inverse_transform, transform_from
from safety_harness.base.settings import DEFAULTS, Vector3
from safety_harness.cell.controller.motion import servo_twist
from safety_harness.cell.perception.camera import transform_camera_to_tcp
from safety_harness.trace.records import Mode

MOUNTED = replace(
    DEFAULTS, camera=replace(DEFAULTS.camera, mount_offset_in_tcp_m=(0.03, -0.045, 0.02), mount_yaw_rad=1.1)
)


@pytest.mark.parametrize("tilt", [(0.0, 0.0, 0.0), (0.05, -0.03, 0.08), (-0.04, 0.06, -0.05)])
def test_the_tcp_moves_as_what_carries_a_camera_that_moves_by_eq_1(tilt: Vector3) -> None:
    bench = Bench(settings=MOUNTED, tilt=tilt)
    assert bench.tick(AWAY)["mode"] == Mode.SERVOING
    records, twist = bench.controller.records, np.full(6, np.nan)
    servo_twist(records.parameters, records.state, twist)
    of_camera, dt_s = records.state["camera_twist"][0], 1e-5
    assert (np.abs(of_camera[3:]) > 1e-4).all() or tilt == (0.0, 0.0, 0.0)

    camera_to_tcp = transform_camera_to_tcp(MOUNTED.camera, calibrated=True)
    moved = transform_from(rotation_from_vector(dt_s * of_camera[3:]), dt_s * of_camera[:3])
    after = bench.pose @ camera_to_tcp @ moved @ inverse_transform(camera_to_tcp)
    expected = np.concatenate(
        [
            after[:3, 3] - bench.pose[:3, 3],
            vector_from_rotation(after[:3, :3] @ bench.pose[:3, :3].T),
        ]
    )
    assert twist == pytest.approx(expected / dt_s, rel=1e-4, abs=1e-6)
