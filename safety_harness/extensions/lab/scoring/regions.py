"""Regions of questions: named regions of hands and TCPs, and the questions that draws of a space lead to.

A region contains only pairs of hand and TCP about which a run can ask.  A run asks when a predicted hand is
within the critical distance of the TCP, which is where the arm can be.  Pairs farther apart form their own
region.
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
AT_ONCE = 10_000
FAR = "far"
NAMED = (
    ("seen", "seen hand", "seen tcp"),
    ("unseen hand", "unseen hand", "seen tcp"),
    ("unseen tcp", "seen hand", "unseen tcp"),
    ("unseen both", "unseen hand", "unseen tcp"),
)


@dataclass(frozen=True, eq=False, kw_only=True)
class QuestionRegion:
    """A distribution of questions, with a test of whether pairs of hand and TCP belong to it.

    ``pairs`` draws independent pairs.  ``holds`` tells whether pairs belong to the region, so that a search
    for near questions stays in it.  ``asked_in_runs`` tells whether a run can ask the questions.
    """

    name: str
    about: str
    pairs: Callable[[Generator, int], Pairs]
    holds: Callable[[ArrayNx3, ArrayNx3], Flags]
    asked_in_runs: bool
    settings: Settings
    robot: AnyRobot = Robot.UR10

    def draw(self, rng: Generator, count: int) -> Questions:
        """Return ``count`` independent questions; return fewer, or none, if valid pairs are too rare."""
        hands, tcps = np.empty((0, 3)), np.empty((0, 3))
        drawn = 0
        while len(hands) < count and drawn < max(MOST_DRAWN * len(hands), LEAST_DRAWN):
            more = self.pairs(rng, max(count, AT_ONCE))
            drawn += max(count, AT_ONCE)
            kept = np.flatnonzero(self.holds(*more))[: count - len(hands)]
            kept = kept[reachable(more[1][kept], self.settings, self.robot)]
            hands, tcps = np.concatenate([hands, more[0][kept]]), np.concatenate([tcps, more[1][kept]])
        return Questions(hands, tcps, rng.integers(0, 2**63, len(hands), dtype=np.uint64))


def named_regions(seen: SeenRegions, settings: Settings) -> tuple[QuestionRegion, ...]:
    """Return the four regions of an avoider's training (Table 3), and a far region that no run asks about.

    The far region covers the boxes of all four regions.

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
    """Return whether (n,) each of ``hands`` (n, 3) is within ``near_m`` of its TCP in ``tcps`` (n, 3)."""
    return np.asarray(np.linalg.norm(hands - tcps, axis=1) < near_m)
