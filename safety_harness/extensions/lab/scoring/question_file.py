"""Create a scenario whose run begins with a given question, so that an engineer can examine a bad answer.

In the scenario, the hand rests at the hand position of the question, and the TCP starts at the TCP position
of the question.  The controller therefore asks the avoider this question in the first control tick.  The
question's seed derives from the scenario's seed.  Before a file is written, the scenario runs once, and the
first question in this run must be the given question.
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

    If no run can begin with the question, ``path`` is None, and ``remark`` states the reason.  ``claims``
    contains the claims of the scenario, whose expected verdicts are the verdicts of a run.  It omits the
    claims that were inconclusive in this run.
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
    """Return True if the hand does not touch the arm at the start.

    The function assumes that the forearm points away from the TCP.  It returns False if the arm cannot reach
    the TCP.

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
    """Return the scenario file of a question after a run in the kinematic world.

    The function does not write the file.

    Args:
        path: The file.
        reference: The reference to the avoider in the file.  A relative path is relative to the working
            directory.
        avoider: The avoider.
        hand_in_base_m: The hand position of the question.
        tcp_in_base_m: The TCP position of the question.
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
    """Yield variants of a scenario with three directions of the forearm and two positions of the object.

    The caller uses the first variant in which the forearm does not touch the arm and the camera sees the
    object.
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
    """Return a text on how the first question of a run differs from the given question.

    The text is empty if they are the same.
    """
    if len(trace.decisions) == 0:
        return "the run has no question, since the sensor does not see the hand"
    hand, tcp = question_of(trace, trace.decisions[0])
    apart_m = max(float(np.abs(hand - hand_in_base_m).max()), float(np.abs(tcp - tcp_in_base_m).max()))
    same = apart_m <= SAME_PLACE_M and int(trace.decisions[0]["seed"]) == seed_of(trace.scenario.seed)
    return "" if same else f"the run's first question is {1e3 * apart_m:.1f} mm from it"


def _vector3(point: Array3) -> Vector3:
    return float(point[0]), float(point[1]), float(point[2])
