from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from safety_harness.exceptions import DatasetError
from safety_harness.learning.spaces import (
    SPACES,
    Box,
    Region,
    Space,
    seen,
    space_named,
    unseen_both,
    unseen_hand,
    unseen_tcp,
)
from safety_harness.settings import DEFAULTS, Settings

SEEN = seen(DEFAULTS)
DESIRED = np.array(DEFAULTS.cell.desired_tcp_position_in_base_m)
NOMINAL = np.array(DEFAULTS.avoidance.nominal_hand_position_in_base_m)


def rng(seed: int = 1) -> np.random.Generator:
    return np.random.default_rng(seed)


@pytest.mark.parametrize("name", SPACES)
def test_what_is_drawn_from_a_space_belongs_to_it(name: str) -> None:
    space = space_named(name, DEFAULTS)
    assert space.name == name
    hands, tcps = space.draw_hands(rng(), 20_000), space.draw_tcps(rng(), 20_000)
    assert space.contains(hand_in_base_m=hands, tcp_in_base_m=tcps).all()


def test_seen_tcps_and_hands_are_the_papers_boxes() -> None:
    tcps, hands = SEEN.draw_tcps(rng(), 20_000) - DESIRED, SEEN.draw_hands(rng(), 20_000) - NOMINAL
    for points, half in ((tcps, (0.060, 0.150, 0.100)), (hands, (0.300, 0.300, 0.300))):
        assert np.all(np.abs(points) <= half)
        assert np.abs(points).max(axis=0) == pytest.approx(half, rel=1e-3)


@pytest.mark.parametrize(
    ("make", "hand_is_seen", "tcp_is_seen"),
    [(unseen_hand, False, True), (unseen_tcp, True, False), (unseen_both, False, False)],
)
def test_what_is_unseen_was_never_seen(
    make: Callable[[Settings], Space], hand_is_seen: bool, tcp_is_seen: bool
) -> None:
    space = make(DEFAULTS)
    hands, tcps = space.draw_hands(rng(), 20_000), space.draw_tcps(rng(), 20_000)
    assert np.all(SEEN.hand.contains(hands) == hand_is_seen)
    assert np.all(SEEN.tcp.contains(tcps) == tcp_is_seen)


def test_unseen_points_stay_within_their_outer_bounds_and_above_the_table() -> None:
    space = unseen_both(DEFAULTS)
    tcps = space.draw_tcps(rng(), 50_000) - DESIRED
    hands = space.draw_hands(rng(), 50_000)
    assert np.abs(tcps).max(axis=0) == pytest.approx((0.120, 0.300, 0.200), rel=1e-3)
    assert np.abs(hands - NOMINAL).max(axis=0) == pytest.approx((0.450, 0.450, 0.450), rel=1e-3)
    assert hands[:, 2].min() >= DEFAULTS.cell.table_height_m


def test_a_table_above_the_seen_hands_leaves_the_shell_whole() -> None:
    high = replace(DEFAULTS, cell=replace(DEFAULTS.cell, table_height_m=0.1))
    hands = unseen_hand(high).draw_hands(rng(), 5_000)
    assert not seen(high).hand.contains(hands).any()


def test_a_shell_is_filled_evenly() -> None:
    """Every octant-and-layer cell of a grid gets its share of the points, by its volume in the shell."""
    shell = unseen_tcp(DEFAULTS).tcp
    points = shell.draw(rng(), 200_000)
    low, high = np.array(shell.outer.low_m), np.array(shell.outer.high_m)
    cells = np.floor(8.0 * (points - low) / (high - low)).astype(int).clip(0, 7)  # the hole is 2..5 of 8
    counts = np.zeros((8, 8, 8), int)
    np.add.at(counts, tuple(cells.T), 1)
    hole = np.zeros((8, 8, 8), bool)
    hole[2:6, 2:6, 2:6] = True
    assert counts[hole].sum() == 0
    expected = len(points) / np.count_nonzero(~hole)
    chi_squared = ((counts[~hole] - expected) ** 2 / expected).sum()
    degrees = np.count_nonzero(~hole) - 1
    assert chi_squared < degrees + 5.0 * np.sqrt(2.0 * degrees)


@given(data=st.data())
@settings(max_examples=30, deadline=None)
def test_a_hole_anywhere_in_the_box_is_avoided(data: st.DataObject) -> None:
    """Also a hole that touches the outer box, or goes right through it along an axis."""
    bounds = st.lists(st.integers(0, 4), min_size=2, max_size=2, unique=True).map(sorted)
    hole = np.array([data.draw(bounds) for _ in range(3)], float)
    if np.all(hole == [0.0, 4.0]):
        return
    region = Region(Box((0.0, 0.0, 0.0), (4.0, 4.0, 4.0)), Box(tuple(hole[:, 0]), tuple(hole[:, 1])))
    points = region.draw(rng(), 2_000)
    strictly_inside = np.all((points > hole[:, 0]) & (points < hole[:, 1]), axis=1)
    assert not strictly_inside.any()
    assert region.contains(points).all()
    share_left = np.mean(points[:, 0] < 2.0)
    grid = np.stack(np.meshgrid(*[np.arange(0.25, 4.0, 0.5)] * 3), axis=-1).reshape(-1, 3)
    kept = grid[region.contains(grid)]
    expected = np.mean(kept[:, 0] < 2.0)
    assert share_left == pytest.approx(expected, abs=5.0 * np.sqrt(0.25 / len(points)))


def test_nan_is_nowhere() -> None:
    nowhere, somewhere = np.array([np.nan, 0.0, 0.35]), DESIRED
    assert not SEEN.tcp.contains(nowhere)
    assert not unseen_tcp(DEFAULTS).tcp.contains(nowhere)
    assert not SEEN.contains(hand_in_base_m=np.full(3, np.nan), tcp_in_base_m=somewhere)


def test_impossible_bounds_and_unknown_names_are_refused() -> None:
    unit = Box((0.0, 0.0, 0.0), (1.0, 1.0, 1.0))
    with pytest.raises(DatasetError, match="below its upper"):
        Box((0.0, 0.0, 0.0), (1.0, 0.0, 1.0))
    with pytest.raises(DatasetError, match="below its upper"):
        Box((0.0, 0.0, 0.0), (1.0, float("nan"), 1.0))
    with pytest.raises(DatasetError, match="hole inside"):
        Region(unit, Box((0.5, 0.5, 0.5), (1.5, 0.6, 0.6)))
    with pytest.raises(DatasetError, match="leaves something"):
        Region(unit, unit)
    with pytest.raises(DatasetError, match="'unseen both'"):
        space_named("unseen", DEFAULTS)
