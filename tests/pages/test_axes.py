from __future__ import annotations

import re
from itertools import pairwise
from xml.etree import ElementTree

import numpy as np
import pytest
from hypothesis import assume, example, given, settings
from hypothesis import strategies as st

from safety_harness.extensions.pages.axes import Axes, Picture, Share, round_values, stairs
from safety_harness.extensions.pages.svg import Ink

LEFT, TOP, WIDTH, HEIGHT = 50.0, 20.0, 200.0, 100.0


def new() -> tuple[Picture, Axes]:
    picture = Picture(300, 160)
    return picture, picture.axes(LEFT, TOP, WIDTH, HEIGHT)


def drawn(picture: Picture) -> ElementTree.Element:
    return ElementTree.fromstring(picture.svg(prefix="p-", title="t", description="d"))


def strokes(picture: Picture, ink: Ink) -> list[list[tuple[float, float]]]:
    """The places of each unbroken line of an ink."""
    paths = [
        path.get("d", "")
        for path in drawn(picture).iter("path")
        if f"var({ink.variable})" in (path.get("stroke"), path.get("fill"))
    ]
    return [_places(part) for path in paths for part in path.split("M")[1:]]


def _places(part: str) -> list[tuple[float, float]]:
    """Of a path from its first place, either all of them or the steps to them."""
    first, _, steps = part.partition("l")
    numbers, off = (list(map(float, re.findall(r"-?[\d.]+", one))) for one in (first, steps))
    if off:
        across, up = (np.cumsum(numbers[k : k + 1] + off[k::2]).tolist() for k in (0, 1))
        return list(zip(across, up, strict=True))
    return list(zip(numbers[::2], numbers[1::2], strict=False))


def test_a_value_is_drawn_where_its_label_stands() -> None:
    picture, axes = new()
    axes.line([0.0, 3.0, 10.0], [0.0, -4.0, 8.0], Ink.TCP)
    (line,) = strokes(picture, Ink.TCP)
    words = [(one.text, one.get("text-anchor"), one) for one in drawn(picture).iter("text")]
    across = {text: float(one.get("x", "")) for text, anchor, one in words if anchor == "middle"}
    up = {text: float(one.get("y", "")) for text, anchor, one in words if anchor == "end"}
    assert [line[0][0], line[2][0]] == pytest.approx([across["0"], across["10"]], abs=0.11)
    assert line[0][1] + 4.0 == pytest.approx(up["0"], abs=0.11)  # the base line is below the middle
    assert line[0][0] > LEFT
    assert line[2][0] < LEFT + WIDTH


def test_what_is_not_finite_breaks_a_curve_and_never_stretches_the_view() -> None:
    picture, axes = new()
    axes.line(np.arange(7.0), [0.0, 1.0, np.nan, 2.0, 1.0, np.inf, 3.0], Ink.TCP)
    assert [len(one) for one in strokes(picture, Ink.TCP)] == [2, 2, 1]
    assert axes.y.view() == pytest.approx((-0.15, 3.15))


def test_marks_and_words_outside_are_left_out_and_a_curve_is_cut_off() -> None:
    picture, axes = new()
    axes.x.show(0.0, 1.0)
    axes.y.show(0.0, 1.0)
    axes.marks([0.5, 5.0], [0.5, 0.5], "s", 6.0, fill=Ink.TCP)
    axes.text("inside", 0.5, Share(1.0))
    axes.text("outside", 5.0, 0.5)
    axes.line([0.0, 5.0], [0.0, 5.0], Ink.SKY)
    assert len(strokes(picture, Ink.TCP)) == 1
    words = [one.text for one in drawn(picture).iter("text")]
    assert "inside" in words
    assert "outside" not in words
    (line,) = [one for one in drawn(picture).iter("path") if one.get("stroke") == f"var({Ink.SKY.variable})"]
    assert line.get("clip-path") == "url(#p-axes-0)"


@example([(0, 0), (1, 0), (1, 0), (0, 0)])
@given(st.lists(st.tuples(st.integers(-30, 30), st.integers(-3, 3)), min_size=2, max_size=40))
def test_a_thinned_curve_passes_through_every_place_and_turns_where_it_turned(
    places: list[tuple[int, int]],
) -> None:
    picture, axes = new()
    axes.x.show(-100.0, 100.0)
    axes.y.show(-50.0, 50.0)
    axes.line([x for x, _ in places], [y for _, y in places], Ink.TCP)
    (line,) = strokes(picture, Ink.TCP)
    expected = [(LEFT + 100.0 + x, TOP + 50.0 - y) for x, y in places]
    assert line[0] == expected[0]
    assert line[-1] == expected[-1]
    missing = [one for one in expected if one not in line]
    for (
        x,
        y,
    ) in missing:  # on a level stretch between two places that are there; of a long path on a straight one
        level = any(a[1] == b[1] == y and min(a[0], b[0]) <= x <= max(a[0], b[0]) for a, b in pairwise(line))
        assert level or (len(places) > 20 and min(_off((x, y), a, b) for a, b in pairwise(line)) < 0.18)


def _off(place: tuple[float, float], a: tuple[float, float], b: tuple[float, float]) -> float:
    """How far a place lies from the way between two others."""
    along = np.subtract(b, a)
    share = 0.0 if not along.any() else np.clip(np.subtract(place, a) @ along / (along @ along), 0.0, 1.0)
    return float(np.linalg.norm(np.subtract(place, a) - share * along))


@settings(max_examples=20)
@given(st.integers(0, 2**32), st.sampled_from([0.05, 0.3, 2.0]))
def test_a_long_path_goes_by_every_place_as_near_as_places_are_told(seed: int, step: float) -> None:
    places = np.cumsum(np.random.default_rng(seed).normal(0.0, step, (80, 2)), axis=0)
    picture, axes = new()
    axes.x.show(-100.0, 100.0)
    axes.y.show(-50.0, 50.0)
    axes.line(places[:, 0], places[:, 1], Ink.TCP)
    (line,) = strokes(picture, Ink.TCP)
    for x, y in zip(LEFT + 100.0 + places[:, 0], TOP + 50.0 - places[:, 1], strict=True):
        assert min(_off((x, y), a, b) for a, b in pairwise(line)) < 0.1 + 0.08  # and half of its last digit
    assert step > 0.05 or len(line) < 60


@given(st.floats(-1e6, 1e6), st.floats(1e-9, 1e9), st.integers(2, 12))
def test_ticks_are_few_round_and_within(low: float, length: float, steps: int) -> None:
    assume(length > 1e-8 * abs(low))  # or the steps are of the numbers' last digits
    found = round_values(low, low + length, steps)
    slack = 1e-6 * (abs(low) + length)
    assert len(found) <= steps + 1
    assert all(low - slack <= value <= low + length + slack for value in found)
    assert len(found) >= steps // 3


def test_a_logarithmic_axis_has_equal_room_for_each_decade_and_none_for_zero() -> None:
    picture, axes = new()
    axes.y.log = True
    axes.y.show(1e-3, 1.0)
    axes.line([0.0, 1.0, 2.0, 3.0, 4.0], [1.0, 0.1, 0.01, 0.0, 0.001], Ink.TCP)
    heights = [place[1] for line in strokes(picture, Ink.TCP) for place in line]
    assert heights == pytest.approx([TOP, TOP + HEIGHT / 3, TOP + 2 * HEIGHT / 3, TOP + HEIGHT], abs=0.1)


def test_fitted_axes_have_one_scale_and_show_all_of_the_rectangle() -> None:
    _, axes = new()
    axes.fit((0.0, 0.0), (10.0, 20.0))
    (left, right), (low, high) = axes.x.view(), axes.y.view()
    assert (right - left) / WIDTH == pytest.approx((high - low) / HEIGHT)
    assert left <= 0.0 <= 10.0 <= right
    assert low <= 0.0 <= 20.0 <= high


def test_stairs_keep_a_value_until_the_next() -> None:
    x, y = stairs([1, 5, 9], [3, 2, 0])
    assert x.tolist() == [1, 5, 5, 9, 9]
    assert y.tolist() == [3, 3, 2, 2, 0]


def test_the_key_names_each_curve_beside_a_sample_of_it_and_words_do_not_meet() -> None:
    picture, axes = new()
    for name, ink in (("one", Ink.TCP), ("a long name", Ink.SKY)):
        axes.line([0.0, 1.0], [0.0, 1.0], ink, name=name)
    axes.legend()
    words = {one.text: float(one.get("x", "")) for one in drawn(picture).iter("text")}
    sample = strokes(picture, Ink.SKY)[-1][0][0]
    assert words["one"] < sample < words["a long name"]
    assert words["a long name"] < LEFT + WIDTH


def test_the_same_plot_is_the_same_text() -> None:
    texts = []
    for _ in range(2):
        picture, axes = new()
        axes.line(np.linspace(0.0, 1.0, 50), np.sin(np.linspace(0.0, 9.0, 50)), Ink.TCP)
        texts.append(picture.svg(prefix="p-", title="t", description="d"))
    assert texts[0] == texts[1]


def test_a_long_line_goes_through_the_places_that_a_short_one_names() -> None:
    x, y = np.linspace(0.0, 10.0, 40), 3.0 * np.sin(np.arange(40.0))

    def places(upto: int) -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
        picture, axes = new()
        axes.x.show(0.0, 10.0)
        axes.y.show(-4.0, 4.0)
        axes.line(x[:upto], y[:upto], Ink.TCP)
        (found,) = strokes(picture, Ink.TCP)
        return np.array(found)

    assert np.allclose(places(40)[:15], places(15), atol=1e-6)
