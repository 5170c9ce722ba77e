"""A recorded cell beside one world, without a run."""

from __future__ import annotations

from safety_harness.base.compiled import source_hash
from safety_harness.extensions.assurance.certification.tools import RecordedCell
from safety_harness.extensions.field.recorded.apart import DelayFit, Difference, Estimate
from safety_harness.extensions.field.recorded.compare import (
    CellComparison,
    ClaimOfBoth,
    ClosestHand,
    WorldBeside,
)
from safety_harness.scenario.model import Verdict
from safety_harness.trace.system import SystemUnderTest
from tests.assurance.certification.made_up_evidence import HOSTILE, evidence

(SYSTEM,) = evidence(counterexamples=0).system.under_test
AN_ESTIMATE = Estimate(value=0.002, low=0.001, high=0.003)
A_DIFFERENCE = Difference(
    what="elbow_joint", unit="rad", samples=900, mean=AN_ESTIMATE, usually=0.004, largest=0.005, at_s=2.0,
    recorded_within=1e-4,
)  # fmt: skip


def cell(
    simulated: Verdict = Verdict.HOLDS, *, present: bool = True, system: SystemUnderTest | None = SYSTEM
) -> RecordedCell:
    claim = ClaimOfBoth(
        sentence="hand distance never below 50 mm",
        recorded=Verdict.HOLDS,
        recorded_margin="+10.0 mm",
        simulated=simulated,
        simulated_margin="+12.0 mm",
    )
    world = WorldBeside(
        world="kinematic",
        joints=(A_DIFFERENCE,),
        tcp=None,
        distances=(),
        closest=(ClosestHand(hand=HOSTILE, simulated_m=0.07, recorded_least_m=None, recorded_most_m=0.08),),
        fit=DelayFit(late=None, why="the joints stand", offsets=(AN_ESTIMATE,), before=0.003, left=0.001),
        claims=(claim,),
        absent=(),
    )
    found = CellComparison(
        log="LOG.yaml",
        title=HOSTILE,
        scenario="cell",
        tested="mc-dropout",
        duration_s=7.2,
        joint_samples=901,
        confidence=0.95,
        blocks=10,
        usually=0.95,
        worlds=(world,),
        notes=(),
        package_version="0",
        source_hash=source_hash() if present else "0123456789abcdef",
        python="3",
        platform="any",
        libraries=(),
        files=(("joints.csv", "0" * 64),),
        system=system,
    )
    return RecordedCell(comparison=found, sha256="f" * 64, present=present)
