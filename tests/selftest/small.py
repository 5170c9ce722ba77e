"""A small suite on which faults are tried in tests."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path

from safety_harness.admission.admit import Admitted, admit
from safety_harness.extensions.selftest.trial import FaultTrials
from safety_harness.scenario.read import read_scenario

SCENARIOS = Path(__file__).parents[2] / "scenarios"


@lru_cache
def shipped(name: str) -> Admitted:
    return admit(read_scenario(SCENARIOS / f"{name}.yaml"))


@lru_cache
def trials(*names: str) -> FaultTrials:
    return FaultTrials(tuple(shipped(name) for name in names))
