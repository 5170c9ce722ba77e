from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest
from examples import VISIT, Displaced, run, scenario

from safety_harness.admission.admit import kinematics, start_joint_position
from safety_harness.avoidance.avoider import Avoider, Proposal
from safety_harness.avoidance.gate import Gate, Query, Ruling
from safety_harness.avoidance.opposite import OppositePose
from safety_harness.robot.kinematics import TCP
from safety_harness.settings import DEFAULTS
from safety_harness.trace.records import Check, Outcome

KINEMATICS = kinematics()
GATE = Gate.of(DEFAULTS, KINEMATICS)
HAND = np.array([0.84, -0.30, 0.30])
LOWEST_M = DEFAULTS.cell.table_height_m + DEFAULTS.avoidance.table_clearance_m


def query(
    hand: np.ndarray = HAND, offset: tuple[float, float, float] = (0.02, -0.05, 0.03), seed: int = 3
) -> Query:
    joints = start_joint_position(scenario(offset=offset), KINEMATICS.arm)
    pose = KINEMATICS._forward(joints)[TCP].copy()
    return Query(hand.copy(), pose[:3, 3].copy(), pose, joints, seed)


@dataclass(frozen=True)
class Answers:
    """An avoider that returns, or raises, what it was made with."""

    what: object
    name: str = "answers"

    def propose(self, **_: object) -> Proposal:
        if isinstance(self.what, BaseException):
            raise self.what
        return self.what  # type: ignore[return-value]


class Vandal:
    """An avoider that writes into whatever it is given."""

    name = "vandal"

    def propose(
        self, *, hand_position_in_base_m: np.ndarray, tcp_position_in_base_m: np.ndarray, seed: int
    ) -> Proposal:
        answer = tcp_position_in_base_m + 0.05
        hand_position_in_base_m[:] = tcp_position_in_base_m
        tcp_position_in_base_m[:] = np.nan
        return Proposal(answer)


BROKEN: dict[str, Avoider] = {
    "raises": Answers(ZeroDivisionError("a user's bug")),
    "nothing": Answers(None),
    "a bare position": Answers(np.zeros(3)),
    "nan": Answers(Proposal(np.array([0.7, np.nan, 0.3]))),
    "infinity": Answers(Proposal(np.array([0.7, np.inf, 0.3]))),
    "wrong shape": Answers(Proposal(np.zeros(2))),
    "a batch": Answers(Proposal(np.zeros((1, 3)))),
    "no numbers": Answers(Proposal(np.array(["far", "far", "away"]))),
    "negative spread": Answers(Proposal(np.array([0.7, 0.0, 0.4]), np.array([0.0, -1e-9, 0.0]))),
    "nan spread": Answers(Proposal(np.array([0.7, 0.0, 0.4]), np.full(3, np.nan))),
}


def opposite_of(question: Query) -> np.ndarray:
    away = question.tcp_position_in_base_m - question.hand_position_in_base_m
    return question.tcp_position_in_base_m + DEFAULTS.avoidance.radius_m * away / np.linalg.norm(away)


def test_a_proposal_that_can_be_reached_is_taken_as_it_is() -> None:
    ruling = GATE.rule(Displaced((0.01, 0.05, 0.04)), query())
    assert ruling.outcome is Outcome.PROPOSED
    assert ruling.proposed_failed is Check.NONE
    expected = np.add(query().tcp_position_in_base_m, (0.01, 0.05, 0.04))
    assert ruling.chosen_position_in_base_m == pytest.approx(expected, abs=1e-15)


def test_a_far_proposal_falls_back_to_the_opposite_pose() -> None:
    ruling = GATE.rule(Displaced((0.0, 2.0, 0.0)), query())
    assert ruling.outcome is Outcome.OPPOSITE
    assert ruling.proposed_failed == Check.UNREACHABLE
    assert ruling.opposite_failed is Check.NONE
    assert ruling.chosen_position_in_base_m == pytest.approx(opposite_of(query()), abs=1e-14)
    assert ruling.proposed.position_in_base_m[1] > 1.5  # the refused proposal is kept for the trace


def test_where_neither_can_be_reached_the_arm_stops() -> None:
    ruling = replace(GATE, fallback=OppositePose(3.0)).rule(Displaced((0.0, 2.0, 0.0)), query())
    assert ruling.outcome is Outcome.STOP
    assert Check.UNREACHABLE in ruling.proposed_failed
    assert Check.UNREACHABLE in ruling.opposite_failed
    assert np.isnan(ruling.chosen_position_in_base_m).all()


def test_a_hand_at_the_tcp_leaves_only_the_proposal_or_a_stop() -> None:
    at_tcp = query(hand=query().tcp_position_in_base_m)
    assert GATE.rule(Displaced((0.0, 0.05, 0.0)), at_tcp).outcome is Outcome.PROPOSED
    stopped = GATE.rule(Displaced((0.0, 2.0, 0.0)), at_tcp)
    assert (stopped.outcome, stopped.opposite_failed) == (Outcome.STOP, Check.NOT_FINITE)


@pytest.mark.parametrize("broken", BROKEN.values(), ids=BROKEN.keys())
def test_a_broken_avoider_is_a_recorded_fault_and_the_run_goes_on(broken: Avoider) -> None:
    ruling = GATE.rule(broken, query())
    assert (ruling.outcome, ruling.proposed_failed) == (Outcome.OPPOSITE, Check.NOT_FINITE)
    assert ruling.chosen_position_in_base_m == pytest.approx(opposite_of(query()), abs=1e-14)
    trace = run(scenario(VISIT, duration_s=1.2), avoider=broken)
    assert trace.complete
    assert len(trace.decisions) > 0
    assert (trace.decisions["proposed_failed"] == Check.NOT_FINITE).all()
    assert (trace.decisions["outcome"] == Outcome.OPPOSITE).all()
    assert np.isnan(trace.decisions["proposed_position_in_base_m"]).all()


@pytest.mark.parametrize("leave", [KeyboardInterrupt, SystemExit])
def test_an_avoider_cannot_swallow_the_users_ctrl_c(leave: type[BaseException]) -> None:
    with pytest.raises(leave):
        GATE.rule(Answers(leave()), query())


@pytest.mark.parametrize(("above_m", "failed"), [(1e-6, Check.NONE), (-1e-6, Check.TABLE)])
def test_a_proposal_below_the_table_clearance_is_refused(above_m: float, failed: Check) -> None:
    low = query(offset=(0.02, 0.0, -0.4))
    down_m = LOWEST_M + above_m - low.tcp_position_in_base_m[2]
    ruling = GATE.rule(Displaced((0.0, 0.0, down_m)), low)
    assert ruling.proposed_failed == failed
    assert (ruling.outcome is Outcome.PROPOSED) == (failed is Check.NONE)


def test_an_opposite_pose_below_the_table_clearance_is_refused_too() -> None:
    low = query(offset=(0.02, 0.0, -0.55))
    above = replace(low, hand_position_in_base_m=np.add(low.tcp_position_in_base_m, (0.0, 0.0, 0.2)))
    ruling = GATE.rule(Displaced((0.0, 0.0, -0.2)), above)
    assert ruling.outcome is Outcome.STOP
    assert Check.TABLE in ruling.opposite_failed


def test_an_end_that_can_be_reached_by_no_straight_way_is_refused() -> None:
    here = query()
    behind = -2.0 * here.tcp_position_in_base_m * (1.0, 1.0, 0.0)  # the way leads through the robot's foot
    ruling = GATE.rule(Displaced(tuple(behind)), here)
    assert ruling.proposed_failed == Check.PATH_UNREACHABLE


def test_staying_where_it_is_needs_no_way() -> None:
    assert GATE.rule(Displaced((0.0, 0.0, 0.0)), query()).outcome is Outcome.PROPOSED


def test_an_avoider_cannot_change_the_question_or_the_answer_afterwards() -> None:
    question, untouched = query(), query()
    kept = Proposal(question.tcp_position_in_base_m + 0.05)
    ruling = GATE.rule(Answers(kept), question)
    kept.position_in_base_m[:] = 9.0
    assert ruling.chosen_position_in_base_m == pytest.approx(untouched.tcp_position_in_base_m + 0.05)
    ruling = GATE.rule(Vandal(), question)
    for name in vars(untouched):
        assert np.array_equal(getattr(question, name), getattr(untouched, name)), name
    assert ruling.outcome is Outcome.PROPOSED
    assert ruling.opposite.position_in_base_m == pytest.approx(opposite_of(untouched), abs=1e-14)


def test_the_gate_remembers_nothing() -> None:
    def bits(ruling: Ruling) -> bytes:
        return ruling.chosen_position_in_base_m.tobytes() + ruling.opposite.position_in_base_m.tobytes()

    before = GATE.rule(Displaced((0.0, 0.05, 0.0)), query())
    GATE.rule(Displaced((0.0, 2.0, 0.0)), query(offset=(0.1, 0.1, 0.1)))
    assert bits(GATE.rule(Displaced((0.0, 0.05, 0.0)), query())) == bits(before)
