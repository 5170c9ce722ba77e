"""The fallback is there when it is needed: the opposite pose can be reached and leads away."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from safety_harness.properties.base import Evaluation, Unit, inconclusive, is_somewhere, judged, unreadable
from safety_harness.properties.entry import CatalogueEntry
from safety_harness.properties.giving_way import Finding
from safety_harness.properties.repulsive_pose import reach_m
from safety_harness.trace.trace import Trace

READS = ("joint_position_rad", "transform_tcp_to_base", "hand_position_in_base_m")
WHAT = ("reachable", "away from every hand")


@dataclass(frozen=True, kw_only=True)
class FallbackPoses:
    """At every decision the fallback pose that the gate had at hand is reachable and leads away.

    Asked of all decisions, not only of those that fell back: a net is tested before one falls.  The
    first of the ``parts`` is as for ``repulsive poses reachable``, from the true joints; the second is
    the component of the way to it away from each true hand, least over hands; the margin is the least
    of both.  Where it is violated the system has nothing left but to stop.

    Exercised by every decision; the second part by those made while a true hand was there.
    """

    unit: Unit = Unit.LENGTH
    sentence: str = "fallback poses reachable and away"

    def evaluate(self, trace: Trace) -> Evaluation:
        """Judge the fallback pose of every decision."""
        problem = unreadable(trace, READS)
        if problem is not None:
            return inconclusive(self, problem)
        if len(trace.decisions) == 0:
            return inconclusive(self, "never exercised: no decision was made")
        reachable = [_reachable(trace, decision) for decision in trace.decisions]
        away = [finding for decision in trace.decisions for finding in _away(trace, decision)]
        parts = tuple(
            self._part(trace, what, findings) for what, findings in zip(WHAT, (reachable, away), strict=True)
        )
        known = [part for part in parts if part.margin is not None]
        worst = min(known, key=lambda part: part.margin or 0.0) if known else parts[0]
        return replace(worst, sentence=self.sentence, exercised=len(trace.decisions), parts=parts)

    def _part(self, trace: Trace, what: str, findings: list[Finding]) -> Evaluation:
        if not findings:
            evaluation = inconclusive(self, f"{what}: never exercised, no true hand was there")
        else:
            worst = min(findings, key=lambda finding: finding.margin_m)
            of = f"worst of {len(findings)}" if len(findings) > 1 else "one pose"
            evaluation = judged(
                self,
                trace,
                margin=worst.margin_m,
                worst_time_s=worst.time_s,
                reason=f"{what}{worst.what}: {of}",
                exercised=len(findings),
            )
        return replace(evaluation, sentence=f"fallback poses {what}")


def _reachable(trace: Trace, decision: np.void) -> Finding:
    margin_m = reach_m(trace, decision, decision["opposite_position_in_base_m"])
    return Finding(margin_m, float(decision["time_s"]), "")


def _away(trace: Trace, decision: np.void) -> list[Finding]:
    tick, found = trace.ticks[decision["tick"]], []
    tcp_in_base = tick["transform_tcp_to_base"][:3, 3]
    position = decision["opposite_position_in_base_m"]
    for hand in np.flatnonzero(tick["hand_present"]):
        apart = tcp_in_base - tick["hand_position_in_base_m"][hand]
        distance = float(np.linalg.norm(apart))
        margin_m = -trace.scenario.settings.avoidance.radius_m  # no pose leads away from nobody
        if is_somewhere(position):
            way = position - tcp_in_base
            margin_m = float(way @ apart) / distance if distance > 0.0 else float(np.linalg.norm(way))
        name = trace.scenario.hands[hand].name
        found.append(Finding(margin_m, float(decision["time_s"]), f" ({name})"))
    return found


FALLBACK_POSES = CatalogueEntry(
    example="fallback poses reachable and away",
    pattern="fallback poses reachable and away",
    make=lambda *_: FallbackPoses(),
    unit=Unit.LENGTH,
    rationale="the fallback is what doubt, faults and lateness end in: it has to be there beforehand",
    source="the paper, section 3.3; opposite poses out of reach are counted in its table 4",
    margin="the lesser of how far beyond the pose the straight way goes on (at most 100 mm) and of the way's "
    "component away from each true hand",
    parameters="radius and least singular value of the settings",
    exercised="a decision was made",
    inconclusive="-",
    scenario="hand-visits-and-leaves",
    broken_by="a gate whose fallback heads for the hand",
)
