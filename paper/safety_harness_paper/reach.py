"""Table 4's measurement: proposals from TCPs outside the training range, and whether the arm reaches them.

The paper does not say where its 50 TCPs are.  Within twice and four times the seen box nothing that is 100 mm
away from a TCP is out of the arm's reach, so only a gross error could lead out of it; both are looked at.
Judged are TCPs at the *edge* of reach: outside the training range, reached by the arm in the desired
orientation with the whole object in view (so that the arm can be servoing there), and with some position 100
mm away that it does not reach.  This was fixed by geometry alone, before any network was asked.  The hand is
at its nominal place.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from safety_harness.base.geometry.regions import Box, Region
from safety_harness.base.settings import GateKind, Settings
from safety_harness.cell.avoidance.avoider import Avoider
from safety_harness.cell.avoidance.gate import Gate, Query
from safety_harness.cell.controller.desired import desired_transform_tcp_to_base
from safety_harness.cell.robot.capsules import load_capsules
from safety_harness.cell.robot.description import load_arm
from safety_harness.cell.robot.inverse import InverseKinematics
from safety_harness.extensions.lab.learning.evaluation import leaf
from safety_harness.extensions.lab.learning.image_error import ImageErrors
from safety_harness.space.regions import paper_seen
from safety_harness.trace.records import Check, DecisionOutcome
from safety_harness_paper.avoiders import with_networks
from safety_harness_paper.work import Done, Json, Task

BOXES = (("within twice the seen box", 2.0), ("within four times the seen box", 4.0))
EDGE = "at the edge of reach"
SETS = (*(name for name, _ in BOXES), EDGE)
WORKSPACE = Box(
    (0.10, -1.00, -0.25), (1.30, 1.00, 1.20)
)  # in front of the arm: all that the camera can work from
DIRECTIONS = 100  # tried about a TCP to find the edge
_DRAW = 2
GATES = (GateKind.REACH, GateKind.FULL)


def measurement(models: tuple[Task, ...], *, tcps: int, root: int, k: int, settings: Settings) -> Task:
    """Ask DNN, Bayesian DNN, ensemble and the others of the k-th training seed."""
    return Task(
        f"reach outside the training range, draw {k}",
        measure,
        (("tcps", tcps), ("draw_seed", leaf(root, _DRAW, k)), ("settings", settings)),
        models,
        seconds=3.0 + 0.1 * tcps,
    )


def measure(folder: Path, *models: Done, tcps: int, draw_seed: int, settings: Settings) -> Json:
    """{set: {"redrawn": n, "avoiders": {name: {"unreachable": [...], "reach": [...], "full": [...]}}}}."""
    kinematics = InverseKinematics(load_arm())
    avoiders = with_networks(settings, *models)
    seen_box = paper_seen(settings).tcp
    found: dict[str, Any] = {}
    for number, name in enumerate(SETS):
        rng = np.random.default_rng([draw_seed, number])
        edge = name == EDGE
        outer = WORKSPACE if edge else seen_box.grown(dict(BOXES)[name])
        starts, redrawn = reachable_starts(
            settings, kinematics, Region(outer, seen_box), tcps, rng, edge=edge
        )
        found[name] = {
            "redrawn": redrawn,
            "tcp": [pose[:3, 3].tolist() for pose, _ in starts],
            "avoiders": {
                system: _asked(avoider, starts, settings, kinematics) for system, avoider in avoiders.items()
            },
        }
    return found


Start = tuple[NDArray[np.float64], NDArray[np.float64]]  # pose (4, 4), joint position (6,)


def reachable_starts(
    settings: Settings,
    kinematics: InverseKinematics,
    region: Region,
    count: int,
    rng: np.random.Generator,
    *,
    edge: bool,
) -> tuple[list[Start], int]:
    """TCPs of a region that the arm reaches, and how many were drawn that will not do.

    With ``edge`` those alone that see the whole object and have something out of reach 100 mm away.
    """
    lowest_m = settings.cell.table_height_m + settings.avoidance.table_clearance_m
    reference = np.array(settings.cell.preferred_joint_position_rad)
    images = ImageErrors.from_settings(settings)
    starts: list[Start] = []
    redrawn = 0
    while len(starts) < count:
        pose = desired_transform_tcp_to_base(settings)
        pose[:3, 3] = region.draw(rng, 1)[0]
        joints = kinematics.nearest(pose, reference) if pose[2, 3] >= lowest_m else None
        wanted = joints is not None
        if wanted and edge:
            in_view = bool(images.at(pose[None, :3, 3])[1][0])
            wanted = in_view and _at_the_edge(pose, settings, kinematics, reference, rng)
        if joints is not None and wanted:
            starts.append((pose, joints))
        else:
            redrawn += 1
    return starts, redrawn


def _at_the_edge(
    pose: NDArray[np.float64],
    settings: Settings,
    kinematics: InverseKinematics,
    reference: NDArray[np.float64],
    rng: np.random.Generator,
) -> bool:
    """Is one of some positions at the radius of the repulsive sphere out of reach?"""
    directions = rng.normal(size=(DIRECTIONS, 3))
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    target = pose.copy()
    for direction in directions:
        target[:3, 3] = pose[:3, 3] + settings.avoidance.radius_m * direction
        if kinematics.nearest(target, reference) is None:
            return True
    return False


def _asked(
    avoider: Avoider,
    starts: list[Start],
    settings: Settings,
    kinematics: InverseKinematics,
) -> Json:
    hand = np.array(settings.avoidance.nominal_hand_position_in_base_m)
    gates = {kind: _gate(settings, kinematics, kind) for kind in GATES}
    unreachable: list[bool] = []
    uncertain: list[bool] = []
    outcomes: dict[str, list[str]] = {kind.value: [] for kind in GATES}
    for number, (pose, joints) in enumerate(starts):
        query = Query(
            hand_position_in_base_m=hand,
            tcp_position_in_base_m=pose[:3, 3].copy(),
            transform_tcp_to_base=pose,
            joint_position_rad=joints,
            hands_in_base_m=hand[None],
            seed=number,
        )
        for kind, gate in gates.items():
            ruling = gate.rule(avoider, query)
            outcomes[kind.value].append(DecisionOutcome(ruling.outcome).name.lower())
        unreachable.append(bool(ruling.proposed_failed & Check.UNREACHABLE))
        uncertain.append(bool(ruling.proposed_failed & Check.UNCERTAIN))
    return {"unreachable": unreachable, "uncertain": uncertain} | outcomes


def _gate(settings: Settings, kinematics: InverseKinematics, kind: GateKind) -> Gate:
    return Gate.from_settings(
        replace(settings, avoidance=replace(settings.avoidance, gate=kind)), kinematics, load_capsules()
    )
