"""The limiter of the harness and the claim about joint speeds agree, in a whole run."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from safety_harness import admit, read_scenario, run_trial
from safety_harness.cell.robot.description import urdf_file
from safety_harness.cell.simulation.worlds import worlds_by_label
from safety_harness.claims.formulas.claim import FormulaClaim
from safety_harness.claims.formulas.parse import parse_formula
from safety_harness.claims.properties.limits import JOINT_SPEEDS
from safety_harness.scenario.model import Verdict
from safety_harness.trace.trace import Trace
from tests.cell.robot.test_drives import text_of


def made(folder: Path, world: str, *, torque: str = "100 %", limits: str = "") -> Trace:
    """A hand visits an arm of the user's own that drives on and gives way."""
    file = text_of(folder, f"{{torque limit: {torque}}}", urdf_file("ur10").read_bytes())
    file.write_text(file.read_text().replace("  drives:", f"{limits}  drives:"))
    return run_trial(admit(read_scenario(file)), world=worlds_by_label()[world])


def test_the_limiter_of_the_harness_never_breaks_its_own_claim(tmp_path: Path) -> None:
    limits = f"  joint speed limits: [{', '.join(['3 deg/s'] * 6)}]\n"
    trace = made(tmp_path, "kinematic", limits=limits)
    demanded = np.abs(trace.ticks["joint_velocity_radps"]).max()
    assert demanded > 0.99 * np.deg2rad(3.0)  # the limiter acted
    found = JOINT_SPEEDS.prop.evaluate(trace)
    assert found.verdict is Verdict.HOLDS, (found.verdict, found.margin, found.reason)


def in_pybullet(folder: Path) -> Trace:
    return made(folder, "PyBullet", limits=f"  joint speed limits: [{', '.join(['3 deg/s'] * 6)}]\n")


def test_what_motors_of_an_engine_miss_is_no_violation_and_not_passed_over(tmp_path: Path) -> None:
    """The command is within its limit to the bit; the engine's motors are 1e-10 rad/s beyond it."""
    trace = in_pybullet(tmp_path)
    limit_radps = np.deg2rad(3.0)
    assert np.abs(trace.ticks["demanded_joint_velocity_radps"]).max() == limit_radps
    beyond_radps = np.abs(trace.ticks["joint_velocity_radps"]).max() - limit_radps
    assert 0.0 < beyond_radps < 1e-8
    found = JOINT_SPEEDS.prop.evaluate(trace)
    assert found.verdict is Verdict.INCONCLUSIVE
    assert found.margin == pytest.approx(-beyond_radps, rel=0.1)
    assert "no more than the world's motors may miss" in found.reason
    assert "between -" in found.reason
    assert " and +0.00115 deg/s" in found.reason
    for relation in ("<=", "<"):
        formula = FormulaClaim(parse_formula(f"always joint speed {relation} 3 deg/s")).evaluate(trace)
        assert formula.verdict is Verdict.INCONCLUSIVE
        assert formula.margin == pytest.approx(found.margin, abs=1e-4)
        assert "between -" in formula.reason
        assert " and +0.00115 deg/s" in formula.reason
    assert (
        FormulaClaim(parse_formula("always joint speed < 3.01 deg/s")).evaluate(trace).verdict
        is Verdict.HOLDS
    )


def test_more_than_motors_miss_is_a_violation_in_every_world(tmp_path: Path) -> None:
    trace = in_pybullet(tmp_path)
    for beyond_radps, world, verdict in (
        (2.1e-5, "pybullet", Verdict.VIOLATED),
        (1.9e-5, "pybullet", Verdict.INCONCLUSIVE),
        (1e-12, "kinematic", Verdict.VIOLATED),
        (0.0, "kinematic", Verdict.HOLDS),
    ):
        ticks = trace.ticks.copy()
        limit_radps = np.deg2rad(3.0)
        ticks["joint_velocity_radps"] = np.clip(ticks["joint_velocity_radps"], -limit_radps, limit_radps)
        ticks["joint_velocity_radps"][50, 2] = limit_radps + beyond_radps
        ticks["joint_position_rad"] = ticks["joint_position_rad"][0]  # so that mean speeds are zero
        told = replace(trace, ticks=ticks, provenance=replace(trace.provenance, world=world))
        assert JOINT_SPEEDS.prop.evaluate(told).verdict is verdict
