"""An arm whose motors are too weak, in PyBullet: what is said of distances is true of every sub-step.

Oracle: the engine itself, asked for its joints after each of its steps; it goes straight between them.
"""

from __future__ import annotations

import re
from dataclasses import replace
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from unittest.mock import patch

import numpy as np
import pytest
from dense_motion import least_m
from examples import ConstantSpeed
from numpy.typing import NDArray

from safety_harness import admit, read_scenario, run_trial
from safety_harness.cell.robot.description import urdf_file
from safety_harness.cell.simulation.engine import pybullet
from safety_harness.cell.simulation.pybullet_world import PyBulletWorld
from safety_harness.claims.formulas.claim import FormulaClaim
from safety_harness.claims.formulas.language import always, hand_distance, m
from safety_harness.claims.properties.hand_distance import HandDistance
from safety_harness.claims.signals.hand_distance import joint_bend_m
from safety_harness.claims.signals.true_motion import arm_of
from safety_harness.scenario.model import Verdict
from safety_harness.trace.trace import Trace, not_recorded
from tests.cell.robot.test_drives import text_of

RADPS = np.array([0.9, -0.9, 0.9, -1.2, 0.9, 0.9])


class BackAndForth(ConstantSpeed):
    """It turns all joints, and every twentieth of a second the other way."""

    def step(self, observation: NDArray[np.void]) -> NDArray[np.void]:
        odd = int(observation[0]["time_s"] / 0.05) % 2
        self._command["joint_velocity_radps"] = -RADPS if odd else RADPS
        return self._command


@cache
def run_with(share: float) -> tuple[Trace, NDArray[np.float64]]:
    """A run with that share of the URDF's efforts; (s (n - 1) + 1, joints) where the engine's joints were."""
    text = urdf_file("ur10").read_text()
    weaker = re.sub(r'effort="([\d.]+)"', lambda found: f'effort="{share * float(found[1])!r}"', text)
    positions_rad: list[list[float]] = []
    worlds: list[PyBulletWorld] = []
    step, engine_step = PyBulletWorld.step, pybullet.stepSimulation

    def ask() -> None:
        robot, joints, client = worlds[0]._robot, worlds[0]._joints, worlds[0]._client
        states = pybullet.getJointStates(robot, joints, physicsClientId=client)
        positions_rad.append([state[0] for state in states])

    def world_step(world: PyBulletWorld, command: NDArray[np.void]) -> bool:
        if not worlds:
            worlds.append(world)
            ask()
        return step(world, command)

    def asked_step(**client: int) -> None:
        engine_step(**client)
        ask()

    with TemporaryDirectory() as folder:
        file = text_of(Path(folder), "{}", weaker.encode())
        file.write_text(file.read_text().replace("  drives: {}\n", ""))
        admitted = admit(read_scenario(file))
        with (
            patch.object(PyBulletWorld, "step", world_step),
            patch.object(pybullet, "stepSimulation", asked_step),
        ):
            trace = run_trial(admitted, controller=BackAndForth(tuple(RADPS)))
    return trace, np.array(positions_rad)


def said(trace: Trace, limit_m: float) -> set[Verdict]:
    """What the catalogue and a formula say."""
    formula = FormulaClaim(always(hand_distance() >= m(limit_m)))
    return {prop.evaluate(trace).verdict for prop in (HandDistance(minimum_m=limit_m, near_m=2.0), formula)}


def off_the_straight_way_m(trace: Trace, positions_rad: NDArray[np.float64]) -> NDArray[np.float64]:
    """(n - 1,) how far sub-steps were off the straight way of each tick, each joint by its chain of links."""
    joints_rad = trace.ticks["joint_position_rad"]
    steps = (len(positions_rad) - 1) // (len(joints_rad) - 1)
    off_m = np.zeros(len(joints_rad) - 1)
    for k in range(1, steps):
        straight_rad = joints_rad[:-1] + k / steps * np.diff(joints_rad, axis=0)
        off_m = np.maximum(off_m, np.abs(positions_rad[k:-1:steps] - straight_rad) @ arm_of(trace).reach_m)
    return off_m


@pytest.mark.parametrize("share", [0.1, 0.05])
def test_what_sub_steps_did_is_within_what_the_trace_records(share: float) -> None:
    trace, positions_rad = run_with(share)
    steps = (len(positions_rad) - 1) // (len(trace.ticks) - 1)
    assert np.array_equal(positions_rad[::steps], trace.ticks["joint_position_rad"])
    off_m, bend_m = off_the_straight_way_m(trace, positions_rad), joint_bend_m(trace)
    rates = trace.ticks["joint_velocity_radps"]
    between_m = np.abs(np.diff(rates, axis=0)) @ arm_of(trace).reach_m * 0.008 / 4.0
    assert trace.overshoot_radps.max() > 0.1
    assert (off_m - between_m).max() > 1e-4  # more than speeds between those of both ticks explain
    assert (bend_m >= off_m - 1e-9).all()


@pytest.mark.parametrize("share", [0.1, 0.05])
def test_a_distance_is_judged_by_what_the_arm_did_in_sub_steps(share: float) -> None:
    trace, positions_rad = run_with(share)
    true_m = least_m(trace, positions_rad)
    offs = np.concatenate([-np.geomspace(1e-5, 0.02, 8), np.geomspace(1e-5, 0.02, 8)])
    verdicts = {off: said(trace, true_m + off) for off in offs}
    for off, found in verdicts.items():
        assert (Verdict.VIOLATED if off < 0.0 else Verdict.HOLDS) not in found
    assert verdicts[offs.min()] == {Verdict.HOLDS}
    assert verdicts[offs.max()] == {Verdict.VIOLATED}
    unknown = replace(trace, overshoot_radps=not_recorded())
    assert Verdict.HOLDS not in said(unknown, true_m - 1e-5)
