from __future__ import annotations

import cv2
import numpy as np
import pytest

from safety_harness.cell.perception.detector import (
    HAND_COLOUR_RGBA,
    OBJECT_RGB,
    OBJECT_SMALLEST_PX,
    SLEEVE_COLOUR_RGBA,
    TABLE_RGB,
    object_mask,
)

TRIANGLE = np.array([[200, 150], [320, 150], [200, 240]])

ROBOT_RGB = (170, 175, 180)  # about the grey of the arm's meshes
SKIN_RGB = tuple(round(255 * value) for value in HAND_COLOUR_RGBA[:3])
SLEEVE_RGB = tuple(round(255 * value) for value in SLEEVE_COLOUR_RGBA[:3])


def table() -> np.ndarray:
    return np.full((480, 640, 3), TABLE_RGB, dtype=np.uint8)


def paint(image: np.ndarray, corners: np.ndarray, rgb: tuple[int, int, int]) -> np.ndarray:
    """Fill a polygon; returns the mask of its pixels."""
    mask = np.zeros(image.shape[:2], dtype=np.uint8)
    cv2.fillPoly(mask, [corners.astype(np.int32)], 1)
    image[mask == 1] = rgb
    return mask


def test_the_mask_is_the_object_among_hand_sleeve_and_robot() -> None:
    image = table()
    paint(image, np.array([[0, 0], [90, 0], [90, 479], [0, 479]]), ROBOT_RGB)
    paint(image, np.array([[400, 300], [639, 300], [639, 479], [400, 479]]), SLEEVE_RGB)
    paint(image, np.array([[340, 200], [460, 200], [460, 330], [340, 330]]), SKIN_RGB)
    expected = paint(image, TRIANGLE, OBJECT_RGB)
    np.testing.assert_array_equal(object_mask(image), expected)


@pytest.mark.parametrize("rgb", [ROBOT_RGB, SKIN_RGB, SLEEVE_RGB, TABLE_RGB])
@pytest.mark.parametrize("light", [1.0, 0.4])
def test_nothing_but_the_object_is_taken_for_it_even_in_shade(
    rgb: tuple[int, int, int], light: float
) -> None:
    image = table()
    paint(image, TRIANGLE, tuple(int(light * channel) for channel in rgb))
    assert not object_mask(image).any()


def test_the_order_of_the_channels_does_not_matter() -> None:
    image = table()
    paint(image, np.array([[400, 300], [600, 300], [600, 400]]), SLEEVE_RGB)
    expected = paint(image, TRIANGLE, OBJECT_RGB)
    np.testing.assert_array_equal(object_mask(np.ascontiguousarray(image[:, :, ::-1])), expected)


@pytest.mark.parametrize("shift", [[-200, 0], [0, -150], [319, 0], [0, 239]])
def test_an_object_that_touches_the_border_is_not_seen(shift: list[int]) -> None:
    image = table()
    paint(image, TRIANGLE + shift, OBJECT_RGB)
    assert not object_mask(image).any()


@pytest.mark.parametrize("shift", [[-199, 0], [0, -149], [318, 0], [0, 238]])
def test_an_object_one_pixel_from_the_border_is_seen(shift: list[int]) -> None:
    image = table()
    expected = paint(image, TRIANGLE + shift, OBJECT_RGB)
    np.testing.assert_array_equal(object_mask(image), expected)


def test_the_largest_black_region_is_the_object() -> None:
    image = table()
    paint(image, TRIANGLE[::-1] // 2 + [300, 200], OBJECT_RGB)
    expected = paint(image, TRIANGLE, OBJECT_RGB)
    np.testing.assert_array_equal(object_mask(image), expected)


def test_a_speck_is_not_an_object() -> None:
    image = table()
    image[100, 100 : 100 + OBJECT_SMALLEST_PX - 1] = OBJECT_RGB
    assert not object_mask(image).any()
    image[100, 100 : 100 + OBJECT_SMALLEST_PX] = OBJECT_RGB
    assert object_mask(image).sum() == OBJECT_SMALLEST_PX


def test_an_empty_table_shows_no_object() -> None:
    assert not object_mask(table()).any()
