"""What can be wrong with an avoider's answers.

These are tried behind the plain gate, which asks for nothing but reach: behind the full one it is the gate
that is on trial, and it keeps most of them from doing harm.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial

import numpy as np

from safety_harness.avoidance.avoider import Avoider, AvoiderAround, Proposal, Vector
from safety_harness.exceptions import AvoiderError
from safety_harness.seeds import Branch, generator
from safety_harness.selftest.fault import FaultyPart, Precondition, SeededFault, SeverityLevels
from safety_harness.selftest.system import ChangedSystem
from safety_harness.settings import DEFAULTS, GateKind

Answers = Callable[[Avoider, Vector, Vector, int], Proposal]  # of an avoider, for a hand, a TCP, a seed

PLAIN_GATE = Precondition(
    "behind a gate that asks for reach alone", lambda s: s.with_gate(kind=GateKind.REACH)
)
DESIRED = np.array(DEFAULTS.cell.desired_tcp_position_in_base_m)
NOMINAL_HAND = np.array(DEFAULTS.avoidance.nominal_hand_position_in_base_m)


@dataclass(frozen=True, eq=False)
class FaultyAvoider(AvoiderAround):
    """An avoider whose answers go through somebody else's hands."""

    answers: Answers

    def propose(
        self, *, hand_position_in_base_m: Vector, tcp_position_in_base_m: Vector, seed: int
    ) -> Proposal:
        """What becomes of the answer."""
        return self.answers(self.avoider, hand_position_in_base_m, tcp_position_in_base_m, seed)


def asked(avoider: Avoider, hand: Vector, tcp: Vector, seed: int) -> Proposal:
    """The sound answer."""
    return avoider.propose(hand_position_in_base_m=hand, tcp_position_in_base_m=tcp, seed=seed)


def spoilt(answers: Callable[[float], Answers]) -> Callable[[ChangedSystem, float], ChangedSystem]:
    """Seeds answers that depend on the magnitude; made afresh for each system."""

    def seed_into(system: ChangedSystem, magnitude: float) -> ChangedSystem:
        made = answers(magnitude)
        return system.with_avoider(lambda avoider: FaultyAvoider(avoider, made))

    return seed_into


def moved(change: Callable[[Vector, float], Vector]) -> Callable[[ChangedSystem, float], ChangedSystem]:
    """Seeds another displacement (3,) in place of the proposed one."""

    def answers(magnitude: float, avoider: Avoider, hand: Vector, tcp: Vector, seed: int) -> Proposal:
        proposal = asked(avoider, hand, tcp, seed)
        return Proposal(tcp + change(proposal.position_in_base_m - tcp, magnitude), proposal.spread_m)

    return spoilt(lambda magnitude: partial(answers, magnitude))


def turned(way: Vector, angle_rad: float) -> Vector:
    """A displacement (3,) turned about the vertical."""
    c, s = np.cos(angle_rad), np.sin(angle_rad)
    return np.array([c * way[0] - s * way[1], s * way[0] + c * way[1], way[2]])


def without_axis(way: Vector, axis: float) -> Vector:
    """A displacement (3,) with one coordinate mirrored: 1, 2, 3 for x, y, z."""
    signs = np.ones(3)
    signs[int(axis) - 1] = -1.0
    return signs * way


def _stale_hand(questions: float) -> Answers:
    seen: list[Vector] = []

    def answers(avoider: Avoider, hand: Vector, tcp: Vector, seed: int) -> Proposal:
        seen.append(hand.copy())
        return asked(avoider, seen[max(len(seen) - 1 - int(questions), 0)], tcp, seed)

    return answers


def _stale_tcp(share: float, avoider: Avoider, hand: Vector, tcp: Vector, seed: int) -> Proposal:
    return asked(avoider, hand, tcp + share * (DESIRED - tcp), seed)


def _constant(height_m: float, avoider: Avoider, hand: Vector, tcp: Vector, seed: int) -> Proposal:
    return Proposal(DESIRED + [0.0, 0.0, height_m], asked(avoider, hand, tcp, seed).spread_m)


def _wrong_octant(conditions: float, avoider: Avoider, hand: Vector, tcp: Vector, seed: int) -> Proposal:
    proposal = asked(avoider, hand, tcp, seed)
    sides = np.array([hand[1] > tcp[1], hand[2] > tcp[2], hand[0] < tcp[0]])
    if not np.all(sides[: int(conditions)]):
        return proposal
    return Proposal(2.0 * tcp - proposal.position_in_base_m, proposal.spread_m)


def _far_when_unseen(factor: float, avoider: Avoider, hand: Vector, tcp: Vector, seed: int) -> Proposal:
    proposal = asked(avoider, hand, tcp, seed)
    if np.all(np.abs(hand - NOMINAL_HAND) <= 0.3):
        return proposal
    return Proposal(tcp + factor * (proposal.position_in_base_m - tcp), proposal.spread_m)


def _sometimes_nan(share: float, avoider: Avoider, hand: Vector, tcp: Vector, seed: int) -> Proposal:
    if generator(seed, Branch.SELFTEST, 1).random() < share:
        return Proposal(np.full(3, np.nan))
    return asked(avoider, hand, tcp, seed)


def _other_spread(factor: float, avoider: Avoider, hand: Vector, tcp: Vector, seed: int) -> Proposal:
    proposal = asked(avoider, hand, tcp, seed)
    return Proposal(proposal.position_in_base_m, factor * proposal.spread_m)


def _wrong_spread_axis(weight: float, avoider: Avoider, hand: Vector, tcp: Vector, seed: int) -> Proposal:
    """Two of the axes are put down for the third one, the most uncertain."""
    proposal = asked(avoider, hand, tcp, seed)
    spread_m = proposal.spread_m.copy()
    spread_m[int(np.argmax(spread_m))] *= 1.0 - weight
    return Proposal(proposal.position_in_base_m, spread_m)


def _noisy(std_m: float, avoider: Avoider, hand: Vector, tcp: Vector, seed: int) -> Proposal:
    proposal = asked(avoider, hand, tcp, seed)
    noise_m = std_m * generator(seed, Branch.SELFTEST, 2).standard_normal(3)
    return Proposal(proposal.position_in_base_m + noise_m, proposal.spread_m)


def _unseeded(std_m: float) -> Answers:
    own = np.random.Generator(np.random.PCG64())  # the fault itself: entropy of the machine's

    def answers(avoider: Avoider, hand: Vector, tcp: Vector, seed: int) -> Proposal:
        proposal = asked(avoider, hand, tcp, seed)
        return Proposal(proposal.position_in_base_m + std_m * own.standard_normal(3), proposal.spread_m)

    return answers


@dataclass
class _Remembering:
    """Drifts by the same step with every question that it has ever been asked."""

    step_m: float
    questions: int = field(default=0)

    def __call__(self, avoider: Avoider, hand: Vector, tcp: Vector, seed: int) -> Proposal:
        proposal = asked(avoider, hand, tcp, seed)
        drift_m = self.step_m * (self.questions % 20)
        self.questions += 1
        return Proposal(proposal.position_in_base_m + [0.0, 0.0, drift_m], proposal.spread_m)


def _raising(share: float, avoider: Avoider, hand: Vector, tcp: Vector, seed: int) -> Proposal:
    if generator(seed, Branch.SELFTEST, 3).random() < share:
        raise AvoiderError("no idea")
    return asked(avoider, hand, tcp, seed)


def _magnitude_first(answers: Callable[..., Proposal]) -> Callable[[ChangedSystem, float], ChangedSystem]:
    return spoilt(lambda magnitude: partial(answers, magnitude))


_avoider = partial(SeededFault, part=FaultyPart.AVOIDER, circumstance=PLAIN_GATE)

AVOIDER_FAULTS = (
    _avoider(
        name="sign flip",
        hazard="the arm goes to the hand instead of away from it",
        seed_into=moved(lambda way, weight: (1.0 - 2.0 * weight) * way),
        ladder=SeverityLevels((1.0, 0.75, 0.6, 0.5), "% of the way turned", 100.0),
    ),
    _avoider(
        name="mirrored axis",
        hazard="a left-handed frame: away along two axes, towards along the third",
        seed_into=moved(without_axis),
        ladder=SeverityLevels((2.0, 3.0, 1.0), names=("y", "z", "x")),
    ),
    _avoider(
        name="wrong frame",
        hazard="the answer is in the frame of the tool, not of the base: the arm gives way to the side",
        seed_into=moved(turned),
        ladder=SeverityLevels((np.pi, np.pi / 2, np.pi / 4, np.pi / 9), "deg", 180.0 / np.pi),
    ),
    _avoider(
        name="millimetres for metres",
        hazard="a position a thousand times too far: the arm is stretched to its limits",
        seed_into=moved(lambda way, factor: factor * way),
        ladder=SeverityLevels((1000.0, 10.0, 5.0, 2.0), "times"),
    ),
    _avoider(
        name="metres for millimetres",
        hazard="the arm stays where it is, before the hand",
        seed_into=moved(lambda way, factor: factor * way),
        ladder=SeverityLevels((0.001, 0.02, 0.1, 0.5), "times"),
    ),
    _avoider(
        name="stale hand",
        hazard="the arm gives way to where the hand was at an earlier question",
        seed_into=spoilt(_stale_hand),
        ladder=SeverityLevels((3.0, 1.0), "questions old"),
    ),
    _avoider(
        name="stale TCP",
        hazard="the answer is for where the tool should be, not for where it is",
        seed_into=_magnitude_first(_stale_tcp),
        ladder=SeverityLevels((3.0, 1.0, 0.5), "% of the way", 100.0),
    ),
    _avoider(
        name="constant output",
        hazard="a network that has collapsed: the same position for every hand",
        seed_into=_magnitude_first(_constant),
        ladder=SeverityLevels((0.0, 0.1), "mm above the desired pose", 1e3),
    ),
    _avoider(
        name="towards the hand in one octant",
        hazard="wrong only for hands from one side, where training had few",
        seed_into=_magnitude_first(_wrong_octant),
        ladder=SeverityLevels((1.0, 2.0, 3.0), names=("left", "left, above", "left, above, behind")),
    ),
    _avoider(
        name="out of reach when unseen",
        hazard="a network that extrapolates: far answers for hands outside its data",
        seed_into=_magnitude_first(_far_when_unseen),
        ladder=SeverityLevels((20.0, 10.0, 5.0), "times"),
    ),
    _avoider(
        name="NaN now and then",
        hazard="no position, and the decision is left to whoever comes after",
        seed_into=_magnitude_first(_sometimes_nan),
        ladder=SeverityLevels((1.0, 0.1, 0.01, 0.001), "of decisions"),
    ),
    _avoider(
        name="an exception now and then",
        hazard="the same with a program that stops",
        seed_into=_magnitude_first(_raising),
        ladder=SeverityLevels((1.0, 0.1, 0.01), "of decisions"),
    ),
    _avoider(
        name="noise in the answers",
        hazard="the arm gives way to anywhere",
        seed_into=_magnitude_first(_noisy),
        ladder=SeverityLevels((0.3, 0.1, 0.03), "mm", 1e3),
    ),
    _avoider(
        name="unseeded randomness",
        hazard="no run of it can be repeated, so that no finding can be looked into",
        seed_into=spoilt(_unseeded),
        ladder=SeverityLevels((0.1, 1e-3, 1e-9), "mm", 1e3),
    ),
    _avoider(
        name="memory between episodes",
        hazard="what it does depends on what was tried before: tests in another order say something else",
        seed_into=spoilt(_Remembering),
        ladder=SeverityLevels((1e-2, 1e-3, 1e-6), "mm a question", 1e3),
    ),
    SeededFault(
        name="overconfident spread",
        part=FaultyPart.AVOIDER,
        hazard="the gate lets pass what the network only guesses",
        seed_into=_magnitude_first(_other_spread),
        ladder=SeverityLevels((0.0, 0.1, 0.25, 0.5), "times"),
        of_spread=True,
    ),
    SeededFault(
        name="underconfident spread",
        part=FaultyPart.AVOIDER,
        hazard="every answer is thrown away; what was tested is not what is used",
        seed_into=_magnitude_first(_other_spread),
        ladder=SeverityLevels((10.0, 4.0, 2.0), "times"),
        of_spread=True,
    ),
    SeededFault(
        name="spread of the wrong axis",
        part=FaultyPart.AVOIDER,
        hazard="the doubt about the most uncertain axis is not seen",
        seed_into=_magnitude_first(_wrong_spread_axis),
        ladder=SeverityLevels((1.0, 0.5), "% of the largest lost", 100.0),
        of_spread=True,
    ),
)
