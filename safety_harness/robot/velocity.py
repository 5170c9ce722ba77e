"""From a TCP twist to joint velocities, with an honest word about singularities."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from safety_harness.compiled import compiled
from safety_harness.geometry.linear import invert
from safety_harness.robot.kinematics import smallest_singular_value


@compiled
def joint_velocity(
    jacobian: NDArray[np.float64],  # (6, 6)
    twist: NDArray[np.float64],  # (6,) v, w in the Jacobian's frame
    min_singular_value: float,
    joint_velocity_out: NDArray[np.float64],  # (6,)
) -> bool:
    """Solve J q' = twist; False (and zeros) nearer to a singularity than ``min_singular_value``.

    1/|J^-1|_F is never above the least singular value and costs nothing; only where it is below
    the bound is the singular value itself computed.
    """
    inverse = np.empty((6, 6))
    regular = invert(jacobian, inverse)
    norm2 = 0.0
    for i in range(6):
        for j in range(6):
            norm2 += inverse[i, j] * inverse[i, j]
    if regular and not norm2 * min_singular_value * min_singular_value <= 1.0:
        regular = np.isfinite(norm2) and smallest_singular_value(jacobian) > min_singular_value
    for i in range(6):
        total = 0.0
        for j in range(6):
            total += inverse[i, j] * twist[j]
        joint_velocity_out[i] = total if regular else 0.0
    return regular
