"""The gate looks at the arm's own body all along a way: against a denser look, and coal's distances."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache

import coal
import numpy as np
import pytest
from examples import ur10_gate

from safety_harness.base.settings import DEFAULTS, GateKind
from safety_harness.cell.avoidance.gate import OWN_CLEARANCE_M, WAY_STEP_M, Query
from safety_harness.cell.avoidance.own_body import body_and_wrist
from safety_harness.cell.controller.desired import desired_transform_tcp_to_base
from safety_harness.cell.robot.inverse import straight_way
from safety_harness.cell.robot.kinematics import forward_kinematics
from safety_harness.cell.robot.robots import inverse_kinematics
from safety_harness.scenario.robots import Robot
from safety_harness.trace.records import Check

KINEMATICS = inverse_kinematics(Robot.UR10)
ARM = KINEMATICS.arm
GATE = ur10_gate(DEFAULTS)
BODY, WRIST = body_and_wrist(ARM, GATE.capsules)
PLAIN = replace(GATE, kind=GateKind.REACH)
Position = tuple[float, float, float]

PAST_THE_BODY: list[tuple[Position, Position]] = [
    ((0.32, -0.31, 0.13), (0.22, 0.63, 0.12)),
    ((0.03, 0.45, 0.04), (-0.34, -0.02, 0.36)),
    ((-0.29, -0.08, 0.11), (0.25, -0.28, 0.15)),
    ((0.20, 0.31, -0.11), (0.30, -0.06, 0.32)),
]


def coal_capsule(start: np.ndarray, end: np.ndarray, radius: float) -> tuple[coal.Capsule, coal.Transform3s]:
    length = float(np.linalg.norm(end - start))
    z = (end - start) / length if length > 0.0 else np.array([0.0, 0.0, 1.0])
    x = np.cross(z, np.eye(3)[np.abs(z).argmin()])
    x /= np.linalg.norm(x)
    turn = np.column_stack((x, np.cross(z, x), z))
    return coal.Capsule(radius, length), coal.Transform3s(turn, (start + end) / 2)


def by_coal_m(joints: np.ndarray) -> float:
    """Least distance of the wrist's capsules from the body's; within them any number below 0."""
    transforms = np.empty((8, 4, 4))
    forward_kinematics(ARM.chain[0], joints, transforms)
    capsules = GATE.capsules
    bodies = []
    for k, link in enumerate(capsules.link_index):
        ends = (
            transforms[link, :3, :3] @ local[k] + transforms[link, :3, 3]
            for local in (capsules.start_in_link, capsules.end_in_link)
        )
        bodies.append((link, coal_capsule(*ends, float(capsules.radius_m[k]))))
    wrist = [body for link, body in bodies if link >= WRIST]
    body = [body for link, body in bodies if link <= BODY]
    return min(
        float(coal.distance(*one, *other, coal.DistanceRequest(), coal.DistanceResult()))
        for one in wrist
        for other in body
    )


@lru_cache
def start_at(tcp: Position) -> Query | None:
    """A query upright at ``tcp``, no hand near; None if no joints lead there."""
    pose = desired_transform_tcp_to_base(DEFAULTS)
    pose[:3, 3] = tcp
    joints = KINEMATICS.nearest(pose, np.array(DEFAULTS.cell.preferred_joint_position_rad))
    if joints is None:
        return None
    return Query(np.zeros(3), pose[:3, 3].copy(), pose, joints, np.empty((0, 3)), 3)


def along_m(start: Query, end: Sequence[float], step_m: float = 0.008) -> np.ndarray:
    """(k,) distances along the whole way, as coal has them; fewer if the arm cannot follow to its end."""
    rows = straight_way(ARM, start.joint_position_rad, np.array(end), step_m=step_m)
    steps = np.ceil(np.linalg.norm(np.array(end) - start.tcp_position_in_base_m) / step_m)
    return np.array([by_coal_m(row) for row in rows]) if len(rows) == steps + 1 else np.empty(0)


@pytest.mark.parametrize(("start", "end"), PAST_THE_BODY)
def test_a_way_that_meets_the_own_body_only_between_its_ends_is_refused(
    start: Position, end: Position
) -> None:
    here = start_at(start)
    assert here is not None
    distances_m = along_m(here, end)
    assert min(distances_m[0], distances_m[-1]) > OWN_CLEARANCE_M + WAY_STEP_M / 2
    assert distances_m.min() < 0.0
    assert GATE.check(np.array(end), here) == Check.ROBOT_ITSELF
    assert PLAIN.check(np.array(end), here) is Check.NONE


def test_a_way_is_refused_if_the_wrist_comes_nearer_than_its_clearance_and_nearer_than_at_the_start() -> None:
    rng = np.random.default_rng(11)
    told = {True: 0, False: 0}
    for _ in range(200):
        here = start_at(tuple(rng.uniform((-0.45, -0.45, -0.1), (0.45, 0.45, 0.5))))
        if here is None:
            continue
        past_the_axis = here.tcp_position_in_base_m * (rng.uniform(-0.5, 1.0), rng.uniform(-0.5, 1.0), 1.0)
        end = past_the_axis + rng.normal(0.0, 0.05, 3)
        failed = GATE.check(end, here)
        if failed & ~Check.ROBOT_ITSELF:
            continue
        distances_m = along_m(here, end, 0.008)
        left_m = distances_m.min() - min(OWN_CLEARANCE_M, distances_m[0])
        told[bool(failed)] += 1
        # between two of its own samples the gate may overlook half a step; here they are 8 mm apart
        assert left_m < 0.004 if failed else left_m > -WAY_STEP_M / 2
    assert min(told.values()) > 8, told


@pytest.mark.parametrize("step_m", [0.002, 0.01, 0.023])  # no multiple of 8 mm: how many steps is rounding
def test_a_short_way_is_looked_at_too(step_m: float) -> None:
    """From just outside the clearance, a little further towards the own body."""
    inwards = np.array([-1.0, 0.0, 0.0])
    beside = next(
        here
        for x_m in np.arange(0.45, 0.25, -0.0005)
        if (here := start_at((float(x_m), 0.0, 0.0))) is not None
        and by_coal_m(here.joint_position_rad) < OWN_CLEARANCE_M + 0.0003
    )
    end = beside.tcp_position_in_base_m + step_m * inwards
    assert by_coal_m(beside.joint_position_rad) > along_m(beside, end)[-1] + 1e-4
    assert GATE.check(end, beside) == Check.ROBOT_ITSELF
    assert GATE.check(beside.tcp_position_in_base_m - step_m * inwards, beside) is Check.NONE


def test_the_reach_is_looked_at_on_a_short_way_too() -> None:
    """Five centimetres short of where a straight way ends, a way that leaves 1 mm of it."""
    here = start_at(DEFAULTS.cell.desired_tcp_position_in_base_m)
    assert here is not None
    outwards = np.array([1.0, 0.0, 0.0])
    limit_m = KINEMATICS.reach_along(
        here.joint_position_rad, outwards, 2.0, min_singular_value=DEFAULTS.motion.min_singular_value
    )
    end = here.tcp_position_in_base_m + (limit_m - 0.001) * outwards
    near_the_end = start_at(tuple(end - 0.05 * outwards))
    assert near_the_end is not None
    assert GATE.check(end, near_the_end) == Check.NEAR_REACH_LIMIT
    assert PLAIN.check(end, near_the_end) is Check.NONE
