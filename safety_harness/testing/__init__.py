"""What a test needs: scenarios to draw from, and claims that fail it with a picture and a command.

    from hypothesis import given
    from safety_harness.testing import assert_holds, scenarios

    @given(scenario=scenarios("scenarios/spaces/unseen-hand.yaml"))
    def test_keeps_its_distance(scenario, simulate):
        assert_holds("hand distance never below 50 mm", simulate(scenario))

``simulate`` is a fixture of the pytest plug-in, which comes with the package.  The names below are
imported when they are first used, so that nobody waits for a physics engine who does not need one.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from safety_harness.testing.asserting import NotEstablished, SafetyViolation, assert_holds
    from safety_harness.testing.drawing import scenarios
    from safety_harness.testing.simulating import Simulate

__all__ = ["NotEstablished", "SafetyViolation", "Simulate", "assert_holds", "scenarios"]

_HOMES = {
    "testing.asserting": ("NotEstablished", "SafetyViolation", "assert_holds"),
    "testing.drawing": ("scenarios",),
    "testing.simulating": ("Simulate",),
}


def __getattr__(name: str) -> object:
    for home, names in _HOMES.items():
        if name in names:
            return getattr(import_module(f"safety_harness.{home}"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
