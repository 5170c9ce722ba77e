"""Boxes and shells: what is in them, how they are filled, and what is no region."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from safety_harness.base.exceptions import RegionError
from safety_harness.base.geometry.regions import Box, Region

UNIT = Box((0.0, 0.0, 0.0), (1.0, 1.0, 1.0))


def rng(seed: int = 1) -> np.random.Generator:
    return np.random.default_rng(seed)


def test_a_shell_is_filled_evenly() -> None:
    """Every octant-and-layer cell of a grid gets its share of the points, by its volume in the shell."""
    shell = Region(Box((-2.0, -1.0, 0.0), (2.0, 1.0, 4.0)), Box((-1.0, -0.5, 1.0), (1.0, 0.5, 3.0)))
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
    assert not UNIT.contains(np.array([np.nan, 0.5, 0.5]))
    assert not Region(UNIT).contains(np.array([0.5, np.nan, 0.5]))


def test_the_pieces_fill_what_the_hole_leaves() -> None:
    hole = Box((0.25, 0.25, 0.25), (0.75, 0.75, 0.5))
    assert sum(piece.volume_m3 for piece in Region(UNIT, hole).pieces) == pytest.approx(1.0 - hole.volume_m3)


def test_a_grown_box_has_the_same_centre_and_round_corners() -> None:
    box = Box.centred_at((0.7, 0.0, 0.35), (0.06, 0.15, 0.1))
    assert box.grown(2.0) == Box((0.58, -0.3, 0.15), (0.82, 0.3, 0.55))


def test_a_shifted_region_moves_its_hole_along() -> None:
    region = Region(UNIT, Box((0.25, 0.25, 0.25), (0.75, 0.75, 0.75))).shifted((1.0, 0.0, 0.0))
    assert not region.contains(np.array([1.5, 0.5, 0.5]))
    assert region.contains(np.array([1.1, 0.5, 0.5]))
    assert not region.contains(np.array([0.1, 0.5, 0.5]))


def test_impossible_bounds_are_refused() -> None:
    with pytest.raises(RegionError, match="below its upper"):
        Box((0.0, 0.0, 0.0), (1.0, 0.0, 1.0))
    with pytest.raises(RegionError, match="below its upper"):
        Box((0.0, 0.0, 0.0), (1.0, float("nan"), 1.0))
    with pytest.raises(RegionError, match="hole inside"):
        Region(UNIT, Box((0.5, 0.5, 0.5), (1.5, 0.6, 0.6)))
    with pytest.raises(RegionError, match="leaves something"):
        Region(UNIT, UNIT)
