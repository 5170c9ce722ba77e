"""The shield: what it allows is safe for every motion of a hand, and breaks only where an assumption does."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache
from math import inf, sqrt
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from safety_harness import Move, Stop
from safety_harness.admission.admit import Admitted, admit
from safety_harness.admission.trial import run_kinematic
from safety_harness.base.settings import DEFAULTS, HAND_SLOTS
from safety_harness.cell.controller.records import (
    CommandRecords,
    ObservationRecords,
    ParameterRecords,
    StateRecords,
    command_dtype,
    initial_state,
    observation_dtype,
    parameters_dtype,
)
from safety_harness.cell.controller.shield import Guard, allowed_share, guard_of, keep_apart
from safety_harness.cell.robot.capsules import load_capsules
from safety_harness.cell.robot.distance import place_capsules
from safety_harness.cell.robot.kinematics import fastest_end, link_twists
from safety_harness.cell.robot.robots import arm_model
from safety_harness.claims.properties.base import Evaluation
from safety_harness.claims.properties.shield_theorem import (
    NOT_KNOWN,
    REFUTED,
    SHIELDED,
    broken_assumptions,
    counts_words,
)
from safety_harness.claims.properties.touching import NO_MOVING_PART_TOUCHES, theorem_bits
from safety_harness.claims.signals.true_motion import refuse_contradictions
from safety_harness.report.shielding import shield_data, shield_lines
from safety_harness.scenario.model import Verdict
from safety_harness.scenario.read import parse_scenario
from safety_harness.scenario.robots import Robot
from safety_harness.scenario.shield import Shield
from safety_harness.trace.compare import first_difference
from safety_harness.trace.consistency import first_inconsistency
from safety_harness.trace.records import Limit
from safety_harness.trace.store import load_trace, save_trace
from safety_harness.trace.trace import Trace
from tests.cell.robot.arms import transforms_of

UR10 = arm_model(Robot.UR10)
CAPSULES = load_capsules("ur10")
PERIOD_S = DEFAULTS.clock.control_period_s

# A hand reaches for the tool at 2 m/s and stays with it, beside an arm that would never stop.
REACH = """
scenario: a hand reaches for an arm that swings to and fro
duration: 4 s
seed: 3
tcp start: {offset: [0 mm, -60 mm, 20 mm]}
hands:
  - hand: right hand
    starts at: [1400 mm, -1200 mm, 300 mm]
    elbow towards: [1900 mm, -1700 mm, 300 mm]
    moves:
      - wait: 300 ms
      - reach for tcp: 2 m/s
        stop at distance: 1 mm
        give up after: 1 s
      - follow tcp: 1 m/s
        keeping: 1 mm
        for: 1500 ms
      - withdraw: 1.6 m/s
claims:
  no moving part touches a hand: holds
"""


class Swings:
    """Turns the arm about its base, to and fro, whatever is there."""

    name = "swings"
    sees = ("joints",)

    def reset(self, *, settings: Any, arm: Any, start: Any, seed: int) -> None:
        self.joints = len(arm.joint_names)

    def act(self, seen: Any) -> Move | Stop:
        rates = np.zeros(self.joints)
        rates[0] = 0.3 if seen.time_s % 2.0 < 1.0 else -0.3
        return Move(joint_velocity_radps=rates)


def swinging(extra: str = "", *, reach: str = REACH) -> tuple[Trace, Evaluation]:
    scenario = parse_scenario(reach + extra)
    trace = run_kinematic(admit(scenario, controller=Swings()))
    return trace, NO_MOVING_PART_TOUCHES.prop.evaluate(trace)


@lru_cache
def shielded() -> tuple[Trace, Evaluation]:
    return swinging("shield: speed and separation\n")


def test_without_a_shield_the_arm_is_touched_as_it_moves() -> None:
    trace, said = swinging()
    assert said.verdict is Verdict.VIOLATED
    assert len(trace.interventions) == 0


def test_with_it_the_hand_touches_only_an_arm_that_stands() -> None:
    trace, said = shielded()
    assert said.verdict is Verdict.HOLDS
    assert trace.ticks["hand_distance_m"].min() < 0.0  # it is touched
    rates = np.abs(trace.ticks["joint_velocity_radps"]).max(axis=1)
    assert rates[:20].max() > 0.1  # and does move before
    assert rates[-1] > 0.1  # and again when the hand has left


def test_it_says_what_it_did_and_for_which_link() -> None:
    trace, _ = shielded()
    done = trace.interventions
    assert len(done) == len(trace.ticks)
    acted = done["scale"] < 1.0
    flagged = trace.ticks["limits"] & int(Limit.SHIELD) != 0
    np.testing.assert_array_equal(acted, flagged)
    assert 0.2 < acted.mean() < 0.9
    assert (done["capsule"][acted] >= 0).all()
    assert (done["capsule"][~acted] == -1).all()


def test_it_brakes_no_harder_than_it_says() -> None:
    trace, _ = shielded()
    rates = trace.ticks["demanded_joint_velocity_radps"]
    slower = np.abs(rates[:-1, 0]) - np.abs(rates[1:, 0])
    speed = [fastest(q, r) for q, r in zip(trace.ticks["joint_position_rad"], rates, strict=True)]
    per_rate = max(speed) / np.abs(rates[:, 0]).max()
    braking = trace.interventions["scale"][1:] < 1.0
    same_way = rates[:-1, 0] * rates[1:, 0] >= 0.0
    assert (slower[braking & same_way] * per_rate).max() <= 1.02 * PERIOD_S * Shield().deceleration_mps2


def test_its_trace_is_stored_compared_and_named(tmp_path: Any) -> None:
    trace, _ = shielded()
    save_trace(trace, tmp_path / "one.trace")
    again = load_trace(tmp_path / "one.trace")
    assert first_difference(trace, again) is None
    assert again.system.shield is not None
    assert again.system.shield.name == "speed and separation"
    changed = trace.interventions.copy()
    changed["scale"][7] = 0.5
    difference = first_difference(trace, replace(trace, interventions=changed))
    assert difference is not None
    assert difference.fields == ("interventions",)
    assert difference.index == 7
    wrong = first_inconsistency(replace(trace, interventions=changed))
    assert wrong is not None
    assert wrong.expected == "the flag SHIELD where the shield scaled"
    assert first_inconsistency(replace(trace, interventions=changed[:-1])) is not None


def test_a_trace_without_a_shield_says_nothing_of_one() -> None:
    trace, _ = swinging()
    assert "shield" not in trace.system.as_dict


# A hand of 60 mm with hardly any forearm, so that nothing but one assumption is in the way.
SMALL = "settings:\n  hand: {forearm length: 10 mm}\n"
WITHIN = "body within: 60 mm"
POSTURE = "  cell: {preferred joint position: [-14 deg, -82 deg, 116 deg, -124 deg, -90 deg, -104 deg]}\n"
UR10E = f"{SMALL}{POSTURE}shield: {{{WITHIN}}}\n"
LATE = UR10E.replace(
    WITHIN, f"{WITHIN}, reaction time: 2 s"
)  # admission wants it, and the shield is not told
BROKEN = {
    "no hand is faster": f"{SMALL}shield: {{{WITHIN}, hand speed: 300 mm/s}}\n",
    "no hand speeds up faster": f"{SMALL}shield: {{{WITHIN}, hand acceleration: 100 mm/s2}}\n",
    "a place is measured within its uncertainty": f"{SMALL}shield: {{{WITHIN}}}\n"
    "faults:\n  - hand sensor: is off\n    offset: [500 mm, -500 mm, 0 mm]\n",
    "frames tell when they were taken": f"{SMALL}shield: {{{WITHIN}}}\n"
    "faults:\n  - hand sensor: freezes\n    from: 100 ms\n",
    "every hand is in every frame": f"{SMALL}shield: {{{WITHIN}}}\nfaults:\n  - hand sensor: sees nothing\n",
    "drives follow in the reaction time": LATE + "robot: {arm: shipped:ur10e, drives: {dead time: 100 ms}}\n",
    "drives brake as they are told": LATE + "robot: {arm: shipped:ur10e, drives: {lag: 200 ms}}\n",
}
ONLY_THE_ARM = f"{SMALL}shield: {{{WITHIN}}}\n"
KEPT = {
    "a small hand": ONLY_THE_ARM,
    "measured speed": f"{SMALL}shield: {{{WITHIN}, hand acceleration: 10 m/s2}}\n",
    "a UR10e": f"{UR10E}robot: {{arm: shipped:ur10e}}\n",
    "a dead time that is known": UR10E.replace(WITHIN, f"{WITHIN}, reaction time: 100 ms")
    + "robot: {arm: shipped:ur10e, drives: {dead time: 100 ms}}\n",
    "frames that are late": f"{SMALL}shield: {{{WITHIN}}}\n"
    "hand sensor: {kind: surround, rate: 30 Hz, latency: 66 ms}\n",
    "a frame that is missing": f"{SMALL}shield: {{{WITHIN}}}\n"
    "faults:\n  - hand sensor: sees nothing\n    from: 300 ms\n",
}


@pytest.mark.parametrize("assumption", BROKEN)
def test_each_assumption_is_needed(assumption: str) -> None:
    admitted = admit(parse_scenario(REACH + BROKEN[assumption]), controller=Swings())
    if LATE in BROKEN[assumption]:
        at_once = replace(admitted.scenario.shield or Shield(), reaction_time_s=0.0)
        unaware = replace(admitted, scenario=replace(admitted.scenario, shield=at_once))
        trace = run_kinematic(unaware)
    else:
        trace = run_kinematic(admitted)
    said = NO_MOVING_PART_TOUCHES.prop.evaluate(trace)
    assert said.verdict is Verdict.VIOLATED
    standing = said.reason.partition("; the shield's theorem does not apply: ")[2]
    assert f"assumption {ASSUMPTIONS[assumption]} did not hold at " in standing
    assert theorem_bits(trace) & (1 << ASSUMPTIONS[assumption])
    assert not theorem_bits(trace) & REFUTED


ASSUMPTIONS = {
    "no hand is faster": 1,
    "no hand speeds up faster": 2,
    "a place is measured within its uncertainty": 5,
    "frames tell when they were taken": 5,  # the hand is not where the frame has it
    "every hand is in every frame": 4,
    "drives follow in the reaction time": 7,
    "drives brake as they are told": 7,
}


class Forgets(Admitted):
    """Its shield knows nothing of the forearm and of what it carries: capsules that enclose no link."""

    def guard(self) -> Guard:
        guard = super().guard()
        guard.capsules["radius_m"][guard.capsules["link_index"] >= 3] = -10.0
        return guard


def forgetful(reach: str = REACH) -> Admitted:
    return Forgets(**vars(admit(parse_scenario(reach + ONLY_THE_ARM), controller=Swings())))


def test_a_touch_while_all_that_a_trace_tells_held_refutes_the_theorem() -> None:
    """No trace tells that capsules do not enclose the links."""
    trace = run_kinematic(forgetful())
    said = NO_MOVING_PART_TOUCHES.prop.evaluate(trace)
    assert said.verdict is Verdict.VIOLATED
    assert "; REFUTES THE SHIELD'S THEOREM: " in said.reason
    assert theorem_bits(trace) == SHIELDED | REFUTED
    words = "the assumptions that a trace tells held in 1 of 1 runs; THE THEOREM IS REFUTED in 1"
    assert shield_lines([trace])[1:] == [words]


FLIES = """      - move to: [1400 mm, -1200 mm, 300 mm]
        speed: 3 m/s
"""


def test_what_is_broken_after_a_touch_does_not_excuse_it() -> None:
    """The hand moves at 3 m/s once it has touched the arm; then before it does."""
    quick = REACH.replace("    moves:\n", "    speed at most: 3 m/s\n    moves:\n")
    later = run_kinematic(forgetful(quick.replace("      - withdraw: 1.6 m/s\n", FLIES)))
    assert [one.number for one in broken_assumptions(later)] == [1]
    assert theorem_bits(later) == SHIELDED | REFUTED | 1 << 1
    there_and_back = FLIES.replace("1400 mm, -1200", "2000 mm, -2000") + FLIES
    earlier = run_kinematic(forgetful(quick.replace("      - reach", f"{there_and_back}      - reach")))
    said = NO_MOVING_PART_TOUCHES.prop.evaluate(earlier)
    assert said.verdict is Verdict.VIOLATED
    assert "the shield's theorem does not apply: assumption 1 did not hold at " in said.reason
    assert theorem_bits(earlier) == SHIELDED | 1 << 1


def test_a_trace_without_a_shield_says_nothing_of_a_theorem() -> None:
    trace, said = swinging()
    assert theorem_bits(trace) == 0
    assert "theorem" not in said.reason


def test_runs_are_counted_by_broken_assumption() -> None:
    runs = [(0, 5), (SHIELDED, 90), (SHIELDED | 1 << 1 | 1 << 5, 7), (SHIELDED | 1 << 5 | REFUTED, 2)]
    words = "the assumptions that a trace tells held in 90 of 99 runs"
    words += ", assumption 1 did not hold in 7, assumption 5 did not hold in 9; THE THEOREM IS REFUTED in 2"
    assert counts_words(runs) == words
    assert counts_words([(0, 5)]) == ""
    assert counts_words([(SHIELDED | 1 << NOT_KNOWN, 3)]).endswith("held in 0 of 3 runs, not known of 3")


EARLIER = Path(__file__).parents[2] / "trace/earlier"


@pytest.mark.parametrize(
    ("file", "verdict", "margin_m"),
    [
        ("shield-touched.trace", Verdict.VIOLATED, -0.025592697198193584),
        ("shield-kept.trace", Verdict.HOLDS, 0.015362109491393945),
    ],
)
def test_traces_of_shields_that_knew_of_no_command_on_its_way_are_judged(
    file: str, verdict: Verdict, margin_m: float
) -> None:
    """They do not say what the shield saw and sent; the verdicts are those of their own version.

    So are the margins, but that what is between ticks is bounded more closely now.
    """
    trace = load_trace(EARLIER / file)
    refuse_contradictions(trace)
    said = NO_MOVING_PART_TOUCHES.prop.evaluate(trace)
    assert said.verdict is verdict
    assert said.margin == pytest.approx(margin_m, abs=3e-4)
    assert "whether the shield's theorem applies is not known: the trace does not say" in said.reason
    assert theorem_bits(trace) == SHIELDED | 1 << NOT_KNOWN
    data = shield_data(trace)
    assert data is not None
    assert data["slowed"] > 0


def test_a_forearm_that_reaches_farther_than_assumed_is_touched() -> None:
    rests = REACH[: REACH.index("    moves:")] + "    moves: []\n" + REACH[REACH.index("claims:") :]
    rests = rests.replace("[1400 mm, -1200 mm, 300 mm]", "[1500 mm, 100 mm, 350 mm]")
    towards = rests.replace("[1900 mm, -1700 mm, 300 mm]", "[0 mm, 100 mm, 350 mm]")
    longer = "settings: {hand: {forearm length: 750 mm}}\n"
    _, said = swinging(f"{longer}shield: {{{WITHIN}}}\n", reach=towards)
    assert said.verdict is Verdict.VIOLATED
    trace, _ = swinging(f"{longer}shield: {{body within: 795 mm}}\n", reach=towards)
    assert trace.ticks["hand_distance_m"].min() > 0.0


@pytest.mark.parametrize("what", KEPT)
def test_where_all_of_them_are_true_nothing_is_touched(what: str) -> None:
    _, said = swinging(KEPT[what])
    assert said.verdict is Verdict.HOLDS


# A forearm, elbow first, meets an arm that turns at full speed when the shield begins to slow it.
MEETS = f"""
scenario: a forearm meets an arm
duration: 3 s
seed: 3
tcp start: {{offset: [0 mm, -60 mm, 20 mm]}}
hands:
  - hand: right hand
    starts at: [700 mm, %d mm, 450 mm]
    elbow towards: [700 mm, -3000 mm, 450 mm]
    moves:
      - wait: %d ms
      - move to: [700 mm, -200 mm, 450 mm]
        speed: 2 m/s
claims:
  no moving part touches a hand: holds
settings:
{POSTURE}shield: {{reaction time: 100 ms, deceleration: 10 m/s2}}
robot: {{arm: "shipped:ur10e", drives: {{dead time: 100 ms}}}}
"""


class Turns(Swings):
    """Turns the arm about its base at full speed, whatever is there."""

    def act(self, seen: Any) -> Move | Stop:
        rates = np.zeros(self.joints)
        rates[0] = 0.6
        return Move(joint_velocity_radps=rates)


class Stops(Turns):
    """As it, and asks for a protective stop after half a second."""

    def act(self, seen: Any) -> Move | Stop:
        return Stop() if seen.time_s > 0.5 else super().act(seen)


@pytest.mark.parametrize(("from_mm", "wait_ms"), [(1500, 140), (1500, 20), (1700, 100), (1700, 180)])
def test_commands_on_their_way_count(from_mm: int, wait_ms: int) -> None:
    """A dead time that is declared and true: what was sent before the arm slows still moves it."""
    trace = run_kinematic(admit(parse_scenario(MEETS % (from_mm, wait_ms)), controller=Turns()))
    assert broken_assumptions(trace) == []
    said = NO_MOVING_PART_TOUCHES.prop.evaluate(trace)
    assert said.verdict is Verdict.HOLDS, said.reason


def test_a_stop_is_handed_to_the_drives_when_no_command_is_on_its_way() -> None:
    """Theirs begins with a reaction time in which the arm goes on with what it then does."""
    trace = run_kinematic(admit(parse_scenario(MEETS % (1700, 2000)), controller=Stops()))
    assert broken_assumptions(trace) == []
    braking = trace.ticks["limits"] & int(Limit.BRAKING) != 0
    assert braking.any()
    assert np.abs(trace.ticks["joint_velocity_radps"])[1:][braking[:-1]].max() == 0.0


def fastest(q: np.ndarray, rates: np.ndarray) -> float:
    """By its own sums: the speed of the fastest end of an axis."""
    twists = np.zeros((7, 6))
    transforms = transforms_of(UR10, q)
    link_twists(UR10.joint_axes, transforms, rates, twists)
    ends = np.empty((len(CAPSULES.names), 2, 3))
    place_capsules(CAPSULES.records, transforms, ends)
    links = np.minimum(CAPSULES.link_index, 6)
    return float(max(fastest_end(twists[link], end) for link, end in zip(links, ends, strict=True)))


def ends_at(q: np.ndarray) -> np.ndarray:
    ends = np.empty((len(CAPSULES.names), 2, 3))
    place_capsules(CAPSULES.records, transforms_of(UR10, q), ends)
    return ends


def axis_distance(point: np.ndarray, ends: np.ndarray) -> np.ndarray:
    """(n,) of a point from segments, by numpy alone."""
    along = ends[:, 1] - ends[:, 0]
    length = np.maximum((along**2).sum(axis=1), 1e-18)
    t = np.clip(((point - ends[:, 0]) * along).sum(axis=1) / length, 0.0, 1.0)
    found: np.ndarray = np.linalg.norm(ends[:, 0] + t[:, None] * along - point, axis=1)
    return found


@pytest.mark.parametrize(
    "what", ["a hand", "a frame's time", "a joint", "a velocity", "the braking", "nothing"]
)
@pytest.mark.parametrize("hands", [0, 1])
def test_whatever_is_no_number_stops_the_arm(what: str, hands: int) -> None:
    q, rates, nan = np.array([-0.22, -1.27, 1.98, -2.27, -1.57, -1.79]), np.full(6, 0.01), np.nan
    deceleration = nan if what == "the braking" else 1.0
    guard = guard_of(Shield(deceleration_mps2=deceleration), DEFAULTS, UR10, CAPSULES, 1)
    parameters, state = np.zeros(1, parameters_dtype(6)), initial_state()
    parameters["control_period_s"], parameters["chain"] = PERIOD_S, UR10.chain
    if what == "a joint":
        q[-1] = nan
    if what == "a velocity":
        rates[-1] = nan
    state["link_transforms"] = transforms_of(UR10, q)
    guard.shield["taken_s"][0, 0] = nan if what == "a frame's time" else 0.0
    guard.shield["count"][0, 0], guard.shield["hand_in_base_m"][0, 0, 0] = hands, (3.0, 3.0, 1.0)
    if what == "a hand":
        guard.shield["hand_in_base_m"][0, 0, 0, 1] = nan
    command, observation = np.zeros(1, command_dtype(6)), np.zeros(1, observation_dtype(HAND_SLOTS[0]))
    command["joint_velocity_radps"] = rates
    arm = ParameterRecords(parameters), StateRecords(state)
    keep_apart(*arm, *guard, ObservationRecords(observation), CommandRecords(command), 0)
    goes = what == "nothing" or (hands == 0 and what == "a hand")  # which is then none
    np.testing.assert_array_equal(command["joint_velocity_radps"][0], rates if goes else np.zeros(6))


ANGLE, RATE = st.floats(-3.0, 3.0), st.floats(-1.0, 1.0)


def _stands_in_time(
    q: np.ndarray, rates: np.ndarray, away_m: float, age_s: float, shield: Shield, seen_mps: float
) -> float:
    """The share that is allowed; asserts that braking from it keeps clear of all that the hand can reach."""
    guard = guard_of(shield, DEFAULTS, UR10, CAPSULES, 1)
    g = guard.shield
    if np.abs(rates).max() < 1e-3:
        return 0.0
    moved = CAPSULES.link_index > 0
    ends = ends_at(q)
    tip = ends[-1].mean(axis=0)
    hand = tip + away_m * np.array([0.6, -0.64, 0.48])
    radius = CAPSULES.radius_m
    g["taken_s"][0, 0], g["count"][0, 0] = 1.0 - age_s, 1
    g["hand_in_base_m"][0, 0, 0] = hand
    g["speed_mps"][0, 0] = seen_mps
    clear = np.where(moved, axis_distance(hand, ends) - radius, inf)
    g["clearance_m"][0, 0], g["capsule"][0, 0] = clear.min(), int(clear.argmin())
    fastest_mps = fastest(q, rates)
    before = rates[::-1] * 0.7  # other commands, on their way for the whole of the reaction time
    turn = before * g["reaction_time_s"][0]
    g["flight_rad"] = np.abs(turn)
    share, by = allowed_share(g, rates, fastest_mps, fastest(q, turn), PERIOD_S, 1.0)
    assert 0.0 <= share <= 1.0
    assert by == (int(clear.argmin()) if share < 1.0 else -1)
    hold_s, stop_s = PERIOD_S + g["reaction_time_s"][0], share * fastest_mps / shield.deceleration_mps2
    if share == 0.0:
        return share
    for t in np.linspace(0.0, hold_s + stop_s, 23):
        flown = min(t / g["reaction_time_s"][0], 1.0) if g["reaction_time_s"][0] > 0.0 else 0.0
        own_s, late = max(t - (hold_s - PERIOD_S), 0.0), max(t - hold_s, 0.0)
        gone_s = min(own_s, PERIOD_S) + (late - late**2 / (2.0 * stop_s) if late > 0.0 else 0.0)
        then = q + flown * turn + share * rates * gone_s
        least = np.where(moved, axis_distance(hand, ends_at(then)) - radius, inf).min()
        known = age_s + t
        reach = shield.hand_speed_mps * known
        if shield.hand_acceleration_mps2 is not None:
            reach = min(reach, seen_mps * known + 0.5 * shield.hand_acceleration_mps2 * known**2)
        assert least >= shield.body_m + shield.uncertainty_m + reach - 1e-9
    return share


@given(
    q=st.tuples(*[ANGLE] * 6),
    rates=st.tuples(*[RATE] * 6),
    away_m=st.floats(0.2, 3.0),
    age_s=st.floats(0.0, 0.1),
    accelerates=st.booleans(),
    reaction_s=st.sampled_from([0.0, 0.1]),
    deceleration=st.floats(0.3, 5.0),
)
def test_whatever_it_allows_stands_before_any_hand_arrives(
    q: tuple[float, ...],
    rates: tuple[float, ...],
    away_m: float,
    age_s: float,
    accelerates: bool,
    reaction_s: float,
    deceleration: float,
) -> None:
    shield = Shield(
        hand_acceleration_mps2=10.0 if accelerates else None,
        reaction_time_s=reaction_s,
        deceleration_mps2=deceleration,
        body_m=0.06,
    )
    _stands_in_time(np.array(q), np.array(rates), away_m, age_s, shield, 0.3)


def test_it_lets_a_far_hand_s_arm_go_and_stops_for_a_near_one() -> None:
    q, rates = np.array([-0.22, -1.27, 1.98, -2.27, -1.57, -1.79]), np.array([0.3, 0.0, 0.0, 0.0, 0.0, 0.0])
    allowed = [_stands_in_time(q, rates, away, 0.0, Shield(), 2.0) for away in (0.2, 0.7, 0.9, 3.0)]
    assert allowed[0] == 0.0
    assert 0.0 < allowed[1] < allowed[2] < 1.0
    assert allowed[3] == 1.0


def test_a_hand_that_was_seen_to_rest_lets_the_arm_go_faster() -> None:
    q, rates = np.array([-0.22, -1.27, 1.98, -2.27, -1.57, -1.79]), np.array([0.3, 0.0, 0.0, 0.0, 0.0, 0.0])
    slow = _stands_in_time(q, rates, 0.65, 0.0, Shield(), 0.0)
    quick = _stands_in_time(q, rates, 0.65, 0.0, Shield(hand_acceleration_mps2=10.0), 0.0)
    assert quick > 1.5 * slow > 0.0
    assert sqrt(quick) <= 1.0
