"""Provide the interface for tests.

Tests draw scenarios and check claims; a failed claim is reported with a picture and with a command that
repeats the run.

    from hypothesis import given
    from safety_harness.testing import assert_holds, hand_distance, mm, scenarios

    @given(scenario=scenarios("shipped:reaching-hands"))
    def test_keeps_its_distance(scenario, simulate):
        assert_holds(hand_distance() > mm(50), simulate(scenario))

A claim is a formula, a property of the catalogue, or a sentence as in a scenario file.  ``simulate`` is a
fixture of the pytest plug-in, which is part of the package.  The names below and all names of
``claims.formulas.language`` are public.  The module imports each name when it is first used, so that a test
without a simulation loads no physics engine.
"""

# ruff: noqa: F403
from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from safety_harness.claims.formulas.language import *
    from safety_harness.testing.asserting import NotEstablished as NotEstablished
    from safety_harness.testing.asserting import SafetyViolation as SafetyViolation
    from safety_harness.testing.asserting import assert_holds as assert_holds
    from safety_harness.testing.drawing import scenarios as scenarios
    from safety_harness.testing.simulating import Simulate as Simulate

_HOMES = {
    "NotEstablished": "asserting",
    "SafetyViolation": "asserting",
    "Simulate": "simulating",
    "assert_holds": "asserting",
    "scenarios": "drawing",
}


def __getattr__(name: str) -> object:
    if name in _HOMES:
        return getattr(import_module(f"safety_harness.testing.{_HOMES[name]}"), name)
    if name == "__all__" or not name.startswith("_"):
        language = import_module("safety_harness.claims.formulas.language")
        if name == "__all__":
            return __dir__()
        if name in language.__all__:
            return getattr(language, name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    """Return the public names.

    ``dir`` and the name completion of interpreters use them.
    """
    language = import_module("safety_harness.claims.formulas.language")
    return sorted([*language.__all__, *_HOMES])
