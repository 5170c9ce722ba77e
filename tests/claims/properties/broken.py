"""For each property of the catalogue a run that violates it, as ``Entry.broken_by`` says."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields, replace
from functools import lru_cache, partial
from typing import Any

from examples import (
    VISIT,
    ConstantSpeed,
    Displaced,
    Nonsense,
    PassingGate,
    Raising,
    RefusingGate,
    Slow,
    TowardsTheHand,
    hand,
    run,
    scenario,
    ur10_gate,
)
from planted_controllers import Drifts, StopsLate, alone

from safety_harness.admission.admit import admit
from safety_harness.admission.trial import run_kinematic
from safety_harness.base.settings import DEFAULTS, GateKind, Settings
from safety_harness.cell.avoidance.gate import Gate
from safety_harness.scenario.faults import FalseHand, HandSensorBlind
from safety_harness.scenario.gate import AskedRegion, GateRule, PositionBox
from safety_harness.scenario.moves import FollowTcp, MoveTo, Wait, Withdraw
from safety_harness.scenario.obstacles import Obstacle
from safety_harness.trace.trace import Trace

STAYS = hand(MoveTo(position_in_base_m=(0.84, -0.35, 0.25), speed_mps=1.0), Wait(duration_s=9.0))


REACH_ONLY = replace(DEFAULTS, avoidance=replace(DEFAULTS.avoidance, gate=GateKind.REACH))
TOO_FAR = replace(DEFAULTS, avoidance=replace(DEFAULTS.avoidance, radius_m=2.0))
SIDEWAYS = (0.0, 0.05, 0.08)
IN_DOUBT = Displaced(SIDEWAYS, spread_m=0.03, spread_threshold_m=0.02)
CERTAIN = Displaced(SIDEWAYS, spread_m=0.01, spread_threshold_m=0.02)


def gate_of(kind: type[Gate], settings: Settings = DEFAULTS, **changed: Any) -> Gate:
    gate = ur10_gate(settings)
    return kind(**{field.name: getattr(gate, field.name) for field in fields(gate)} | changed)


def passing() -> Gate:
    return gate_of(PassingGate)


@lru_cache
def seeks_the_hand() -> Trace:
    return run(scenario(STAYS, duration_s=3.0), avoider=TowardsTheHand(), gate=passing())


@lru_cache
def proposes_the_hand() -> Trace:
    return run(scenario(VISIT), avoider=TowardsTheHand())


@lru_cache
def is_sure_of_two_metres() -> Trace:
    sure = Displaced((0.0, 2.0, 0.0), spread_m=0.01, spread_threshold_m=0.02)
    return run(scenario(VISIT), avoider=sure)


@lru_cache
def is_always_in_doubt() -> Trace:
    return run(scenario(VISIT), avoider=IN_DOUBT)


@lru_cache
def proposes_far_away() -> Trace:
    return run(scenario(VISIT), avoider=Displaced((0.0, 2.0, 0.0)), gate=passing())


@lru_cache
def proposes_below_the_table() -> Trace:
    return run(scenario(STAYS, duration_s=5.0), avoider=Displaced((0.0, 0.0, -0.7)), gate=passing())


@lru_cache
def uses_what_it_doubts() -> Trace:
    return run(scenario(VISIT, settings=REACH_ONLY), avoider=IN_DOUBT)


@lru_cache
def uses_no_answer() -> Trace:
    return run(scenario(VISIT), avoider=CERTAIN, gate=gate_of(RefusingGate))


@lru_cache
def heads_out_of_reach() -> Trace:
    return run(scenario(VISIT, settings=TOO_FAR), avoider=Displaced((0.0, 2.0, 0.0)), gate=passing())


@lru_cache
def falls_back_to_the_hand() -> Trace:
    return run(scenario(VISIT), avoider=IN_DOUBT, gate=gate_of(Gate, fallback=TowardsTheHand()))


@lru_cache
def minds_hands_within(critical_distance_m: float) -> Trace:
    """A controller that was set up for another critical distance than the cell's."""
    avoidance = replace(DEFAULTS.avoidance, critical_distance_m=critical_distance_m)
    other = admit(scenario(VISIT, settings=replace(DEFAULTS, avoidance=avoidance)))
    return run(scenario(VISIT), controller=other.controller())


@lru_cache
def turns_too_fast() -> Trace:
    return run(scenario(duration_s=0.2), controller=ConstantSpeed((2.5, 0.0, 0.0, 0.0, 0.0, 0.0)))


@lru_cache
def turns_on_and_on() -> Trace:
    return run(scenario(duration_s=1.0), controller=ConstantSpeed((0.0, 0.0, 2.5, 0.0, 0.0, 0.0)))


@lru_cache
def does_nothing(duration_s: float = 6.0) -> Trace:
    return run(scenario(duration_s=duration_s), controller=ConstantSpeed((0.0,) * 6))


def does_nothing_for_a_minute() -> Trace:
    start = replace(scenario(duration_s=56.0, offset=(0.02, -0.03, 0.02)))
    return run(start, controller=ConstantSpeed((0.0,) * 6))


@lru_cache
def sees_a_hand_where_none_is() -> Trace:
    ghost = FalseHand(from_s=0.2, position_in_base_m=(0.4, 0.5, 0.2))
    return run(replace(scenario(VISIT), faults=(ghost,)))


@lru_cache
def sees_no_hand() -> Trace:
    return run(replace(scenario(VISIT), faults=(HandSensorBlind(),)))


@lru_cache
def never_answers() -> Trace:
    return run(scenario(VISIT, duration_s=1.5), avoider=Slow(0.2))


@lru_cache
def raises_at_every_question() -> Trace:
    return run(scenario(VISIT, duration_s=1.5), avoider=Raising())


@lru_cache
def carries_the_object_out_of_view() -> Trace:
    sideways = hand(
        FollowTcp(speed_mps=0.4, distance_m=0.33, duration_s=2.6),
        Withdraw(speed_mps=0.8),
        at=(0.7, -0.6, 0.35),
    )
    start = scenario(sideways, duration_s=7.0, offset=(0.0, 0.06, 0.0))
    return run(start, avoider=Displaced((0.0, 0.1, 0.0)), gate=passing())


@lru_cache
def hardly_leaves() -> Trace:
    near = hand(MoveTo(position_in_base_m=(0.79, -0.27, 0.3), speed_mps=1.0), Wait(duration_s=9.0))
    return run(scenario(near, duration_s=6.0), avoider=Displaced((-0.01, 0.025, 0.007)), gate=passing())


@lru_cache
def servoes_through_a_box() -> Trace:
    box = Obstacle(size_m=(0.05, 0.05, 0.05), position_in_base_m=(0.7, -0.06, 0.30))
    return run(replace(scenario(duration_s=8.0, offset=(0.0, -0.16, 0.0)), obstacles=(box,)))


@lru_cache
def computes_nonsense() -> Trace:
    return run(scenario(duration_s=0.1), controller=Nonsense((0.1,) * 6))


@lru_cache
def leaves_its_region() -> Trace:
    far = PositionBox(low_m=(2.0, 0.0, 0.0), high_m=(2.1, 0.1, 0.1))
    rule = GateRule(questions_within=AskedRegion(hand=far, tcp=far))
    return run(replace(scenario(VISIT, duration_s=1.5), gate=rule), gate=ur10_gate(DEFAULTS))


@lru_cache
def drifts() -> Trace:
    near = alone(scenario(duration_s=6.0, offset=(0.01, 0.0, 0.01)))
    return run_kinematic(admit(near, controller=Drifts()))


@lru_cache
def stops_late() -> Trace:
    return run_kinematic(admit(alone(scenario(VISIT, duration_s=1.5)), controller=StopsLate()))


BROKEN: dict[str, Callable[[], Trace]] = {
    "hand distance never below 50 mm": seeks_the_hand,
    "no moving part touches a hand": seeks_the_hand,
    "protective separation kept": seeks_the_hand,
    "protective separation kept at 1.6 m/s": seeks_the_hand,
    "protective separation kept from hands at their own speeds": seeks_the_hand,
    "repulsive poses reachable": proposes_far_away,
    "proposed repulsive poses reachable": proposes_far_away,
    "proposals lead away to within 10 mm": proposes_the_hand,
    "proposals within 60 mm of the optimum": proposes_far_away,
    "proposals within 3 spreads and 30 mm of the optimum": is_sure_of_two_metres,
    "proposals never sure and more than 60 mm from the optimum": is_sure_of_two_metres,
    "at most 50 % of proposals overruled": is_always_in_doubt,
    "acts only on answers within the gate's region": leaves_its_region,
    "repulsion moves away from every hand": seeks_the_hand,
    "repulsive ways clear of table, object and robot": proposes_below_the_table,
    "obstacle distance never below 20 mm": servoes_through_a_box,
    "uncertain answers fall back within 2 cycles": uses_what_it_doubts,
    "certain answers are used": uses_no_answer,
    "stops where neither answer nor opposite pose can be reached": heads_out_of_reach,
    "fallback poses reachable and away": falls_back_to_the_hand,
    "starts retreating within 100 ms of a predicted hand": lambda: minds_hands_within(0.3),
    "starts retreating within 100 ms of a true hand": sees_no_hand,
    "reacts within 120 ms": stops_late,
    "never retreats without a hand": lambda: minds_hands_within(0.8),
    "never retreats without a hand within 600 mm": lambda: minds_hands_within(0.8),
    "joint positions within limits": turns_on_and_on,
    "joint speeds within limits": turns_too_fast,
    "TCP speed never above 250 mm/s": turns_too_fast,
    "gain switch reached": does_nothing,
    "gain switch reached within 5 s": does_nothing,
    "converged to the desired pose": does_nothing_for_a_minute,
    "hand predictions within 50 mm": sees_a_hand_where_none_is,
    "decisions within 100 ms": never_answers,
    "the avoider answered": raises_at_every_question,
    "joint accelerations never above 500 deg/s2": turns_too_fast,
    "TCP acceleration never above 2 m/s2": turns_too_fast,
    "object in view or recovered within 2 s": carries_the_object_out_of_view,
    "gain switch reached within 600 iterations": does_nothing,
    "retreats at most 3 times": hardly_leaves,
    "task pauses at most 10 s": partial(does_nothing, 11.0),
    "keeps its place within 5 mm": drifts,
    "trace finite and monotone": computes_nonsense,
}
