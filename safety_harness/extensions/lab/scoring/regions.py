"""Define regions of questions to avoiders, that is, of pairs of hand and TCP.

A region contains only pairs that can occur in a run as a question to the avoider.  The controller asks the
avoider if the predicted hand is within the critical distance of the TCP, and the arm can reach the TCP.
Pairs with larger distances form a separate region.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from safety_harness.base.geometry.arrays import ArrayNx3
from safety_harness.base.geometry.regions import Region
from safety_harness.base.settings import Settings
from safety_harness.cell.controller.desired import reachable
from safety_harness.extensions.lab.scoring.questions import Questions
from safety_harness.scenario.robots import AnyRobot, Robot
from safety_harness.space.regions import SeenRegions, region_named

Generator = np.random.Generator
Pairs = tuple[ArrayNx3, ArrayNx3]  # hands and TCPs in the base frame [m]
Flags = NDArray[np.bool_]

MOST_DRAWN, LEAST_DRAWN = 2_000, 200_000  # drawing ends after both: pairs per valid pair, and pairs in all
AT_ONCE = 10_000  # pairs in a draw, at least; a choice
FAR = "far"
NAMED = (
    ("seen", "seen hand", "seen tcp"),
    ("unseen hand", "unseen hand", "seen tcp"),
    ("unseen tcp", "seen hand", "unseen tcp"),
    ("unseen both", "unseen hand", "unseen tcp"),
)


@dataclass(frozen=True, eq=False, kw_only=True)
class QuestionRegion:
    """A distribution of questions, and a test of whether a pair of hand and TCP belongs to the region.

    ``pairs`` draws independent random pairs.  ``holds`` returns which pairs belong to the region, so that a
    search for neighbouring questions remains in the region.  ``asked_in_runs`` is True if the questions can
    occur in a run.
    """

    name: str
    about: str
    pairs: Callable[[Generator, int], Pairs]
    holds: Callable[[ArrayNx3, ArrayNx3], Flags]
    asked_in_runs: bool
    settings: Settings
    robot: AnyRobot = Robot.UR10

    def draw(self, rng: Generator, count: int) -> Questions:
        """Return ``count`` independent random questions.

        If valid pairs are too rare, the result contains fewer questions, or may be empty.
        """
        hands, tcps = np.empty((0, 3)), np.empty((0, 3))
        drawn = 0
        while len(hands) < count and drawn < max(MOST_DRAWN * len(hands), LEAST_DRAWN):
            more = self.pairs(rng, max(count, AT_ONCE))
            drawn += max(count, AT_ONCE)
            kept = np.flatnonzero(self.holds(*more))[: count - len(hands)]
            # Inverse kinematics takes longest, so only pairs of the region reach this test.
            kept = kept[reachable(more[1][kept], self.settings, self.robot)]
            hands, tcps = np.concatenate([hands, more[0][kept]]), np.concatenate([tcps, more[1][kept]])
        return Questions(hands, tcps, rng.integers(0, 2**63, len(hands), dtype=np.uint64))


def named_regions(seen: SeenRegions, settings: Settings) -> tuple[QuestionRegion, ...]:
    """Return the four regions of Table 3 for an avoider's training data, and a far region.

    The questions of the far region cannot occur in a run.

    It contains the distant pairs in the boxes of all four regions.

    Args:
        seen: The regions of the avoider's training data.
        settings: The settings of the cell.

    """
    near_m = settings.avoidance.critical_distance_m
    description = f"of {seen.source}; hands within {near_m * 1e3:g} mm of the TCP"

    def region_of(name: str, hands: Region, tcps: Region) -> QuestionRegion:
        def holds(hand: ArrayNx3, tcp: ArrayNx3) -> Flags:
            return hands.contains(hand) & tcps.contains(tcp) & are_near(hand, tcp, near_m)

        return QuestionRegion(
            name=name,
            about=f"{name}: {description}",
            pairs=lambda rng, count: (hands.draw(rng, count), tcps.draw(rng, count)),
            holds=holds,
            asked_in_runs=True,
            settings=settings,
        )

    regions = [
        region_of(name, region_named(hand, seen, settings), region_named(tcp, seen, settings))
        for name, hand, tcp in NAMED
    ]
    hands, tcps = (
        region_named("unseen hand", seen, settings).outer,
        region_named("unseen tcp", seen, settings).outer,
    )
    far = QuestionRegion(
        name=FAR,
        about=f"far: hands farther than {near_m * 1e3:g} mm from the TCP, about which no run asks",
        pairs=lambda rng, count: (Region(hands).draw(rng, count), Region(tcps).draw(rng, count)),
        holds=lambda hand, tcp: hands.contains(hand) & tcps.contains(tcp) & ~are_near(hand, tcp, near_m),
        asked_in_runs=False,
        settings=settings,
    )
    return (*regions, far)


def are_near(hands: ArrayNx3, tcps: ArrayNx3, near_m: float) -> Flags:
    """Return whether the distance of each hand from its TCP is below ``near_m``, shape (n,).

    ``hands`` and ``tcps`` have the shape (n, 3).
    """
    return np.asarray(np.linalg.norm(hands - tcps, axis=1) < near_m)
