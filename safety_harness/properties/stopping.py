"""Where there is nothing to give way to, the arm stops."""

from __future__ import annotations

from dataclasses import dataclass

from safety_harness.properties.base import Evaluation, Unit, inconclusive, judged, unreadable
from safety_harness.properties.entry import CatalogueEntry
from safety_harness.properties.giving_way import Finding
from safety_harness.properties.positions import opposite_position, stopped_m
from safety_harness.properties.repulsive_pose import reach_m
from safety_harness.trace.trace import Trace

BEYOND_DOUBT_M = 0.0002  # reach is known to 0.1 mm
READS = ("joint_position_rad", "transform_tcp_to_base", "tcp_speed_mps")


@dataclass(frozen=True, kw_only=True)
class StopsWhereNothingIsReachable:
    """Where neither the answer nor the opposite pose can be reached, the arm comes to a stop.

    Both are tried again from the true joints; an avoider that gave no answer gave none that can be
    reached.  Margin: what the TCP's way leaves of that of a protective stop from the decision on
    (``stopped_m``), so that an arm that goes on to anywhere is violated, whatever its controller says.
    """

    unit: Unit = Unit.LENGTH
    sentence: str = "stops where neither answer nor opposite pose can be reached"

    def evaluate(self, trace: Trace) -> Evaluation:
        """Judge each decision that left nothing."""
        problem = unreadable(trace, READS)
        if problem is not None:
            return inconclusive(self, problem)
        findings: list[Finding] = []
        for decision in trace.decisions:
            answers = (decision["proposed_position_in_base_m"], opposite_position(trace, decision))
            if any(reach_m(trace, decision, position) >= -BEYOND_DOUBT_M for position in answers):
                continue
            left_m = stopped_m(trace, int(decision["tick"]))
            findings.append(Finding(left_m, float(decision["time_s"]), "way left of a stop's"))
        if not findings:
            return inconclusive(self, "never exercised: one of the two could always be reached")
        worst = min(findings, key=lambda finding: finding.margin_m)
        return judged(
            self,
            trace,
            margin=worst.margin_m,
            worst_time_s=worst.time_s,
            reason=worst.what + (f", worst of {len(findings)}" if len(findings) > 1 else ""),
            exercised=len(findings),
        )


STOPS = CatalogueEntry(
    example="stops where neither answer nor opposite pose can be reached",
    pattern="stops where neither answer nor opposite pose can be reached",
    make=lambda *_: StopsWhereNothingIsReachable(),
    unit=Unit.LENGTH,
    rationale="an arm that goes on as before has not noticed the hand; one that heads for where it cannot go "
    "ends at its limits",
    source="the last of the three steps: answer, opposite pose, stop",
    margin="way allowed to a protective stop (v T_r + v T_s/2, one period's and 2 mm) less the TCP's",
    parameters="reaction and stop time, radius and least singular value of the settings",
    exercised="a decision of which neither can be reached",
    inconclusive="-",
    scenario="nothing-reachable",
    broken_by="an avoider that proposes a position two metres away, behind a gate that passes everything",
)
