from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest
from examples import VISIT, Displaced, run, scenario, ur10_gate
from hypothesis import given
from hypothesis import settings as hypothesis_settings
from hypothesis import strategies as st

from safety_harness.admission.poses import start_joint_position
from safety_harness.base.settings import DEFAULTS, GateKind
from safety_harness.cell.avoidance.avoider import Avoider, Proposal
from safety_harness.cell.avoidance.gate import GateDecision, Query, leads_away
from safety_harness.cell.avoidance.own_body import own_distances
from safety_harness.cell.avoidance.simple import OppositePose
from safety_harness.cell.robot.kinematics import TCP
from safety_harness.cell.robot.robots import inverse_kinematics
from safety_harness.scenario.robots import Robot
from safety_harness.trace.records import FAULT_CHARACTERS, Check, DecisionOutcome
from safety_harness.trace.trace import Trace
from tests.cell.robot.arms import transforms_of

KINEMATICS = inverse_kinematics(Robot.UR10)
GATE = ur10_gate(DEFAULTS)
PLAIN = replace(GATE, kind=GateKind.REACH)
HAND = np.array([0.84, -0.30, 0.30])
LOWEST_M = DEFAULTS.cell.table_height_m + DEFAULTS.avoidance.table_clearance_m


def query(
    hand: np.ndarray = HAND, offset: tuple[float, float, float] = (0.02, -0.05, 0.03), seed: int = 3
) -> Query:
    joints = start_joint_position(scenario(offset=offset), KINEMATICS.arm)
    pose = transforms_of(KINEMATICS.arm, joints)[TCP].copy()
    return Query(hand.copy(), pose[:3, 3].copy(), pose, joints, hand[None].copy(), seed)


@dataclass(frozen=True)
class Answers:
    """An avoider that returns, or raises, what it was made with."""

    what: object
    name: str = "answers"

    def propose(self, **_: object) -> Proposal:
        if isinstance(self.what, BaseException):
            raise self.what
        return self.what  # type: ignore[return-value]


class NoQuestion:
    """An avoider that does not want to know anything."""

    name = "no question"

    def propose(self) -> Proposal:
        return Proposal(np.zeros(3))


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


class Unsure(Displaced):
    """Displaced, with a spread, and the largest one that it allows."""

    def __init__(self, by_m: tuple[float, float, float], spread_m: object, threshold_m: object) -> None:
        super().__init__(by_m)
        object.__setattr__(self, "spread_m", spread_m)
        object.__setattr__(self, "spread_threshold_m", threshold_m)

    def propose(self, **question: object) -> Proposal:
        position = super().propose(**question).position_in_base_m  # type: ignore[arg-type]
        return Proposal(position, np.array(self.spread_m))  # type: ignore[attr-defined]


class Speechless(Exception):
    """An exception that cannot say what it is."""

    def __str__(self) -> str:
        raise RuntimeError


HERE = np.array([0.7, 0.0, 0.4])
BROKEN: dict[str, tuple[Avoider, str]] = {
    "raises": (Answers(ZeroDivisionError("a user's bug")), "ZeroDivisionError: a user's bug (test_gate.py:"),
    "raises on two lines": (Answers(OSError("one\ntwo\x00\ud800")), "OSError: one two?? (test_gate.py:"),
    "cannot say what": (Answers(Speechless()), "Speechless (test_gate.py:"),
    "names an address": (Answers(KeyError(object)), "KeyError: <class 'object'> (test_gate.py:"),
    "nothing": (Answers(None), "must return a Proposal; got NoneType"),
    "a bare position": (Answers(np.zeros(3)), "must return a Proposal; got ndarray"),
    "nan": (Answers(Proposal(np.array([0.7, np.nan, 0.3]))), "position is not finite: [0.7, nan, 0.3]"),
    "infinity": (Answers(Proposal(np.array([0.7, np.inf, 0.3]))), "position is not finite: [0.7, inf, 0.3]"),
    "wrong shape": (Answers(Proposal(np.zeros(2))), "position must have shape (3,); got (2,)"),
    "a batch": (Answers(Proposal(np.zeros((1, 3)))), "position must have shape (3,); got (1, 3)"),
    "no numbers": (Answers(Proposal(np.array(["far", "away", ""]))), "position must be real numbers"),
    "negative spread": (Answers(Proposal(HERE, np.array([0.0, -1e-9, 0.0]))), "never negative"),
    "nan spread": (Answers(Proposal(HERE, np.full(3, np.nan))), "spread is not finite"),
    "another signature": (NoQuestion(), "TypeError: NoQuestion.propose() got an unexpected keyword"),
    "a threshold that is none": (Unsure((0.0, 0.05, 0.0), (0.0, 0.0, 0.0), "little"), "got 'little'"),
    "a nan threshold": (Unsure((0.0, 0.05, 0.0), (0.0, 0.0, 0.0), np.nan), "or None; got nan"),
    "no limit as threshold": (Unsure((0.0, 0.05, 0.0), (0.0, 0.0, 0.0), np.inf), "or None; got inf"),
}


def opposite_of(question: Query) -> np.ndarray:
    away = question.tcp_position_in_base_m - question.hand_position_in_base_m
    return question.tcp_position_in_base_m + DEFAULTS.avoidance.radius_m * away / np.linalg.norm(away)


def test_a_proposal_that_can_be_reached_is_taken_as_it_is() -> None:
    ruling = GATE.rule(Displaced((0.01, 0.05, 0.04)), query())
    assert ruling.outcome is DecisionOutcome.PROPOSED
    assert ruling.proposed_failed is Check.NONE
    expected = np.add(query().tcp_position_in_base_m, (0.01, 0.05, 0.04))
    assert ruling.chosen_position_in_base_m == pytest.approx(expected, abs=1e-15)


def test_a_far_proposal_falls_back_to_the_opposite_pose() -> None:
    ruling = GATE.rule(Displaced((0.0, 2.0, 0.0)), query())
    assert ruling.outcome is DecisionOutcome.OPPOSITE
    assert ruling.proposed_failed == Check.UNREACHABLE
    assert ruling.opposite_failed is Check.NONE
    assert ruling.chosen_position_in_base_m == pytest.approx(opposite_of(query()), abs=1e-14)
    assert ruling.proposed.position_in_base_m[1] > 1.5  # the refused proposal is kept for the trace


def test_where_neither_can_be_reached_the_arm_stops() -> None:
    ruling = replace(GATE, fallback=OppositePose(3.0)).rule(Displaced((0.0, 2.0, 0.0)), query())
    assert ruling.outcome is DecisionOutcome.STOP
    assert Check.UNREACHABLE in ruling.proposed_failed
    assert Check.UNREACHABLE in ruling.opposite_failed
    assert np.isnan(ruling.chosen_position_in_base_m).all()


def test_a_hand_at_the_tcp_leaves_only_the_proposal_or_a_stop() -> None:
    at_tcp = query(hand=query().tcp_position_in_base_m)
    assert GATE.rule(Displaced((0.0, 0.05, 0.0)), at_tcp).outcome is DecisionOutcome.PROPOSED
    stopped = GATE.rule(Displaced((0.0, 2.0, 0.0)), at_tcp)
    assert (stopped.outcome, stopped.opposite_failed) == (DecisionOutcome.STOP, Check.NOT_FINITE)


@pytest.mark.parametrize(("broken", "fault"), BROKEN.values(), ids=BROKEN.keys())
def test_a_broken_avoider_is_a_recorded_fault_and_the_run_goes_on(broken: Avoider, fault: str) -> None:
    ruling = GATE.rule(broken, query())
    assert (ruling.outcome, ruling.proposed_failed) == (DecisionOutcome.OPPOSITE, Check.NOT_FINITE)
    assert fault in ruling.fault
    assert ruling.fault.isprintable()
    assert ruling.chosen_position_in_base_m == pytest.approx(opposite_of(query()), abs=1e-14)
    trace = run(scenario(VISIT, duration_s=1.2), avoider=broken)
    assert trace.complete
    assert len(trace.decisions) > 0
    assert (trace.decisions["proposed_failed"] == Check.NOT_FINITE).all()
    assert (trace.decisions["outcome"] == DecisionOutcome.OPPOSITE).all()
    assert np.isnan(trace.decisions["proposed_position_in_base_m"]).all()
    assert (trace.decisions["fault"] == ruling.fault).all()


def test_a_fault_is_the_same_when_a_run_is_repeated_and_fits_the_trace() -> None:
    def fault(error: Exception) -> str:
        return str(run(scenario(VISIT, duration_s=0.7), avoider=Answers(error)).decisions["fault"][0])

    assert fault(ValueError(f"not {object()}")) == fault(ValueError(f"not {object()}"))
    long = fault(ValueError("x" * 10_000))
    assert long == "ValueError: " + "x" * (FAULT_CHARACTERS - len("ValueError: "))


def test_a_decision_without_a_fault_says_nothing_of_one(visit: Trace) -> None:
    assert (visit.decisions["fault"] == "").all()
    assert np.isnan(visit.decisions["spread_threshold_m"]).all()


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
    assert (ruling.outcome is DecisionOutcome.PROPOSED) == (failed is Check.NONE)


def test_an_opposite_pose_below_the_table_clearance_is_refused_too() -> None:
    low = query(offset=(0.02, 0.0, -0.55))
    above = replace(low, hand_position_in_base_m=np.add(low.tcp_position_in_base_m, (0.0, 0.0, 0.2)))
    ruling = GATE.rule(Displaced((0.0, 0.0, -0.2)), above)
    assert ruling.outcome is DecisionOutcome.STOP
    assert Check.TABLE in ruling.opposite_failed


def test_an_end_that_can_be_reached_by_no_straight_way_is_refused() -> None:
    here = query()
    behind = -2.0 * here.tcp_position_in_base_m * (1.0, 1.0, 0.0)  # the way leads through the robot's foot
    ruling = GATE.rule(Displaced(tuple(behind)), here)
    assert ruling.proposed_failed == Check.PATH_UNREACHABLE


def test_staying_where_it_is_leads_away_from_nothing() -> None:
    assert GATE.rule(Displaced((0.0, 0.0, 0.0)), query()).proposed_failed == Check.TOWARDS_A_HAND
    assert PLAIN.rule(Displaced((0.0, 0.0, 0.0)), query()).outcome is DecisionOutcome.PROPOSED


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize(
    ("spread_m", "threshold_m", "failed"),
    [
        (0.02, 0.02, Check.NONE),
        (0.0200001, 0.02, Check.UNCERTAIN),
        (0.0, 0.0, Check.NONE),
        (1e-12, 0.0, Check.UNCERTAIN),
        (9.0, None, Check.NONE),
    ],
)
def test_a_spread_above_the_avoiders_own_threshold_on_any_axis_is_refused(
    axis: int, spread_m: float, threshold_m: float | None, failed: Check
) -> None:
    unsure = Unsure((0.01, 0.05, 0.04), spread_m * np.eye(3)[axis], threshold_m)
    ruling = GATE.rule(unsure, query())
    assert ruling.proposed_failed == failed
    assert ruling.outcome is (DecisionOutcome.OPPOSITE if failed else DecisionOutcome.PROPOSED)
    assert ruling.proposed.spread_m[axis] == spread_m  # kept for the trace
    assert np.array_equal(
        ruling.spread_threshold_m, np.nan if threshold_m is None else threshold_m, equal_nan=True
    )
    assert PLAIN.rule(unsure, query()).outcome is DecisionOutcome.PROPOSED


def test_the_trace_has_the_spread_its_threshold_and_the_check() -> None:
    trace = run(scenario(VISIT, duration_s=0.8), avoider=Unsure((0.0, 0.05, 0.0), (0.0, 0.03, 0.0), 0.02))
    assert len(trace.decisions) > 0
    assert (trace.decisions["spread_threshold_m"] == 0.02).all()
    assert (trace.decisions["proposed_failed"] == Check.UNCERTAIN).all()
    assert (trace.decisions["outcome"] == DecisionOutcome.OPPOSITE).all()


@pytest.mark.parametrize("direction", [(1.0, 0.0, 0.0), (0.3, 1.0, 0.2), (0.5, -1.0, 0.0), (0.0, 0.0, 1.0)])
def test_a_position_at_the_edge_of_reach_is_refused_unless_10_mm_are_left(
    direction: tuple[float, float, float],
) -> None:
    unit = np.array(direction) / np.linalg.norm(direction)
    here = query()
    behind = here.tcp_position_in_base_m - 0.3 * unit
    here = replace(here, hand_position_in_base_m=behind, hands_in_base_m=behind[None])
    limit_m = KINEMATICS.reach_along(
        here.joint_position_rad, unit, 2.0, min_singular_value=DEFAULTS.motion.min_singular_value
    )
    assert 0.1 < limit_m < 1.9
    failed = {
        left_m: GATE.check(here.tcp_position_in_base_m + (limit_m - left_m) * unit, here)
        for left_m in (0.0105, 0.0095, 0.001, -0.001)
    }
    assert failed[0.0105] == Check.NONE
    assert failed[0.0095] == failed[0.001] == Check.NEAR_REACH_LIMIT
    assert failed[-0.001] & (Check.PATH_UNREACHABLE | Check.UNREACHABLE)
    assert PLAIN.check(here.tcp_position_in_base_m + (limit_m - 0.001) * unit, here) is Check.NONE


whole = st.integers(-10, 10)
vectors = st.tuples(whole, whole, whole).map(np.array)  # decimetres: exact, and no dip hides between samples


@given(start=vectors, way=vectors.filter(np.any), hands=st.lists(vectors, max_size=4))
@hypothesis_settings(deadline=None, max_examples=200)
def test_a_way_leads_away_exactly_if_every_hand_is_left_farther_behind_all_along(
    start: np.ndarray, way: np.ndarray, hands: list[np.ndarray]
) -> None:
    along = 1000 * start + np.arange(1001)[:, None] * way  # a thousandth of the way each
    grows = [np.all(np.diff(((along - 1000 * each) ** 2).sum(axis=1)) > 0) for each in hands]
    assert leads_away(1.0 * start, 1.0 * way, np.array(hands, float).reshape(-1, 3)) == all(grows)


def test_right_behind_at_the_tcp_and_sideways_a_hand_is_left_but_one_that_is_no_number_is_not() -> None:
    start, way = np.zeros(3), np.array([0.0, 0.1, 0.0])
    assert leads_away(start, way, np.array([[0.0, -0.3, 0.0], [0.0, 0.0, 0.0], [0.3, 0.0, 0.0]]))
    assert not leads_away(start, way, np.array([[0.0, -0.3, 0.0], [np.nan] * 3]))


def test_a_way_towards_another_predicted_hand_is_refused_and_so_is_the_opposite_pose() -> None:
    here = query()
    away = opposite_of(here) - here.tcp_position_in_base_m
    for distance_m in (0.2, 1.0):
        other = here.tcp_position_in_base_m + distance_m * away / np.linalg.norm(away)
        two = replace(here, hands_in_base_m=np.array([HAND, other]))
        ruling = GATE.rule(OppositePose(0.1), two)
        assert ruling.outcome is DecisionOutcome.STOP
        assert ruling.proposed_failed == ruling.opposite_failed == Check.TOWARDS_A_HAND
        assert PLAIN.rule(OppositePose(0.1), two).outcome is DecisionOutcome.PROPOSED


def test_the_opposite_pose_stands_in_where_the_proposal_leads_to_the_hand() -> None:
    here = query()
    ruling = GATE.rule(Displaced(tuple(0.3 * (HAND - here.tcp_position_in_base_m))), here)
    assert (ruling.outcome, ruling.proposed_failed) == (DecisionOutcome.OPPOSITE, Check.TOWARDS_A_HAND)


def test_a_way_into_the_arms_own_body_is_refused_and_one_out_of_it_is_not() -> None:
    """At the height of its shoulder the arm can fold until its wrist meets its upper arm."""
    beside = np.array([0.7, 0.0, -0.15])
    outside, inside = at((0.45, 0.0, 0.0), beside), at((0.30, 0.0, 0.0), beside)
    inwards, outwards = np.array([0.30, 0.0, 0.0]), np.array([0.45, 0.0, 0.0])
    assert GATE.check(inwards, outside) == Check.ROBOT_ITSELF
    assert PLAIN.check(inwards, outside) is Check.NONE
    assert GATE.check(np.array([0.42, 0.0, 0.0]), outside) is Check.NONE
    behind = at((0.30, 0.0, 0.0), np.array([0.0, 0.0, 0.2]))
    assert own_distances(KINEMATICS.arm, GATE.capsules, inside.joint_position_rad[None])[0] < 0.0
    assert GATE.check(outwards, behind) is Check.NONE


def at(tcp: tuple[float, float, float], hand: np.ndarray) -> Query:
    """A query with the TCP at a place of its own, upright."""
    pose = query().transform_tcp_to_base.copy()
    pose[:3, 3] = tcp
    joints = KINEMATICS.nearest(pose, np.array(DEFAULTS.cell.preferred_joint_position_rad))
    assert joints is not None
    return Query(hand, pose[:3, 3].copy(), pose, joints, hand[None], 3)


def test_an_avoider_cannot_change_the_question_or_the_answer_afterwards() -> None:
    question, untouched = query(), query()
    kept = Proposal(question.tcp_position_in_base_m + 0.05)
    ruling = GATE.rule(Answers(kept), question)
    kept.position_in_base_m[:] = 9.0
    assert ruling.chosen_position_in_base_m == pytest.approx(untouched.tcp_position_in_base_m + 0.05)
    ruling = GATE.rule(Vandal(), question)
    for name in vars(untouched):
        assert np.array_equal(getattr(question, name), getattr(untouched, name)), name
    assert ruling.outcome is DecisionOutcome.PROPOSED
    assert ruling.opposite.position_in_base_m == pytest.approx(opposite_of(untouched), abs=1e-14)


def test_the_gate_remembers_nothing() -> None:
    def bits(ruling: GateDecision) -> bytes:
        return ruling.chosen_position_in_base_m.tobytes() + ruling.opposite.position_in_base_m.tobytes()

    before = GATE.rule(Displaced((0.0, 0.05, 0.0)), query())
    GATE.rule(Displaced((0.0, 2.0, 0.0)), query(offset=(0.1, 0.1, 0.1)))
    assert bits(GATE.rule(Displaced((0.0, 0.05, 0.0)), query())) == bits(before)
