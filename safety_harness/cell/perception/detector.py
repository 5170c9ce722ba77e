"""Detect the bounding boxes of hands in a colour image and a depth image.

A user's detector can replace the detector of this module. The paper's detector is a YOLO network. The
detector here needs no network, because the simulator paints only its hands in the colour of skin. Any object
with the method ``detect`` of ``BoundingBoxDetector`` can replace it, for example a YOLO network in an ONNX
file:

    class YoloDetector:
        def __init__(self, file: Path) -> None:
            self._session = onnxruntime.InferenceSession(file)

        def detect(self, colour, depth_m):
            rows = []
            for left, top, right, bottom in self._hands(colour):  # network, threshold, suppression
                width, height = right - left, bottom - top
                u_px, v_px = (left + right - 1) / 2, (top + bottom - 1) / 2
                z_m = np.median(depth_m[round(v_px) - 1 : round(v_px) + 2, round(u_px) - 1 : round(u_px) + 2])
                rows.append((u_px, v_px, z_m, width * height, width / height))
            return np.array(rows).reshape(-1, 5)

In this example, ``left`` and ``right`` are edges, as in the output of most networks. An edge is half a pixel
away from the centre of a pixel. Edge 0 is the boundary before pixel 0, and the *centre* of pixel 0 is at u =
0. A detector should keep no state from frame to frame. The tracks keep the state, so that a run is
repeatable.

The module finds the object's pixels by a threshold, as the paper does (OpenCV). Only the object is nearly
black, and the table is light. A pixel is black if it is dark in *every* colour channel, so the order of the
channels does not matter. A blue sleeve has a low brightness but a high blue value, so it does not count as
black.
"""

from __future__ import annotations

from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from safety_harness.base.exceptions import SimulationError
from safety_harness.base.extras import IMAGES
from safety_harness.cell.perception.hand_boxes import BOX_LENGTH

# The simulator's paint.  Hues (OpenCV's scale of 0 to 179): hand 12, sleeve 113.
HAND_COLOUR_RGBA = (0.87, 0.67, 0.53, 1.0)
SLEEVE_COLOUR_RGBA = (0.15, 0.25, 0.60, 1.0)

# The range of skin, ends included: hue from 0 to 179, saturation and value from 0 to 255.
# Shading changes only the value, so hue and saturation decide.  Grey, white and black
# things have hardly any saturation, and blue things a very different hue.
SKIN_HSV_LEAST = (4, 60, 40)
SKIN_HSV_GREATEST = (22, 180, 255)

# The cell's colours, R G B; a simulated world paints with them.
OBJECT_RGB = (20, 20, 20)
TABLE_RGB = (225, 220, 210)

# Three times the object's own brightness, and less than the sleeve's blue in 30 % of the light.
OBJECT_BRIGHTEST = 60
# A smaller region is a speck: the default object covers some 4,800 pixels from 0.65 m, and still 200
# from 3 m.
OBJECT_SMALLEST_PX = 200

MINIMUM_AREA_PX = 50  # a choice: a smaller area is a speck and no hand
DEPTH_SAMPLES = 9  # a window of 3 x 3 pixels


class BoundingBoxDetector(Protocol):
    """A detector that finds hands in a frame of the hand sensor."""

    def detect(
        self,
        colour: NDArray[np.uint8],  # (h, w, 3) red, green, blue
        depth_m: NDArray[np.float64],  # (h, w) camera Z; 0 or not finite where unknown
    ) -> NDArray[np.float64]:
        """Return the boxes (k, 5) of all hands, with the columns u_px, v_px, z_m, area_px2, width/height.

        Integer coordinates are pixel centres. z_m is the depth of the surface at the box's centre. The
        harness ignores rows without a finite, positive depth. The number of rows k may be 0.

        Args:
            colour: The colour image.
            depth_m: The depth image.

        """
        ...


def opencv() -> Any:
    """Return the module cv2, which only rendered images need.

    Raise ``MissingPackageError`` if OpenCV is not installed.
    """
    with IMAGES.needed("rendered images"):
        import cv2
    return cv2


class SkinColourDetector:
    """A detector that takes connected skin-coloured areas for hands.

    A hand behind a narrow object gives two boxes. The detector then reports one hand too many, not too few.
    """

    def __init__(self, most: int = 4) -> None:
        self._most = most

    def detect(
        self,
        colour: NDArray[np.uint8],  # (h, w, 3) red, green, blue
        depth_m: NDArray[np.float64],  # (h, w) [m]
    ) -> NDArray[np.float64]:  # (k, 5)
        """Return the boxes of up to ``most`` skin-coloured areas of at least ``MINIMUM_AREA_PX``.

        The largest area comes first. The method leaves out areas without a known depth. Among the area's
        pixels with a known depth, the method takes the nine that are nearest to the box's centre. The depth
        is the median of these nine. These pixels form the 3 x 3 window around the centre, unless part of this
        window is hidden or has no depth.

        Args:
            colour: The colour image.
            depth_m: The depth image.

        """
        cv2 = opencv()
        hsv = cv2.cvtColor(colour, cv2.COLOR_RGB2HSV)
        skin = cv2.inRange(hsv, SKIN_HSV_LEAST, SKIN_HSV_GREATEST)
        count, labels, statistics, _ = cv2.connectedComponentsWithStats(skin, connectivity=8)
        area = statistics[:, cv2.CC_STAT_AREA]
        boxes: list[tuple[float, float, float, float, float]] = []
        for label in sorted(range(1, count), key=lambda k: (-area[k], k)):
            if area[label] < MINIMUM_AREA_PX or len(boxes) == self._most:
                break
            left, top, width, height = (int(value) for value in statistics[label, :4])
            u_px, v_px = left + (width - 1) / 2, top + (height - 1) / 2
            window = np.s_[top : top + height, left : left + width]
            z_m = _depth_near(labels[window] == label, depth_m[window], (width - 1) / 2, (height - 1) / 2)
            if z_m is not None:
                boxes.append((u_px, v_px, z_m, float(width * height), width / height))
        return np.array(boxes, np.float64).reshape(-1, BOX_LENGTH)


def _depth_near(
    area: NDArray[np.bool_], depth_m: NDArray[np.float64], u_px: float, v_px: float
) -> float | None:
    """Return the median depth [m] of the pixels in ``area`` that are nearest to (u, v), or None.

    The function uses the ``DEPTH_SAMPLES`` nearest pixels with a known depth. ``area`` has the shape (h, w).
    ``depth_m`` (h, w) is 0 or not finite where the depth is unknown. Return None if the depth is unknown in
    the whole area.
    """
    v, u = np.nonzero(area & np.isfinite(depth_m) & (depth_m > 0.0))
    if u.size == 0:
        return None
    nearest = np.argsort(np.square(u - u_px) + np.square(v - v_px), kind="stable")[:DEPTH_SAMPLES]
    return float(np.median(depth_m[v[nearest], u[nearest]]))


def copy_detections(boxes: NDArray[np.float64], boxes_out: NDArray[np.float64]) -> int:
    """Copy a detector's result into ``boxes_out`` (n, 5) and return the number of rows.

    If the detector reports more than n boxes, the function keeps the n largest in the image, in the
    detector's order.

    Args:
        boxes: The detector's result (k, 5).
        boxes_out: The rows to fill (n, 5).

    Raises:
        SimulationError: ``boxes`` is not an array of numbers of the shape (k, 5).

    """
    try:
        rows = np.asarray(boxes, np.float64)
    except (TypeError, ValueError) as error:
        raise SimulationError(f"the hand detector did not return an array of numbers: {error}") from error
    if rows.ndim != 2 or rows.shape[1] != BOX_LENGTH:
        raise SimulationError(f"the hand detector has to return boxes (k, 5), not shape {rows.shape}")
    if len(rows) > len(boxes_out):
        usable = np.isfinite(rows).all(axis=1) & (rows[:, 2] > 0.0)
        order = np.argsort(np.where(usable, -rows[:, 3], np.inf), kind="stable")
        rows = rows[np.sort(order[: len(boxes_out)])]
    boxes_out[: len(rows)] = rows
    return len(rows)


def object_mask(colour: NDArray[np.uint8]) -> NDArray[np.uint8]:  # (h, w, 3) -> (h, w)
    """Return a mask with 1 on the object's pixels and 0 elsewhere.

    The mask is 0 everywhere if no complete object is in view. The object is the largest connected black
    region that does not touch the image border. The border may have cropped a region that touches it, and a
    cropped triangle can have the features of a whole triangle. A hand in front of the object may cut the
    region or change its shape, and the function does not detect this.
    """
    cv2 = opencv()
    black = cv2.inRange(colour, (0, 0, 0), (OBJECT_BRIGHTEST,) * 3)
    count, labels, stats, _ = cv2.connectedComponentsWithStats(black, connectivity=8)
    height_px, width_px = black.shape
    best, best_area = 0, OBJECT_SMALLEST_PX - 1
    for label in range(1, count):  # label 0 is the background
        left, top, width, height, pixels = stats[label]
        touches = left == 0 or top == 0 or left + width == width_px or top + height == height_px
        if not touches and pixels > best_area:
            best, best_area = label, pixels
    if best == 0:
        return np.zeros_like(black)
    return np.asarray(labels == best, dtype=np.uint8)
