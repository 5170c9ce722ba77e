"""Obstacles in the cell in addition to the table and the object.

All obstacles are boxes.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from safety_harness.base.elementary import cos, product, sin
from safety_harness.base.settings import Vector3
from safety_harness.scenario.codec import POINT, TURN, Below, QuantityValue, Several, declared, key, table_of
from safety_harness.scenario.units import LENGTH

MAX_OBSTACLES = 50  # a choice
_EDGES = Several(
    of=QuantityValue(LENGTH, least=0.001, most=10.0),
    kind="list of three lengths",
    expected="a list of three lengths, its edges, such as 400 mm",
    count=3,
)
_BOX = "- {box: [400 mm, 300 mm, 500 mm], at: [900 mm, 500 mm, 0 mm]}"


@declared
class Obstacle:
    """A box in the base frame, turned by ``yaw_rad`` about the vertical axis.

    Points on its surface count as inside.
    """

    size_m: Vector3 = key("box", _EDGES, "its edges, before it is turned along x, y and z of the base", _BOX)
    position_in_base_m: Vector3 = key("at", POINT, "of its middle", _BOX)
    yaw_rad: float = key("yaw", TURN, "turn about the vertical", f"{_BOX[:-1]}, yaw: 20 deg}}", default=0.0)

    @property
    def corners_in_base_m(self) -> NDArray[np.float64]:
        """The corners (8, 3): the four lower corners in order around the box, then the four upper corners."""
        across, along, half_height = (0.5 * edge for edge in self.size_m)
        square = np.array([[across, along], [-across, along], [-across, -along], [across, -along]])
        c, s = cos(self.yaw_rad), sin(self.yaw_rad)
        square = product(square, np.array([[c, s], [-s, c]]))
        corners: NDArray[np.float64] = np.concatenate(
            [np.column_stack([square, np.full(4, z)]) for z in (-half_height, half_height)]
        )
        corners += np.array(self.position_in_base_m)
        return corners


OBSTACLES = Several(
    of=Below(tables=(table_of(Obstacle, "an obstacle", path="obstacles"),)),
    kind=f"list of at most {MAX_OBSTACLES}",
    expected="a list of boxes",
    most=MAX_OBSTACLES,
)
