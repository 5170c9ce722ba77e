"""What a test needs: scenarios to draw from, and claims that fail it with a picture and a command.

    from hypothesis import given
    from safety_harness.testing import assert_holds, hand_distance, mm, scenarios

    @given(scenario=scenarios("scenarios/spaces/unseen-hand.yaml"))
    def test_keeps_its_distance(scenario, simulate):
        assert_holds(hand_distance() > mm(50), simulate(scenario))

A claim is a formula, a property of the catalogue or a sentence as in a scenario file.  ``simulate`` is a
fixture of the pytest plug-in, which comes with the package.  The names below are
imported when they are first used, so that nobody waits for a physics engine who does not need one.
"""

# ruff: noqa: F403, F405
from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from safety_harness.formulas.language import *
    from safety_harness.testing.asserting import NotEstablished, SafetyViolation, assert_holds
    from safety_harness.testing.drawing import scenarios
    from safety_harness.testing.simulating import Simulate

__all__ = [
    "Formula",
    "NotEstablished",
    "Quantity",
    "SafetyViolation",
    "Signal",
    "Simulate",
    "always",
    "angle_to_desired_pose",
    "assert_holds",
    "cm",
    "cm_per_s",
    "deciding",
    "deg",
    "deg_per_s",
    "distance_to_desired_pose",
    "elapsed_time",
    "eventually",
    "falling_back",
    "fault_acting",
    "hand_distance",
    "hand_tracked",
    "image_error",
    "initially",
    "joint_speed",
    "m",
    "m_per_s",
    "minutes",
    "mm",
    "mm_per_s",
    "ms",
    "nearest_hand_to_tcp",
    "object_lost",
    "object_visible",
    "parse_formula",
    "predicted_hand_distance",
    "prediction_error",
    "rad",
    "rad_per_s",
    "repulsing",
    "s",
    "scenarios",
    "servoing",
    "spread",
    "stopped",
    "tcp_height",
    "tcp_speed",
    "whenever",
]

_HOMES = {  # everything else is of formulas.language
    "testing.asserting": ("NotEstablished", "SafetyViolation", "assert_holds"),
    "testing.drawing": ("scenarios",),
    "testing.simulating": ("Simulate",),
}


def __getattr__(name: str) -> object:
    for home, names in _HOMES.items():
        if name in names:
            return getattr(import_module(f"safety_harness.{home}"), name)
    if name in __all__:
        return getattr(import_module("safety_harness.formulas.language"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
