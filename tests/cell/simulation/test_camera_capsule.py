"""The capsule of the hand-eye camera leaves the corners of the camera's body outside, as limits.md says."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest

from safety_harness.base.settings import DEFAULTS
from safety_harness.cell.robot.capsules import load_capsules
from safety_harness.cell.simulation.truth import cell_capsules


def test_a_corner_of_the_cameras_body_protrudes_by_7_3_mm_and_no_point_by_more() -> None:
    camera = cell_capsules(load_capsules(), DEFAULTS).records[-1]
    start, end = camera["start_in_link"], camera["end_in_link"]
    middle, along = (start + end) / 2.0, (end - start) / np.linalg.norm(end - start)
    up = np.array([0.0, 0.0, 1.0])
    aside = np.cross(up, along)
    outside_m = []
    for x, y, z in product((-0.045, 0.045), (-0.0125, 0.0125), (-0.0125, 0.0125)):  # a corner is farthest
        corner = middle + x * along + y * aside + z * up
        on_axis = np.clip((corner - start) @ along, 0.0, np.linalg.norm(end - start))
        outside_m.append(np.linalg.norm(corner - start - on_axis * along) - camera["radius_m"])
    assert max(outside_m) == pytest.approx(0.0073, abs=5e-5)
