from __future__ import annotations

from itertools import pairwise

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from safety_harness.report.svg import keep_extremes, spans, ticks_per_column


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
