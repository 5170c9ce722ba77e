"""The limiter of the harness and the claim about joint speeds agree, in a whole run."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from safety_harness import admit, read_scenario, run_trial
from safety_harness.properties.limits import JOINT_SPEEDS
from safety_harness.robot.description import urdf_file
from safety_harness.scenario.model import Verdict
from safety_harness.simulation.worlds import worlds_by_label
from safety_harness.trace.trace import Trace
from tests.robot.test_drives import text_of


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
