"""Coverage: counts of runs by approach direction, speed, distance, seen or unseen, and outcome.

Each run belongs to one cell. Direction, speed, and seen or unseen are those at the run's worst decision. A
protective stop is worse than an opposite pose, which is worse than a proposed position; of equal decisions,
the first counts. Without a decision they are those at the hand's nearest approach. The distance is the least
distance of the run. If a controller reports no decisions, distances and motion determine the cell, with its
first protective stop if it reports its mode.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass, field
from itertools import product

import numpy as np
from numpy.typing import NDArray

from safety_harness.base.compiled import compiled
from safety_harness.base.elementary import length
from safety_harness.space.regions import SeenRegions
from safety_harness.trace.records import DecisionOutcome, Mode, as_compiled
from safety_harness.trace.trace import Trace

# The directions from the TCP to the hand along the base's axes +x, -x, +y, -y, +z and -z.
DIRECTIONS = ("front", "back", "left", "right", "above", "below")
SPEEDS = ("at rest", "to 0.5 m/s", "to 1 m/s", "above 1 m/s")
DISTANCES = ("touching", "to 50 mm", "to 200 mm", "farther")
SEEN = ("seen", "hand unseen", "TCP unseen", "both unseen")
OUTCOMES = ("no decision", "proposed position", "opposite pose", "protective stop")
AXES = {"direction": DIRECTIONS, "speed": SPEEDS, "distance": DISTANCES, "seen": SEEN, "outcome": OUTCOMES}

READ = ("transform_tcp_to_base", "hand_present", "hand_position_in_base_m", "hand_distance_m")
READ_OF_DECISIONS = ("decision.tick", "decision.outcome")
_FAST_MPS, _NEAR_M = (0.05, 0.5, 1.0), (0.0, 0.05, 0.2)
_RANKS = {DecisionOutcome.PROPOSED: 1, DecisionOutcome.OPPOSITE: 2, DecisionOutcome.STOP: 3}


@dataclass(frozen=True, order=True)
class CoverageCell:
    """One of 1,536 cells, as one word for each axis."""

    direction: str
    speed: str
    distance: str
    seen: str
    outcome: str

    def __str__(self) -> str:
        return f"{self.direction}, {self.speed}, {self.distance}, {self.seen}, {self.outcome}"


@dataclass
class Coverage:
    """The number of runs in each cell; ``without`` counts the runs that have no cell."""

    counts: Counter[CoverageCell] = field(default_factory=Counter)
    without: int = 0

    def add(self, cells: Iterable[CoverageCell | None]) -> None:
        """Count one run for each of ``cells``; None stands for a run without a cell."""
        runs = list(cells)
        self.without += runs.count(None)
        self.counts.update(cell for cell in runs if cell is not None)

    def along(self, axis: str) -> dict[str, int]:
        """Return the number of runs for each word of ``axis``, including 0."""
        counts = dict.fromkeys(AXES[axis], 0)
        for cell, count in self.counts.items():
            counts[getattr(cell, axis)] += count
        return counts

    def table(self, rows: str, columns: str) -> dict[str, dict[str, int]]:
        """Return the number of runs for each pair of words of the axes ``rows`` and ``columns``.

        Args:
            rows: An axis of AXES.
            columns: Another axis of AXES.

        """
        counts = {row: dict.fromkeys(AXES[columns], 0) for row in AXES[rows]}
        for cell, count in self.counts.items():
            counts[getattr(cell, rows)][getattr(cell, columns)] += count
        return counts

    @property
    def touching(self) -> int:
        """The number of runs in which a hand touched the arm's capsules, whatever the claims."""
        return self.along("distance")[DISTANCES[0]]

    @property
    def holes(self) -> list[CoverageCell]:
        """The cells without a run; many of them may be out of reach in a given space."""
        return [cell for names in product(*AXES.values()) if not self.counts[cell := CoverageCell(*names)]]

    def __str__(self) -> str:
        runs = sum(self.counts.values())
        lines = [f"{len(self.counts)} of {len(self.counts) + len(self.holes)} cells in {runs} runs"]
        if self.without:
            lines.append(f"{self.without} runs without any hand")
        for axis in AXES:
            text = ", ".join(f"{name} {count}" for name, count in self.along(axis).items())
            lines.append(f"{axis}: {text}")
        return "\n".join(lines)


def cell_of(trace: Trace, seen: SeenRegions) -> CoverageCell | None:
    """Return the cell of a run.

    Args:
        trace: The run.
        seen: The regions of the avoider's training data.

    Returns:
        The cell; None if no hand was ever present, or a needed quantity was not measured or not finite.

    """
    if not (_measured(trace, READ) and (trace.scenario.driven or _measured(trace, READ_OF_DECISIONS))):
        return None
    ticks = as_compiled(trace.ticks)
    least_m, tick, hand = _nearest(ticks)
    if hand < 0:
        return None
    rank, worst_tick = _worst_decision(trace)
    if worst_tick is not None:
        tick, hand = worst_tick, max(_nearest(ticks[worst_tick : worst_tick + 1])[2], 0)
    hand_m = trace.ticks["hand_position_in_base_m"][:, hand]
    tcp_m = trace.ticks["transform_tcp_to_base"][tick, :3, 3]
    way_m = hand_m[tick] - tcp_m
    axis = int(np.argmax(np.abs(way_m)))
    return CoverageCell(
        direction=DIRECTIONS[2 * axis + int(way_m[axis] < 0.0)],
        speed=_speed(trace, hand_m, tick),
        distance=_class_of(DISTANCES, _NEAR_M, least_m),
        seen=SEEN[int(not seen.hand.contains(hand_m[tick])) + 2 * int(not seen.tcp.contains(tcp_m))],
        outcome=OUTCOMES[rank],
    )


@compiled
def _nearest(ticks: NDArray[np.void]) -> tuple[float, int, int]:
    """Return the least hand distance [m] in ``ticks`` (n,), and the first tick and hand with it.

    The hand is -1 if no hand was at a finite distance; NaN distances are left out.
    """
    least_m, at, nearest = np.inf, 0, -1
    for k in range(ticks.shape[0]):
        for hand in range(ticks[k].hand_present.shape[0]):
            if ticks[k].hand_present[hand] != 0 and ticks[k].hand_distance_m[hand] < least_m:
                least_m, at, nearest = ticks[k].hand_distance_m[hand], k, hand
    return least_m, at, nearest


def _measured(trace: Trace, names: Iterable[str]) -> bool:
    """Return whether all columns ``names`` of ``trace`` were measured without gaps."""
    if not trace.known.columns:
        return True
    return not any(trace.known.missing([name]) or trace.known.column(name).gaps for name in names)


def _worst_decision(trace: Trace) -> tuple[int, int | None]:
    """Return the rank of the worst known decision, 0 to 3, and its tick; None without a decision."""
    if not _measured(trace, READ_OF_DECISIONS):
        stops = np.flatnonzero(trace.ticks["mode"] == Mode.PROTECTIVE_STOP)
        known = len(stops) > 0 and _measured(trace, ["mode"])
        return (_RANKS[DecisionOutcome.STOP], int(stops[0])) if known else (0, None)
    ranks = [_RANKS[DecisionOutcome(int(outcome))] for outcome in trace.decisions["outcome"]]
    if not ranks:
        return 0, None
    worst = int(np.argmax(ranks))
    return ranks[worst], int(trace.decisions["tick"][worst])


def _speed(trace: Trace, hand_m: NDArray[np.float64], tick: int) -> str:
    """Return the word for the hand's speed in the period before ``tick``, or in the first period."""
    first, last = max(tick - 1, 0), max(tick, 1)
    if last >= len(hand_m):
        return SPEEDS[0]
    way_m = length(hand_m[last] - hand_m[first])
    speed_mps = way_m / trace.scenario.settings.clock.control_period_s
    return _class_of(SPEEDS, _FAST_MPS, speed_mps)


def _class_of(names: tuple[str, ...], bounds: tuple[float, ...], value: float) -> str:
    """Return the word of ``names`` for ``value``; a bound belongs to the word before it, NaN to the last."""
    return names[sum(not value <= bound for bound in bounds)]
