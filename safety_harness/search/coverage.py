"""Count runs by five axes: approach direction, speed, distance, coverage by training data, and outcome.

Each run belongs to one cell. The direction, the speed and the coverage by training data are those at the
run's worst decision. A protective stop is worse than an opposite pose, and an opposite pose is worse than a
proposed position. If several decisions are equally bad, the earliest of them is used. If a run has no
decision, these values are taken at the hand's nearest approach. The distance is always the least distance of
the run. If a controller reports no decisions, the cell follows from distances and motion. If such a
controller reports its mode, its first protective stop is used as a decision.
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
# The upper bounds of the classes in SPEEDS and DISTANCES, except the last class.
_FAST_MPS, _NEAR_M = (0.05, 0.5, 1.0), (0.0, 0.05, 0.2)
_RANKS = {DecisionOutcome.PROPOSED: 1, DecisionOutcome.OPPOSITE: 2, DecisionOutcome.STOP: 3}


@dataclass(frozen=True, order=True)
class CoverageCell:
    """One of 1,536 cells. A word for each axis describes the cell."""

    direction: str
    speed: str
    distance: str
    seen: str
    outcome: str

    def __str__(self) -> str:
        return f"{self.direction}, {self.speed}, {self.distance}, {self.seen}, {self.outcome}"


@dataclass
class Coverage:
    """The number of runs in each cell.

    ``without`` is the number of runs that have no cell.
    """

    counts: Counter[CoverageCell] = field(default_factory=Counter)
    without: int = 0

    def add(self, cells: Iterable[CoverageCell | None]) -> None:
        """Count a run for each element of ``cells``.

        An element None means a run without a cell.
        """
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
        """Return the number of runs for each combination of a word of ``rows`` and a word of ``columns``.

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
        """The number of runs in which a hand touched the arm's capsules, regardless of the claims."""
        return self.along("distance")[DISTANCES[0]]

    @property
    def holes(self) -> list[CoverageCell]:
        """The cells without a run.

        In a given space, many of them may be impossible.
        """
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
        The cell of the run. It is None if no hand was ever present, or if a needed quantity was not measured
        or not finite.

    """
    if not (_measured(trace, READ) and (trace.scenario.driven or _measured(trace, READ_OF_DECISIONS))):
        return None
    ticks = as_compiled(trace.ticks)
    least_m, tick, hand = _nearest(ticks)
    if hand < 0:
        return None
    rank, worst_tick = _worst_decision(trace)
    if worst_tick is not None:
        # At that tick, no hand may have a finite distance; then the first hand counts.
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
    """Return the least hand distance [m] in ``ticks`` (n,), and the tick and hand at which it first occurs.

    If no hand was at a finite distance, the hand is -1. NaN distances are ignored.
    """
    least_m, at, nearest = np.inf, 0, -1
    for k in range(ticks.shape[0]):
        for hand in range(ticks[k].hand_present.shape[0]):
            # A comparison with NaN is False.
            if ticks[k].hand_present[hand] != 0 and ticks[k].hand_distance_m[hand] < least_m:
                least_m, at, nearest = ticks[k].hand_distance_m[hand], k, hand
    return least_m, at, nearest


def _measured(trace: Trace, names: Iterable[str]) -> bool:
    """Return whether all columns ``names`` of ``trace`` were measured without gaps."""
    if not trace.known.columns:
        return True
    return not any(trace.known.missing([name]) or trace.known.column(name).gaps for name in names)


def _worst_decision(trace: Trace) -> tuple[int, int | None]:
    """Return the rank (from 0 to 3) and the tick of the run's worst known decision.

    If no decision is known, the tick is None.
    """
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
    """Return the word for the hand's speed in the control period before ``tick``.

    For the first tick, return the word for the speed in the first control period.
    """
    first, last = max(tick - 1, 0), max(tick, 1)
    if last >= len(hand_m):
        return SPEEDS[0]
    way_m = length(hand_m[last] - hand_m[first])
    speed_mps = way_m / trace.scenario.settings.clock.control_period_s
    return _class_of(SPEEDS, _FAST_MPS, speed_mps)


def _class_of(names: tuple[str, ...], bounds: tuple[float, ...], value: float) -> str:
    """Return the word in ``names`` for ``value``.

    A value that equals a bound belongs to the class below the bound. NaN belongs to the last class.
    """
    return names[sum(not value <= bound for bound in bounds)]
