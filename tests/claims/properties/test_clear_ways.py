"""Clearances against sampled points, and repulsions that lead into the table or into the robot itself."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from broken import STAYS, passing, proposes_below_the_table
from examples import Displaced, run, scenario

from safety_harness.base.geometry.segments import point_segment_distance
from safety_harness.base.settings import DEFAULTS
from safety_harness.cell.robot.capsules import load_capsules
from safety_harness.cell.robot.description import load_arm
from safety_harness.cell.robot.distance import place_capsules
from safety_harness.cell.robot.kinematics import forward_kinematics
from safety_harness.cell.simulation.truth import cell_capsules
from safety_harness.claims.properties.clear_ways import (
    ClearWays,
    above_polygon,
    clearances_m,
    executed,
    planned,
)
from safety_harness.claims.properties.giving_way import last_tick
from safety_harness.claims.signals.true_motion import arm_of
from safety_harness.scenario.model import Verdict
from safety_harness.trace.trace import Trace

PROP = ClearWays()
SQUARE = np.array([[0.0, 0.0, 0.2], [1.0, 0.0, 0.2], [1.0, 1.0, 0.2], [0.0, 1.0, 0.2]])


@pytest.mark.parametrize(
    ("start", "end", "distance"),
    [
        ((0.5, 0.5, 0.5), (0.5, 0.5, 0.9), 0.3),  # an end above it
        ((0.2, 0.2, 0.5), (0.8, 0.8, 0.5), 0.3),  # level above it
        ((0.5, 0.5, 0.0), (0.5, 0.5, 0.9), 0.0),  # through it
        ((0.5, 0.5, -0.1), (0.5, 0.5, 0.1), 0.1),  # below it
        ((1.3, 0.5, 0.6), (1.3, 0.5, 0.6), 0.5),  # a point beside it
        ((1.3, -0.5, 0.2), (1.3, 1.5, 0.2), 0.3),  # beside it, at its height
        ((2.0, 0.5, 0.0), (2.0, 0.5, 0.4), 1.0),  # passes its plane elsewhere
    ],
)
def test_the_distance_from_a_square_is_what_one_sees(
    start: tuple[float, ...], end: tuple[float, ...], distance: float
) -> None:
    assert above_polygon(np.array(start), np.array(end), SQUARE) == pytest.approx(distance, abs=1e-12)
    assert above_polygon(np.array(end), np.array(start), SQUARE[::-1].copy()) == pytest.approx(distance)


def test_the_distance_from_a_polygon_with_an_inward_corner_agrees_with_sampling() -> None:
    rng = np.random.default_rng(3)
    corners = np.array([[0, 0], [1, 0], [1, 1], [0.5, 0.3], [0, 1.0]])
    polygon = np.column_stack([corners, np.full(5, 0.1)])
    u, v = np.meshgrid(np.linspace(0, 1, 101), np.linspace(0, 1, 101))
    roof = np.where(u < 0.5, 1.0 - 1.4 * u, 1.4 * u - 0.4)
    grid = np.column_stack([u[v <= roof], v[v <= roof], np.full((v <= roof).sum(), 0.1)])
    for _ in range(20):
        start, end = rng.uniform(-0.5, 1.5, size=(2, 3))
        sampled = min(point_segment_distance(point, start, end) for point in grid)
        assert above_polygon(start, end, polygon) == pytest.approx(sampled, abs=0.011)


def test_clearances_are_those_of_points_sampled_on_the_capsules(visit: Trace) -> None:
    arm, capsules = load_arm("ur10"), cell_capsules(load_capsules(), DEFAULTS)
    joints = visit.ticks["joint_position_rad"][:1]
    transforms, placed = np.empty((8, 4, 4)), np.empty((len(capsules.names), 2, 3))
    forward_kinematics(arm.chain[0], joints[0], transforms)
    place_capsules(capsules.records, transforms, placed)
    points = placed[:, 0, None] + np.linspace(0, 1, 200)[:, None] * (placed[:, 1] - placed[:, 0])[:, None]
    radius, link = capsules.radius_m, capsules.link_index
    lowest = (points[..., 2].min(axis=1) - radius)[link >= 3].min()
    wrist, body = np.flatnonzero(link >= 4), np.flatnonzero(link <= 2)
    own = min(
        np.linalg.norm(points[a][:, None] - points[b][None], axis=2).min() - radius[a] - radius[b]
        for a in wrist
        for b in body
    )
    table, thing, itself = clearances_m(visit, joints)[0]
    assert table == pytest.approx(lowest + 0.3, abs=1e-12)
    assert itself == pytest.approx(own, abs=2e-4)
    assert table - 1e-12 <= thing < table + 0.1  # the object lies on the table, below the tool


@pytest.mark.parametrize("which", range(3))
def test_what_is_between_samples_is_bounded_from_below(which: int, visit: Trace) -> None:
    """Of every fourth tick alone, the bound is no higher than the clearance at any tick."""
    thin = replace(
        visit,
        ticks=visit.ticks[::4].copy(),
        scenario=replace(
            visit.scenario,
            settings=replace(DEFAULTS, clock=replace(DEFAULTS.clock, control_period_s=0.032)),
        ),
    )
    decisions = thin.decisions.copy()
    decisions["tick"] = -(-decisions["tick"] // 4)
    first = 4 * int(decisions["tick"][-1])
    reach_m, last = arm_of(visit).reach_m, len(decisions) - 1
    bound = executed(replace(thin, decisions=decisions), last, reach_m).least_m[which]
    true = clearances_m(visit, visit.ticks["joint_position_rad"])[first : last_tick(visit, last) + 1, which]
    assert true.min() - 0.03 < bound <= true.min()


def test_a_visit_keeps_clear_of_everything(visit: Trace) -> None:
    evaluation = PROP.evaluate(visit)
    assert (evaluation.verdict, evaluation.exercised) == (Verdict.HOLDS, len(visit.decisions))
    assert [part.verdict for part in evaluation.parts] == [Verdict.HOLDS] * 3
    assert evaluation.margin == min(part.margin or 0.0 for part in evaluation.parts)


def test_a_way_into_the_table_is_violated_and_its_part_says_so() -> None:
    evaluation = PROP.evaluate(proposes_below_the_table())
    assert evaluation.verdict is Verdict.VIOLATED
    assert evaluation.reason.startswith("table")
    assert [part.verdict for part in evaluation.parts][2] is Verdict.HOLDS


def test_a_plan_into_the_table_is_violated_before_the_arm_gets_there(visit: Trace) -> None:
    decisions = visit.decisions.copy()
    decisions["chosen_position_in_base_m"] = visit.ticks["transform_tcp_to_base"][decisions["tick"], :3, 3]
    decisions["chosen_position_in_base_m"][:, 2] = -0.29
    plan = replace(visit, decisions=decisions)
    assert planned(plan, 0, arm_of(plan).reach_m).least_m[0] < 0.0
    assert executed(plan, 0, arm_of(plan).reach_m).least_m[0] > 0.0
    assert PROP.evaluate(plan).verdict is Verdict.VIOLATED


def test_a_way_into_the_robot_itself_is_violated() -> None:
    inwards = run(scenario(STAYS, duration_s=4.0), avoider=Displaced((-0.6, 0.0, -0.2)), gate=passing())
    evaluation = PROP.evaluate(inwards)
    assert evaluation.verdict is Verdict.VIOLATED, evaluation
    assert evaluation.reason.startswith("robot itself")


def test_a_higher_table_leaves_less(visit: Trace) -> None:
    def margin(height_m: float) -> float:
        cell = replace(DEFAULTS.cell, table_height_m=height_m)
        settings = replace(DEFAULTS, cell=cell)
        of_table = PROP.evaluate(replace(visit, scenario=replace(visit.scenario, settings=settings))).parts[0]
        assert of_table.margin is not None
        return of_table.margin

    assert margin(-0.25) == pytest.approx(margin(-0.3) - 0.05, abs=1e-12)


def test_without_a_way_there_is_nothing_to_judge() -> None:
    assert PROP.evaluate(run(scenario(duration_s=0.2))).verdict is Verdict.INCONCLUSIVE


@pytest.mark.parametrize("field", ["joint_position_rad", "joint_velocity_radps", "transform_tcp_to_base"])
def test_what_is_not_finite_is_no_evidence(field: str, visit: Trace) -> None:
    ticks = visit.ticks.copy()
    ticks[field][len(ticks) // 2] = np.nan
    assert PROP.evaluate(replace(visit, ticks=ticks)).verdict is Verdict.INCONCLUSIVE
    decisions = visit.decisions.copy()
    decisions["chosen_position_in_base_m"] = np.nan
    assert PROP.evaluate(replace(visit, decisions=decisions)).verdict is Verdict.INCONCLUSIVE
