"""What of a space was exercised: approach direction x speed x distance x seen or unseen x outcome, as counts.

A run is in one cell.  Direction, speed and what was seen are those at its gravest decision (a protective
stop before an opposite pose before a proposed one, the first of them), or, without a decision, at the
hand's nearest approach; the distance is the nearest of the run.  A controller that reports no decisions is
covered by distances and motion alone, and by its first protective stop if it reports its mode.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass, field
from itertools import product

import numpy as np
from numpy.typing import NDArray

from safety_harness.base.compiled import compiled
from safety_harness.space.regions import SeenRegions
from safety_harness.trace.records import DecisionOutcome, Mode, as_compiled
from safety_harness.trace.trace import Trace

# From the TCP, in the base: +x -x +y -y +z -z.
DIRECTIONS = ("front", "back", "left", "right", "above", "below")
SPEEDS = ("at rest", "to 0.5 m/s", "to 1 m/s", "above 1 m/s")
DISTANCES = ("touching", "to 50 mm", "to 200 mm", "farther")
SEEN = ("seen", "hand unseen", "TCP unseen", "both unseen")
OUTCOMES = ("no decision", "proposed position", "opposite pose", "protective stop")
AXES = {"direction": DIRECTIONS, "speed": SPEEDS, "distance": DISTANCES, "seen": SEEN, "outcome": OUTCOMES}

READ = ("transform_tcp_to_base", "hand_present", "hand_position_in_base_m", "hand_distance_m")
READ_OF_DECISIONS = ("decision.tick", "decision.outcome")
_FAST_MPS, _NEAR_M = (0.05, 0.5, 1.0), (0.0, 0.05, 0.2)
_GRAVITY = {DecisionOutcome.PROPOSED: 1, DecisionOutcome.OPPOSITE: 2, DecisionOutcome.STOP: 3}


@dataclass(frozen=True, order=True)
class CoverageCell:
    """One of 1,536, each by its word on every axis."""

    direction: str
    speed: str
    distance: str
    seen: str
    outcome: str

    def __str__(self) -> str:
        return f"{self.direction}, {self.speed}, {self.distance}, {self.seen}, {self.outcome}"


@dataclass
class Coverage:
    """How many runs fell into which cell; ``without`` counts those in which no hand was ever there."""

    counts: Counter[CoverageCell] = field(default_factory=Counter)
    without: int = 0

    def add(self, cells: Iterable[CoverageCell | None]) -> None:
        """Count runs."""
        found = list(cells)
        self.without += found.count(None)
        self.counts.update(cell for cell in found if cell is not None)

    def along(self, axis: str) -> dict[str, int]:
        """Runs for each word of an axis, 0 included."""
        found = dict.fromkeys(AXES[axis], 0)
        for cell, count in self.counts.items():
            found[getattr(cell, axis)] += count
        return found

    def table(self, rows: str, columns: str) -> dict[str, dict[str, int]]:
        """Runs for each pair of words of two axes."""
        found = {row: dict.fromkeys(AXES[columns], 0) for row in AXES[rows]}
        for cell, count in self.counts.items():
            found[getattr(cell, rows)][getattr(cell, columns)] += count
        return found

    @property
    def touching(self) -> int:
        """Runs in which a hand touched the arm's capsules, whatever was claimed of them."""
        return self.along("distance")[DISTANCES[0]]

    @property
    def holes(self) -> list[CoverageCell]:
        """Cells without a run; many of them cannot be reached by any."""
        return [cell for words in product(*AXES.values()) if not self.counts[cell := CoverageCell(*words)]]

    def __str__(self) -> str:
        runs = sum(self.counts.values())
        lines = [f"{len(self.counts)} of {len(self.counts) + len(self.holes)} cells in {runs} runs"]
        if self.without:
            lines.append(f"{self.without} runs without any hand")
        for axis in AXES:
            words = ", ".join(f"{word} {count}" for word, count in self.along(axis).items())
            lines.append(f"{axis}: {words}")
        return "\n".join(lines)


def cell_of(trace: Trace, seen: SeenRegions) -> CoverageCell | None:
    """Where a run belongs; None if no hand was there, or what it takes was not all measured or finite."""
    if not (_measured(trace, READ) and (trace.scenario.driven or _measured(trace, READ_OF_DECISIONS))):
        return None
    ticks = as_compiled(trace.ticks)
    least_m, tick, hand = _nearest(ticks)
    if hand < 0:
        return None
    gravity, gravest = _gravest(trace)
    if gravest is not None:
        tick, hand = gravest, max(_nearest(ticks[gravest : gravest + 1])[2], 0)
    hand_m = trace.ticks["hand_position_in_base_m"][:, hand]
    tcp_m = trace.ticks["transform_tcp_to_base"][tick, :3, 3]
    way_m = hand_m[tick] - tcp_m
    axis = int(np.argmax(np.abs(way_m)))
    return CoverageCell(
        direction=DIRECTIONS[2 * axis + int(way_m[axis] < 0.0)],
        speed=_speed(trace, hand_m, tick),
        distance=_word(DISTANCES, _NEAR_M, least_m),
        seen=SEEN[int(not seen.hand.contains(hand_m[tick])) + 2 * int(not seen.tcp.contains(tcp_m))],
        outcome=OUTCOMES[gravity],
    )


@compiled
def _nearest(ticks: NDArray[np.void]) -> tuple[float, int, int]:
    """How near a hand came [m], and the first such tick and hand of ``ticks`` (n,) ``as_compiled``.

    Hand -1 if none was at a finite distance; a NaN is left out.
    """
    least_m, at, nearest = np.inf, 0, -1
    for k in range(ticks.shape[0]):
        for hand in range(ticks[k].hand_present.shape[0]):
            if ticks[k].hand_present[hand] != 0 and ticks[k].hand_distance_m[hand] < least_m:
                least_m, at, nearest = ticks[k].hand_distance_m[hand], k, hand
    return least_m, at, nearest


def _measured(trace: Trace, names: Iterable[str]) -> bool:
    if not trace.known.columns:
        return True
    return not any(trace.known.missing([name]) or trace.known.of(name).gaps for name in names)


def _gravest(trace: Trace) -> tuple[int, int | None]:
    """How grave the gravest decision was that is known of, and its tick; None without any."""
    if not _measured(trace, READ_OF_DECISIONS):
        stops = np.flatnonzero(trace.ticks["mode"] == Mode.PROTECTIVE_STOP)
        known = len(stops) > 0 and _measured(trace, ["mode"])
        return (_GRAVITY[DecisionOutcome.STOP], int(stops[0])) if known else (0, None)
    gravity = [_GRAVITY[DecisionOutcome(int(outcome))] for outcome in trace.decisions["outcome"]]
    if not gravity:
        return 0, None
    gravest = int(np.argmax(gravity))
    return gravity[gravest], int(trace.decisions["tick"][gravest])


def _speed(trace: Trace, hand_m: NDArray[np.float64], tick: int) -> str:
    """Over the tick before, and after for the first one."""
    before, after = max(tick - 1, 0), max(tick, 1)
    if after >= len(hand_m):
        return SPEEDS[0]
    way_m = float(np.linalg.norm(hand_m[after] - hand_m[before]))
    speed_mps = way_m / trace.scenario.settings.clock.control_period_s
    return _word(SPEEDS, _FAST_MPS, speed_mps)


def _word(words: tuple[str, ...], bounds: tuple[float, ...], value: float) -> str:
    """Each bound belongs to the word before it; a NaN is beyond all of them."""
    return words[sum(not value <= bound for bound in bounds)]
