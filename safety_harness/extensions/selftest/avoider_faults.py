"""Define faults in an avoider's answers.

These faults are tried with the plain gate, which checks only reach. The full gate would prevent most of the
faults from doing harm, so the trial would test the gate instead.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from itertools import count
from typing import Any

import numpy as np

from safety_harness.base.elementary import cos, sin
from safety_harness.base.exceptions import AvoiderError
from safety_harness.base.normals import standard_normal
from safety_harness.base.seeds import Branch, generator
from safety_harness.base.settings import DEFAULTS, GateKind
from safety_harness.cell.avoidance.avoider import Avoider, AvoiderAround, Proposal, Vector
from safety_harness.extensions.selftest.fault import Precondition, Seeds, faults_in, of_avoider, seeded
from safety_harness.extensions.selftest.system import ChangedSystem

Answers = Callable[[Avoider, Vector, Vector, int], Proposal]  # sound avoider, hand, TCP, seed -> answer

PLAIN_GATE = Precondition(
    "behind a gate that asks for reach alone", lambda s: s.with_gate(kind=GateKind.REACH)
)
DESIRED = np.array(DEFAULTS.cell.desired_tcp_position_in_base_m)
NOMINAL_HAND = np.array(DEFAULTS.avoidance.nominal_hand_position_in_base_m)

_avoider = partial(of_avoider, circumstance=PLAIN_GATE)
_spread = partial(of_avoider, of_spread=True)


@dataclass(frozen=True, eq=False)
class FaultyAvoider(AvoiderAround):
    """An avoider whose answers come from the function ``answers``, which may query the sound avoider."""

    answers: Answers

    def propose(
        self, *, hand_position_in_base_m: Vector, tcp_position_in_base_m: Vector, seed: int, **seen: Any
    ) -> Proposal:
        """Return the faulty answer to the query."""
        avoider = _Shown(self.avoider, seen) if seen else self.avoider
        return self.answers(avoider, hand_position_in_base_m, tcp_position_in_base_m, seed)


@dataclass(frozen=True, eq=False)
class _Shown(AvoiderAround):
    """A wrapper of an avoider that passes the additional arguments ``seen`` in each query."""

    seen: dict[str, Any]

    def propose(self, **question: Any) -> Proposal:
        """Return the avoider's own answer to the query, with the additional arguments."""
        return self.avoider.propose(**question, **self.seen)


def sound_answer(avoider: Avoider, hand: Vector, tcp: Vector, seed: int) -> Proposal:
    """Return the answer of the sound avoider."""
    return avoider.propose(hand_position_in_base_m=hand, tcp_position_in_base_m=tcp, seed=seed)


def answering(make: Callable[[float], Answers]) -> Seeds:
    """Seed a fault into the avoider's answers; ``make`` creates a new fault for each system."""

    def seed_into(system: ChangedSystem, magnitude: float) -> ChangedSystem:
        answers = make(magnitude)
        return system.with_avoider(lambda avoider: FaultyAvoider(avoider, answers))

    return seed_into


def queried(answers: Callable[[float, Avoider, Vector, Vector, int], Proposal]) -> Seeds:
    """Seed a fault that may query the avoider and that answers in its place."""
    return answering(lambda magnitude: partial(answers, magnitude))


def answered(change: Callable[[float, Proposal, Vector, Vector, int], Proposal]) -> Seeds:
    """Seed a fault that changes each answer of the avoider."""

    def answers(magnitude: float, avoider: Avoider, hand: Vector, tcp: Vector, seed: int) -> Proposal:
        return change(magnitude, sound_answer(avoider, hand, tcp, seed), hand, tcp, seed)

    return queried(answers)


def moved(change: Callable[[Vector, float], Vector]) -> Seeds:
    """Seed a fault that changes the displacement (3,) [m] that the avoider proposes."""

    def displaced(magnitude: float, proposal: Proposal, hand: Vector, tcp: Vector, seed: int) -> Proposal:
        return Proposal(tcp + change(proposal.position_in_base_m - tcp, magnitude), proposal.spread_m)

    return answered(displaced)


def turned(vector: Vector, angle_rad: float) -> Vector:
    """Return a displacement (3,) rotated by ``angle_rad`` about the vertical axis."""
    c, s = cos(angle_rad), sin(angle_rad)
    return np.array([c * vector[0] - s * vector[1], s * vector[0] + c * vector[1], vector[2]])


@_avoider("sign flip", "the arm goes to the hand instead of away from it")
@seeded(moved, (1.0, 0.75, 0.6, 0.5), "% of the way turned", 100.0)
def _flipped(displacement: Vector, weight: float) -> Vector:
    return (1.0 - 2.0 * weight) * displacement


@_avoider("mirrored axis", "a left-handed frame: away along two axes, towards along the third")
@seeded(moved, (2.0, 3.0, 1.0), names=("y", "z", "x"))
def _mirrored(displacement: Vector, axis: float) -> Vector:
    """Mirror one coordinate of a displacement (3,); ``axis`` 1, 2 or 3 stands for x, y or z."""
    signs = np.ones(3)
    signs[int(axis) - 1] = -1.0
    return signs * displacement


@_avoider(
    "wrong frame", "the answer is in the frame of the tool, not of the base: the arm gives way to the side"
)
@seeded(moved, (np.pi, np.pi / 2, np.pi / 4, np.pi / 9), "deg", 180.0 / np.pi)
def _wrong_frame(displacement: Vector, angle_rad: float) -> Vector:
    return turned(displacement, angle_rad)


@_avoider("millimetres for metres", "a position a thousand times too far: the arm is stretched to its limits")
@seeded(moved, (1000.0, 10.0, 5.0, 2.0), "times")
def _too_far(displacement: Vector, factor: float) -> Vector:
    return factor * displacement


@_avoider("metres for millimetres", "the arm stays where it is, before the hand")
@seeded(moved, (0.001, 0.02, 0.1, 0.5), "times")
def _too_near(displacement: Vector, factor: float) -> Vector:
    return factor * displacement


@_avoider("stale hand", "the arm gives way to where the hand was at an earlier question")
@seeded(answering, (3.0, 1.0), "questions old")
def _stale_hand(questions: float) -> Answers:
    seen: list[Vector] = []

    def answers(avoider: Avoider, hand: Vector, tcp: Vector, seed: int) -> Proposal:
        seen.append(hand.copy())
        return sound_answer(avoider, seen[max(len(seen) - 1 - int(questions), 0)], tcp, seed)

    return answers


@_avoider("stale TCP", "the answer is for where the tool should be, not for where it is")
@seeded(queried, (3.0, 1.0, 0.5), "% of the way", 100.0)
def _stale_tcp(share: float, avoider: Avoider, hand: Vector, tcp: Vector, seed: int) -> Proposal:
    return sound_answer(avoider, hand, tcp + share * (DESIRED - tcp), seed)


@_avoider("constant output", "a network that has collapsed: the same position for every hand")
@seeded(answered, (0.0, 0.1), "mm above the desired pose", 1e3)
def _constant(height_m: float, proposal: Proposal, hand: Vector, tcp: Vector, seed: int) -> Proposal:
    return Proposal(DESIRED + [0.0, 0.0, height_m], proposal.spread_m)


@_avoider("towards the hand in one octant", "wrong only for hands from one side, where training had few")
@seeded(answered, (1.0, 2.0, 3.0), names=("left", "left, above", "left, above, behind"))
def _wrong_octant(conditions: float, proposal: Proposal, hand: Vector, tcp: Vector, seed: int) -> Proposal:
    sides = np.array([hand[1] > tcp[1], hand[2] > tcp[2], hand[0] < tcp[0]])
    if not np.all(sides[: int(conditions)]):
        return proposal
    return Proposal(2.0 * tcp - proposal.position_in_base_m, proposal.spread_m)


@_avoider("out of reach when unseen", "a network that extrapolates: far answers for hands outside its data")
@seeded(answered, (20.0, 10.0, 5.0), "times")
def _far_when_unseen(factor: float, proposal: Proposal, hand: Vector, tcp: Vector, seed: int) -> Proposal:
    if np.all(np.abs(hand - NOMINAL_HAND) <= 0.3):
        return proposal
    return Proposal(tcp + factor * (proposal.position_in_base_m - tcp), proposal.spread_m)


@_avoider("NaN now and then", "no position, so that the next stage has to decide")
@seeded(queried, (1.0, 0.1, 0.01, 0.001), "of decisions")
def _sometimes_nan(share: float, avoider: Avoider, hand: Vector, tcp: Vector, seed: int) -> Proposal:
    if generator(seed, Branch.SELFTEST, 1).random() < share:
        return Proposal(np.full(3, np.nan))
    return sound_answer(avoider, hand, tcp, seed)


@_avoider("an exception now and then", "the same with a program that stops")
@seeded(queried, (1.0, 0.1, 0.01), "of decisions")
def _raising(share: float, avoider: Avoider, hand: Vector, tcp: Vector, seed: int) -> Proposal:
    if generator(seed, Branch.SELFTEST, 3).random() < share:
        raise AvoiderError("no idea")
    return sound_answer(avoider, hand, tcp, seed)


@_avoider("noise in the answers", "the arm gives way to anywhere")
@seeded(answered, (0.3, 0.1, 0.03), "mm", 1e3)
def _noisy(std_m: float, proposal: Proposal, hand: Vector, tcp: Vector, seed: int) -> Proposal:
    noise_m = std_m * standard_normal(generator(seed, Branch.SELFTEST, 2), 3)
    return Proposal(proposal.position_in_base_m + noise_m, proposal.spread_m)


@_avoider("unseeded randomness", "no run of it can be repeated, so that no finding can be looked into")
@seeded(answering, (0.1, 1e-3, 1e-9), "mm", 1e3)
def _unseeded(std_m: float) -> Answers:
    own = np.random.Generator(np.random.PCG64())  # the fault: it is seeded from the machine's entropy

    def answers(avoider: Avoider, hand: Vector, tcp: Vector, seed: int) -> Proposal:
        proposal = sound_answer(avoider, hand, tcp, seed)
        return Proposal(proposal.position_in_base_m + std_m * standard_normal(own, 3), proposal.spread_m)

    return answers


@_avoider(
    "memory between episodes",
    "its answers depend on earlier questions: tests in another order give other results",
)
@seeded(answering, (1e-2, 1e-3, 1e-6), "mm a question", 1e3)
def _remembering(step_m: float) -> Answers:
    """Shift the answer further by the same step with each query, and begin again after twenty queries.

    The drift continues from run to run of the same system.
    """
    questions = count()

    def answers(avoider: Avoider, hand: Vector, tcp: Vector, seed: int) -> Proposal:
        proposal = sound_answer(avoider, hand, tcp, seed)
        drift_m = step_m * (next(questions) % 20)
        return Proposal(proposal.position_in_base_m + [0.0, 0.0, drift_m], proposal.spread_m)

    return answers


@_spread("overconfident spread", "the gate accepts guesses of the network")
@seeded(answered, (0.0, 0.1, 0.25, 0.5), "times")
def _overconfident(factor: float, proposal: Proposal, hand: Vector, tcp: Vector, seed: int) -> Proposal:
    return Proposal(proposal.position_in_base_m, factor * proposal.spread_m)


@_spread("underconfident spread", "every answer is thrown away: the system in use is not the tested system")
@seeded(answered, (10.0, 4.0, 2.0), "times")
def _underconfident(factor: float, proposal: Proposal, hand: Vector, tcp: Vector, seed: int) -> Proposal:
    return Proposal(proposal.position_in_base_m, factor * proposal.spread_m)


@_spread("spread of the wrong axis", "the doubt about the most uncertain axis is not seen")
@seeded(answered, (1.0, 0.5), "% of the largest lost", 100.0)
def _wrong_spread_axis(weight: float, proposal: Proposal, hand: Vector, tcp: Vector, seed: int) -> Proposal:
    """Report a spread that is too small on the most uncertain axis."""
    spread_m = proposal.spread_m.copy()
    spread_m[int(np.argmax(spread_m))] *= 1.0 - weight
    return Proposal(proposal.position_in_base_m, spread_m)


AVOIDER_FAULTS = faults_in(globals())
