"""The protective separation distance: by hand, against finite differences, on runs that keep and break it."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
from examples import VISIT, ConstantSpeed, hand, run, scenario

from safety_harness.admission.claims import property_of
from safety_harness.base.settings import DEFAULTS
from safety_harness.cell.robot.capsules import load_capsules
from safety_harness.cell.robot.description import load_arm
from safety_harness.cell.robot.distance import hand_distance, place_capsules
from safety_harness.cell.robot.kinematics import forward_kinematics, links_in_base
from safety_harness.cell.simulation.truth import cell_capsules
from safety_harness.claims.properties.protective_separation import (
    ProtectiveSeparation,
    _times_s,
    times_left_s,
)
from safety_harness.claims.signals.separation import Separation
from safety_harness.scenario.model import EDITION, Claim, Verdict
from safety_harness.scenario.moves import MoveTo, Wait
from safety_harness.trace.known import Knowledge, Measurement
from safety_harness.trace.records import Limit, Mode
from safety_harness.trace.trace import Trace

CONSTANT = ProtectiveSeparation()
OWN = ProtectiveSeparation(own_speeds=True)


@pytest.mark.parametrize(
    ("robot_mps", "stop_s", "needed_m"), [(1.0, 0.45, 1.205), (1.5, 0.5, 1.485), (2.0, 0.55, 1.79)]
)
def test_the_stop_times_of_a_ur10_give_the_distances_computed_by_hand(
    robot_mps: float, stop_s: float, needed_m: float
) -> None:
    terms = Separation(
        tick=0,
        hand=0,
        capsule=0,
        forearm=False,
        distance_m=0.0,
        hand_speed_mps=1.6,
        robot_speed_mps=robot_mps,
        reaction_time_s=0.1,
        stop_time_s=stop_s,
        hand_moves_m=0.0,
        robot_moves_m=0.0,
    ).terms
    assert [term.symbol for term in terms] == ["S_h", "S_r", "S_s", "C", "Z_d", "Z_r"]
    assert all(term.assumption for term in terms)
    assert sum(term.length_m for term in terms) == pytest.approx(needed_m, abs=1e-12)


def distance_m(trace: Trace, joints: np.ndarray, hand_m: np.ndarray, elbow_m: np.ndarray, k: int) -> float:
    """Of one capsule from one hand, by forward kinematics alone."""
    arm = load_arm("ur10")
    capsules = cell_capsules(load_capsules(), DEFAULTS)
    transforms, placed = np.empty((8, 4, 4)), np.empty((len(capsules.names), 2, 3))
    forward_kinematics(arm.chain[0], joints, transforms)
    place_capsules(capsules.records, transforms, placed)
    return hand_distance(capsules.records[k : k + 1], placed[k : k + 1], hand_m, elbow_m, 0.060, 0.045)[0]


@pytest.mark.parametrize("prop", [CONSTANT, OWN], ids=lambda p: p.sentence)
def test_the_speeds_are_the_rates_at_which_the_distance_shrinks(prop: ProtectiveSeparation) -> None:
    """Moving the joints alone gives v_r, moving the hand alone v_h: finite differences of the distance."""
    near = run(scenario(VISIT, duration_s=1.2), controller=ConstantSpeed((-0.15, 0.1, -0.1, 0.2, 0.1, 0.0)))
    found = prop.worst(near)
    assert found is not None
    tick, step_s = near.ticks[found.tick], 1e-6
    q, rates = tick["joint_position_rad"], tick["joint_velocity_radps"]
    bodies = [tick[name][found.hand] for name in ("hand_position_in_base_m", "elbow_position_in_base_m")]
    following = near.ticks[found.tick + 1]
    names = ("hand_position_in_base_m", "elbow_position_in_base_m")
    speeds = [(following[n][found.hand] - tick[n][found.hand]) / 0.008 for n in names]

    def at(joint_s: float, hand_s: float) -> float:
        moved = [body + hand_s * speed for body, speed in zip(bodies, speeds, strict=True)]
        return distance_m(near, q + joint_s * rates, moved[0], moved[1], found.capsule)

    assert at(0.0, 0.0) == pytest.approx(found.distance_m, abs=1e-12)
    robot_mps = max(0.0, (at(-step_s, 0.0) - at(step_s, 0.0)) / (2.0 * step_s))
    hand_mps = max(0.0, (at(0.0, -step_s) - at(0.0, step_s)) / (2.0 * step_s))
    assert found.robot_speed_mps == pytest.approx(robot_mps, abs=1e-6)
    assert found.robot_speed_mps > 0.01
    assert found.hand_speed_mps == pytest.approx(hand_mps if prop.own_speeds else 2.0, abs=1e-6)


def test_a_receding_arm_is_as_good_as_a_standing_one(visit: Trace) -> None:
    found = CONSTANT.worst(visit)
    assert found is not None
    assert visit.ticks["mode"][found.tick] == Mode.REPULSING
    assert found.robot_speed_mps == 0.0
    assert found.required_m < 2.0 * 0.475 + 0.01
    assert visit.ticks["hand_distance_m"][:, 0].min() <= found.distance_m


def test_a_faster_hand_needs_more(visit: Trace) -> None:
    margins = [
        ProtectiveSeparation(hand_speed_mps=speed).evaluate(visit).margin for speed in (0.5, 1.0, 1.6, 2.0)
    ]
    assert all(margin is not None for margin in margins)
    assert margins == sorted(margins, key=lambda margin: -(margin or 0.0))
    assert margins[3] == CONSTANT.evaluate(visit).margin


def test_the_plain_system_breaks_it_at_walking_speed_and_says_why_in_a_sentence(visit: Trace) -> None:
    evaluation, found = CONSTANT.evaluate(visit), CONSTANT.worst(visit)
    assert evaluation.verdict is Verdict.VIOLATED
    assert found is not None
    assert re.fullmatch(
        r"right \d+\.\d mm from [a-z0-9 ]+, where the hand's speed of 2\.00 m/s and the arm's speed of "
        r"\d+ mm/s towards it require (\d+\.\d) mm",
        evaluation.reason,
    )
    assert f"require {found.required_m * 1e3:.1f} mm" in evaluation.reason


NO_WAY_OUT = replace(DEFAULTS, avoidance=replace(DEFAULTS.avoidance, radius_m=2.0, critical_distance_m=1.05))
COMES = hand(
    MoveTo(position_in_base_m=(0.9, -0.3, 0.4), speed_mps=1.2), Wait(duration_s=9.0), at=(1.6, -1.4, 0.4)
)


def test_an_arm_that_stops_in_time_keeps_it_while_the_hand_comes_on() -> None:
    stopped = run(scenario(COMES, settings=NO_WAY_OUT))
    assert np.any(stopped.ticks["mode"] == Mode.PROTECTIVE_STOP)
    evaluation = CONSTANT.evaluate(stopped)
    assert evaluation.verdict is Verdict.HOLDS, evaluation
    assert stopped.ticks["hand_distance_m"][:, 0].min() < 0.5 * (CONSTANT.largest_m(DEFAULTS))


def test_one_that_stops_too_late_does_not() -> None:
    late = replace(NO_WAY_OUT, avoidance=replace(NO_WAY_OUT.avoidance, critical_distance_m=0.6))
    assert CONSTANT.evaluate(run(scenario(COMES, settings=late))).verdict is Verdict.VIOLATED


def test_saying_that_the_drives_brake_is_no_excuse_for_moving_on() -> None:
    going = run(scenario(COMES, duration_s=2.5), controller=ConstantSpeed((0.1, 0.0, 0.0, 0.0, 0.0, 0.0)))
    ticks = going.ticks.copy()
    ticks["limits"] |= int(Limit.BRAKING)
    assert CONSTANT.evaluate(replace(going, ticks=ticks)).verdict is Verdict.VIOLATED


def test_what_is_left_of_a_stop_shrinks_by_the_clock() -> None:
    stopped = run(scenario(COMES, settings=NO_WAY_OUT))
    reaction_s, stop_s = times_left_s(stopped)
    first = int(np.argmax(stopped.ticks["limits"] & Limit.BRAKING != 0))
    assert reaction_s[first - 1] == reaction_s[first] == 0.1
    left_s = reaction_s + stop_s
    assert np.all(np.diff(left_s[first : first + 12]) < 0.0)
    ramp = slice(first + 14, first + 40)
    assert np.all(reaction_s[ramp] == 0.0)
    assert np.diff(stop_s[ramp]) == pytest.approx(-0.008, abs=1e-12)


def test_an_arm_that_stands_is_no_evidence() -> None:
    still = run(scenario(COMES), controller=ConstantSpeed((0.0,) * 6))
    assert CONSTANT.evaluate(still).verdict is Verdict.INCONCLUSIVE


def test_a_hand_that_stays_far_away_is_no_evidence() -> None:
    far = run(scenario(hand(Wait(duration_s=1.0), at=(2.4, -1.5, 0.2)), duration_s=0.4))
    for prop in (CONSTANT, OWN):
        evaluation = prop.evaluate(far)
        assert (evaluation.verdict, evaluation.exercised) == (Verdict.INCONCLUSIVE, 0)


@pytest.mark.parametrize(
    "field",
    [
        "joint_position_rad",
        "joint_velocity_radps",
        "tcp_speed_mps",
        "hand_position_in_base_m",
        "elbow_position_in_base_m",
    ],
)
@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_what_is_not_finite_is_no_evidence(field: str, value: float, visit: Trace) -> None:
    ticks = visit.ticks.copy()
    ticks[field][len(ticks) // 2] = value
    assert CONSTANT.evaluate(replace(visit, ticks=ticks)).verdict is Verdict.INCONCLUSIVE


def ends_m(joints: np.ndarray) -> np.ndarray:
    """(capsules, 2, 3) the ends of the arm's axes, by forward kinematics alone."""
    capsules = cell_capsules(load_capsules(), DEFAULTS)
    transforms, placed = np.empty((8, 4, 4)), np.empty((len(capsules.names), 2, 3))
    forward_kinematics(load_arm("ur10").chain[0], joints, transforms)
    place_capsules(capsules.records, transforms, placed)
    return placed


@pytest.fixture(scope="module")
def elbow_first() -> Trace:
    """The shoulder lifts and the other joints hold the TCP nearly where it is; a hand waits nearby."""
    still = run(scenario(hand(Wait(duration_s=9.0)), duration_s=0.1), controller=ConstantSpeed((0.0,) * 6))
    q = still.ticks["joint_position_rad"][0]
    step = 1e-6 * np.eye(6)
    arm = load_arm("ur10")
    tcps_m = [[links_in_base(arm, q + way * one)[-1][:3, 3] for way in (1.0, -1.0)] for one in step]
    jacobian = np.array([(after - before) / 2e-6 for after, before in tcps_m]).T
    rates = np.array([0.0, 0.1, 0.0, 0.0, 0.0, 0.0])
    rates[2:5] = np.linalg.lstsq(jacobian[:, 2:5], -jacobian[:, 1] * 0.1, rcond=None)[0]
    waiting = scenario(hand(Wait(duration_s=9.0)), duration_s=0.2)
    return run(waiting, controller=ConstantSpeed(tuple(rates)))


def test_an_elbow_that_is_faster_than_the_tcp_stops_later(elbow_first: Trace) -> None:
    """T_s is that of the fastest point, whose speed finite differences of the arm's points give."""
    found, then = CONSTANT.worst(elbow_first), replace(CONSTANT, tcp_alone=True).worst(elbow_first)
    assert found is not None
    assert then is not None
    tick = elbow_first.ticks[found.tick]
    q, rates, step_s = tick["joint_position_rad"], tick["joint_velocity_radps"], 1e-6
    moved_m = ends_m(q + step_s * rates) - ends_m(q - step_s * rates)
    fastest_mps = np.linalg.norm(moved_m, axis=-1).max() / (2.0 * step_s)
    assert fastest_mps > 2.0 * tick["tcp_speed_mps"]
    braking = DEFAULTS.braking
    stop_s = braking.stop_time_base_s + braking.stop_time_per_speed_s2pm * fastest_mps
    assert found.stop_time_s == pytest.approx(stop_s, abs=1e-8)
    assert found.required_m > then.required_m + 2.0 * 0.9 * 0.1 * (fastest_mps - float(tick["tcp_speed_mps"]))


def test_editions_1_and_2_stop_from_the_tcps_speed(elbow_first: Trace) -> None:
    margins = {}
    for edition in (2, EDITION):
        claim = Claim(sentence=CONSTANT.sentence, expected=Verdict.HOLDS, edition=edition)
        margins[edition] = property_of(claim, elbow_first.scenario).evaluate(elbow_first).margin
    assert margins[2] == replace(CONSTANT, tcp_alone=True).evaluate(elbow_first).margin
    assert margins[EDITION] == CONSTANT.evaluate(elbow_first).margin != margins[2]


def test_where_joints_are_uncertain_the_verdict_says_whose_speed_it_takes(elbow_first: Trace) -> None:
    columns = {"joint_velocity_radps": Measurement(uncertainty=1e-6)}
    found = CONSTANT.evaluate(replace(elbow_first, known=Knowledge(columns)))
    assert "T_s is by the TCP's speed alone, as joints are known to within some" in found.reason
    assert "TCP's speed alone" not in CONSTANT.evaluate(elbow_first).reason


def test_a_stop_excuses_no_longer_than_from_the_tcps_speed() -> None:
    """The drives ramp by the TCP's speed: an arm that moves after that has all of its stop before it."""
    on = scenario(hand(Wait(duration_s=9.0)), duration_s=1.0)
    moves_on = run(on, controller=ConstantSpeed((0.0, 0.1, -0.46, 0.0, 0.0, 0.0)))
    ticks = moves_on.ticks.copy()
    ticks["limits"][2:] |= int(Limit.BRAKING)
    stopping = replace(moves_on, ticks=ticks)
    by_tcp = sum(times_left_s(stopping))
    by_elbow = sum(_times_s(stopping, CONSTANT.stopped_from_mps(stopping)))
    assert np.all(by_elbow >= by_tcp)
    over = np.flatnonzero(np.diff(by_tcp) > 0.1)
    assert len(over)
    assert np.all(by_elbow[over + 1] > 0.4)
