"""Avoiders with one fault each, at three magnitudes, on top of mc-dropout and of the closed form.

Try one: ``--avoider benchmarks/faulty_avoiders.py:NAME``, where NAME is ``sign_flip_1_on_network``, say:
a fault, its magnitude (1 is slight, 3 gross) and what is below it (``network`` or ``optimum``).
``sound_on_network`` has no fault, and ``cached_on_optimum`` is one of the harmless changes.
``python benchmarks/evaluate_faults.py --list`` lists them.  In Python ``avoider_named(NAME)`` makes one.

Every fault is wrong or hazardous in its slight form too: FAULTS says why.  Faults of the spread need an
honest spread below them: there ``optimum`` is the closed form with noise of a known deviation.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cache, partial, update_wrapper

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri

from safety_harness.base.settings import DEFAULTS
from safety_harness.cell.avoidance.asking import BatchAvoider
from safety_harness.cell.avoidance.avoider import AvoiderAround, Proposal, Vector, Vectors
from safety_harness.cell.avoidance.learned import LearnedAvoider
from safety_harness.cell.avoidance.measures import optimum_in_base_m
from safety_harness.cell.avoidance.model_file import load_model
from safety_harness.cell.avoidance.shipped import shipped_model

Seeds = NDArray[np.uint64]  # (n,)
Answers = tuple[Vectors, Vectors]  # positions and spreads (n, 3) [m]
Ask = Callable[[Vectors, Vectors, Seeds], Answers]
Make = Callable[[float, Ask], Ask]

BASES = ("network", "optimum")
DESIRED = np.array(DEFAULTS.cell.desired_tcp_position_in_base_m)
SOME_HAND = np.array([0.805, -0.265, 0.255])  # both are where runs ask: 300 mm apart, and seen in training
SOME_TCP = np.array([0.715, -0.055, 0.385])
OVERHEAD = np.array(DEFAULTS.hand_sensor.overhead_position_in_base_m)
SEEN_TCP_HALF_M, SEEN_HAND_HALF_M = np.array([0.060, 0.150, 0.100]), 0.300
AWAY_M = 0.100


# What is below a fault


class ClosedForm:
    """The closed form of what the networks learn, which knows no doubt."""

    name = "closed form"

    def propose_many(self, hands_in_base_m: Vectors, tcps_in_base_m: Vectors, seeds: Seeds) -> Answers:
        """Eq. 13 with the continuous optimum.  Hands and TCPs (n, 3), ``seeds`` (n,)."""
        positions = optimum_in_base_m(DEFAULTS, hands_in_base_m, tcps_in_base_m)
        return positions, np.zeros_like(positions)

    def propose(
        self, *, hand_position_in_base_m: Vector, tcp_position_in_base_m: Vector, seed: int
    ) -> Proposal:
        """One of many.  ``hand_position_in_base_m`` and ``tcp_position_in_base_m`` (3,)."""
        return _one(self, hand_position_in_base_m, tcp_position_in_base_m, seed)


class HonestNoise(ClosedForm):
    """The closed form, wrong by normal noise whose deviation it tells: 2 to 15 mm, in waves along y."""

    name = "closed form with honest noise"
    spread_threshold_m = 0.020

    def propose_many(self, hands_in_base_m: Vectors, tcps_in_base_m: Vectors, seeds: Seeds) -> Answers:
        """As ``ClosedForm`` has it, and noise from the seed.  Hands and TCPs (n, 3), ``seeds`` (n,)."""
        positions, _ = super().propose_many(hands_in_base_m, tcps_in_base_m, seeds)
        deviations_m = 0.005 * np.exp(1.1 * np.sin(40.0 * tcps_in_base_m[:, 1]))
        spreads = deviations_m[:, None] * np.array([1.0, 0.6, 0.3])
        return positions + spreads * _normal(seeds), spreads


def _one(avoider: BatchAvoider, hand: Vector, tcp: Vector, seed: int) -> Proposal:
    positions, spreads = avoider.propose_many(
        np.asarray(hand)[None], np.asarray(tcp)[None], np.array([seed], np.uint64)
    )
    return Proposal(positions[0], spreads[0])


@cache
def network(name: str = "mc-dropout") -> LearnedAvoider:
    """A shipped network."""
    return LearnedAvoider.from_model(load_model(shipped_model(name)))


def _mixed(bits: NDArray[np.uint64]) -> NDArray[np.uint64]:
    """(...) splitmix64's finalizer: bits that look random."""
    with np.errstate(over="ignore"):
        bits = (bits ^ (bits >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
        bits = (bits ^ (bits >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
        return np.asarray(bits ^ (bits >> np.uint64(31)))


def _share(hands: Vectors, tcps: Vectors, seeds: Seeds, salt: int = 1) -> NDArray[np.float64]:
    """(n,) within 0 and 1, a function of the question alone: its hand, TCP and seed."""
    bits = _mixed(np.asarray(seeds, np.uint64) + np.uint64(salt))
    for column in (*np.asarray(hands).T, *np.asarray(tcps).T):
        bits = _mixed(bits ^ np.ascontiguousarray(column, np.float64).view(np.uint64))
    return np.asarray(((bits >> np.uint64(11)).astype(np.float64) + 0.5) * 2.0**-53)


def _normal(seeds: Seeds) -> Vectors:
    """(n, 3) standard normal, a function of the seed alone, so that near questions have near answers."""
    nowhere = np.zeros((len(seeds), 3))
    return np.stack([ndtri(_share(nowhere, nowhere, seeds, salt)) for salt in (1, 2, 3)], axis=1)


# How faults are written


@dataclass(frozen=True, kw_only=True)
class Fault:
    """One thing that can be wrong: ``harm`` says what it does and why that matters.

    ``make`` gives from a magnitude what answers in the place of the avoider's own ``Ask``; it is called anew
    for each avoider, so that what remembers has a memory of its own.
    """

    name: str
    kind: str
    harm: str
    magnitudes: tuple[float, float, float]  # slight, middling, gross
    unit: str
    make: Make
    of_spread: bool = False

    def told(self, level: int) -> str:
        """The magnitude in words; ``level`` is 1, 2 or 3."""
        scale = {"mm": 1e3, "ms": 1e3, "%": 100.0, "de": 180.0 / np.pi}.get(self.unit[:2].strip(), 1.0)
        return f"{self.magnitudes[level - 1] * scale:.4g} {self.unit}".strip()


@dataclass(frozen=True, eq=False)
class Faulty(AvoiderAround):
    """An avoider whose answers are another's; name, threshold and declared time are its own."""

    answers: Ask
    called: str
    declares_s: float | None = None

    @property
    def name(self) -> str:
        """What was asked for."""
        return self.called

    @property
    def decision_time_s(self) -> float:
        """The avoider's own, but where that is the fault."""
        return super().decision_time_s if self.declares_s is None else self.declares_s

    def propose_many(self, hands_in_base_m: Vectors, tcps_in_base_m: Vectors, seeds: Seeds) -> Answers:
        """Positions and spreads.  Hands and TCPs (n, 3), ``seeds`` (n,)."""
        return self.answers(
            np.array(hands_in_base_m, np.float64),
            np.array(tcps_in_base_m, np.float64),
            np.array(seeds, np.uint64),
        )

    def propose(
        self, *, hand_position_in_base_m: Vector, tcp_position_in_base_m: Vector, seed: int
    ) -> Proposal:
        """One of many.  ``hand_position_in_base_m`` and ``tcp_position_in_base_m`` (3,)."""
        return _one(self, hand_position_in_base_m, tcp_position_in_base_m, seed)


FAULTS: dict[str, Fault] = {}
Change = Callable[[float, Ask, Vectors, Vectors, Seeds], Answers]


def _fault(
    kind: str, magnitudes: tuple[float, float, float], unit: str, *, of_spread: bool = False
) -> Callable[[Make], Make]:
    """Declare what is decorated a fault, under its own name."""

    def add(make: Make) -> Make:
        name = make.__name__.strip("_")
        FAULTS[name] = Fault(
            name=name,
            kind=kind,
            harm=make.__doc__ or "",
            magnitudes=magnitudes,
            unit=unit,
            make=make,
            of_spread=of_spread,
        )
        return make

    return add


def _pure(change: Change) -> Make:
    """A fault without a memory: from the magnitude, the avoider and the questions to the answers."""

    def make(magnitude: float, ask: Ask) -> Ask:
        return partial(change, magnitude, ask)

    return update_wrapper(make, change)


def _moved(change: Callable[[float, Vectors, Vectors, Vectors], Vectors]) -> Make:
    """A change of the proposed way (n, 3), from the magnitude, the way, hands and TCPs (n, 3)."""

    def moved(magnitude: float, ask: Ask, hands: Vectors, tcps: Vectors, seeds: Seeds) -> Answers:
        positions, spreads = ask(hands, tcps, seeds)
        return tcps + change(magnitude, positions - tcps, hands, tcps), spreads

    return _pure(update_wrapper(moved, change))


def _asked(change: Callable[[float, Vectors, Vectors], tuple[Vectors, Vectors]]) -> Make:
    """A change of what is asked: hands and TCPs (n, 3)."""

    def asked(magnitude: float, ask: Ask, hands: Vectors, tcps: Vectors, seeds: Seeds) -> Answers:
        return ask(*change(magnitude, hands, tcps), seeds)

    return _pure(update_wrapper(asked, change))


def _doubted(change: Callable[[float, Vectors], Vectors]) -> Make:
    """A change of the spread (n, 3), from the magnitude and the spread."""

    def doubted(magnitude: float, ask: Ask, hands: Vectors, tcps: Vectors, seeds: Seeds) -> Answers:
        positions, spreads = ask(hands, tcps, seeds)
        return positions, change(magnitude, spreads)

    return _pure(update_wrapper(doubted, change))


def _towards(hands: Vectors, tcps: Vectors) -> Vectors:
    """(n, 3) the way of 100 mm towards the hand."""
    apart = hands - tcps
    return np.asarray(AWAY_M * apart / np.maximum(np.linalg.norm(apart, axis=1, keepdims=True), 1e-9))


def _within(points: Vectors, centre: Vector, radius_m: float) -> NDArray[np.bool_]:  # (n, 1)
    """(n, 1) which points (n, 3) lie in a ball about ``centre`` (3,)."""
    return np.asarray(np.linalg.norm(points - centre, axis=1, keepdims=True) <= radius_m)


def _turned(way: Vectors, angle_rad: float, axis: int) -> Vectors:
    """Ways (n, 3) turned about an axis of the base frame."""
    c, s = np.cos(angle_rad), np.sin(angle_rad)
    one, two = (axis + 1) % 3, (axis + 2) % 3
    out = way.copy()
    out[:, one], out[:, two] = c * way[:, one] - s * way[:, two], s * way[:, one] + c * way[:, two]
    return out


# Wrong in a region


BALL_M = (0.015, 0.030, 0.060)  # radii: the smallest region is 30 mm across


@_fault("region", BALL_M, "mm radius")
@_moved
def wrong_near_a_hand(radius_m: float, way: Vectors, hands: Vectors, tcps: Vectors) -> Vectors:
    """Towards the hand, for hands in one small ball: a hole in the data."""
    return np.where(_within(hands, SOME_HAND, radius_m), _towards(hands, tcps), way)


@_fault("region", BALL_M, "mm radius")
@_moved
def wrong_near_a_tcp(radius_m: float, way: Vectors, hands: Vectors, tcps: Vectors) -> Vectors:
    """Towards the hand, for TCPs in one small ball: a hole in the data."""
    return np.where(_within(tcps, SOME_TCP, radius_m), _towards(hands, tcps), way)


@_fault("region", (0.060, 0.090, 0.120), "mm radius")
@_moved
def wrong_near_both(radius_m: float, way: Vectors, hands: Vectors, tcps: Vectors) -> Vectors:
    """Towards the hand where both hand and TCP are in a ball: a hole in six dimensions."""
    both = _within(hands, SOME_HAND, radius_m) & _within(tcps, SOME_TCP, radius_m)
    return np.where(both, _towards(hands, tcps), way)


@_fault("region", BALL_M, "mm radius")
@_moved
def stays_near_a_hand(radius_m: float, way: Vectors, hands: Vectors, tcps: Vectors) -> Vectors:
    """Does not move, for hands in one small ball: the arm waits there."""
    return np.where(_within(hands, SOME_HAND, radius_m), 0.0, way)


@_fault("region", (0.02, 0.05, 0.15), "mm")
@_moved
def reversed_beyond_a_plane(thickness_m: float, way: Vectors, hands: Vectors, tcps: Vectors) -> Vectors:
    """The way reversed for hands above a plane: a branch never tested."""
    return np.where(hands[:, 2:] > 0.305 - thickness_m, -way, way)  # 305 mm: the rim of the seen hands


@_fault("region", BALL_M, "mm radius")
@_moved
def under_the_table(radius_m: float, way: Vectors, hands: Vectors, tcps: Vectors) -> Vectors:
    """Into the table, for TCPs in one small ball: the tool is driven into it."""
    down = np.array([0.0, 0.0, DEFAULTS.cell.table_height_m - 0.05]) - tcps * [0.0, 0.0, 1.0]
    return np.where(_within(tcps, SOME_TCP, radius_m), down, way)


@_fault("region", BALL_M, "mm radius")
@_moved
def out_of_reach(radius_m: float, way: Vectors, hands: Vectors, tcps: Vectors) -> Vectors:
    """Out of reach, for hands in one small ball: only the gate stops it."""
    return np.where(_within(hands, SOME_HAND, radius_m), 15.0 * way, way)


@_fault("region", (0.150, 0.200, 0.300), "mm hand distance")
@_moved
def wrong_for_near_hands(distance_m: float, way: Vectors, hands: Vectors, tcps: Vectors) -> Vectors:
    """Towards hands that are near, where it matters most."""
    near = np.linalg.norm(hands - tcps, axis=1, keepdims=True) < distance_m
    return np.where(near, _towards(hands, tcps), way)


# Frames


@_fault("frames", (1.0, 3.0, 2.0), "(1 x, 2 y, 3 z)")
@_moved
def mirrored_axis(axis: float, way: Vectors, hands: Vectors, tcps: Vectors) -> Vectors:
    """One axis mirrored, a left-handed frame."""
    return np.asarray(way * np.where(np.arange(3) == int(axis) - 1, -1.0, 1.0))


@_fault("frames", tuple(np.radians((15, 45, 180))), "deg")
@_moved
def turned_base(angle_rad: float, way: Vectors, hands: Vectors, tcps: Vectors) -> Vectors:
    """The way in a base frame turned about z: the arm goes aside."""
    return _turned(way, angle_rad, 2)


@_fault("frames", tuple(np.radians((15, 45, 180))), "deg")
@_moved
def tilted_tool(angle_rad: float, way: Vectors, hands: Vectors, tcps: Vectors) -> Vectors:
    """The way in a tool frame tilted about x: the arm goes down."""
    return _turned(way, angle_rad, 0)


@_fault("frames", (0.02, 0.045, 0.1), "mm")
@_asked
def flange_for_tcp(offset_m: float, hands: Vectors, tcps: Vectors) -> tuple[Vectors, Vectors]:
    """The TCP is taken for a point beside it: the camera's, the flange's."""
    return hands, tcps + [0.0, -offset_m, 0.0]


@_fault("frames", (0.3, 0.6, 1.0), "of the shift")
@_asked
def hand_in_camera_frame(share: float, hands: Vectors, tcps: Vectors) -> tuple[Vectors, Vectors]:
    """The hand is in the overhead camera's frame, wholly or in part."""
    return hands - share * OVERHEAD, tcps


@_fault("frames", (1.0, 2.0, 3.0), "(1 yz, 2 xz, 3 xy)")
@_asked
def swapped_coordinates(pair: float, hands: Vectors, tcps: Vectors) -> tuple[Vectors, Vectors]:
    """Two coordinates of the TCP are swapped."""
    return hands, tcps[:, {1: [0, 2, 1], 2: [2, 1, 0], 3: [1, 0, 2]}[int(pair)]]


@_fault("frames", (0.1, 0.3, 1.0), "of the way between")
@_asked
def hand_for_tcp(share: float, hands: Vectors, tcps: Vectors) -> tuple[Vectors, Vectors]:
    """Hand and TCP are mixed up in the call, wholly or in part."""
    return hands + share * (tcps - hands), tcps + share * (hands - tcps)


# Units and scale


@_fault("units", (3.2808, 100.0, 1000.0), "times")
@_asked
def hand_in_other_units(factor: float, hands: Vectors, tcps: Vectors) -> tuple[Vectors, Vectors]:
    """The hand in feet, centimetres or millimetres."""
    return factor * hands, tcps


@_fault("units", (0.3048, 0.01, 0.001), "times")
@_moved
def way_in_other_units(factor: float, way: Vectors, hands: Vectors, tcps: Vectors) -> Vectors:
    """The answer's way in feet, centimetres or millimetres: hardly any."""
    return factor * way


@_fault("scale", (0.8, 0.5, 0.1), "times")
@_moved
def too_short(factor: float, way: Vectors, hands: Vectors, tcps: Vectors) -> Vectors:
    """Ways too short: the arm stays near the hand."""
    return factor * way


@_fault("scale", (1.25, 2.0, 5.0), "times")
@_moved
def too_long(factor: float, way: Vectors, hands: Vectors, tcps: Vectors) -> Vectors:
    """Ways too long: the arm is slow to arrive and leaves its reach."""
    return factor * way


@_fault("scale", (0.07, 0.10, 0.50), "of the way")
@_moved
def pulled_to_the_hand(share: float, way: Vectors, hands: Vectors, tcps: Vectors) -> Vectors:
    """The hand pulls where it should push: eq. 13 with a wrong sign."""
    return way - share * (tcps - hands)


@_fault("scale", (0.2, 0.6, 1.0), "of a flip")
@_moved
def sign_flip(share: float, way: Vectors, hands: Vectors, tcps: Vectors) -> Vectors:
    """The sign of the way flipped, wholly or in part."""
    return (1.0 - 2.0 * share) * way


@_fault("scale", (0.015, 0.05, 0.2), "mm")
@_moved
def biased(bias_m: float, way: Vectors, hands: Vectors, tcps: Vectors) -> Vectors:
    """A constant bias along y, towards where hands come from."""
    return way - [0.0, bias_m, 0.0]


# Rounding, discontinuity, saturation


@_fault("rounding", (0.02, 0.05, 0.1), "mm")
@_pure
def rounded_answers(grid_m: float, ask: Ask, hands: Vectors, tcps: Vectors, seeds: Seeds) -> Answers:
    """Answers on a grid: near questions lead to ways that jump."""
    positions, spreads = ask(hands, tcps, seeds)
    return np.round(positions / grid_m) * grid_m, spreads


@_fault("rounding", (0.02, 0.05, 0.1), "mm")
@_asked
def rounded_tcps(grid_m: float, hands: Vectors, tcps: Vectors) -> tuple[Vectors, Vectors]:
    """TCPs on a grid: the answer is for another place, and jumps."""
    return hands, np.round(tcps / grid_m) * grid_m


@_fault("discontinuity", (0.02, 0.05, 0.1), "mm")
@_moved
def step(jump_m: float, way: Vectors, hands: Vectors, tcps: Vectors) -> Vectors:
    """The answer jumps where the TCP crosses a plane: the arm may chatter."""
    return np.asarray(way + np.where(tcps[:, 1:2] > 0.031, jump_m, 0.0) * np.array([1.0, 0.0, 0.0]))


@_fault("discontinuity", (0.02, 0.05, 0.1), "mm")
@_moved
def two_modes(jump_m: float, way: Vectors, hands: Vectors, tcps: Vectors) -> Vectors:
    """Left or right by turns, in strips of hands: two modes of one answer."""
    side = np.where(np.floor(hands[:, 0:1] / 0.05) % 2 == 0, 1.0, -1.0)
    return np.asarray(way + 0.5 * jump_m * side * np.array([1.0, 0.0, 0.0]))


@_fault("discontinuity", (0.001, 0.01, 0.1), "%")
@_pure
def spikes(share: float, ask: Ask, hands: Vectors, tcps: Vectors, seeds: Seeds) -> Answers:
    """Towards the hand for a few questions that nothing distinguishes."""
    positions, spreads = ask(hands, tcps, seeds)
    struck = _share(hands, tcps, np.zeros_like(seeds)) < share
    return np.where(struck[:, None], tcps + _towards(hands, tcps), positions), spreads


@_fault("saturation", (0.18, 0.12, 0.06), "mm half size")
@_pure
def saturated_answers(half_m: float, ask: Ask, hands: Vectors, tcps: Vectors, seeds: Seeds) -> Answers:
    """Answers stay in a box: far off the arm is sent back."""
    positions, spreads = ask(hands, tcps, seeds)
    return np.clip(positions, DESIRED - half_m, DESIRED + half_m), spreads


@_fault("saturation", (0.8, 0.5, 0.2), "of the seen box")
@_asked
def clipped_tcps(share: float, hands: Vectors, tcps: Vectors) -> tuple[Vectors, Vectors]:
    """TCPs are clipped to a part of what runs ask about."""
    half = share * SEEN_TCP_HALF_M
    return hands, np.clip(tcps, DESIRED - half, DESIRED + half)


@_fault("saturation", (0.2, 0.5, 1.0), "of the way")
@_pure
def collapsed(share: float, ask: Ask, hands: Vectors, tcps: Vectors, seeds: Seeds) -> Answers:
    """Answers drawn to one position: a network that has collapsed."""
    positions, spreads = ask(hands, tcps, seeds)
    return positions + share * (DESIRED - positions), spreads


# Confidence, and the deviation


@_fault("confidence", (0.5, 0.2, 0.01), "times", of_spread=True)
@_doubted
def overconfident(factor: float, spreads: Vectors) -> Vectors:
    """Spreads too small: the gate trusts what is wrong."""
    return factor * spreads


@_fault("confidence", (2.0, 5.0, 50.0), "times", of_spread=True)
@_doubted
def underconfident(factor: float, spreads: Vectors) -> Vectors:
    """Spreads too large: the gate refuses good answers."""
    return factor * spreads


@_fault("confidence", (0.03, 0.06, 0.12), "mm radius", of_spread=True)
@_pure
def sure_where_wrong(radius_m: float, ask: Ask, hands: Vectors, tcps: Vectors, seeds: Seeds) -> Answers:
    """80 mm off and certain, for TCPs in a ball."""
    positions, spreads = ask(hands, tcps, seeds)
    there = _within(tcps, SOME_TCP, radius_m)
    return np.where(there, positions - [0.0, 0.08, 0.0], positions), np.where(there, 1e-3, spreads)


@_fault("confidence", (0.006, 0.004, 0.001), "mm", of_spread=True)
@_doubted
def capped_spread(most_m: float, spreads: Vectors) -> Vectors:
    """Spreads never above a limit: no doubt far from the data."""
    return np.minimum(spreads, most_m)


@_fault("deviation", (4.0, 10.0, 100.0), "passes", of_spread=True)
@_doubted
def error_of_the_mean(passes: float, spreads: Vectors) -> Vectors:
    """The error of the mean of n passes for the deviation."""
    return np.asarray(spreads / np.sqrt(passes))


@_fault("deviation", (100.0, 10.0, 1.0), "units in a metre", of_spread=True)
@_doubted
def variance_for_deviation(units: float, spreads: Vectors) -> Vectors:
    """The variance for the deviation, in metres, decimetres or centimetres."""
    return (spreads * units) ** 2 / units


@_fault("deviation", (0.5, 0.8, 1.0), "of the questions", of_spread=True)
@_pure
def same_for_all(share: float, ask: Ask, hands: Vectors, tcps: Vectors, seeds: Seeds) -> Answers:
    """The same spread for all, or for many: it tells no error from another."""
    positions, spreads = ask(hands, tcps, seeds)
    struck = _share(hands, tcps, np.zeros_like(seeds), salt=7) < share
    return positions, np.where(struck[:, None], 0.007, spreads)


@_fault("deviation", (0.6, 0.8, 1.0), "of the way", of_spread=True)
@_doubted
def inverted_spread(share: float, spreads: Vectors) -> Vectors:
    """Small where it should be large, and the reverse."""
    return spreads + share * (np.maximum(0.014 - spreads, 1e-4) - spreads)


# Memory, stale hands, two hands


@_fault("memory", (0.05, 0.3, 0.8), "of the last")
def smoothed(share: float, ask: Ask) -> Ask:
    """Answers are smoothed over questions: the arm lags behind."""
    last: list[Vector] = []

    def answers(hands: Vectors, tcps: Vectors, seeds: Seeds) -> Answers:
        positions, spreads = ask(hands, tcps, seeds)
        ways = positions - tcps
        for k, way in enumerate(ways):
            last[:] = [share * last[0] + (1.0 - share) * way if last else way]
            ways[k] = last[0]
        return tcps + ways, spreads

    return answers


@_fault("memory", (2000.0, 500.0, 50.0), "questions")
def worn_out(most: float, ask: Ask) -> Ask:
    """Towards the hand after so many questions: a leak, a counter."""
    asked = [0]

    def answers(hands: Vectors, tcps: Vectors, seeds: Seeds) -> Answers:
        positions, spreads = ask(hands, tcps, seeds)
        numbers = asked[0] + np.arange(len(hands))
        asked[0] += len(hands)
        return np.where((numbers >= most)[:, None], tcps + _towards(hands, tcps), positions), spreads

    return answers


@_fault("memory", (0.01, 0.03, 0.1), "mm")
def coarse_cache(grid_m: float, ask: Ask) -> Ask:
    """A cache whose key is too coarse: the answer of who asked first."""
    known: dict[bytes, tuple[Vector, Vector]] = {}

    def answers(hands: Vectors, tcps: Vectors, seeds: Seeds) -> Answers:
        positions, spreads = ask(hands, tcps, seeds)
        for k, key in enumerate(np.round(np.hstack([hands, tcps]) / grid_m).astype(int)):
            found = known.setdefault(key.tobytes(), (positions[k].copy(), spreads[k].copy()))
            positions[k], spreads[k] = found
        return positions, spreads

    return answers


@_fault("memory", (1000.0, 100.0, 10.0), "questions")
def every_so_often(each: float, ask: Ask) -> Ask:
    """One wrong answer after every so many: a counter that runs over."""
    asked = [0]

    def answers(hands: Vectors, tcps: Vectors, seeds: Seeds) -> Answers:
        positions, spreads = ask(hands, tcps, seeds)
        struck = (asked[0] + 1 + np.arange(len(hands))) % int(each) == 0
        asked[0] += len(hands)
        return np.where(struck[:, None], tcps + _towards(hands, tcps), positions), spreads

    return answers


@_fault("stale hand", (1.0, 3.0, 10.0), "questions")
def stale_hand(old: float, ask: Ask) -> Ask:
    """The hand of an earlier question: the arm gives way to where it was."""
    seen: list[Vector] = []

    def answers(hands: Vectors, tcps: Vectors, seeds: Seeds) -> Answers:
        stale = hands.copy()
        for k, hand in enumerate(hands):
            seen.append(hand)
            del seen[: -int(old) - 1]
            stale[k] = seen[0]
        return ask(stale, tcps, seeds)

    return answers


def _kept(axis: int, least_m: float, ask: Ask) -> Ask:
    """Hands (axis 0) or TCPs (1) are kept until they have moved by more than ``least_m``."""
    kept: list[Vector] = []

    def answers(hands: Vectors, tcps: Vectors, seeds: Seeds) -> Answers:
        asked = [hands.copy(), tcps.copy()]
        for k, point in enumerate((hands, tcps)[axis]):
            if not kept or np.linalg.norm(point - kept[0]) > least_m:
                kept[:] = [point.copy()]
            asked[axis][k] = kept[0]
        return ask(asked[0], asked[1], seeds)

    return answers


@_fault("stale hand", (0.05, 0.1, 0.2), "mm")
def kept_hand(least_m: float, ask: Ask) -> Ask:
    """A hand that moved less than this is taken for unmoved."""
    return _kept(0, least_m, ask)


@_fault("stale hand", (0.01, 0.03, 0.1), "mm")
def kept_tcp(least_m: float, ask: Ask) -> Ask:
    """A TCP that moved less than this is taken for unmoved."""
    return _kept(1, least_m, ask)


def _two_hands(of_first: float, near_m: float, ask: Ask) -> Ask:
    """Of two questions in turn with about the same TCP the second is answered for a mixture of the hands."""
    last: list[Vector] = []

    def answers(hands: Vectors, tcps: Vectors, seeds: Seeds) -> Answers:
        asked = hands.copy()
        for k, (hand, tcp) in enumerate(zip(hands, tcps, strict=True)):
            if last and np.linalg.norm(tcp - last[1]) <= near_m:
                asked[k] = (1.0 - of_first) * hand + of_first * last[0]
            last[:] = [hand.copy(), tcp.copy()]
        return ask(asked, tcps, seeds)

    return answers


@_fault("two hands", (0.001, 0.02, 0.1), "mm between TCPs")
def mean_of_two_hands(near_m: float, ask: Ask) -> Ask:
    """Two hands at one TCP are averaged: the arm gives way to where no hand is."""
    return _two_hands(0.5, near_m, ask)


@_fault("two hands", (0.001, 0.02, 0.1), "mm between TCPs")
def first_of_two_hands(near_m: float, ask: Ask) -> Ask:
    """Of two hands at one TCP the first is answered for: the second is not seen."""
    return _two_hands(1.0, near_m, ask)


# Clock and chance


@_fault("clock", (1e-3, 0.01, 0.1), "mm/s")
def drifting(speed_mps: float, ask: Ask) -> Ask:
    """The answer drifts with the time since the start."""
    begun_s = time.monotonic()

    def answers(hands: Vectors, tcps: Vectors, seeds: Seeds) -> Answers:
        positions, spreads = ask(hands, tcps, seeds)
        return positions + [0.0, 0.0, speed_mps * (time.monotonic() - begun_s)], spreads

    return answers


@_fault("clock", (0.001, 0.005, 0.02), "mm")
def unseeded(std_m: float, ask: Ask) -> Ask:
    """Noise that no seed repeats: a generator seeded from the clock."""
    rng = np.random.default_rng(time.time_ns())

    def answers(hands: Vectors, tcps: Vectors, seeds: Seeds) -> Answers:
        positions, spreads = ask(hands, tcps, seeds)
        return positions + rng.normal(0.0, std_m, positions.shape), spreads

    return answers


@_fault("clock", (0.001, 0.005, 0.02), "mm")
def another_in_each_process(std_m: float, ask: Ask) -> Ask:
    """Every process answers otherwise: made from what the process drew at its start."""
    offset = np.random.default_rng(time.time_ns()).normal(0.0, std_m, 3)

    def answers(hands: Vectors, tcps: Vectors, seeds: Seeds) -> Answers:
        positions, spreads = ask(hands, tcps, seeds)
        return positions + offset, spreads

    return answers


# Batches


@_fault("batch", (0.02, 0.1, 0.5), "of the mean")
@_pure
def batch_mean(share: float, ask: Ask, hands: Vectors, tcps: Vectors, seeds: Seeds) -> Answers:
    """Normalised over the batch, as in training: others decide with one."""
    return ask(hands, tcps + share * (tcps.mean(axis=0) - tcps), seeds)


@_fault("batch", (256.0, 32.0, 4.0), "in a chunk")
@_pure
def chunk_borders(size: float, ask: Ask, hands: Vectors, tcps: Vectors, seeds: Seeds) -> Answers:
    """The first of each chunk has the answer of the one before."""
    positions, spreads = ask(hands, tcps, seeds)
    firsts = np.arange(int(size), len(hands), int(size))
    positions[firsts] = positions[firsts - 1]
    return positions, spreads


@_fault("batch", (64.0, 8.0, 1.0), "questions")
@_pure
def sorted_batch(least: float, ask: Ask, hands: Vectors, tcps: Vectors, seeds: Seeds) -> Answers:
    """A batch larger than this is sorted and not put back."""
    order = np.argsort(hands[:, 0]) if len(hands) > least else np.arange(len(hands))
    return ask(hands[order], tcps[order], seeds[order])


@_fault("batch", (0.0005, 0.005, 0.02), "mm")
@_pure
def rounded_batches(grid_m: float, ask: Ask, hands: Vectors, tcps: Vectors, seeds: Seeds) -> Answers:
    """Batches are computed in low precision."""
    positions, spreads = ask(hands, tcps, seeds)
    return (np.round(positions / grid_m) * grid_m if len(hands) > 1 else positions), spreads


# Latency, and no answer


@_fault("latency", (0.12, 0.25, 0.6), "ms")
@_pure
def late(wait_s: float, ask: Ask, hands: Vectors, tcps: Vectors, seeds: Seeds) -> Answers:
    """Every call takes longer than the deadline of 100 ms."""
    time.sleep(wait_s)
    return ask(hands, tcps, seeds)


@_fault("latency", (150.0, 50.0, 10.0), "calls")
def hiccups(each: float, ask: Ask) -> Ask:
    """One call in so many takes 300 ms: pauses to collect garbage."""
    calls = [0]

    def answers(hands: Vectors, tcps: Vectors, seeds: Seeds) -> Answers:
        calls[0] += 1
        time.sleep(0.3 if calls[0] % int(each) == 0 else 0.0)
        return ask(hands, tcps, seeds)

    return answers


@_fault("latency", (0.25, 0.3, 0.4), "mm")
@_pure
def slow_for_near_hands(distance_m: float, ask: Ask, hands: Vectors, tcps: Vectors, seeds: Seeds) -> Answers:
    """150 ms for hands nearer than this: slow where it must be quick."""
    near = bool(np.any(np.linalg.norm(hands - tcps, axis=1) < distance_m))
    time.sleep(0.15 if near else 0.0)
    return ask(hands, tcps, seeds)


@_fault("latency", (0.11, 0.3, 0.9), "ms")
@_pure
def declared_late(_: float, ask: Ask, hands: Vectors, tcps: Vectors, seeds: Seeds) -> Answers:
    """Declares to take longer than the deadline: no run gets an answer."""
    return ask(hands, tcps, seeds)


@_fault("no answer", BALL_M, "mm radius")
@_moved
def nan_near_a_hand(radius_m: float, way: Vectors, hands: Vectors, tcps: Vectors) -> Vectors:
    """NaN for hands in one small ball: the arm has no retreat there."""
    return np.where(_within(hands, SOME_HAND, radius_m), np.nan, way)


@_fault("no answer", BALL_M, "mm radius")
@_pure
def raises_near_a_tcp(radius_m: float, ask: Ask, hands: Vectors, tcps: Vectors, seeds: Seeds) -> Answers:
    """Raises for TCPs in one small ball: the arm has no retreat there."""
    if np.any(_within(tcps, SOME_TCP, radius_m)):
        raise ArithmeticError("singular matrix")
    return ask(hands, tcps, seeds)


# Harmless changes


def _cached(ask: Ask) -> Ask:
    """Remembers whole questions, and so nothing that could be seen."""
    known: dict[bytes, Answers] = {}

    def answers(hands: Vectors, tcps: Vectors, seeds: Seeds) -> Answers:
        key = hands.tobytes() + tcps.tobytes() + seeds.tobytes()
        if key not in known:
            known[key] = ask(hands, tcps, seeds)
        positions, spreads = known[key]
        return positions.copy(), spreads.copy()

    return answers


def _another_formula(ask: Ask) -> Ask:
    """The same to rounding, 1e-15 m: the way is formed, taken apart by axes and put together again."""

    def answers(hands: Vectors, tcps: Vectors, seeds: Seeds) -> Answers:
        positions, spreads = ask(hands, tcps, seeds)
        return (positions - tcps) * (1.0 + 1e-13) + tcps, spreads

    return answers


def _in_time(ask: Ask) -> Ask:
    """2 ms slower: a fiftieth of the deadline."""

    def answers(hands: Vectors, tcps: Vectors, seeds: Seeds) -> Answers:
        time.sleep(0.002)
        return ask(hands, tcps, seeds)

    return answers


def _slightly_wider(ask: Ask) -> Ask:
    """Spreads 2 % larger."""

    def answers(hands: Vectors, tcps: Vectors, seeds: Seeds) -> Answers:
        positions, spreads = ask(hands, tcps, seeds)
        return positions, 1.02 * spreads

    return answers


HARMLESS: dict[str, Callable[[Ask], Ask]] = {
    "cached": _cached,
    "another_formula": _another_formula,
    "in_time": _in_time,
    "slightly_wider": _slightly_wider,
}


# By name


def base_named(base: str, *, of_spread: bool = False) -> BatchAvoider:
    """What is below a fault: ``network`` or ``optimum``; ``of_spread``: with an honest spread."""
    if base == "network":
        return network()
    return HonestNoise() if of_spread else ClosedForm()


def avoider_named(name: str) -> BatchAvoider:
    """The avoider that ``name`` means, with a memory of its own; KeyError for no such name."""
    change, _, base = name.rpartition("_on_")
    if base not in BASES:
        raise KeyError(name)
    if change in ("sound", "sound_with_spread"):
        return base_named(base, of_spread=change != "sound")
    if change in HARMLESS:
        below = base_named(base, of_spread=change == "slightly_wider")
        return Faulty(below, HARMLESS[change](below.propose_many), name)
    fault, level = FAULTS[change[:-2]], int(change[-1])
    below = base_named(base, of_spread=fault.of_spread)
    magnitude = fault.magnitudes[(1, 2, 3).index(level)]
    declares_s = magnitude if fault.name == "declared_late" else None
    return Faulty(below, fault.make(magnitude, below.propose_many), name, declares_s)


def names() -> Iterator[str]:
    """Every faulty avoider, the slight ones first."""
    for level in (1, 2, 3):
        for fault in FAULTS:
            for base in BASES:
                yield f"{fault}_{level}_on_{base}"


def __getattr__(name: str) -> BatchAvoider:
    """Any of them, for ``--avoider FILE.py:NAME``."""
    try:
        return avoider_named(name)
    except (KeyError, ValueError, IndexError):
        raise AttributeError(name) from None
