"""Planted bugs on which searchers are measured: cheap episodes on a real space, each wrong in a corner.

An episode is a cartoon of one encounter: two hands come near to a tool that gives way.  Its first margin
is the clearance [m] to the hands, which the bug spoils; the second one another claim's, which holds.
Committed together with the default searcher, before anything was tuned.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from safety_harness.claims.properties.base import Unit
from safety_harness.search.cube import Cube, Points
from safety_harness.search.findings import Goal, Outcomes
from safety_harness.space.read import parse_space

SPACE = parse_space(
    """\
scenario space: two hands from everywhere
duration: 8 s
avoider: opposite pose
hand sensor:
  one of:
    - kind: ideal
    - kind: overhead
      pixel noise: from 0 px to 3 px
  chances: [19, 1]
tcp start:
  offset: {in: unseen tcp}
hands:
  - hand: right hand
    starts at: [1300 mm, -1000 mm, 400 mm]
    elbow towards: [1700 mm, -1300 mm, 400 mm]
    moves:
      - wait: from 100 ms to 2 s
      - move to: {box: [[400 mm, -800 mm, -100 mm], [1200 mm, 0 mm, 500 mm]]}
        speed: from 0.2 m/s to 1.6 m/s
      - wait: from 100 ms to 2 s
      - withdraw: from 0.2 m/s to 1.6 m/s
  - hand: left hand
    starts at: [1300 mm, 1000 mm, 400 mm]
    elbow towards: [1700 mm, 1300 mm, 400 mm]
    delayed by: from 0 s to 5 s
    moves:
      - move to: {box: [[400 mm, 0 mm, -100 mm], [1200 mm, 800 mm, 500 mm]]}
        speed: from 0.2 m/s to 1.6 m/s
claims:
  hand distance never below 50 mm: holds
  TCP speed never above 250 mm/s: holds
"""
)
CUBE = Cube.from_space(SPACE)
GOALS = (Goal("clearance", 0.1, Unit.LENGTH), Goal("TCP speed", 0.1, Unit.SPEED))
DESIRED = np.array(SPACE.simplest.settings.cell.desired_tcp_position_in_base_m)
_COLUMN = {parameter.name: parameter.columns for parameter in SPACE.parameters}


@dataclass(frozen=True, eq=False)
class Encounter:
    """What the values (n, 17) of a batch say, in SI."""

    values: Points

    def of(self, name: str) -> Points:
        return self.values[:, _COLUMN[name]]

    def one(self, name: str) -> Points:
        return self.of(name)[:, 0]

    @property
    def tcp_m(self) -> Points:
        return DESIRED + self.of("tcp start.offset")

    @property
    def right_m(self) -> Points:
        return self.of("hands[0].moves[1].move to")

    @property
    def left_m(self) -> Points:
        return self.of("hands[1].moves[0].move to")

    @property
    def speed_mps(self) -> Points:
        return self.one("hands[0].moves[1].speed")

    @property
    def arrival_s(self) -> Points:
        way_m = np.linalg.norm(self.right_m - [1.3, -1.0, 0.4], axis=1)
        return self.one("hands[0].moves[0].wait") + way_m / self.speed_mps

    @property
    def left_arrival_s(self) -> Points:
        way_m = np.linalg.norm(self.left_m - [1.3, 1.0, 0.4], axis=1)
        return self.one("hands[1].delayed by") + way_m / self.one("hands[1].moves[0].speed")

    @property
    def noisy(self) -> Points:
        """Pixels of noise; none with the ideal sensor."""
        return np.nan_to_num(self.one("hand sensor.one of[1].pixel noise"))

    @property
    def clearance_m(self) -> Points:
        """Without a bug: nearer and faster is worse, and never a violation."""
        right_m = np.linalg.norm(self.right_m - self.tcp_m, axis=1)
        left_m = np.linalg.norm(self.left_m - self.tcp_m, axis=1)
        return 0.06 + 0.3 * np.minimum(right_m, 1.5 * left_m) - 0.03 * self.speed_mps / 1.6


def ramp(x: Points, start: float, end: float) -> Points:
    """0 before ``start``, 1 from ``end`` on."""
    return np.clip((x - start) / (end - start), 0.0, 1.0)


def wrong_octant(e: Encounter) -> Points:
    """Gives way towards the hand when it comes from above, behind and the right, fast."""
    relative_m = e.right_m - e.tcp_m
    wrong = (relative_m[:, 0] < 0.0) & (relative_m[:, 1] < 0.0) & (relative_m[:, 2] > 0.0)
    return e.clearance_m - 0.085 * (wrong & (e.speed_mps > 1.4))


def speed_window(e: Encounter) -> Points:
    """A filter that resonates: wrong at hand speeds of about 1 m/s, the more the nearer the hand."""
    wrong = 1.0 - ramp(np.abs(e.speed_mps - 1.0), 0.0, 0.04)
    near = 1.0 - ramp(np.linalg.norm(e.right_m - e.tcp_m, axis=1), 0.1, 0.5)
    return e.clearance_m - 0.16 * wrong * near


def unseen(e: Encounter) -> Points:
    """A network that is the worse the farther the tool and the hand are from what was seen."""
    beyond_m = np.maximum(np.abs(e.of("tcp start.offset")) - [0.06, 0.15, 0.1], 0.0).sum(axis=1)
    hand_m = np.maximum(np.abs(e.right_m - [0.8, -0.4, 0.2]) - [0.3, 0.3, 0.25], 0.0).sum(axis=1)
    return e.clearance_m - 0.95 * beyond_m * ramp(hand_m, 0.0, 0.2)


def late_second_hand(e: Encounter) -> Points:
    """Forgets the other hand while giving way to the first one."""
    together = 1.0 - ramp(np.abs(e.left_arrival_s - e.arrival_s - 0.4), 0.0, 0.25)
    near = 1.0 - ramp(np.linalg.norm(e.left_m - e.tcp_m, axis=1), 0.1, 0.45)
    return e.clearance_m - 0.19 * together * near


def hasty_departure(e: Encounter) -> Points:
    """Resumes too early after a long stay and a quick withdrawal, with the tool low."""
    long = ramp(e.one("hands[0].moves[2].wait"), 1.5, 2.0)
    quick = ramp(e.one("hands[0].moves[3].withdraw"), 1.2, 1.6)
    low = ramp(-e.of("tcp start.offset")[:, 2], 0.05, 0.2)
    return e.clearance_m - 0.26 * long * quick * low


def same_height(e: Encounter) -> Points:
    """A singular direction: hand and tool at one height, to one side."""
    relative_m = e.right_m - e.tcp_m
    level = 1.0 - ramp(np.abs(relative_m[:, 2]), 0.0, 0.05)
    aside = 1.0 - ramp(np.abs(relative_m[:, 0]), 0.0, 0.08)
    return e.clearance_m - 0.15 * level * aside


def noisy_sensor(e: Encounter) -> Points:
    """Loses a fast hand in the noise of the rarer sensor."""
    return e.clearance_m - 0.23 * ramp(e.noisy, 1.5, 3.0) * ramp(e.speed_mps, 0.8, 1.6)


def nan_in_a_corner(e: Encounter) -> Points:
    """Flat: no position at all where the hand is at one far corner of its box, and fast."""
    far = np.all(np.abs(e.right_m - [1.2, -0.8, 0.5]) < [0.1, 0.1, 0.075], axis=1)
    return np.where(far & (e.speed_mps > 1.2), -0.1, 0.1)


def rare_mode(e: Encounter) -> Points:
    """Flat: the rarer sensor, a late second hand, a fast first one."""
    late = e.one("hands[1].delayed by") > 4.5
    rare = ~np.isnan(e.one("hand sensor.one of[1].pixel noise"))
    return np.where(rare & late & (e.speed_mps > 1.45), -0.1, 0.1)


def hidden_window(e: Encounter) -> Points:
    """Flat, and nowhere near an end of anything: no search can do better than chance."""
    speed = np.abs(e.speed_mps - 0.73) < 0.03
    wait = np.abs(e.one("hands[0].moves[0].wait") - 0.8) < 0.08
    high = np.abs(e.right_m[:, 2] - 0.24) < 0.05
    return np.where(speed & wait & high, -0.1, 0.1)


Bug = Callable[[Encounter], Points]
SMOOTH: tuple[Bug, ...] = (
    wrong_octant,
    speed_window,
    unseen,
    late_second_hand,
    hasty_departure,
    same_height,
    noisy_sensor,
)
FLAT: tuple[Bug, ...] = (nan_in_a_corner, rare_mode, hidden_window)
BUGS = SMOOTH + FLAT


def by_lot(number: int) -> Bug:
    """A bug in two to four coordinates about a random place; even numbers have slopes, odd ones are flat.

    Written after the search was tuned once (docs/explanation/search.md), and looked at only then.
    """
    rng = np.random.default_rng(number)
    always_used = np.flatnonzero(CUBE.used(np.zeros((1, CUBE.dimension)))[0])
    free = np.setdiff1d(always_used, CUBE.flat_columns)
    columns = rng.choice(free, size=rng.integers(2, 5), replace=False)
    centre, half = rng.random(len(columns)), 0.5 * 5e-4 ** (1.0 / len(columns))

    def bug(e: Encounter) -> Points:
        away = np.abs(SPACE.cube_at(e.values)[:, columns] - centre).max(axis=1) / half
        if number % 2:
            return np.where(away < 1.0, -0.1, 0.1)
        return 0.1 * np.minimum(away - 1.0, 3.0)

    bug.__name__ = f"by_lot_{number}_{'flat' if number % 2 else 'sloping'}"
    return bug


BY_LOT = tuple(by_lot(number) for number in range(6))
# Drawn before the search was changed a second time, and looked at only afterwards.
FRESH = tuple(by_lot(number) for number in range(100, 112))


def world(bug: Bug) -> Callable[[Points, int], Outcomes]:
    """The planted episodes as a world."""

    def evaluate(points: Points, first: int) -> Outcomes:
        encounter = Encounter(SPACE.values_at(points))
        held = 0.05 + 0.1 * encounter.of("tcp start.offset")[:, 0]
        return Outcomes.of_margins(np.column_stack([bug(encounter), held]))

    return evaluate


def share_violated(bug: Bug, draws: int = 1_000_000) -> float:
    """How much of the space violates the claim."""
    points = np.random.default_rng(0).random((draws, CUBE.dimension))
    encounter = Encounter(SPACE.values_at(points))
    return float(np.mean(bug(encounter) < 0.0))
