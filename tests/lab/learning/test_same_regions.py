"""Data sets and scenarios mean the same by unseen."""

from __future__ import annotations

import pytest

from safety_harness.base.settings import DEFAULTS
from safety_harness.extensions.lab.learning.dataset import SPACES, space_named
from safety_harness.space.regions import paper_seen, region_named


@pytest.mark.parametrize("name", SPACES)
def test_data_sets_and_scenarios_mean_the_same_by_unseen(name: str) -> None:
    seen = paper_seen(DEFAULTS)
    space = space_named(name, DEFAULTS)
    hand = "unseen hand" if name in ("unseen hand", "unseen both") else "seen hand"
    tcp = "unseen tcp" if name in ("unseen tcp", "unseen both") else "seen tcp"
    assert space.hand == region_named(hand, seen, DEFAULTS)
    assert space.tcp == region_named(tcp, seen, DEFAULTS)
