from __future__ import annotations

import re
from dataclasses import replace
from itertools import pairwise
from xml.etree import ElementTree

import factory
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from safety_harness.extensions.pages.axes import Picture
from safety_harness.extensions.pages.path_views import capsule_outline, close_up_mm, path_views, shown_moment
from safety_harness.extensions.pages.svg import Ink, keep_extremes, plain, spans, ticks_per_column
from safety_harness.extensions.pages.timeline import timeline
from safety_harness.trace.records import DecisionOutcome


def text_of(svg: str) -> list[str]:
    return [element.text or "" for element in ElementTree.fromstring(svg).iter("text")]


def sample(prefix: str) -> str:
    picture = Picture(200, 100)
    axes = picture.axes(20, 20, 160, 60)
    axes.line([0.0, 1.0], [1.0, 2.0], Ink.TCP)
    axes.bars([(0.0, 1.0)], (0.0, 1.0), Ink.LOST, hatched=True)
    axes.title("a <script>alert(1)</script> & $x^2$")
    return picture.svg(prefix=prefix, title="<b>title</b>", description="1 < 2")


def test_two_figures_share_no_id_and_point_only_at_their_own() -> None:
    ids = []
    for prefix in ("one-", "two-"):
        svg = sample(prefix)
        own = re.findall(r'id="([^"]+)"', svg)
        pointed = re.findall(r'href="#([^"]+)"', svg) + re.findall(r"url\(#([^)]+)\)", svg)
        assert pointed
        assert set(pointed) <= set(own)
        assert all(name.startswith(prefix) for name in own)
        ids.append(set(own))
    assert not ids[0] & ids[1]


def test_the_drawing_has_only_the_pages_colours_no_address_and_no_style_rule() -> None:
    svg = sample("x-")
    assert "http" not in svg
    assert "<style" not in svg
    assert "font-family" not in svg
    assert not re.search(r"#[0-9a-f]{6}", svg)
    assert "var(--fig-tcp)" in svg
    assert "var(--fig-lost)" in svg


def test_markup_and_dollars_in_a_figure_stay_the_text_that_they_are() -> None:
    svg = sample("x-")
    assert "<script" not in svg
    assert "a <script>alert(1)</script> & $x^2$" in text_of(svg)
    root = ElementTree.fromstring(svg)
    assert root.findtext("title") == "<b>title</b>"
    assert root.findtext("desc") == "1 < 2"
    assert root.get("role") == "img"


def test_plain_text_has_no_control_characters_and_is_not_too_long() -> None:
    assert plain("a\x00b\nc\x0bd") == "a\ufffdb\ufffdc\ufffdd"
    assert plain("x" * 100, longest=10) == "x" * 9 + "…"


def test_the_views_show_the_moment_of_the_worst_claim_else_the_nearest_hand() -> None:
    run = factory.violated_run()
    moment = shown_moment(run)
    assert moment is not None
    assert (moment.claim, moment.time_s) == (0, 8.6)
    assert run.trace.time_s[moment.tick] == pytest.approx(8.6)
    source = factory.scenario()
    unclaimed = factory.JudgedRun(factory.trace(source), (), "again")
    moment = shown_moment(unclaimed)
    assert moment is not None
    assert moment.claim is None
    assert moment.tick == np.argmin(unclaimed.trace.ticks["hand_distance_m"][:, 0])
    assert shown_moment(factory.no_hands_run()) is None


def test_a_capsule_outline_keeps_its_radius_from_the_segment_everywhere() -> None:
    start, end = np.array([0.1, -0.2]), np.array([0.4, 0.3])
    outline = capsule_outline(start, end, 0.05)
    along = end - start
    share = np.clip((outline - start) @ along / (along @ along), 0.0, 1.0)
    distance = np.linalg.norm(outline - (start + share[:, None] * along), axis=1)
    assert distance == pytest.approx(0.05)


def test_the_close_up_holds_the_whole_way_of_the_tcp_and_every_chosen_position() -> None:
    trace = factory.violated_run().trace
    low, high = close_up_mm(trace)
    chosen = trace.decisions["chosen_position_in_base_m"]
    for points in (trace.ticks["transform_tcp_to_base"][:, :3, 3], chosen[np.isfinite(chosen).all(axis=1)]):
        assert np.all(points * 1e3 >= low)
        assert np.all(points * 1e3 <= high)


def test_the_time_series_names_its_limits_lanes_and_hands() -> None:
    words = text_of(timeline(factory.violated_run(), prefix="t-"))
    for expected in (
        "critical distance: 250",
        "claim 1: 150",
        "speed limit and claim 2: 250",
        "gain switch: 0.005",
        "right hand",
        "left hand",
        "protective stop",
        "Squared image error |f − f*|²",
    ):
        assert expected in words


def panel_of(words: list[str], title: str) -> set[str]:
    """The words between the panel's title and the one before it: its ticks and its limits."""
    titles = [i for i, word in enumerate(words) if word in PANELS]
    end = words.index(title)
    return set(words[max([i for i in titles if i < end], default=0) : end])


PANELS = (
    "True hand to robot, surface to surface, mm",
    "Predicted hand to TCP, centre to centre, mm",
    "Feature errors, lengths, mm",
    "Squared image error |f − f*|²",
    "TCP speed, mm/s",
)


def test_a_limit_stands_only_across_the_curve_that_it_limits() -> None:
    words = text_of(timeline(factory.violated_run(), prefix="t-"))
    true, predicted = (panel_of(words, title) for title in PANELS[:2])
    assert "claim 1: 150" in true
    assert "critical distance: 250" not in true
    assert "critical distance: 250" in predicted
    assert "claim 1: 150" not in predicted


@pytest.mark.parametrize(("least", "most"), [(4e-3, 6e-3), (1e-9, 1e-1), (1e-30, 1e3), (5e-3, 5e-3)])
def test_the_logarithmic_axis_has_a_labelled_decade_at_both_ends_of_what_it_shows(
    least: float, most: float
) -> None:
    run = factory.no_hands_run()
    ticks = run.trace.ticks.copy()
    ticks["sse"] = np.geomspace(least, most, len(ticks))
    words = text_of(timeline(replace(run, trace=replace(run.trace, ticks=ticks)), prefix="t-"))
    raised = str.maketrans("⁻⁰¹²³⁴⁵⁶⁷⁸⁹", "-0123456789")
    shown = panel_of(words, "Squared image error |f − f*|²")
    decades = [int(word[2:].translate(raised)) for word in shown if re.fullmatch("10[⁻⁰¹²³⁴⁵⁶⁷⁸⁹]+", word)]
    assert 2 <= len(decades) <= 5
    assert 10.0 ** max(decades) >= most * (1.0 - 1e-9)
    assert "gain switch: 0.005" in shown


def test_a_decision_is_drawn_by_its_outcome_and_ringed_for_its_fault() -> None:
    run = factory.holds_run()

    def drawn(outcomes: list[DecisionOutcome], fault: str = "") -> str:
        decisions = run.trace.decisions.copy()
        decisions["outcome"], decisions["fault"] = outcomes, fault
        return timeline(replace(run, trace=replace(run.trace, decisions=decisions)), prefix="t-")

    pictures = {drawn([outcome] * 3) for outcome in DecisionOutcome}
    assert len({re.sub("<desc.*?</desc>", "", picture) for picture in pictures}) == len(DecisionOutcome)
    assert drawn([DecisionOutcome.PROPOSED] * 3, "it broke") not in pictures
    assert "1 opposite pose, 2 protective stop" in drawn(
        [DecisionOutcome.OPPOSITE, DecisionOutcome.STOP, DecisionOutcome.STOP]
    )


@pytest.mark.parametrize("size", [1e-13, 2e-3, 1.0])
def test_an_axis_of_tiny_errors_is_labelled_with_their_true_size(size: float) -> None:
    run = factory.holds_run()
    ticks = run.trace.ticks.copy()
    ticks["feature_error"][:, 3:] = size * np.sin(run.trace.time_s)[:, None]
    words = text_of(timeline(replace(run, trace=replace(run.trace, ticks=ticks)), prefix="t-"))
    below = words[: words.index("Feature errors, γ and δ (no unit), α (rad)")]
    numbers: list[float] = []
    for word in reversed(below):
        try:
            numbers.append(float(word.replace("−", "-")))
        except ValueError:
            break
    assert 0.5 * size <= max(numbers) <= 1.5 * size
    assert 0.5 * size <= -min(numbers) <= 1.5 * size


def test_hand_names_in_the_figures_are_text_whatever_they_hold() -> None:
    svg = timeline(factory.hostile_run(), prefix="t-")
    assert "<script" not in svg
    assert any(words.startswith("_<script>") for words in text_of(svg))


@pytest.mark.parametrize("ticks", [1, 2, 5])
def test_a_trace_of_hardly_any_ticks_can_be_drawn(ticks: int) -> None:
    source = factory.scenario(claims=())
    run = factory.JudgedRun(factory.trace(source, ticks=ticks, ended="stopped"), (), "again")
    assert "ended: stopped" in text_of(timeline(run, prefix="t-"))
    assert path_views(run, prefix="p-")[3]


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_a_trace_full_of_nothing_finite_can_be_drawn(value: float) -> None:
    run = factory.holds_run()
    ticks = run.trace.ticks.copy()
    for name in ticks.dtype.names:
        if ticks[name].dtype == np.float64 and (name != "time_s" or np.isnan(value)):
            ticks[name] = value
    trace = factory.Trace(
        scenario=run.trace.scenario,
        ticks=ticks,
        decisions=run.trace.decisions.copy(),
        decision_latency_s=run.trace.decision_latency_s.copy(),
        provenance=run.trace.provenance,
    )
    broken = factory.JudgedRun(trace, run.evaluations, "again")
    assert "True hand to robot, surface to surface, mm" in text_of(timeline(broken, prefix="t-"))
    assert path_views(broken, prefix="p-")[0]


@given(st.integers(0, 2**32), st.integers(1, 3000), st.integers(1, 200))
def test_no_extreme_of_any_column_is_lost_and_order_is_kept(seed: int, count: int, columns: int) -> None:
    values = np.random.default_rng(seed).normal(size=count)
    time = np.arange(count) * 0.008
    times, kept = keep_extremes(time, values, columns)
    assert len(kept) <= 2 * columns + 2
    assert np.all(np.diff(times) > 0)
    assert np.array_equal(values[np.searchsorted(time, times)], kept)
    width = ticks_per_column(count, columns)
    for start in range(0, count, width):
        column = values[start : start + width]
        assert {column.min(), column.max()} <= set(kept)


def test_one_high_tick_among_ten_thousand_survives() -> None:
    values = np.zeros(10_000)
    values[4321] = 1.0
    times, kept = keep_extremes(np.arange(10_000.0), values, 100)
    assert kept.max() == 1.0
    assert times[np.argmax(kept)] == 4321.0


def test_a_curve_breaks_where_there_is_nothing_finite() -> None:
    values = np.ones(1000)
    values[300:700] = np.inf
    times, kept = keep_extremes(np.arange(1000.0), values, 50)
    assert np.isnan(kept[(times > 320) & (times < 680)]).all()
    assert np.isfinite(kept[(times < 280) | (times > 720)]).all()


def test_a_curve_of_nothing_is_empty_of_numbers() -> None:
    assert np.isnan(keep_extremes(np.arange(1000.0), np.full(1000, np.nan), 50)[1]).all()


@given(st.lists(st.booleans(), min_size=1, max_size=200), st.integers(5, 400))
def test_no_tick_of_a_mode_falls_out_of_its_spans(flags: list[bool], columns: int) -> None:
    mask = np.array(flags)
    time = np.arange(len(mask)) * 0.008
    found = spans(time, mask, len(mask) * 0.008, columns)
    shortest = len(mask) * 0.008 / columns
    for index, inside in enumerate(mask):
        middle = time[index] + 0.004
        covered = any(start <= middle <= start + length for start, length in found)
        assert covered or not inside
    gaps = [b[0] - (a[0] + a[1]) for a, b in pairwise(found)]
    assert all(gap >= shortest - 1e-12 for gap in gaps)
