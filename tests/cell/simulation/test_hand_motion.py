from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from examples import hand, scenario
from hypothesis import given, settings
from hypothesis import strategies as st

from safety_harness.admission.admit import admit
from safety_harness.admission.trial import run_kinematic
from safety_harness.base.settings import DEFAULTS
from safety_harness.cell.simulation.hand_motion import advance_hands
from safety_harness.cell.simulation.hand_programs import hands_at_start
from safety_harness.scenario.model import (
    HAND_SLOTS,
    HandTrajectory,
    JoinedHand,
    MovingHand,
    RecordedHand,
    RecordedMotion,
)
from safety_harness.scenario.moves import (
    FollowTcp,
    HandMove,
    Hesitation,
    MoveTo,
    ReachForObject,
    ReachForTcp,
    Sweep,
    Tremor,
    Wait,
    Wander,
    Withdraw,
)
from safety_harness.scenario.read import read_scenario

DT_S = DEFAULTS.clock.control_period_s
TCP = np.array([0.7, 0.0, 0.35])
START = (1.1, -0.75, 0.2)
OBJECT = np.array(DEFAULTS.object.position_in_base_m)
BOX = ((1.0, -0.5, 0.4), (0.8, -0.2, 0.2))
ABRUPT = 1e9  # m/s^2: as good as at once


class Play:
    """Plays hands against a TCP that stands (or moves as told); remembers every position."""

    def __init__(self, *trajectories: HandTrajectory, seed: int = 1) -> None:
        self.hands = hands_at_start(scenario(*trajectories, duration_s=60.0, seed=seed))
        self.tick = 0
        self.positions = [self.hands.state["position_in_base_m"].copy()]  # (n, hands, 3)
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


def abrupt(*moves: HandMove) -> MovingHand:
    return replace(hand(*moves, at=START), max_acceleration_mps2=ABRUPT, max_speed_mps=20.0)


def played(*moves: HandMove, ticks: int, tcp: np.ndarray = TCP, dt_s: float = DT_S) -> np.ndarray:
    return Play(hand(*moves, at=START)).advance(ticks, tcp, dt_s)


def distances(path: np.ndarray, point: np.ndarray = TCP) -> np.ndarray:
    return np.linalg.norm(path - point, axis=1)


def trapezoid(way_m: float, speed_mps: float, acceleration_mps2: float, time_s: np.ndarray) -> np.ndarray:
    """Oracle: the way gone, by adding up the speed that the ramps and the bound allow, every 10 us."""
    fine_s = np.arange(0.0, time_s[-1] + 1e-5, 1e-5)
    peak = min(speed_mps, np.sqrt(way_m * acceleration_mps2))
    total_s = way_m / peak + peak / acceleration_mps2
    rate = np.minimum(peak, acceleration_mps2 * np.minimum(fine_s, total_s - fine_s)).clip(0.0)
    gone = np.concatenate([[0.0], np.cumsum(0.5 * (rate[1:] + rate[:-1]) * 1e-5)])
    return np.interp(time_s, fine_s, gone)


@pytest.mark.parametrize("speed_mps", [0.3, 1.6, 3.0])
def test_a_move_is_straight_from_rest_to_rest_and_ends_exactly_there(speed_mps: float) -> None:
    goal = np.array([0.84, -0.35, 0.25])
    path = played(MoveTo(position_in_base_m=tuple(goal), speed_mps=speed_mps), ticks=250)
    way_m = np.linalg.norm(goal - START)
    travelled = np.linalg.norm(path - START, axis=1)
    expected = trapezoid(float(way_m), speed_mps, 10.0, DT_S * np.arange(251))
    assert travelled == pytest.approx(expected, abs=1e-6)
    assert (path - START) @ (goal - START) / way_m == pytest.approx(travelled, abs=1e-12)
    assert np.array_equal(path[-1], goal)


def test_without_a_bound_on_acceleration_a_move_has_exactly_its_speed() -> None:
    goal = np.array([0.84, -0.35, 0.25])
    path = Play(abrupt(MoveTo(position_in_base_m=tuple(goal), speed_mps=1.6))).advance(100)
    travelled = np.linalg.norm(path - START, axis=1)
    expected = np.minimum(1.6 * DT_S * np.arange(101), np.linalg.norm(goal - START))
    assert travelled == pytest.approx(expected, abs=1e-8)


@pytest.mark.parametrize("wait_s", [0.4, 0.4001, 0.0035, 0.0])
def test_a_wait_is_exact_and_what_is_left_of_a_tick_flows_on(wait_s: float) -> None:
    goal = (1.1, 0.25, 0.2)  # one metre along y
    path = Play(abrupt(Wait(duration_s=wait_s), MoveTo(position_in_base_m=goal, speed_mps=0.5))).advance(120)
    time_s = DT_S * np.arange(121)
    assert path[:, 1] - START[1] == pytest.approx(0.5 * np.maximum(time_s - wait_s, 0.0), abs=1e-8)


def test_many_moves_fit_into_one_tick() -> None:
    moves = [MoveTo(position_in_base_m=(1.1, -0.75 + 0.001 * k, 0.2), speed_mps=1.0) for k in range(1, 9)]
    assert Play(abrupt(*moves)).advance(1)[-1] == pytest.approx((1.1, -0.742, 0.2), abs=1e-6)


PROGRAM = (
    MoveTo(position_in_base_m=(0.9, -0.4, 0.3), speed_mps=1.5),
    Wait(duration_s=0.0371),
    Sweep(speed_mps=0.7, from_in_base_m=BOX[0], to_in_base_m=BOX[1], times=1),
    ReachForObject(
        speed_mps=0.9,
        until_distance_m=0.2,
        at_most_s=0.9,
        hesitation=Hesitation(distance_m=0.3, duration_s=0.1),
    ),
    Wander(speed_mps=1.0, corners_in_base_m=BOX, duration_s=1.23),
    Withdraw(speed_mps=1.0),
)


def test_moves_that_do_not_look_at_the_tcp_are_the_same_on_every_clock() -> None:
    coarse, fine = played(*PROGRAM, ticks=160, dt_s=0.05), played(*PROGRAM, ticks=8000, dt_s=0.001)
    assert coarse == pytest.approx(fine[::50], abs=1e-9)
    assert np.array_equal(coarse[-1], START)


def test_a_reach_stops_at_its_distance_and_goes_on_to_the_next_move() -> None:
    reach = ReachForTcp(speed_mps=2.0, until_distance_m=0.15, at_most_s=9.0)
    gap = distances(played(reach, ticks=150))
    assert gap[-1] == pytest.approx(0.15, abs=2e-9)
    assert gap.min() >= 0.15 - 1e-12
    assert np.array_equal(played(reach, Withdraw(speed_mps=2.0), ticks=250)[-1], START)


def test_a_reach_is_hardly_slower_than_a_straight_way_there() -> None:
    way_m = distances(np.array([START]))[0] - 0.15
    reach = played(ReachForTcp(speed_mps=2.0, until_distance_m=0.15, at_most_s=9.0), ticks=100)
    straight_s = way_m / 2.0 + 2.0 / 10.0
    assert np.argmax(distances(reach) < 0.15 + 1e-6) * DT_S < straight_s + 2 * DT_S


def test_a_reach_gives_up_after_its_time_and_stops() -> None:
    path = played(ReachForTcp(speed_mps=0.5, until_distance_m=0.0, at_most_s=0.1), ticks=50)
    # up to speed in 50 ms, 50 ms more, and 50 ms to stop
    assert np.linalg.norm(path[-1] - START) == pytest.approx(0.5 * 0.1, abs=1e-4)
    assert np.array_equal(path[20], path[-1])


def test_a_reach_turns_to_where_the_tcp_is_now() -> None:
    play = Play(hand(ReachForTcp(speed_mps=1.0, until_distance_m=0.1, at_most_s=9.0), at=START))
    play.advance(30)
    for k in range(30):
        tcp = np.add(TCP, (0.0, 0.002 * k, 0.0))
        before, now = play.path()[-2:]
        change = (play.advance(1, tcp)[-1] - now) - (now - before)
        towards = np.cross(tcp - now, now - before)  # the turn is in the plane of the way and the goal
        if np.linalg.norm(towards) > 1e-8:
            assert abs(change @ towards) / np.linalg.norm(towards) < 1e-5
    heading = play.path()[-1] - play.path()[-2]
    assert heading @ (tcp - now) > 0.999 * np.linalg.norm(heading) * np.linalg.norm(tcp - now)


@pytest.mark.parametrize("kind", [ReachForTcp, ReachForObject])
def test_a_reach_that_hesitates_stops_on_its_way_and_goes_on(
    kind: type[ReachForTcp | ReachForObject],
) -> None:
    goal = TCP if kind is ReachForTcp else OBJECT
    stop = Hesitation(distance_m=0.4, duration_s=0.3)
    reach = kind(speed_mps=1.0, until_distance_m=0.1, at_most_s=9.0, hesitation=stop)
    gap = distances(played(reach, ticks=300), goal)
    still = np.flatnonzero(np.abs(np.diff(gap)) < 1e-9)
    there = still[np.abs(gap[still] - 0.4) < 1e-6]
    assert len(there) * DT_S == pytest.approx(0.3, abs=2 * DT_S)
    assert np.array_equal(there, np.arange(there[0], there[-1] + 1))
    assert gap[-1] == pytest.approx(0.1, abs=2e-9)


def test_the_hand_of_the_scenario_that_ships_does_hesitate() -> None:
    trace = run_kinematic(admit(read_scenario(Path("shipped:hesitating-reach"))))
    hand_m, tcp_m = (
        trace.ticks["hand_position_in_base_m"][:, 0],
        trace.ticks["transform_tcp_to_base"][:, :3, 3],
    )
    gap_m = np.linalg.norm(hand_m - tcp_m, axis=1)[1:]
    still = np.linalg.norm(np.diff(hand_m, axis=0), axis=1) < 1e-9
    there = still & (gap_m > 0.4) & (gap_m < 0.46)
    assert np.count_nonzero(there) * DT_S == pytest.approx(0.4, abs=3 * DT_S)
    assert gap_m.min() < 0.21


def test_the_time_of_a_reach_counts_its_hesitation() -> None:
    stop = Hesitation(distance_m=0.4, duration_s=5.0)
    reach = ReachForTcp(speed_mps=1.0, until_distance_m=0.1, at_most_s=2.0, hesitation=stop)
    path = played(reach, Withdraw(speed_mps=1.0), ticks=500)
    assert distances(path).min() == pytest.approx(0.4, abs=1e-6)
    leaves = np.flatnonzero(distances(path) > 0.4 + 1e-5)
    assert DT_S * leaves[leaves > 150][0] == pytest.approx(2.0, abs=2 * DT_S)


def test_a_reach_for_the_object_comes_straight_to_its_distance() -> None:
    path = played(ReachForObject(speed_mps=1.0, until_distance_m=0.12, at_most_s=9.0), ticks=250)
    assert distances(path[-1:], OBJECT) == pytest.approx(0.12, abs=1e-12)
    assert np.cross(path - START, OBJECT - START) == pytest.approx(np.zeros((251, 3)), abs=1e-12)


def test_a_follower_comes_never_nearer_than_its_distance_and_keeps_it() -> None:
    play = Play(hand(FollowTcp(speed_mps=1.0, distance_m=0.2, duration_s=4.0), at=START))
    play.advance(200)
    gap = distances(play.path())
    assert gap.min() >= 0.2 - 1e-12
    assert gap[-1] == pytest.approx(0.2, abs=2e-9)
    away = TCP - (0.0, -0.1, 0.0)  # the TCP gives way by 100 mm: the hand comes after it
    play.advance(150, away)
    assert distances(play.path()[-1:], away) == pytest.approx(0.2, abs=2e-9)


def test_a_follower_never_backs_off_and_ends_on_time() -> None:
    back = MoveTo(position_in_base_m=START, speed_mps=1.0)
    play = Play(hand(FollowTcp(speed_mps=1.0, distance_m=0.2, duration_s=0.96), back, at=START))
    play.advance(120)
    standing = play.positions[-1][0].copy()
    play.advance(1, TCP)
    assert np.linalg.norm(play.positions[-1][0] - standing) == pytest.approx(0.5 * 10.0 * DT_S**2, abs=1e-9)
    near = Play(hand(FollowTcp(speed_mps=1.0, distance_m=0.2, duration_s=9.0), at=tuple(TCP + 0.05)))
    assert np.array_equal(near.advance(20)[-1], TCP + 0.05)  # already nearer: it waits


def test_a_wanderer_stays_in_its_box_on_straight_ways_between_points_all_over_it() -> None:
    corners = np.sort(BOX, axis=0)
    wander = Wander(speed_mps=1.0, corners_in_base_m=BOX, duration_s=40.0)
    path = played(MoveTo(position_in_base_m=BOX[0], speed_mps=1.0), wander, ticks=5500)[150:]
    assert ((path >= corners[0] - 1e-12) & (path <= corners[1] + 1e-12)).all()
    speed = np.linalg.norm(np.diff(path, axis=0), axis=1) / DT_S
    turns = path[1:-1][(speed[1:] < 0.05) & (speed[:-1] < 0.15)]  # near the corners between two legs
    assert ((turns.min(axis=0) - corners[0]) < 0.15 * (corners[1] - corners[0])).all()
    assert ((corners[1] - turns.max(axis=0)) < 0.15 * (corners[1] - corners[0])).all()
    assert speed.max() == pytest.approx(1.0, abs=0.2)


def test_a_wander_is_that_of_its_seed_hand_and_move() -> None:
    wander = Wander(speed_mps=1.0, corners_in_base_m=BOX, duration_s=2.0)
    one, other = hand(wander, at=START), hand(wander, at=START, name="left")
    first = Play(one, seed=7).advance(200)
    assert np.array_equal(first, Play(one, seed=7).advance(200))
    assert not np.array_equal(first, Play(one, seed=8).advance(200))
    both = Play(one, other, seed=7)
    assert np.array_equal(both.advance(200), first)
    assert not np.array_equal(both.path(1), first)
    twice = Play(hand(wander, wander, at=START), seed=7).advance(550)
    assert np.array_equal(twice[:201], first)
    assert not np.allclose(twice[300:550], twice[49:299], atol=1e-3)


def test_a_wander_ends_on_time_within_its_box() -> None:
    wander = Wander(speed_mps=1.0, corners_in_base_m=BOX, duration_s=2.0)
    path = played(wander, ticks=400)
    assert np.array_equal(path[-1], path[275])  # 2 s and at most 100 ms to stop
    assert not np.array_equal(path[250], path[240])


def test_a_sweep_goes_there_and_back_as_often_as_it_says() -> None:
    sweep = Sweep(speed_mps=1.0, from_in_base_m=BOX[0], to_in_base_m=BOX[1], times=3)
    path = played(sweep, ticks=800)
    at_from = distances(path, np.array(BOX[0])) < 1e-3
    at_to = distances(path, np.array(BOX[1])) < 1e-3
    assert np.count_nonzero(np.diff(at_from.astype(int)) == 1) == 4
    assert np.count_nonzero(np.diff(at_to.astype(int)) == 1) == 3
    assert np.array_equal(path[-1], BOX[0])


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


def test_a_shifted_hand_does_the_same_elsewhere() -> None:
    moves = tuple(move for move in PROGRAM if not isinstance(move, ReachForObject))
    by = np.array([0.1, -0.2, 0.05])
    shifted = replace(hand(*moves, at=START), shift_in_base_m=tuple(by))
    assert Play(shifted).advance(900) == pytest.approx(played(*moves, ticks=900) + by, abs=1e-9)


def test_a_delayed_hand_does_the_same_later() -> None:
    delayed = replace(hand(*PROGRAM, at=START), delay_s=25 * DT_S)
    path = Play(delayed).advance(925)
    assert path[25:] == pytest.approx(played(*PROGRAM, ticks=900), abs=1e-9)
    assert np.array_equal(path[:25], np.tile(START, (25, 1)))


def test_a_tremor_is_a_bounded_ellipse_at_its_rate_on_top_of_the_moves() -> None:
    tremor = Tremor(amplitude_m=0.003, rate_hz=5.0)  # 25 ticks of 8 ms
    moves = (MoveTo(position_in_base_m=BOX[0], speed_mps=1.0),)
    trembling = replace(hand(*moves, at=START), tremor=tremor)
    displacement = Play(trembling).advance(500) - played(*moves, ticks=500)
    assert np.linalg.norm(displacement, axis=1).max() <= 0.003
    assert np.abs(displacement).max(axis=0) == pytest.approx(np.full(3, 0.003 / np.sqrt(3.0)), rel=0.01)
    assert displacement[25:] == pytest.approx(displacement[:-25], abs=1e-12)
    steps = np.linalg.norm(np.diff(displacement, axis=0), axis=1)
    assert steps.max() <= tremor.max_speed_mps * DT_S
    assert np.array_equal(Play(trembling).advance(20), Play(trembling).advance(20))
    assert not np.array_equal(Play(trembling, seed=2).advance(20), Play(trembling).advance(20))


def joined(to: str = "right", apart: tuple[float, float, float] = (0.0, 0.3, 0.1)) -> JoinedHand:
    return JoinedHand(
        name="left", joined_to=to, apart_in_base_m=apart, elbow_towards_in_base_m=(1.6, 1.0, 0.3)
    )


def test_a_joined_hand_keeps_its_place_beside_the_other_tremor_included() -> None:
    leader = replace(hand(*PROGRAM, at=START), tremor=Tremor(amplitude_m=0.003, rate_hz=8.0))
    for one in (leader, recording(5, 40)):
        play = Play(one, joined())
        play.advance(300)
        assert play.path(1) == pytest.approx(play.path(0) + (0.0, 0.3, 0.1), abs=1e-12)
        forearm = np.array(play.elbows)[:, 1] - play.path(1)
        towards = np.array((1.6, 1.0, 0.3)) - play.path(1)
        assert np.cross(forearm, towards) == pytest.approx(np.zeros_like(towards), abs=1e-12)
        assert np.array_equal(play.path(0), Play(one).advance(300))


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
    assert list(play.hands.state["present"]) == [True] + [False] * (HAND_SLOTS[0] - 1)
    assert np.isnan(play.path(1)).all()


coordinates = st.tuples(*[st.floats(-1.5, 1.5)] * 3)
speeds = st.floats(0.05, 4.0)
durations = st.floats(0.001, 0.5)
gaps = st.floats(0.0, 0.5)
hesitations = st.none() | st.builds(Hesitation, distance_m=st.floats(0.5, 1.0), duration_s=durations)
reaches = {"speed_mps": speeds, "until_distance_m": gaps, "at_most_s": durations, "hesitation": hesitations}
boxes = st.tuples(coordinates, coordinates.map(lambda point: (point[0] + 3.0, point[1], point[2])))
any_move = st.one_of(
    st.builds(MoveTo, position_in_base_m=coordinates, speed_mps=speeds),
    st.builds(Wait, duration_s=durations),
    st.builds(ReachForTcp, **reaches),
    st.builds(ReachForObject, **reaches),
    st.builds(FollowTcp, speed_mps=speeds, distance_m=gaps, duration_s=durations),
    st.builds(Wander, speed_mps=speeds, corners_in_base_m=boxes, duration_s=durations),
    st.builds(
        Sweep,
        speed_mps=speeds,
        from_in_base_m=coordinates,
        to_in_base_m=st.just((1.6, 0.0, 0.0)),
        times=st.integers(1, 3),
    ),
    st.builds(Withdraw, speed_mps=speeds),
)
accelerations = st.floats(0.1, 100.0)


@settings(max_examples=150, deadline=None, derandomize=True)
@given(
    moves=st.lists(any_move, min_size=1, max_size=6),
    acceleration_mps2=accelerations,
    dt_s=st.sampled_from([0.001, 0.008, 0.05]),
    seed=st.integers(0, 2**31),
)
def test_no_hand_is_ever_faster_or_changes_its_speed_more_than_it_may(
    moves: list[HandMove], acceleration_mps2: float, dt_s: float, seed: int
) -> None:
    """Finite differences of a way with |p'| <= v and |p''| <= a are within v dt and a dt^2."""
    play = Play(replace(hand(*moves, at=START), max_acceleration_mps2=acceleration_mps2), seed=seed)
    rng = np.random.default_rng(seed)
    for _ in range(80):
        play.advance(1, TCP + rng.uniform(-0.2, 0.2, 3), dt_s)
    path = np.concatenate([[START], play.path()])  # at rest before it begins
    fastest = max(getattr(move, "speed_mps", 0.0) for move in moves)
    assert np.linalg.norm(np.diff(path, axis=0), axis=1).max() <= fastest * dt_s + 1e-12
    bend = np.linalg.norm(np.diff(path, n=2, axis=0), axis=1)
    assert bend.max() <= acceleration_mps2 * dt_s**2 + 1e-12
    assert np.isfinite(path).all()
    assert np.isfinite(np.array(play.elbows)[:, 0]).all()


def test_the_law_of_bounded_acceleration_can_fail() -> None:
    path = Play(abrupt(MoveTo(position_in_base_m=BOX[0], speed_mps=1.0))).advance(80)
    assert np.linalg.norm(np.diff(path, n=2, axis=0), axis=1).max() > 10.0 * DT_S**2


@settings(max_examples=60, deadline=None, derandomize=True)
@given(
    speed_mps=speeds,
    gap_m=gaps,
    acceleration_mps2=accelerations,
    dt_s=st.sampled_from([0.001, 0.008, 0.05]),
    at=coordinates,
)
def test_who_comes_from_rest_never_oversteps_a_goal_that_stands(
    speed_mps: float, gap_m: float, acceleration_mps2: float, dt_s: float, at: tuple[float, float, float]
) -> None:
    start_m = distances(np.array([at]))[0]
    follower = hand(FollowTcp(speed_mps=speed_mps, distance_m=gap_m, duration_s=60.0), at=at)
    path = Play(replace(follower, max_acceleration_mps2=acceleration_mps2)).advance(120, dt_s=dt_s)
    assert distances(path).min() >= min(start_m, gap_m) - 1e-9
    assert (np.diff(distances(path)) <= 1e-9).all()
