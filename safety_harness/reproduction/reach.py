"""Table 4's measurement: proposals from TCPs outside the training range, and whether the arm reaches them.

The paper does not say how far outside its 50 TCPs are.  The package's own "unseen tcp" space ends at twice
the seen box, and there the arm reaches everything within 100 mm; so boxes of three and four times are looked
at too.  Fixed before any proposal was made: TCPs that the arm itself reaches in the desired orientation, the
hand at its nominal position, and the largest box as the one that is judged.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from safety_harness.avoidance.avoider import Avoider
from safety_harness.avoidance.gate import Gate, Query
from safety_harness.controller.desired import desired_transform_tcp_to_base
from safety_harness.geometry.regions import Region
from safety_harness.learning.evaluation_sets import leaf
from safety_harness.reproduction.avoiders import with_networks
from safety_harness.reproduction.work import Done, Json, Task
from safety_harness.robot.description import load_arm
from safety_harness.robot.inverse import InverseKinematics
from safety_harness.settings import GateKind, Settings
from safety_harness.space.regions import paper_seen
from safety_harness.trace.records import Check, Outcome

FACTORS = (2.0, 3.0, 4.0)  # of the seen box's size
JUDGED = 4.0
_DRAW = 2
GATES = (GateKind.REACH, GateKind.FULL)


def measurement(models: tuple[Task, ...], *, tcps: int, root: int, k: int, settings: Settings) -> Task:
    """Ask DNN, Bayesian DNN, ensemble and the others of the k-th training seed."""
    return Task(
        f"reach outside the training range, draw {k}",
        measure,
        (("tcps", tcps), ("draw_seed", leaf(root, _DRAW, k)), ("settings", settings)),
        models,
        seconds=3.0 + 0.03 * tcps,
    )


def measure(folder: Path, *models: Done, tcps: int, draw_seed: int, settings: Settings) -> Json:
    """{factor: {"redrawn": n, "avoiders": {name: {"unreachable": [...], "reach": [...], "full": [...]}}}}."""
    kinematics = InverseKinematics(load_arm())
    avoiders = with_networks(settings, *models)
    found: dict[str, Any] = {}
    for number, factor in enumerate(FACTORS):
        rng = np.random.default_rng([draw_seed, number])
        starts, redrawn = reachable_starts(settings, kinematics, factor, tcps, rng)
        found[f"{factor:g}"] = {
            "redrawn": redrawn,
            "avoiders": {
                name: _asked(avoider, starts, settings, kinematics) for name, avoider in avoiders.items()
            },
        }
    return found


def reachable_starts(
    settings: Settings,
    kinematics: InverseKinematics,
    factor: float,
    count: int,
    rng: np.random.Generator,
) -> tuple[list[tuple[NDArray[np.float64], NDArray[np.float64]]], int]:
    """(pose (4, 4), joints (6,)) of TCPs that the arm reaches, and how many were drawn that it does not."""
    seen = paper_seen(settings).tcp
    region = Region(seen.grown(factor), seen)
    lowest_m = settings.cell.table_height_m + settings.avoidance.table_clearance_m
    reference = np.array(settings.cell.preferred_joint_position_rad)
    starts: list[tuple[NDArray[np.float64], NDArray[np.float64]]] = []
    redrawn = 0
    while len(starts) < count:
        pose = desired_transform_tcp_to_base(settings)
        pose[:3, 3] = region.draw(rng, 1)[0]
        joints = kinematics.nearest(pose, reference) if pose[2, 3] >= lowest_m else None
        if joints is None:
            redrawn += 1
        else:
            starts.append((pose, joints))
    return starts, redrawn


def _asked(
    avoider: Avoider,
    starts: list[tuple[NDArray[np.float64], NDArray[np.float64]]],
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
            late=False,
        )
        for kind, gate in gates.items():
            ruling = gate.rule(avoider, query)
            outcomes[kind.value].append(Outcome(ruling.outcome).name.lower())
        unreachable.append(bool(ruling.proposed_failed & Check.UNREACHABLE))
        uncertain.append(bool(ruling.proposed_failed & Check.UNCERTAIN))
    return {"unreachable": unreachable, "uncertain": uncertain} | outcomes


def _gate(settings: Settings, kinematics: InverseKinematics, kind: GateKind) -> Gate:
    return Gate.of(replace(settings, avoidance=replace(settings.avoidance, gate=kind)), kinematics)
