"""Every seeded fault, and the changes that are declared harmless."""

from __future__ import annotations

from types import ModuleType

from safety_harness.selftest import (
    avoider_faults,
    gate_faults,
    harmless,
    motion_faults,
    perception_faults,
    servoing_faults,
    timing_faults,
)
from safety_harness.selftest.fault import SeededFault


def _declared_in(*modules: ModuleType) -> tuple[SeededFault, ...]:
    """In the order in which they stand there."""
    return tuple(one for module in modules for one in vars(module).values() if isinstance(one, SeededFault))


FAULTS = _declared_in(
    avoider_faults, gate_faults, perception_faults, servoing_faults, motion_faults, timing_faults
)
HARMLESS = _declared_in(harmless)
EVERY = (*FAULTS, *HARMLESS)
