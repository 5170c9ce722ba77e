"""Decide whether the arm may use a position that an avoider proposes.

The arm uses a position only if it passes every check of the gate. The gate first checks the avoider's
proposal, then the opposite pose. If both fail, the gate demands a protective stop. The gate records every
check that fails. A position is reachable if the arm can follow the whole straight path to it within the joint
limits.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from math import ceil

import numpy as np

from safety_harness.base.elementary import length, product
from safety_harness.base.settings import GateKind, Settings
from safety_harness.cell.avoidance.asking import (
    NAN_PROPOSAL,
    WALL_LIMIT_S,
    Answer,
    OutOfProcessAvoider,
    Question,
    answers_together,
    ask,
    takes_many,
)
from safety_harness.cell.avoidance.avoider import Avoider, Proposal, Vector
from safety_harness.cell.avoidance.own_body import own_distances
from safety_harness.cell.avoidance.simple import OppositePose
from safety_harness.cell.robot.capsules import CapsuleSet, arm_with
from safety_harness.cell.robot.inverse import InverseKinematics
from safety_harness.cell.robot.obstacles import BoxRecords, box_records, distances_m
from safety_harness.scenario.gate import GateRule
from safety_harness.scenario.obstacles import Obstacle
from safety_harness.seams.contract import Seen
from safety_harness.trace.records import Check, DecisionOutcome

REACH_MARGIN_M = 0.010  # the arm must be able to go straight on this far beyond the position
OWN_CLEARANCE_M = 0.020  # the least distance of the wrist's capsules from base, shoulder and upper arm
WAY_STEP_M = 0.025  # between two samples of a path, capsules can come nearer by about half of this


@dataclass(frozen=True, eq=False)
class Query:
    """A question to the avoider: the nearest predicted hand, the TCP, the joints and a seed.

    ``hands_in_base_m`` contains the positions of all predicted hands, including the nearest hand. Only the
    gate uses these positions. Each hand may be anywhere in a box around its predicted position.
    ``half_widths_m`` contains the half widths of these boxes, or is None if no rule needs them. An answer may
    take effect some time after its question. ``asked_of`` then contains the positions (3,) of the hand and of
    the TCP at the time of the question.
    """

    hand_position_in_base_m: Vector
    tcp_position_in_base_m: Vector
    transform_tcp_to_base: Vector  # (4, 4)
    joint_position_rad: Vector  # (n,)
    hands_in_base_m: Vector  # (k, 3)
    seed: int
    late: str = ""  # why there is no answer in simulated time; empty if there is one
    limit_s: float = WALL_LIMIT_S
    asked_of: tuple[Vector, Vector] | None = None
    seen: Seen | None = None  # at the time of the question
    half_widths_m: Vector | None = None  # (k, 3)

    @property
    def question(self) -> Question:
        """The question for the avoider."""
        hand, tcp = self.asked_of or (self.hand_position_in_base_m, self.tcp_position_in_base_m)
        return Question(hand, tcp, self.seed, self.limit_s, self.seen)


@dataclass(frozen=True, eq=False)
class GateDecision:
    """The gate's decision with its reasons.

    A position that does not exist is NaN. ``fault`` states why the avoider gave no usable answer, and is
    empty after a usable answer. ``latency_s`` is the wall-clock time that the answer took.
    """

    outcome: DecisionOutcome
    chosen_position_in_base_m: Vector
    proposed: Proposal
    opposite: Proposal
    proposed_failed: Check
    opposite_failed: Check
    spread_threshold_m: float = np.nan
    fault: str = ""
    latency_s: float = 0.0


@dataclass(frozen=True, eq=False)
class Gate:
    """The gate between an avoider and the arm, which has no memory between decisions."""

    kinematics: InverseKinematics
    fallback: Avoider
    min_singular_value: float
    lowest_tcp_height_m: float
    capsules: CapsuleSet
    kind: GateKind = GateKind.FULL
    boxes: BoxRecords = field(default_factory=lambda: box_records(()))
    more: GateRule | None = None

    @classmethod
    def from_settings(
        cls,
        settings: Settings,
        kinematics: InverseKinematics,
        capsules: CapsuleSet,
        obstacles: Sequence[Obstacle] = (),
        more: GateRule | None = None,
    ) -> Gate:
        """Return the gate of the settings.

        Args:
            settings: The settings, with the limits and the kind of gate.
            kinematics: The arm's inverse kinematics.
            capsules: The arm's capsules.
            obstacles: The boxes of the cell.
            more: An additional rule of the scenario. None means that there is no additional rule.

        """
        return cls(
            kinematics,
            OppositePose(settings.avoidance.radius_m),
            settings.motion.min_singular_value,
            settings.cell.table_height_m + settings.avoidance.table_clearance_m,
            capsules,
            settings.avoidance.gate,
            box_records(obstacles),
            more,
        )

    def rule(self, avoider: Avoider, query: Query) -> GateDecision:
        """Ask the avoider, and decide on its answer with ``rule_on``."""
        return self.rule_on(answer_to(avoider, query), query)

    def rule_on(self, proposed: Answer, query: Query) -> GateDecision:
        """Decide between the avoider's answer, the opposite pose and a stop.

        If the answer passes all checks, the gate chooses the answer. If only the opposite pose passes, the
        gate chooses this pose. If both fail, the gate chooses a stop.

        Args:
            proposed: The avoider's answer.
            query: The question, with all data that the checks need.

        """
        # Always computed, even if the answer passes, because claims judge the fallback at every decision.
        opposite = answer_to(self.fallback, replace(query, late="", asked_of=None))
        proposed_failed, opposite_failed = self._failed(proposed, query), self._failed(opposite, query)
        if not (proposed.late or proposed.fault):
            proposed_failed |= self._outside(query.question)
        if not proposed_failed:
            outcome, chosen = DecisionOutcome.PROPOSED, proposed.proposal
        elif not opposite_failed:
            outcome, chosen = DecisionOutcome.OPPOSITE, opposite.proposal
        else:
            outcome, chosen = DecisionOutcome.STOP, NAN_PROPOSAL
        return GateDecision(
            outcome,
            chosen.position_in_base_m,
            proposed.proposal,
            opposite.proposal,
            proposed_failed,
            opposite_failed,
            proposed.spread_threshold_m,
            proposed.fault,
            proposed.latency_s,
        )

    def _failed(self, answer: Answer, query: Query) -> Check:
        """Return the checks that an answer fails."""
        if answer.late:
            return Check.LATE
        if answer.fault:
            return Check.NOT_FINITE
        failed = self.check(answer.proposal.position_in_base_m, query)
        spread_m, threshold_m = answer.proposal.spread_m.max(), answer.spread_threshold_m
        if self.kind is GateKind.FULL and spread_m > threshold_m:  # False without a threshold (NaN)
            failed |= Check.UNCERTAIN
        return failed

    def _outside(self, question: Question) -> Check:
        """Return ``Check.OUTSIDE_REGION`` if the question is outside of the scenario's region."""
        region = None if self.more is None else self.more.questions_within
        if region is None:
            return Check.NONE
        depth_m = region.depth_m(question.hand_position_in_base_m, question.tcp_position_in_base_m)
        return Check.NONE if depth_m >= 0.0 else Check.OUTSIDE_REGION

    def check(self, position_in_base_m: Vector, query: Query) -> Check:
        """Return the checks that fail if the TCP goes to a position with its current orientation.

        A straight path is lowest at its start or its end, so the function checks the height above the table
        only there.

        Args:
            position_in_base_m: The position (3,).
            query: The question, with the arm's state and the hands.

        """
        failed = Check.NONE
        full = self.kind is GateKind.FULL
        start_in_base_m = query.transform_tcp_to_base[:3, 3]
        path = position_in_base_m - start_in_base_m
        if position_in_base_m[2] < self.lowest_tcp_height_m:
            failed |= Check.TABLE
        if full and not leads_away(start_in_base_m, path, query.hands_in_base_m, query.half_widths_m):
            failed |= Check.TOWARDS_A_HAND
        target = query.transform_tcp_to_base.copy()
        target[:3, 3] = position_in_base_m
        if self.kinematics.nearest(target, query.joint_position_rad) is None:
            return failed | Check.UNREACHABLE
        length_m = length(path)
        if not length_m > 0.0:
            return failed
        wanted_m = length_m + (REACH_MARGIN_M if full else 0.0)
        reach_m = self.kinematics.reach_along(
            query.joint_position_rad, path / length_m, wanted_m, min_singular_value=self.min_singular_value
        )
        if reach_m < length_m:
            return failed | Check.PATH_UNREACHABLE
        if reach_m < wanted_m:
            failed |= Check.NEAR_REACH_LIMIT
        return failed | self._met(path, length_m, query) if full else failed

    def _met(self, path: Vector, length_m: float, query: Query) -> Check:
        """Return the check that fails first on the path, or ``Check.NONE``.

        A check fails if the wrist comes too near to the body, or if the arm comes too near to an obstacle. If
        the distance is already too small at the start, a check fails only if the arm comes nearer.
        """
        arm, capsules, steps = self.kinematics.arm, self.capsules, ceil(length_m / WAY_STEP_M)
        poses = np.repeat(query.transform_tcp_to_base[None], steps, axis=0)
        poses[:, :3, 3] += (np.arange(1, steps + 1) / steps)[:, None] * path
        joints = np.empty((steps + 1, len(query.joint_position_rad)))
        joints[0] = query.joint_position_rad
        joints[1:] = self.kinematics.followed(poses, query.joint_position_rad)
        own_m = own_distances(arm, capsules, joints)
        wrist = np.isnan(joints[1:, 0]) | ~(own_m[1:] >= min(OWN_CLEARANCE_M, own_m[0]))
        too_near = wrist
        if len(self.boxes) > 0:
            box_m = distances_m(arm_with(arm, capsules), self.boxes, joints)
            too_near = wrist | ~(box_m[1:] >= min(OWN_CLEARANCE_M, box_m[0]))
        if not too_near.any():
            return Check.NONE
        return Check.ROBOT_ITSELF if wrist[too_near.argmax()] else Check.OBSTACLE


def answer_to(avoider: Avoider, query: Query) -> Answer:
    """Return the avoider's answer, or a fault if the answer would be late in simulated time.

    The function raises the same errors as ``ask``.
    """
    if query.late:
        return Answer(fault=query.late, late=True)
    return ask(avoider, query.question)


def ask_many(avoiders: Sequence[Avoider], queries: Sequence[Query]) -> list[Answer]:
    """Return the answers in the order of the queries.

    Except for the latency, each answer equals the answer of ``ask`` bit for bit. The latency of an answer in
    a batch is NaN, because the function only measures the whole batch. If the function asks a question in a
    separate call, it measures the latency of the answer. An avoider in another process gets all its questions
    in one message. The process then answers these questions in a batch or one by one.

    Args:
        avoiders: The avoiders, one for each query.
        queries: The questions.

    Raises:
        NoAnswerError: An avoider hangs.

    """
    answers = [Answer()] * len(queries)
    together: dict[int, list[int]] = {}  # by avoider
    for k, (avoider, query) in enumerate(zip(avoiders, queries, strict=True)):
        if (takes_many(avoider) or isinstance(avoider, OutOfProcessAvoider)) and not query.late:
            together.setdefault(id(avoider), []).append(k)
        else:
            answers[k] = answer_to(avoider, query)
    for numbers in together.values():
        avoider = avoiders[numbers[0]]
        joint = answers_together(avoider, [queries[k].question for k in numbers])
        for row, k in enumerate(numbers):
            answers[k] = joint[row] if joint else answer_to(avoider, queries[k])
    return answers


def leads_away(
    start_in_base_m: Vector, path: Vector, hands_in_base_m: Vector, half_widths_m: Vector | None = None
) -> bool:
    """Return whether the distance from each hand never decreases along a straight path.

    Along a straight path, the distance from a fixed point is a convex function. So the distance from a hand h
    never decreases if it does not decrease at the start, that is, if dot(p - t, t - h) >= 0. Return False if
    the path has the length zero, or if the position of a hand is NaN. If there are half widths r, the
    inequality must be true for every position of a hand in its box. The left side is linear in h, so its
    minimum over the box is at a corner. This minimum is smaller than the value at the middle of the box by
    the sum of |p - t|_i r_i over the axes i.

    Args:
        start_in_base_m: The start t (3,).
        path: The vector p - t (3,).
        hands_in_base_m: The hands h (k, 3).
        half_widths_m: The half widths r (k, 3) of boxes about the hands. None means that the positions of the
            hands are exact.

    """
    if not length(path) > 0.0:
        return False
    lost = np.zeros(len(hands_in_base_m)) if half_widths_m is None else product(half_widths_m, np.abs(path))
    pairs = zip(hands_in_base_m, lost, strict=True)
    return all(float(product(path, start_in_base_m - hand)) >= less for hand, less in pairs)
