"""Rendered images: what PyBullet's software renderer shows from a camera, and what is made of it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from safety_harness.perception.hand_boxes import rendered_principal_point_px
from safety_harness.perception.moments import MOMENT_COUNT
from safety_harness.perception.raster import mask_moments
from safety_harness.perception.threshold import object_mask
from safety_harness.simulation.engine import pybullet

NEAR_M, FAR_M = 0.02, 5.0


def render(
    client: int,
    transform_camera_to_base: NDArray[np.float64],  # (4, 4)
    focal_px: float,
    width_px: int,
    height_px: int,
) -> tuple[NDArray[np.uint8], NDArray[np.float64]]:
    """Colour (h, w, 3) and depth along the optical axis (h, w) [m]; pixels hit by nothing are +inf deep.

    OpenGL's camera looks along -z with y up; ours looks along z with y down.
    """
    eye = transform_camera_to_base[:3, 3]
    view = pybullet.computeViewMatrix(
        eye, eye + transform_camera_to_base[:3, 2], -transform_camera_to_base[:3, 1]
    )
    projection = (
        (2.0 * focal_px / width_px, 0.0, 0.0, 0.0)
        + (0.0, 2.0 * focal_px / height_px, 0.0, 0.0)
        + (0.0, 0.0, -(FAR_M + NEAR_M) / (FAR_M - NEAR_M), -1.0)
        + (0.0, 0.0, -2.0 * FAR_M * NEAR_M / (FAR_M - NEAR_M), 0.0)
    )
    _, _, colour, buffer, _ = pybullet.getCameraImage(
        width_px,
        height_px,
        view,
        projection,
        shadow=0,
        lightDirection=(0.0, 0.0, 1.0),
        renderer=pybullet.ER_TINY_RENDERER,
        physicsClientId=client,
    )
    buffer = np.asarray(buffer, dtype=np.float64).reshape(height_px, width_px)
    depth_m = FAR_M * NEAR_M / (FAR_M - (FAR_M - NEAR_M) * buffer)
    depth_m[buffer >= 1.0] = np.inf
    pixels = np.asarray(colour, dtype=np.uint8).reshape(height_px, width_px, 4)
    return np.ascontiguousarray(pixels[:, :, :3]), depth_m


def rendered_object(colour: NDArray[np.uint8], focal_px: float) -> tuple[bool, NDArray[np.float64]]:
    """(visible, moments (31,)) of the thresholded object in a rendered image."""
    moments = np.full(MOMENT_COUNT, np.nan)
    mask = object_mask(colour)
    c_u, c_v = rendered_principal_point_px(colour.shape[1], colour.shape[0])
    pixels = mask_moments(mask, focal_px, c_u, c_v, moments)
    return pixels > 0, moments
