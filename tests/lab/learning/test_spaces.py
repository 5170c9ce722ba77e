from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from safety_harness.base.exceptions import DatasetError
from safety_harness.base.settings import DEFAULTS
from safety_harness.extensions.lab.learning.dataset import SPACES, seen, space_named

SEEN = seen(DEFAULTS)
DESIRED = np.array(DEFAULTS.cell.desired_tcp_position_in_base_m)
NOMINAL = np.array(DEFAULTS.avoidance.nominal_hand_position_in_base_m)


def rng(seed: int = 1) -> np.random.Generator:
    return np.random.default_rng(seed)


@pytest.mark.parametrize("name", SPACES)
def test_what_is_drawn_from_a_space_belongs_to_it(name: str) -> None:
    space = space_named(name, DEFAULTS)
    assert space.name == name
    hands, tcps = space.hand.draw(rng(), 20_000), space.tcp.draw(rng(), 20_000)
    assert space.hand.contains(hands).all()
    assert space.tcp.contains(tcps).all()


def test_seen_tcps_and_hands_are_the_papers_boxes() -> None:
    tcps, hands = SEEN.tcp.draw(rng(), 20_000) - DESIRED, SEEN.hand.draw(rng(), 20_000) - NOMINAL
    for points, half in ((tcps, (0.060, 0.150, 0.100)), (hands, (0.300, 0.300, 0.300))):
        assert np.all(np.abs(points) <= half)
        assert np.abs(points).max(axis=0) == pytest.approx(half, rel=1e-3)


@pytest.mark.parametrize(
    ("name", "hand_is_seen", "tcp_is_seen"),
    [("unseen hand", False, True), ("unseen tcp", True, False), ("unseen both", False, False)],
)
def test_what_is_unseen_was_never_seen(name: str, hand_is_seen: bool, tcp_is_seen: bool) -> None:
    space = space_named(name, DEFAULTS)
    hands, tcps = space.hand.draw(rng(), 20_000), space.tcp.draw(rng(), 20_000)
    assert np.all(SEEN.hand.contains(hands) == hand_is_seen)
    assert np.all(SEEN.tcp.contains(tcps) == tcp_is_seen)


def test_unseen_points_stay_within_their_outer_bounds_and_above_the_table() -> None:
    space = space_named("unseen both", DEFAULTS)
    tcps = space.tcp.draw(rng(), 50_000) - DESIRED
    hands = space.hand.draw(rng(), 50_000)
    assert np.abs(tcps).max(axis=0) == pytest.approx((0.120, 0.300, 0.200), rel=1e-3)
    assert np.abs(hands - NOMINAL).max(axis=0) == pytest.approx((0.450, 0.450, 0.450), rel=1e-3)
    assert hands[:, 2].min() >= DEFAULTS.cell.table_height_m


def test_a_table_above_the_seen_hands_leaves_the_shell_whole() -> None:
    high = replace(DEFAULTS, cell=replace(DEFAULTS.cell, table_height_m=0.1))
    hands = space_named("unseen hand", high).hand.draw(rng(), 5_000)
    assert not seen(high).hand.contains(hands).any()


def test_nan_is_nowhere() -> None:
    nowhere = np.array([np.nan, 0.0, 0.35])
    assert not SEEN.tcp.contains(nowhere)
    assert not space_named("unseen tcp", DEFAULTS).tcp.contains(nowhere)
    assert not SEEN.hand.contains(np.full(3, np.nan))


def test_unknown_names_are_refused() -> None:
    with pytest.raises(DatasetError, match="'unseen both'"):
        space_named("unseen", DEFAULTS)
