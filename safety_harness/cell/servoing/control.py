"""Compute the control law v = -lambda L^+ e (eq. 1), and the desired view, which is its target."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from safety_harness.base.compiled import compiled, njit_no_nrt
from safety_harness.base.elementary import hypot, product
from safety_harness.base.exceptions import Place, SettingsError
from safety_harness.base.geometry.arrays import Array4x4, Array6, Array6x6, Array31
from safety_harness.base.geometry.linear import eigen, invert, solve_in_place
from safety_harness.base.settings import InteractionChoice, ObjectKind
from safety_harness.cell.perception.camera import object_plane, polygon_in_camera, project
from safety_harness.cell.perception.moments import MOMENT_COUNT, XG, YG, point_moments, polygon_moments
from safety_harness.cell.servoing.features import A_N, area, brackets, features
from safety_harness.cell.servoing.interaction import interaction_matrix

# Numbers of InteractionChoice for compiled code.
DESIRED, CURRENT, MEAN = range(3)

# If a bracket pair or a singular value is this much smaller than the largest, it is only rounding.
NEGLIGIBLE = 1e-6


def choice_code(choice: InteractionChoice) -> int:
    """Return the number by which ``camera_twist`` refers to ``choice``."""
    return (InteractionChoice.DESIRED, InteractionChoice.CURRENT, InteractionChoice.MEAN).index(choice)


@dataclass(frozen=True, kw_only=True, eq=False)
class DesiredView:
    """The camera's view from the desired pose, and the interaction matrix L* at this pose.

    All arrays are read-only. ``area`` is a* of eq. 3, ``depth_m`` is the depth Z* of the object's centroid,
    and ``plane`` contains (A, B, C) of the object's plane. ``condition_number`` is the ratio of the largest
    to the smallest singular value of L*.
    """

    dense: bool
    features: NDArray[np.float64]  # (6,) f*
    area: float
    depth_m: float
    moments: NDArray[np.float64]  # (31,)
    plane: NDArray[np.float64]  # (3,)
    interaction: NDArray[np.float64]  # (6, 6) L*
    interaction_pinv: NDArray[np.float64]  # (6, 6)
    condition_number: float

    def __post_init__(self) -> None:
        for array in (self.features, self.moments, self.plane, self.interaction, self.interaction_pinv):
            array.setflags(write=False)


def desired_view(
    polygon_m: NDArray[np.float64],  # (n, 2)
    transform_object_to_camera: Array4x4,  # at the desired pose
    object_kind: ObjectKind,
    *,
    place: Place = Place(field="object.polygon"),  # noqa: B008 (frozen)
) -> DesiredView:
    """Return the desired view of a flat object.

    ``polygon_m`` is in the object's own frame. The mirror symmetry of an isosceles triangle makes two rows of
    L* dependent, so that the rank of L* is 5. For an equilateral triangle gamma is 0/0.

    Args:
        polygon_m: The object's vertices (n, 2).
        transform_object_to_camera: The object's pose (4, 4) at the desired pose of the camera.
        object_kind: Whether the object is dense (a region) or discrete (points).
        place: The place that an error states.

    Raises:
        SettingsError: The camera cannot see the object from there, or the object is too symmetric for
            servoing.

    """
    dense = object_kind is ObjectKind.DENSE
    points_in_camera = np.empty((len(polygon_m), 3))
    normalised = np.empty((len(polygon_m), 2))
    plane = np.empty(3)
    moments = np.empty(MOMENT_COUNT)
    polygon_in_camera(polygon_m, transform_object_to_camera, points_in_camera)
    seen = object_plane(transform_object_to_camera, plane) and project(points_in_camera, normalised)
    seen = seen and (polygon_moments if dense else point_moments)(normalised, moments)
    if not seen:
        raise SettingsError(
            place=place,
            expected="an object with an area, in front of the camera at the desired pose",
            got="one that cannot be seen from there",
        )
    depth_m = float(1.0 / (plane[0] * moments[XG] + plane[1] * moments[YG] + plane[2]))
    desired_area = float(area(moments, dense))
    f = np.empty(6)
    interaction = np.empty((6, 6))
    # Before the features, whose gamma would be 0/0, so that the error can state the true reason.
    _refuse_threefold_symmetry(moments, place)
    finite = features(moments, desired_area, depth_m, dense, f)
    finite = interaction_matrix(moments, plane, desired_area, depth_m, dense, interaction) and finite
    # The singular values of L* are the roots of the eigenvalues of L*^T L*. numpy's svd calls LAPACK, whose
    # last bits depend on the processor.
    squares = eigen(product(interaction.T, interaction))[0] if finite else np.zeros(6)
    singular_values = np.sqrt(np.maximum(squares[::-1], 0.0))
    inverse = np.empty((6, 6))
    regular = finite and invert(interaction, inverse)
    if not (regular and singular_values[-1] > NEGLIGIBLE * singular_values[0]):
        raise SettingsError(
            place=place,
            expected="an object whose interaction matrix has rank 6 at the desired pose",
            got=f"rank {int(np.sum(singular_values > NEGLIGIBLE * singular_values[0]))}",
            hint="a mirror-symmetric object (an isosceles triangle, say) leaves one motion unseen; "
            "a triangle near 3:4:5 is best",
        )
    return DesiredView(
        dense=dense,
        features=f,
        area=desired_area,
        depth_m=depth_m,
        moments=moments,
        plane=plane,
        interaction=interaction,
        interaction_pinv=inverse,
        condition_number=float(singular_values[0] / singular_values[-1]),
    )


def _refuse_threefold_symmetry(moments: Array31, place: Place) -> None:
    """Raise ``SettingsError`` if the invariant In3 of ``moments`` (31,) is zero up to rounding.

    The features gamma and delta would then be 0/0 or x/0.
    """
    pairs = np.empty((3, 2))
    brackets(moments, pairs)
    sizes = hypot(pairs[:, 0], pairs[:, 1])
    if not sizes[2] > NEGLIGIBLE * sizes.max():
        raise SettingsError(
            place=place,
            expected="an object whose invariants gamma and delta exist (In3 of eq. 5 is not zero)",
            got="one with a rotational symmetry (an equilateral triangle, say), whose In3 is zero",
            hint="a triangle near 3:4:5 is best",
        )


@njit_no_nrt
def camera_twist(
    choice: int,  # DESIRED, CURRENT or MEAN
    desired_interaction: Array6x6,  # L*
    desired_interaction_pinv: Array6x6,
    moments: Array31,  # current
    current_features: Array6,
    desired_area: float,
    desired_depth_m: float,
    dense: bool,
    gain: float,  # [1/s]
    error: Array6,  # e = f - f*
    out: Array6,
) -> bool:
    """Fill ``out`` with the camera's twist (v, w) by eq. 1, in the camera frame [m/s, rad/s].

        (v, w) = -lambda L^+ e,   L = L* (desired), L_f (current) or (L* + L_f)/2 (mean)

    Here lambda is the ``gain`` and e is the ``error``. Chaumette and Hutchinson (2006) describe these three
    choices of L. The current matrix L_f is eq. 2. This matrix assumes that the object's plane is parallel to
    the image, at the depth a_n, because the camera has no better estimate. The choice "mean" inverts the mean
    of L_f and L*. The pseudoinverse of a square matrix of full rank is its inverse, so the last two choices
    solve L (v, w) = -lambda e. Return False if the matrix is exactly singular or the result is not finite.
    """
    # L* is constant, so ``desired_view`` has inverted it once. It is the default: from tilted starts with
    # raster images, 92 to 100 % of the runs converged, with the current matrix 25 to 50 %.
    if choice == DESIRED:
        for row in range(6):
            total = 0.0
            for column in range(6):
                total += desired_interaction_pinv[row, column] * error[column]
            out[row] = -gain * total
    else:
        for row in range(6):
            out[row] = -gain * error[row]
        depth_m, mean = current_features[A_N], choice == MEAN
        if not _solve(desired_interaction, moments, depth_m, desired_area, desired_depth_m, dense, mean, out):
            return False
    finite = True
    for k in range(6):
        finite = finite and np.isfinite(out[k])
    return finite


@compiled
def _solve(
    desired_interaction: Array6x6,
    moments: Array31,
    depth_m: float,
    desired_area: float,
    desired_depth_m: float,
    dense: bool,
    mean: bool,
    vector: Array6,  # overwritten
) -> bool:
    """Solve L x = ``vector`` for x, and store x in ``vector``.

    L is the current matrix at ``depth_m`` or, if ``mean`` is True, the mean of this matrix and L*.
    """
    # The plane of eq. 2: A = B = 0 and C = 1/Z with Z = a_n.
    parallel, matrix = np.zeros(3), np.empty((6, 6))
    parallel[2] = 1.0 / depth_m
    if not interaction_matrix(moments, parallel, desired_area, desired_depth_m, dense, matrix):
        return False
    if mean:
        for row in range(6):
            for column in range(6):
                matrix[row, column] = 0.5 * (matrix[row, column] + desired_interaction[row, column])
    return solve_in_place(matrix, vector)
