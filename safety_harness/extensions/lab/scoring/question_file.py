"""A scenario whose run begins with a given question, so that an engineer can examine a bad answer.

The hand rests at the question's hand, and the TCP starts at the question's TCP.  So the first control tick
asks the question.  The question's seed derives from the scenario's seed.  Every scenario runs once before its
file is written: the first question of that run must be the given question.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from safety_harness.admission.admit import admit
from safety_harness.admission.avoiders import with_avoider
from safety_harness.admission.trial import run_trial
from safety_harness.base.exceptions import InputError, SafetyHarnessError
from safety_harness.base.geometry.arrays import Array3
from safety_harness.base.seeds import Branch
from safety_harness.base.seeds import seed as leaf
from safety_harness.base.settings import DEFAULTS, Settings, Vector3
from safety_harness.cell.avoidance.avoider import Avoider
from safety_harness.cell.avoidance.flaky import question_of
from safety_harness.cell.controller.desired import desired_transform_tcp_to_base
from safety_harness.cell.robot.distance import hand_distance, place_capsules
from safety_harness.cell.robot.kinematics import links_in_base
from safety_harness.cell.robot.robots import arm_capsules, arm_model, inverse_kinematics
from safety_harness.cell.simulation.truth import cell_capsules
from safety_harness.cell.simulation.worlds import KINEMATIC
from safety_harness.scenario.model import Claim, MovingHand, PoseStart, Scenario, Verdict
from safety_harness.scenario.robots import AnyRobot, Robot
from safety_harness.scenario.write import write_scenario
from safety_harness.trace.trace import Trace

SAME_PLACE_M = 0.001  # the largest difference from the given hand and TCP, along each axis
LASTS_S = 0.4  # so short that a run contains only its first decision: a path of 100 mm takes 0.65 s


@dataclass(frozen=True)
class QuestionFile:
    """The scenario file of a question.

    ``path`` is None if no run can ask the question first; ``remark`` then states the reason.  The ``claims``
    expect the verdicts that a run gave.  They omit each claim that was inconclusive.
    """

    path: Path | None
    remark: str
    claims: tuple[Claim, ...] = ()
    text: str = ""


def seed_of(scenario_seed: int) -> int:
    """Return the seed of the first question in a run of a scenario whose seed is ``scenario_seed``."""
    return leaf(scenario_seed, Branch.DECISION, 0)


def begins_clear(
    settings: Settings, hand_in_base_m: Array3, tcp_in_base_m: Array3, robot: AnyRobot = Robot.UR10
) -> bool:
    """Return whether a hand, with its forearm pointing away from the TCP, is clear of the arm at the start.

    Args:
        settings: The settings of the cell.
        hand_in_base_m: The position of the hand.
        tcp_in_base_m: The position of the TCP.
        robot: The arm.

    """
    arm, capsules = arm_model(robot), cell_capsules(arm_capsules(robot), settings)
    target = desired_transform_tcp_to_base(settings)
    target[:3, 3] = tcp_in_base_m
    joints = inverse_kinematics(robot).nearest(target, np.array(settings.cell.preferred_joint_position_rad))
    if joints is None:
        return False
    ends = np.empty((len(capsules.names), 2, 3))
    place_capsules(capsules.records, links_in_base(arm, joints), ends)
    away = hand_in_base_m - tcp_in_base_m
    elbow = hand_in_base_m + settings.hand.forearm_length_m * away / max(float(np.linalg.norm(away)), 1e-9)
    radii_m = settings.hand.radius_m, settings.hand.forearm_radius_m
    return bool(hand_distance(capsules.records, ends, hand_in_base_m, elbow, *radii_m)[0] > 0.0)


def question_file(
    path: Path,
    reference: str,
    avoider: Avoider,
    hand_in_base_m: Array3,
    tcp_in_base_m: Array3,
    scenario_seed: int,
    *,
    title: str,
    description: str,
    claims: tuple[str, ...],
    settings: Settings = DEFAULTS,
    robot: AnyRobot = Robot.UR10,
) -> QuestionFile:
    """Return the scenario file of a question, without writing it, after a run in the kinematic world.

    Args:
        path: The file.
        reference: The avoider's name in the file; a relative path starts at the working directory.
        avoider: The avoider.
        hand_in_base_m: The question's hand.
        tcp_in_base_m: The question's TCP.
        scenario_seed: The scenario's seed.
        title: The scenario's title.
        description: The scenario's description.
        claims: The sentences of its claims.
        settings: The settings of the cell.
        robot: The arm.

    """
    why = "no run begins with it"
    bare = Scenario(
        name=path.stem,
        title=title,
        about=description,
        duration_s=LASTS_S,
        seed=scenario_seed,
        start=PoseStart(position_in_base_m=_vector3(tcp_in_base_m)),
        hands=(),
        avoider="",
        claims=tuple(Claim(sentence=sentence, expected=Verdict.VIOLATED) for sentence in claims),
        settings=settings,
        robot=robot,
        file=path,
    )
    for scenario in _variants(with_avoider(bare, reference), hand_in_base_m, tcp_in_base_m):
        try:
            admitted = admit(scenario, avoider=avoider)
            trace = run_trial(admitted, world=KINEMATIC)
        except InputError as error:
            why = f"expected {error.expected}; got {error.got}"
            continue
        except SafetyHarnessError as error:
            return QuestionFile(None, str(error))
        why = _asked_another(trace, hand_in_base_m, tcp_in_base_m)
        if not why:
            verdicts = tuple(prop.evaluate(trace).verdict for prop in admitted.properties)
            judged = tuple(
                replace(claim, expected=verdict)
                for claim, verdict in zip(scenario.claims, verdicts, strict=True)
                if verdict is not Verdict.INCONCLUSIVE
            )
            return QuestionFile(path, "", judged, write_scenario(replace(scenario, claims=judged)))
    return QuestionFile(None, why)


def _variants(scenario: Scenario, hand_in_base_m: Array3, tcp_in_base_m: Array3) -> Iterator[Scenario]:
    """Yield scenarios with three directions of the forearm, first with the object in place, then shifted.

    A caller tries several, because the forearm must be clear of the arm and the camera must see the object.
    """
    away = hand_in_base_m - tcp_in_base_m
    outwards = np.array([hand_in_base_m[0], hand_in_base_m[1], 0.0])
    object_m = np.array(scenario.settings.object.position_in_base_m)
    aside = (tcp_in_base_m - scenario.settings.cell.desired_tcp_position_in_base_m) / 2.0
    for shift in (np.zeros(3), np.array([aside[0], aside[1], 0.0])):
        shifted = replace(scenario.settings.object, position_in_base_m=_vector3(object_m + shift))
        for direction in (away, outwards, np.array([0.0, 0.0, 1.0])):
            length = float(np.linalg.norm(direction))
            if length > 0.0:
                hand = MovingHand(
                    name="hand",
                    starts_at_in_base_m=_vector3(hand_in_base_m),
                    elbow_towards_in_base_m=_vector3(hand_in_base_m + 0.6 * direction / length),
                    moves=(),
                )
                settings = replace(scenario.settings, object=shifted)
                yield replace(scenario, hands=(hand,), settings=settings)


def _asked_another(trace: Trace, hand_in_base_m: Array3, tcp_in_base_m: Array3) -> str:
    """Return how the run's first question differs from the given question; empty if they are the same."""
    if len(trace.decisions) == 0:
        return "the run has no question, since the sensor does not see the hand"
    hand, tcp = question_of(trace, trace.decisions[0])
    apart_m = max(float(np.abs(hand - hand_in_base_m).max()), float(np.abs(tcp - tcp_in_base_m).max()))
    same = apart_m <= SAME_PLACE_M and int(trace.decisions[0]["seed"]) == seed_of(trace.scenario.seed)
    return "" if same else f"the run's first question is {1e3 * apart_m:.1f} mm from it"


def _vector3(point: Array3) -> Vector3:
    return float(point[0]), float(point[1]), float(point[2])
