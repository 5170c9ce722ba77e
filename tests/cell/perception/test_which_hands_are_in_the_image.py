from __future__ import annotations

import numpy as np
import pytest

from safety_harness.cell.perception.camera import principal_point_px
from safety_harness.cell.perception.hand_boxes import box_in_image, sphere_box

WIDTH, HEIGHT, FOCAL, RADIUS = 640, 480, 615.0, 0.06
C_U, C_V = principal_point_px(WIDTH, HEIGHT)


@pytest.mark.parametrize(
    ("edge_px", "outwards"),
    [
        ((-0.5, 200.0), (-1.0, 0.0)),
        ((WIDTH - 0.5, 200.0), (1.0, 0.0)),
        ((300.0, -0.5), (0.0, -1.0)),
        ((300.0, HEIGHT - 0.5), (0.0, 1.0)),
    ],
)
@pytest.mark.parametrize("beyond_px", [-0.01, 0.01])
def test_a_hand_is_in_the_image_up_to_the_outer_edge_of_the_outermost_pixels(
    edge_px: tuple[float, float], outwards: tuple[float, float], beyond_px: float
) -> None:
    u_px, v_px = np.add(edge_px, beyond_px * np.array(outwards))
    centre = 0.8 * np.array([(u_px - C_U) / FOCAL, (v_px - C_V) / FOCAL, 1.0])
    box = np.empty(5)
    assert sphere_box(centre, RADIUS, FOCAL, C_U, C_V, box)
    assert box_in_image(centre, RADIUS, FOCAL, C_U, C_V, WIDTH, HEIGHT, box) == (beyond_px < 0.0)
