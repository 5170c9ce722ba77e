from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from examples import hand
from hypothesis import given, settings
from hypothesis import strategies as st

from safety_harness.scenario.model import (
    MAX_HANDS,
    FollowTcp,
    HandMove,
    HandTrajectory,
    MoveTo,
    ReachForTcp,
    RecordedHand,
    RecordedMotion,
    Wait,
    Withdraw,
)
from safety_harness.settings import DEFAULTS
from safety_harness.simulation.hand_motion import advance_hands, hands_at_start

DT_S = DEFAULTS.clock.control_period_s
TCP = np.array([0.7, 0.0, 0.35])
START = (1.1, -0.75, 0.2)


class Play:
    """Plays hands against a TCP that stands (or moves as told); remembers every position."""

    def __init__(self, *trajectories: HandTrajectory) -> None:
        self.hands = hands_at_start(trajectories, DEFAULTS.hand)
        self.tick = 0
        self.positions = [self.hands.state["position_in_base_m"].copy()]  # (n, MAX_HANDS, 3)
        self.elbows = [self.hands.state["elbow_in_base_m"].copy()]

    def advance(self, ticks: int, tcp: np.ndarray = TCP, dt_s: float = DT_S) -> np.ndarray:
        for _ in range(ticks):
            advance_hands(self.hands.state, self.hands.moves, self.hands.samples, tcp, self.tick * dt_s, dt_s)
            self.tick += 1
            self.positions.append(self.hands.state["position_in_base_m"].copy())
            self.elbows.append(self.hands.state["elbow_in_base_m"].copy())
        return self.path()

    def path(self, which: int = 0) -> np.ndarray:
        return np.array(self.positions)[:, which]


def played(*moves: HandMove, ticks: int, tcp: np.ndarray = TCP) -> np.ndarray:
    return Play(hand(*moves, at=START)).advance(ticks, tcp)


def distances(path: np.ndarray, point: np.ndarray = TCP) -> np.ndarray:
    return np.linalg.norm(path - point, axis=1)


def test_a_move_is_straight_at_exactly_its_speed_and_ends_exactly_there() -> None:
    goal = np.array([0.84, -0.35, 0.25])
    path = played(MoveTo(position_in_base_m=tuple(goal), speed_mps=1.6), ticks=100)
    way_m = np.linalg.norm(goal - START)
    travelled = np.linalg.norm(path - START, axis=1)
    assert travelled == pytest.approx(np.minimum(1.6 * DT_S * np.arange(101), way_m), abs=1e-12)
    along = (path - START) @ (goal - START) / way_m
    assert along == pytest.approx(travelled, abs=1e-12)
    assert np.array_equal(path[-1], goal)


@pytest.mark.parametrize("wait_s", [0.4, 0.4001, 0.0035, 0.0])
def test_a_wait_is_exact_and_what_is_left_of_a_tick_flows_on(wait_s: float) -> None:
    goal = (1.1, 0.25, 0.2)  # one metre along y
    path = played(Wait(duration_s=wait_s), MoveTo(position_in_base_m=goal, speed_mps=0.5), ticks=120)
    time_s = DT_S * np.arange(121)
    assert path[:, 1] - START[1] == pytest.approx(0.5 * np.maximum(time_s - wait_s, 0.0), abs=1e-12)


def test_the_corner_between_two_moves_falls_inside_a_tick() -> None:
    corner, goal = (1.1, -0.74, 0.2), (1.1, -0.74, 1.2)  # 10 mm at 3 m/s is 3.33 ms of an 8 ms tick
    path = played(
        MoveTo(position_in_base_m=corner, speed_mps=3.0),
        MoveTo(position_in_base_m=goal, speed_mps=1.0),
        ticks=3,
    )
    assert path[1:, 2] - START[2] == pytest.approx(DT_S * np.arange(1, 4) - 0.01 / 3.0, abs=1e-12)


def test_many_moves_fit_into_one_tick() -> None:
    moves = [MoveTo(position_in_base_m=(1.1, -0.75 + 0.001 * k, 0.2), speed_mps=1.0) for k in range(1, 9)]
    assert played(*moves, ticks=1)[-1] == pytest.approx((1.1, -0.742, 0.2), abs=1e-12)


def test_a_reach_stops_at_its_distance_and_goes_on_to_the_next_move() -> None:
    path = played(ReachForTcp(speed_mps=2.0, until_distance_m=0.15, at_most_s=9.0), ticks=150)
    gap = distances(path)
    assert gap[-1] == pytest.approx(0.15, abs=1e-12)
    assert gap.min() >= 0.15 - 1e-12
    assert gap == pytest.approx(np.maximum(gap[0] - 2.0 * DT_S * np.arange(151), 0.15), abs=1e-12)
    path = played(
        ReachForTcp(speed_mps=2.0, until_distance_m=0.15, at_most_s=9.0), Withdraw(speed_mps=2.0), ticks=150
    )
    assert np.array_equal(path[-1], START)


def test_a_reach_gives_up_after_its_time() -> None:
    path = played(ReachForTcp(speed_mps=0.5, until_distance_m=0.0, at_most_s=0.1), ticks=50)
    assert np.linalg.norm(path[-1] - START) == pytest.approx(0.5 * 0.1, abs=1e-12)


def test_a_reach_heads_for_where_the_tcp_is_now() -> None:
    play = Play(hand(ReachForTcp(speed_mps=1.0, until_distance_m=0.1, at_most_s=9.0), at=START))
    for k in range(40):
        tcp = np.add(TCP, (0.0, 0.002 * k, 0.0))
        before = play.positions[-1][0]
        step = play.advance(1, tcp)[-1] - before
        assert step == pytest.approx(DT_S * (tcp - before) / np.linalg.norm(tcp - before), abs=1e-12)


def test_a_follower_comes_never_nearer_than_its_distance_and_keeps_it() -> None:
    play = Play(hand(FollowTcp(speed_mps=1.0, distance_m=0.2, duration_s=4.0), at=START))
    play.advance(200)
    gap = distances(play.path())
    assert gap.min() >= 0.2 - 1e-12
    assert gap[-1] == pytest.approx(0.2, abs=1e-12)
    away = TCP - (0.0, -0.1, 0.0)  # the TCP gives way by 100 mm: the hand comes after it
    play.advance(150, away)
    assert distances(play.path()[-1:], away) == pytest.approx(0.2, abs=1e-12)


def test_a_follower_never_backs_off_and_ends_on_time() -> None:
    play = Play(
        hand(
            FollowTcp(speed_mps=1.0, distance_m=0.2, duration_s=0.8),
            MoveTo(position_in_base_m=START, speed_mps=1.0),
            at=START,
        )
    )
    play.advance(100)
    standing = play.positions[-1][0].copy()
    play.advance(1, TCP)
    assert np.linalg.norm(play.positions[-1][0] - standing) == pytest.approx(DT_S, abs=1e-12)
    near = Play(hand(FollowTcp(speed_mps=1.0, distance_m=0.2, duration_s=9.0), at=tuple(TCP + 0.05)))
    assert np.array_equal(near.advance(20)[-1], TCP + 0.05)  # already nearer: it waits


def test_withdrawing_returns_exactly_to_the_start() -> None:
    for k, speed_mps in enumerate((0.3, 1.0, 1.7)):
        goal = tuple(np.random.default_rng(k).uniform(-1.0, 1.0, 3))
        path = played(
            MoveTo(position_in_base_m=goal, speed_mps=1.3), Withdraw(speed_mps=speed_mps), ticks=2500
        )
        assert np.array_equal(path[-1], START)


def test_after_its_last_move_a_hand_rests() -> None:
    path = played(MoveTo(position_in_base_m=(1.0, -0.7, 0.2), speed_mps=1.0), ticks=60)
    assert np.array_equal(path[-1], path[-20])
    assert np.array_equal(played(ticks=5), np.tile(START, (6, 1)))  # no moves at all


def test_the_forearm_has_its_length_and_points_to_the_person() -> None:
    moving = hand(
        MoveTo(position_in_base_m=(0.6, 0.2, 0.4), speed_mps=1.6), Withdraw(speed_mps=1.0), at=START
    )
    play = Play(moving)
    play.advance(250)
    forearm = np.array(play.elbows)[:, 0] - play.path()
    assert np.linalg.norm(forearm, axis=1) == pytest.approx(DEFAULTS.hand.forearm_length_m, abs=1e-12)
    towards = np.array(moving.elbow_towards_in_base_m) - play.path()
    assert np.cross(forearm, towards) == pytest.approx(np.zeros_like(towards), abs=1e-12)
    assert ((forearm * towards).sum(axis=1) > 0.0).all()


def test_a_hand_where_the_person_stands_still_has_a_forearm() -> None:
    moving = hand(at=(1.6, -1.2, 0.3))
    play = Play(moving)
    forearm = play.elbows[0][0] - play.positions[0][0]
    assert np.linalg.norm(forearm) == pytest.approx(DEFAULTS.hand.forearm_length_m)


def recorded(time_s: np.ndarray, positions: np.ndarray) -> RecordedHand:
    motion = RecordedMotion(time_s, positions, np.add(positions, (0.1, -0.2, 0.2)), (), "0" * 64)
    return RecordedHand(
        name="right",
        recording=Path("nowhere.csv"),
        track="right_hand",
        elbow_track=None,
        elbow_towards_in_base_m=(1.6, -1.2, 0.3),
        starts_at_in_base_m=START,
        turn_rad=0.0,
        speed_factor=1.0,
        from_s=None,
        to_s=None,
        longest_gap_s=0.1,
        fastest_jump_mps=5.0,
        motion=motion,
    )


def recording(seed: int, count: int) -> RecordedHand:
    rng = np.random.default_rng(seed)
    time_s = np.concatenate([[0.0], np.cumsum(rng.uniform(0.002, 0.05, count - 1))])
    return recorded(time_s, np.cumsum(rng.normal(0.0, 0.01, (count, 3)), axis=0) + START)


@pytest.mark.parametrize("count", [2, 3, 40])
def test_a_recorded_hand_is_straight_between_samples_and_rests_after_them(count: int) -> None:
    source = recording(count, count)
    play = Play(source)
    play.advance(200)
    time_s = DT_S * np.arange(201)
    for path, samples in (
        (play.path(), source.motion.hand_position_in_base_m),
        (np.array(play.elbows)[:, 0], source.motion.elbow_position_in_base_m),
    ):
        expected = np.column_stack([np.interp(time_s, source.motion.time_s, column) for column in samples.T])
        assert path == pytest.approx(expected, abs=1e-12)


def test_two_hands_do_not_disturb_each_other() -> None:
    moves = (
        MoveTo(position_in_base_m=(0.9, -0.3, 0.2), speed_mps=1.0),
        Wait(duration_s=0.1),
        Withdraw(speed_mps=2.0),
    )
    single, other = hand(*moves, at=START), recording(3, 30)
    both = Play(single, other)
    both.advance(150)
    for which, alone in enumerate((Play(single), Play(other))):
        assert np.array_equal(both.path(which), alone.advance(150))
    swapped = Play(other, hand(*moves, at=START, name="left"))
    swapped.advance(150)
    assert np.array_equal(swapped.path(1), both.path(0))


def test_a_hand_that_does_not_exist_is_nowhere() -> None:
    play = Play(hand(at=START))
    play.advance(3)
    assert list(play.hands.state["present"]) == [True] + [False] * (MAX_HANDS - 1)
    assert np.isnan(play.path(1)).all()


coordinates = st.tuples(*[st.floats(-1.5, 1.5)] * 3)
speeds = st.floats(0.05, 4.0)
durations = st.floats(0.0, 0.5)
any_move = st.one_of(
    st.builds(MoveTo, position_in_base_m=coordinates, speed_mps=speeds),
    st.builds(Wait, duration_s=durations),
    st.builds(ReachForTcp, speed_mps=speeds, until_distance_m=st.floats(0.0, 0.5), at_most_s=durations),
    st.builds(FollowTcp, speed_mps=speeds, distance_m=st.floats(0.0, 0.5), duration_s=durations),
    st.builds(Withdraw, speed_mps=speeds),
)


@settings(max_examples=60, deadline=None, derandomize=True)
@given(moves=st.lists(any_move, min_size=1, max_size=6), seed=st.integers(0, 2**31))
def test_no_hand_ever_moves_faster_than_it_is_told(moves: list[HandMove], seed: int) -> None:
    play = Play(hand(*moves, at=START))
    rng = np.random.default_rng(seed)
    for _ in range(80):
        play.advance(1, TCP + rng.uniform(-0.2, 0.2, 3))
    fastest = max(getattr(move, "speed_mps", 0.0) for move in moves)
    steps = np.linalg.norm(np.diff(play.path(), axis=0), axis=1)
    assert steps.max() <= fastest * DT_S + 1e-12
    assert np.isfinite(play.path()).all()
    assert np.isfinite(np.array(play.elbows)[:, 0]).all()
