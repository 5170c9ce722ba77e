"""From a colour image to the object's pixels, by thresholding as in the paper (OpenCV).

The object is nearly black on a light table.  Nothing else that may come into view is: black is what
is dark in *every* colour channel, so that the order of the channels does not matter and a blue
sleeve, whose brightness is low but whose blue is not, is distinguished.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

# The cell's colours, R G B; a simulated world paints with them.
OBJECT_RGB = (20, 20, 20)
TABLE_RGB = (225, 220, 210)

# Three times the object's own brightness, and what is left of the sleeve's blue in 30 % of the light.
OBJECT_BRIGHTEST = 60
# A smaller region is a speck: the default object covers some 4,800 pixels from 0.65 m, and still 200
# from 3 m.
OBJECT_SMALLEST_PX = 200


def object_mask(colour: NDArray[np.uint8]) -> NDArray[np.uint8]:  # (h, w, 3) -> (h, w)
    """1 on the object's pixels, 0 elsewhere; all 0 if no complete object is in view.

    The object is the largest connected black region that does not touch the image border: one
    that does may be cropped, and a cropped triangle can have the features of a whole one.  A hand
    in front of the object is not noticed as such: it cuts the region or changes its shape.
    """
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
