"""Where TCPs and hands of a data set are: the seen space and the three unseen ones (Table 3 of the paper).

The regions themselves are those of scenario spaces (``space.regions``, which says why they are so).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from safety_harness.exceptions import DatasetError, Place
from safety_harness.geometry.regions import Region
from safety_harness.settings import Settings
from safety_harness.space.regions import paper_seen, region_named

Vector = NDArray[np.float64]


@dataclass(frozen=True)
class Space:
    """Where the TCPs and, independently of them, the hands of a data set are."""

    name: str
    tcp: Region
    hand: Region

    def draw_tcps(self, rng: np.random.Generator, count: int) -> Vector:
        """(count, 3) TCP positions in the base frame [m], uniform."""
        return self.tcp.draw(rng, count)

    def draw_hands(self, rng: np.random.Generator, count: int) -> Vector:
        """(count, 3) hand positions in the base frame [m], uniform."""
        return self.hand.draw(rng, count)

    def contains(self, *, hand_in_base_m: Vector, tcp_in_base_m: Vector) -> NDArray[np.bool_]:
        """(..., 3) each -> (...): which pairs belong to the space."""
        return self.hand.contains(hand_in_base_m) & self.tcp.contains(tcp_in_base_m)


def seen(settings: Settings) -> Space:
    """Where training happens: TCPs about the desired one, hands about the nominal one."""
    return _space("seen", settings, hand="seen hand", tcp="seen tcp")


def unseen_hand(settings: Settings) -> Space:
    """Seen TCPs with hands that were not."""
    return _space("unseen hand", settings, hand="unseen hand", tcp="seen tcp")


def unseen_tcp(settings: Settings) -> Space:
    """Seen hands with TCPs that were not."""
    return _space("unseen tcp", settings, hand="seen hand", tcp="unseen tcp")


def unseen_both(settings: Settings) -> Space:
    """Neither the hand nor the TCP was seen."""
    return _space("unseen both", settings, hand="unseen hand", tcp="unseen tcp")


SPACES: dict[str, Callable[[Settings], Space]] = {
    "seen": seen,
    "unseen hand": unseen_hand,
    "unseen tcp": unseen_tcp,
    "unseen both": unseen_both,
}


def space_named(name: str, settings: Settings) -> Space:
    """The space that a user names; DatasetError with the four names for any other."""
    if name not in SPACES:
        raise DatasetError(
            place=Place(field="space"), expected=f"one of {', '.join(map(repr, SPACES))}", got=repr(name)
        )
    return SPACES[name](settings)


def _space(name: str, settings: Settings, *, hand: str, tcp: str) -> Space:
    bounds = paper_seen(settings)
    return Space(name, tcp=region_named(tcp, bounds, settings), hand=region_named(hand, bounds, settings))
