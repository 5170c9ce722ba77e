"""Types of float64 arrays for the parameters of compiled functions.

A type's name states the array's shape.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array2x3 = NDArray[np.float64]  # (2, 3): the ends of a segment
Array3 = NDArray[np.float64]  # (3,): a point, a direction
Array3x3 = NDArray[np.float64]  # (3, 3): a rotation
Array4x4 = NDArray[np.float64]  # (4, 4): a transform
Array5 = NDArray[np.float64]  # (5,): a hand's box
Array6 = NDArray[np.float64]  # (6,): a number for each feature, or joint of an arm with six; a twist (v, w)
Array6x6 = NDArray[np.float64]  # (6, 6)
Array31 = NDArray[np.float64]  # (31,): the moments of an image
Array6xN = NDArray[np.float64]  # (6, n): a twist for each joint
ArrayN = NDArray[np.float64]  # (n,): a number for each joint
ArrayNx2x3 = NDArray[np.float64]  # (n, 2, 3): the ends of n segments
ArrayNx3 = NDArray[np.float64]  # (n, 3): points; a direction for each joint
ArrayNx4x4 = NDArray[np.float64]  # (n + 2, 4, 4): the transforms of ``forward_kinematics`` of n joints
ArrayNx6 = NDArray[np.float64]  # (n, 6): joint positions, one a row
