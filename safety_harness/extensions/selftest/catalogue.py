"""List all seeded faults, and the changes that are declared harmless."""

from __future__ import annotations

from safety_harness.extensions.selftest.avoider_faults import AVOIDER_FAULTS
from safety_harness.extensions.selftest.filter_faults import FILTER_FAULTS
from safety_harness.extensions.selftest.gate_faults import GATE_FAULTS
from safety_harness.extensions.selftest.harmless import HARMLESS
from safety_harness.extensions.selftest.motion_faults import MOTION_FAULTS
from safety_harness.extensions.selftest.perception_faults import PERCEPTION_FAULTS
from safety_harness.extensions.selftest.predictor_faults import PREDICTOR_FAULTS
from safety_harness.extensions.selftest.servoing_faults import SERVOING_FAULTS
from safety_harness.extensions.selftest.shield_faults import SHIELD_FAULTS
from safety_harness.extensions.selftest.timing_faults import TIMING_FAULTS

FAULTS = (
    *AVOIDER_FAULTS,
    *GATE_FAULTS,
    *PERCEPTION_FAULTS,
    *PREDICTOR_FAULTS,
    *SERVOING_FAULTS,
    *MOTION_FAULTS,
    *SHIELD_FAULTS,
    *FILTER_FAULTS,
    *TIMING_FAULTS,
)
EVERY = (*FAULTS, *HARMLESS)
