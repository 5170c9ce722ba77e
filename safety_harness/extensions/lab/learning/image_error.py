"""Compute the image errors |f - f*|^2 (eq. 15) of many candidates in one compiled call."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from safety_harness.base.compiled import compiled
from safety_harness.base.exceptions import DatasetError, Place
from safety_harness.base.settings import ObjectKind, Settings
from safety_harness.cell.controller.desired import desired_camera, view_of
from safety_harness.cell.perception.camera import polygon_in_camera, polygon_inside_image, project
from safety_harness.cell.perception.moments import MOMENT_COUNT, point_moments, polygon_moments
from safety_harness.cell.perception.raster import raster_moments
from safety_harness.cell.servoing.features import feature_error, features


class ImageErrors(NamedTuple):
    """The image errors of TCP positions in the desired orientation, and a selection by these errors.

    The features at the desired pose are f* = ``features``, with the area a* = ``area`` and the depth Z* =
    ``depth_m``.  ``dense`` is True for a dense object and False for a discrete object.
    """

    polygon_m: NDArray[np.float64]  # (corners, 2)
    desired_position_in_base_m: NDArray[np.float64]  # (3,)
    transform_camera_to_base: NDArray[np.float64]  # (4, 4) at the desired pose
    transform_object_to_camera: NDArray[np.float64]  # (4, 4) at the desired pose
    features: NDArray[np.float64]  # (6,)
    area: float
    depth_m: float
    dense: bool
    focal_px: float
    width_px: int
    height_px: int

    @classmethod
    def from_settings(cls, settings: Settings) -> ImageErrors:
        """Return an instance for the cell of ``settings``; the camera has its true mount."""
        camera_to_base, object_to_camera = desired_camera(settings)
        view, camera = view_of(settings), settings.camera
        return cls(
            np.array(settings.object.polygon_m),
            np.array(settings.cell.desired_tcp_position_in_base_m),
            camera_to_base,
            np.ascontiguousarray(object_to_camera),
            view.features,
            view.area,
            view.depth_m,
            view.dense,
            camera.focal_px,
            camera.width_px,
            camera.height_px,
        )

    def at(
        self, positions_in_base_m: NDArray[np.float64], *, raster: bool = False
    ) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
        """Return the error at each position, and whether the whole object is in view there, shape (...).

        The error is |f - f*|^2 (eq. 15, in metres and radians), where f are the features of the image from
        the position.  The error is +inf if there is no image of the object.  The exact image has no border,
        so the error exists even if the object is beyond the sensor's border.

        Args:
            positions_in_base_m: (..., 3) TCP positions in the base frame.
            raster: Whether to sample the image at pixel centres and crop it to the sensor, as the camera
                does.  This works only for dense objects.

        Raises:
            DatasetError: ``raster`` is set for a discrete object.

        """
        if raster and not self.dense:
            raise DatasetError(
                place=Place(field="servo.object_kind"),
                expected=f"a {ObjectKind.DENSE.value} object for raster images",
                got=ObjectKind.DISCRETE.value,
            )
        positions = np.ascontiguousarray(positions_in_base_m, dtype=np.float64).reshape(-1, 3)
        errors, in_view = np.empty(len(positions)), np.empty(len(positions), np.bool_)
        _image_errors(self, positions, raster, errors, in_view)
        shape = positions_in_base_m.shape[:-1]
        return errors.reshape(shape), in_view.reshape(shape)

    def select(
        self, positions_in_base_m: NDArray[np.float64], *, raster: bool = False
    ) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Return each TCP's selected candidate and number of candidates in view, shape (n,) each.

        The first array contains the indices of the selected candidates.

        A candidate is in view if the camera sees the whole object from this candidate.  The selected
        candidate has the least error among the candidates in view.  If no candidate is in view, it has the
        least error among all candidates.

        Args:
            positions_in_base_m: (n, c, 3) the c candidates of each of n TCPs, in the base frame.
            raster: The same meaning as in ``at``.

        Raises:
            DatasetError: For some TCP, no candidate has an image of the object.

        """
        errors, in_view = self.at(positions_in_base_m, raster=raster)
        counts = np.count_nonzero(in_view, axis=1)
        allowed = np.where(in_view | (counts == 0)[:, None], errors, np.inf)
        best = np.argmin(allowed, axis=1)
        blind = ~np.isfinite(allowed[np.arange(len(best)), best])
        if blind.any():
            raise DatasetError(
                place=Place(field="candidates"),
                expected="an image of the object from at least one candidate of every TCP",
                got=f"{int(blind.sum())} of {len(best)} TCPs without any",
                hint="the space reaches beyond the camera's view from above",
            )
        return best.astype(np.int64), counts.astype(np.int64)


@compiled
def _image_errors(
    sight: ImageErrors,
    positions_in_base_m: NDArray[np.float64],  # (n, 3) of the TCP
    raster: bool,
    errors_out: NDArray[np.float64],  # (n,)
    in_view_out: NDArray[np.bool_],  # (n,)
) -> None:
    """Fill ``errors_out`` and ``in_view_out`` with the two results of ``ImageErrors.at``.

    If the camera moves, the object moves in the opposite direction in the camera frame:

        t(p) = t* - R_camera_to_base^T (p - p*)

    Here t is the object's position in the camera frame and p is the position of the TCP.  The * marks the
    desired pose.  The orientation R is the same for all positions.
    """
    corners = sight.polygon_m.shape[0]
    pose = sight.transform_object_to_camera.copy()
    points, image = np.empty((corners, 3)), np.empty((corners, 2))
    moments, current, error = np.empty(MOMENT_COUNT), np.empty(6), np.empty(6)
    for k in range(positions_in_base_m.shape[0]):
        for i in range(3):
            pose[i, 3] = sight.transform_object_to_camera[i, 3]
            for j in range(3):
                shift_m = positions_in_base_m[k, j] - sight.desired_position_in_base_m[j]
                pose[i, 3] -= sight.transform_camera_to_base[j, i] * shift_m
        # A position without an image keeps these values, and ``argmin`` never selects it.
        errors_out[k] = np.inf
        in_view_out[k] = False
        polygon_in_camera(sight.polygon_m, pose, points)
        if not project(points, image):
            continue
        inside = polygon_inside_image(image, sight.focal_px, sight.width_px, sight.height_px)
        if raster:
            usable = raster_moments(image, sight.focal_px, sight.width_px, sight.height_px, moments) > 0
        elif sight.dense:
            usable = polygon_moments(image, moments)
        else:
            usable = point_moments(image, moments)
        if usable and features(moments, sight.area, sight.depth_m, sight.dense, current):
            errors_out[k] = feature_error(current, sight.features, error)
            in_view_out[k] = inside
