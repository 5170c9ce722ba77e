"""Define the ingredients of a run and, for each ingredient, the changes that a replay can try.

A change converts an admitted system into an altered system. A change also removes those faults of the
scenario that belong to its ingredient. Attribution skips a change without an effect.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, fields, replace
from enum import Enum
from functools import reduce
from types import UnionType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from safety_harness.admission.admit import Admitted, check
from safety_harness.admission.driving import kalman_filter
from safety_harness.base.exceptions import InputError
from safety_harness.base.settings import (
    DEFAULTS,
    Braking,
    Camera,
    DecisionCost,
    DecisionTimes,
    GateKind,
    HandSensor,
    ImageSource,
    Settings,
)
from safety_harness.cell.avoidance.avoider import (
    Avoider,
    AvoiderAround,
    Proposal,
    Vector,
    Vectors,
    decision_time_of,
)
from safety_harness.cell.avoidance.measures import optimum_in_base_m
from safety_harness.cell.avoidance.simple import AnswersNaN, NearestCandidate, OppositePose
from safety_harness.cell.controller.controller import AvoidingServo
from safety_harness.cell.controller.predicting import KALMAN_FILTER
from safety_harness.claims.properties.protective_separation import ProtectiveSeparation
from safety_harness.scenario.faults import (
    AvoiderLate,
    AvoiderNaN,
    AvoiderSilent,
    CameraFault,
    HandSensorFault,
    JointStuck,
)
from safety_harness.scenario.model import HandTrajectory, MovingHand, RecordedHand, Scenario
from safety_harness.scenario.moves import FollowTcp, HandMove, Wander
from safety_harness.scenario.robots import OwnRobot
from safety_harness.scenario.settings_keys import setting_keys
from safety_harness.trace.trace import Trace

FARTHEST_M = 3.0  # the largest critical distance of a scenario


class Ingredient(Enum):
    """An ingredient of a run.

    The order of the members determines the blame. If several ingredients help equally, the first of them is
    blamed. The hand is the last member.
    """

    SAFETY_FILTER = "safety filter"
    PREDICTOR = "predictor"
    AVOIDER = "avoider"
    DEADLINE = "deadline"
    PERCEPTION = "perception"
    SETTINGS = "settings"
    DRIVES = "drives and brakes"
    SERVOING = "servoing"
    GATE = "gate"
    PREDICTION = "prediction"
    FALLBACK = "fallback"
    DISTANCE = "critical distance"
    HAND = "hand"


# A user's controller replaces the servo, so changes of these ingredients have no effect.
OF_THE_SERVO = frozenset({Ingredient.AVOIDER, Ingredient.GATE, Ingredient.FALLBACK})


@dataclass(frozen=True, eq=False, kw_only=True)
class Altered(Admitted):
    """An admitted scenario after some changes.

    ``fallback`` is the new fallback of the gate, or None if the gate keeps its fallback.
    """

    fallback: Avoider | None = None
    changes: tuple[Change, ...] = ()

    @classmethod
    def from_admitted(cls, admitted: Admitted) -> Altered:
        """Return an unchanged copy of ``admitted``."""
        return cls(**{field.name: getattr(admitted, field.name) for field in fields(admitted)})

    def servo(self, recorded: Trace | None = None) -> AvoidingServo:
        """Return the admitted servo. If ``fallback`` is set, the servo's gate uses this fallback."""
        pilot = super().servo(recorded)
        if self.fallback is not None:
            pilot.gate = replace(pilot.gate, fallback=self.fallback)
        return pilot

    def with_scenario(self, scenario: Scenario) -> Altered:
        """Return the system with ``scenario``, after the checks of a scenario file.

        Raise InputError if the scenario is refused.
        """
        return self if scenario == self.scenario else replace(self, **vars(check(scenario)))

    def without(self, *kinds: type[Any] | UnionType) -> Altered:
        """Return the system without the scenario's faults of these kinds."""
        kept = tuple(fault for fault in self.scenario.faults if not isinstance(fault, kinds))
        return self.with_scenario(replace(self.scenario, faults=kept))

    def with_settings(self, alter: Callable[[Settings], Settings]) -> Altered:
        """Return the system with the settings that ``alter`` returns.

        Admission does not check these settings again. Therefore ``alter`` may change only settings of the
        controller, hand sensor and brakes, which admission never refuses.
        """
        scenario = replace(self.scenario, settings=alter(self.scenario.settings))
        return self if scenario == self.scenario else replace(self, scenario=scenario)


def setting(group: str, values: Callable[[Settings], Mapping[str, Any]]) -> Callable[[Altered], Altered]:
    """Return a function that alters a system by setting new ``values`` in one ``group`` of the settings.

    Args:
        group: The field of ``Settings`` that contains the group.
        values: The function that receives the present settings and returns the names and values to set.

    """

    def alter(settings: Settings) -> Settings:
        return replace(settings, **{group: replace(getattr(settings, group), **values(settings))})

    return lambda system: system.with_settings(alter)


@dataclass(frozen=True, eq=False)
class Change:
    """One change of an ingredient.

    If the change has no effect, ``alter`` returns the same system. ``chosen`` is true if the change concerns
    a choice of the designer. All other changes repair a part that can break.
    """

    ingredient: Ingredient
    words: str
    alter: Callable[[Altered], Altered]
    chosen: bool = False

    def __str__(self) -> str:
        return f"{self.ingredient.value} ({self.words})"

    def on(self, system: Altered) -> Altered | None:
        """Return the changed system, or None if the change has no effect or is refused.

        A driven scenario has its own controller. Therefore changes of the servo have no effect in it.
        """
        if system.scenario.driven and self.ingredient in OF_THE_SERVO:
            return None
        try:
            altered = self.alter(system)
        except InputError:
            return None
        return None if altered is system else replace(altered, changes=(*system.changes, self))


@dataclass(frozen=True, eq=False)
class ExactOptimum(AvoiderAround):
    """An avoider that proposes the exact optimum, and takes as much time as ``avoider``.

    The networks approximate this optimum.
    """

    settings: Settings
    name = "exact optimum"
    spread_threshold_m = None
    sees = ()

    def propose(
        self, *, hand_position_in_base_m: Vector, tcp_position_in_base_m: Vector, seed: int
    ) -> Proposal:
        """Return the exact solution of eq. 13 for one hand position and one TCP position, both (3,)."""
        hands, tcps = hand_position_in_base_m[None], tcp_position_in_base_m[None]
        return Proposal(optimum_in_base_m(self.settings, hands, tcps)[0])

    def propose_many(
        self, hands_in_base_m: Vectors, tcps_in_base_m: Vectors, seeds: NDArray[np.uint64]
    ) -> tuple[Vectors, Vectors]:
        """Return the exact positions and zero spreads, both (n, 3) [m].

        The hands and TCPs have the shape (n, 3), and ``seeds`` has the shape (n,).
        """
        return optimum_in_base_m(self.settings, hands_in_base_m, tcps_in_base_m), np.zeros_like(
            tcps_in_base_m
        )


@dataclass(frozen=True, eq=False)
class InTheTimeOf(AvoiderAround):
    """An avoider that gives the answers of ``quick``, but takes as much time as ``avoider``."""

    quick: OppositePose
    name = "opposite pose"
    spread_threshold_m = None
    sees = ()

    def propose(
        self, *, hand_position_in_base_m: Vector, tcp_position_in_base_m: Vector, seed: int
    ) -> Proposal:
        """Return the answer of ``quick`` for one hand position and one TCP position, both (3,)."""
        return self.quick.propose(
            hand_position_in_base_m=hand_position_in_base_m,
            tcp_position_in_base_m=tcp_position_in_base_m,
            seed=seed,
        )

    def propose_many(
        self, hands_in_base_m: Vectors, tcps_in_base_m: Vectors, seeds: NDArray[np.uint64]
    ) -> tuple[Vectors, Vectors]:
        """Return the answers of ``quick`` to n queries.

        ``seeds`` has the shape (n,).
        """
        return self.quick.propose_many(hands_in_base_m, tcps_in_base_m, seeds)


def _unfiltered(system: Altered) -> Altered:
    """Remove the safety filter, so that the drives receive every command as the controller issues it."""
    if system.safety_filter is None:
        return system
    return replace(system.with_scenario(replace(system.scenario, safety_filter="")), safety_filter=None)


def _by_kalman_filter(system: Altered) -> Altered:
    """Let the Kalman filter predict the hands."""
    if system.predictor is None or system.scenario.predictor == KALMAN_FILTER:
        return system
    changed = system.with_scenario(replace(system.scenario, predictor=KALMAN_FILTER))
    return replace(changed, predictor=kalman_filter())


def _optimum(system: Altered) -> Altered:
    """Replace the avoider by the exact optimum."""
    sound = system.without(AvoiderSilent, AvoiderNaN)
    return replace(sound, avoider=ExactOptimum(system.avoider, system.scenario.settings))


def _opposite(system: Altered) -> Altered:
    """Replace the avoider by an avoider that proposes the opposite pose."""
    sound = system.without(AvoiderSilent, AvoiderNaN)
    opposite = OppositePose(system.scenario.settings.avoidance.radius_m)
    if isinstance(system.avoider, OppositePose) and system.avoider == opposite:
        return sound
    return replace(sound, avoider=InTheTimeOf(system.avoider, opposite))


def _in_a_tick(system: Altered) -> Altered:
    """If the avoider's answers take longer than one control period, let every answer take one control period.

    Answers without any delay would not exercise the claims about answers.
    """
    on_time, settings = system.without(AvoiderLate), system.scenario.settings
    declared = settings.avoidance.decision_time is DecisionCost.AS_DECLARED
    if on_time is system and declared and (system.scenario.driven or decision_time_of(system.avoider) == 0.0):
        return system
    tick = DecisionTimes(quantiles_s=(settings.clock.control_period_s,))
    return setting("avoidance", lambda s: {"decision_time": tick})(on_time)


def _other_gate(settings: Settings) -> dict[str, GateKind]:
    """Return the kind of gate that differs from the kind in ``settings``."""
    return {"gate": GateKind.REACH if settings.avoidance.gate is GateKind.FULL else GateKind.FULL}


def _stops(system: Altered) -> Altered:
    """Replace the fallback by a protective stop."""
    return replace(system, fallback=AnswersNaN("protective stop"))


def _exact_hands(system: Altered) -> Altered:
    """Let the hand sensor measure every hand exactly and without delay.

    The filter gets the true size of the hand.
    """

    def alter(settings: Settings) -> Settings:
        place = settings.hand_sensor.overhead_position_in_base_m
        size = replace(settings.hand_filter, assumed_hand_radius_m=settings.hand.radius_m)
        return replace(settings, hand_sensor=HandSensor(overhead_position_in_base_m=place), hand_filter=size)

    return system.without(HandSensorFault).with_settings(alter)


def _exact_camera(system: Altered) -> Altered:
    """Let the servoing camera measure the object exactly and without delay.

    The camera has the pose that the servo assumes.
    """

    def alter(settings: Settings) -> Settings:
        zero = Camera()
        camera = replace(
            settings.camera,
            source=ImageSource.EXACT,
            rate_hz=None,
            latency_s=0.0,
            calibration_error_rotation_rad=zero.calibration_error_rotation_rad,
            calibration_error_offset_m=zero.calibration_error_offset_m,
        )
        return replace(settings, camera=camera)

    seen = system.without(CameraFault)
    return seen.with_scenario(replace(seen.scenario, settings=alter(seen.scenario.settings)))


def _predicting(horizon_s: Callable[[Settings], float]) -> Callable[[Altered], Altered]:
    return setting("hand_filter", lambda settings: {"prediction_horizon_s": horizon_s(settings)})


def _time_to_stop_s(settings: Settings) -> float:
    """Return the time [s] from a query until the arm has stopped from its full speed, limited to 2 s."""
    braking, fastest_mps = settings.braking, fastest_tcp_mps(settings)
    stop_s = braking.stop_time_base_s + braking.stop_time_per_speed_s2pm * fastest_mps
    return min(settings.avoidance.decision_deadline_s + braking.reaction_time_s + stop_s, 2.0)


def fastest_tcp_mps(settings: Settings) -> float:
    """Return the greatest TCP speed [m/s] that the controller allows."""
    return max(settings.motion.max_tcp_speed_mps, settings.avoidance.repulsion_speed_mps)


def _sound_drives(system: Altered) -> Altered:
    """Free all stuck joints, remove the drives' delays, and let the brakes stop in one control period."""

    def alter(settings: Settings) -> Settings:
        stop_s = settings.clock.control_period_s
        brakes = Braking(reaction_time_s=0.0, stop_time_base_s=stop_s, stop_time_per_speed_s2pm=0.0)
        return replace(settings, braking=brakes)

    sound, robot = system.without(JointStuck), system.scenario.robot
    if isinstance(robot, OwnRobot) and robot.drives is not None:
        sound = sound.with_scenario(replace(sound.scenario, robot=replace(robot, drives=None)))
    return sound.with_settings(alter)


def _avoiding_from(distance_m: Callable[[Settings], float]) -> Callable[[Altered], Altered]:
    """Return a change that sets the critical distance to ``distance_m``, but never makes it smaller."""

    def larger(settings: Settings) -> dict[str, float]:
        before_m = settings.avoidance.critical_distance_m
        return {"critical_distance_m": max(before_m, min(distance_m(settings), FARTHEST_M))}

    return setting("avoidance", larger)


def _at_default(group: str, name: str) -> Callable[[Altered], Altered]:
    """Return a change of one setting to its default.

    An avoider that depends on settings is created anew.
    """
    default = getattr(getattr(DEFAULTS, group), name)

    def alter(system: Altered) -> Altered:
        settings_before, avoider = system.scenario.settings, system.avoider
        own = getattr(settings_before, group)
        if getattr(own, name) == default:
            return system
        settings = replace(settings_before, **{group: replace(own, **{name: default})})
        if isinstance(avoider, OppositePose):
            avoider = OppositePose(settings.avoidance.radius_m)
        elif isinstance(avoider, NearestCandidate):
            avoider = NearestCandidate.for_cell(settings)
        return replace(system.with_scenario(replace(system.scenario, settings=settings)), avoider=avoider)

    return alter


def _without_gate_rule(system: Altered) -> Altered:
    """Remove the gate rule that the scenario adds."""
    return system.with_scenario(replace(system.scenario, gate=None))


def _all_at_default(system: Altered) -> Altered:
    """Set all changed settings to their defaults, if at least two settings have been changed.

    If only one setting has been changed, ``_at_default`` provides the same change.
    """
    changed = [change for change in AT_DEFAULT if change.on(system) is not None]
    return reduce(lambda done, change: change.alter(done), changed, system) if len(changed) > 1 else system


def _times(factor: float) -> Callable[[Settings], float]:
    return lambda settings: factor * settings.avoidance.critical_distance_m


def _separation_m(settings: Settings) -> float:
    """Return the protective separation [m] from the TCP to the hand's centre at the arm's speed limit."""
    return ProtectiveSeparation().largest_m(settings) + settings.hand.radius_m


def _half_as_fast(system: Altered) -> Altered:
    """Let hands move on the same paths at half their speed.

    The run takes twice as long as before.
    """
    scenario = system.scenario
    hands = tuple(map(_slower, scenario.hands))
    if hands == scenario.hands:
        return system
    return system.with_scenario(replace(scenario, hands=hands, duration_s=2.0 * scenario.duration_s))


def _slower(hand: HandTrajectory) -> HandTrajectory:
    """Return the hand at half its speed."""
    if isinstance(hand, MovingHand):
        return replace(hand, moves=tuple(map(_slower_move, hand.moves)))
    if isinstance(hand, RecordedHand):
        motion = replace(hand.motion, time_s=2.0 * hand.motion.time_s)
        return replace(hand, motion=motion, speed_factor=0.5 * hand.speed_factor)
    return hand


def _slower_move(move: HandMove) -> HandMove:
    """Return the move at half its speed and with twice its time limits.

    The length of a pause stays the same.
    """
    slower = {"speed_mps": 0.5, "at_most_s": 2.0}
    if isinstance(move, FollowTcp | Wander):
        slower["duration_s"] = 2.0
    return replace(move, **{k: factor * getattr(move, k) for k, factor in slower.items() if hasattr(move, k)})


# Settings that belong to other ingredients.  Groups that describe arm, cell, person or sensors are no choice.
ELSEWHERE = ("gate", "critical_distance_m", "decision_time", "decision_deadline_s")
AT_DEFAULT = (
    *(
        Change(Ingredient.SETTINGS, f"{key.name} at its default", _at_default(group, key.attribute))
        for group in ("hand_filter", "servo", "motion", "avoidance")
        for key in setting_keys(type(getattr(DEFAULTS, group)))
        if key.attribute not in ELSEWHERE
    ),
    Change(Ingredient.SETTINGS, "no rule for the gate", _without_gate_rule),
)
# Of the helpful changes of an ingredient, the report shows the first one that keeps the claim.
CHANGES: tuple[Change, ...] = (
    Change(Ingredient.SAFETY_FILTER, "left out", _unfiltered),
    Change(Ingredient.PREDICTOR, "the Kalman filter", _by_kalman_filter),
    Change(Ingredient.AVOIDER, "exact optimum", _optimum),
    Change(Ingredient.AVOIDER, "opposite pose", _opposite),
    Change(Ingredient.DEADLINE, "answers within a tick", _in_a_tick),
    Change(Ingredient.PERCEPTION, "ideal", _exact_hands),
    *AT_DEFAULT,
    Change(Ingredient.SETTINGS, "all at their defaults", _all_at_default),
    Change(Ingredient.DRIVES, "ideal", _sound_drives),
    Change(Ingredient.SERVOING, "ideal camera", _exact_camera),
    Change(Ingredient.GATE, "the other kind", setting("avoidance", _other_gate), True),
    Change(Ingredient.PREDICTION, "none", _predicting(lambda settings: 0.0), True),
    Change(Ingredient.PREDICTION, "as far as a stop takes", _predicting(_time_to_stop_s), True),
    Change(Ingredient.FALLBACK, "protective stop", _stops, True),
    Change(Ingredient.DISTANCE, "x 1.5", _avoiding_from(_times(1.5)), True),
    Change(Ingredient.DISTANCE, "x 2", _avoiding_from(_times(2.0)), True),
    Change(Ingredient.DISTANCE, "protective separation", _avoiding_from(_separation_m), True),
    Change(Ingredient.HAND, "half as fast", _half_as_fast),
)


def changes_for(faulty: Collection[Ingredient]) -> tuple[Change, ...]:
    """Return the changes to try.

    The first changes remove the faults of the ingredients in ``faulty``. The changes in CHANGES follow.
    """
    order = list(Ingredient)
    return tuple(Change(part, "sound", replace) for part in sorted(faulty, key=order.index)) + CHANGES
